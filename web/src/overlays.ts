// Overlays: camera paths, the camera of an image, the error ellipse of the selected cone, labels.
import {
  BufferGeometry, CircleGeometry, DoubleSide, Float32BufferAttribute, Group, Line, LineBasicMaterial, LineLoop, LineSegments, Mesh,
  MeshBasicMaterial, Object3D, Shape, ShapeGeometry, Vector3,
} from "three";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";
import type { FrameView, HistoryItem, Trajectory, Vec3 } from "./api";
import { el } from "./dom";
import type { Cone } from "./kinds";
import { leftAt } from "./markings";
import type { Stage } from "./scene";
import { colours, colourVariable, onTheme } from "./theme";

/** Number of sigmas that contain 95 % of a normal distribution in two dimensions. */
export const SIGMAS_95 = Math.sqrt(-2 * Math.log(0.05));
const FRUSTUM_DEPTH_M = 1.6;
const ARROW_EVERY_M = 8;
/** Distance of the frame of a selected lane marking from its middle. */
const FRAME_M = 0.3;
const MAX_LABELS = 60;
/** Width and height reserved for a label. */
const LABEL_PX = [64, 20] as const;
/** Objects nearer than this to a labelled one, along either axis, may be hidden by its label. */
const NEAR_M = 10;

export interface Ellipse {
  /** Semi-axes on the ground that contain 95 %, and the direction of the major one, counter-clockwise from east. */
  major_m: number;
  minor_m: number;
  angle_rad: number;
}

export function ellipse95(cov: HistoryItem["cov_m2"]): Ellipse {
  const [xx, xy, , yy] = cov;
  const mean = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, xy);
  return {
    major_m: SIGMAS_95 * Math.sqrt(mean + spread),
    minor_m: SIGMAS_95 * Math.sqrt(Math.max(mean - spread, 0)),
    angle_rad: 0.5 * Math.atan2(2 * xy, xx - yy),
  };
}

export const tipOf = ({ xyz: [x, y, z], height_m }: Cone): Vec3 => [x, y, z + height_m];

/** Enlargement that makes the ellipse visible beside a cone. */
export const niceFactor = (e: Ellipse): number => [1, 10, 100, 1000].find((f) => e.major_m * f >= 0.3) ?? 1000;

export function createOverlays(stage: Stage, host: HTMLElement) {
  const paths = new Group();
  const selection = new Group();
  const frustum = new Group();
  stage.scene.add(paths, selection, frustum);
  const labels = el("div", { class: "labels", aria: { hidden: "true" } });
  host.append(labels);
  let labelled: { at: Vec3; node: HTMLElement; near: Vec3[] }[] = [];
  onTheme(() => paths.traverse((part) => {
    if (part instanceof Line || part instanceof Mesh) (part.material as LineBasicMaterial).color.set(colours().path);
  })); // prettier-ignore

  stage.beforeDraw(() => {
    const taken: [number, number][] = [];
    for (const { at, node, near } of labelled) {
      const pixel = stage.project(at);
      // From a distance labels would overlap: the first one stays.
      node.hidden = pixel === null || taken.some(([x, y]) => Math.abs(x - pixel[0]) < LABEL_PX[0] && Math.abs(y - pixel[1]) < LABEL_PX[1]);
      if (!pixel || node.hidden) continue;
      taken.push(pixel);
      const beside = near.map((one) => stage.project(one)).filter((one) => one !== null);
      const hides = (side: number) => beside.some(([x, y]) => {
        const [right, up] = [(x - pixel[0]) * side, pixel[1] - y];
        return right > 0 && right < LABEL_PX[0] + 16 && up > 0 && up < 2 * LABEL_PX[1] + 4;
      }); // prettier-ignore
      node.classList.toggle("left", hides(1) && !hides(-1));
      node.style.transform = `translate(${Math.round(pixel[0])}px, ${Math.round(pixel[1])}px)`;
    }
  });

  return {
    showPaths(drives: Trajectory[]): void {
      empty(paths);
      for (const drive of drives) {
        const line = new Line(geometry(drive.xyz_m), new LineBasicMaterial({ color: colours().path }));
        paths.add(line, ...chevrons(drive.xyz_m));
      }
      stage.draw();
    },

    /** `line`: of a lane marking, framed instead of an ellipse. */
    showSelection(at: Vec3 | null, ellipse: Ellipse | null, factor: number, line?: Vec3[]): void {
      empty(selection);
      if (line) {
        const frame = new LineLoop(geometry([...beside(line, FRAME_M), ...beside(line, -FRAME_M).reverse()]), new LineBasicMaterial({ color: colours().ellipse, depthTest: false }));
        frame.renderOrder = 2;
        selection.add(frame);
      }
      if (at && ellipse) {
        const circle = new CircleGeometry(1, 72);
        const points = Array.from({ length: 72 }, (_, i) => new Vector3(Math.cos((i * Math.PI) / 36), Math.sin((i * Math.PI) / 36), 0));
        const rim = new LineLoop(new BufferGeometry().setFromPoints(points), new LineBasicMaterial({ color: colours().ellipse, depthTest: false }));
        const fill = new Mesh(circle, new MeshBasicMaterial({ color: colours().ellipse, transparent: true, opacity: 0.22, depthTest: false, side: DoubleSide }));
        for (const part of [fill, rim]) {
          part.scale.set(ellipse.major_m * factor, ellipse.minor_m * factor, 1);
          part.rotation.z = ellipse.angle_rad;
          part.position.set(at[0], at[1], at[2] + 0.01);
          part.renderOrder = 2;
          selection.add(part);
        }
      }
      stage.draw();
    },

    /** Where an image was taken, and the line to what it shows. */
    showCamera(view: FrameView | null, target: Vec3 | null): void {
      empty(frustum);
      if (view) {
        const centre = new Vector3(...view.xyz_m);
        const [left, top] = [-view.cx_px / view.fx_px, -view.cy_px / view.fy_px];
        const [right, bottom] = [left + view.width_px / view.fx_px, top + view.height_px / view.fy_px];
        const rays: Vec3[] = [[left, top, 1], [right, top, 1], [right, bottom, 1], [left, bottom, 1]];
        const corner = rays.map((ray) => centre.clone().add(rotate(view.map_R_camera, ray).multiplyScalar(FRUSTUM_DEPTH_M)));
        const points: Vector3[] = [];
        corner.forEach((c, i) => points.push(centre, c, c, corner[(i + 1) % 4] ?? c));
        const [a, b] = [corner[0], corner[1]];
        if (a && b) {
          const roof = a.clone().lerp(b, 0.5).add(rotate(view.map_R_camera, [0, -0.25, 0]));
          points.push(a.clone().lerp(b, 0.35), roof, roof, a.clone().lerp(b, 0.65));
        }
        const lines = new LineSegments(new BufferGeometry().setFromPoints(points), new LineBasicMaterial({ color: colours().camera }));
        frustum.add(lines);
        const material = new LineBasicMaterial({ color: colours().camera, transparent: true, opacity: 0.55 });
        if (target) frustum.add(new Line(new BufferGeometry().setFromPoints([centre, new Vector3(...target)]), material));
      }
      stage.draw();
    },

    showLabels(cones: Cone[], chosen: string | null): void {
      const moved = cones.filter((c) => c.id !== chosen && c.kind === "moved" && c.shift_m !== null).slice(0, MAX_LABELS);
      const wanted = [...cones.filter((c) => c.id === chosen), ...moved];
      labelled = wanted.map((cone) => {
        const isChosen = cone.id === chosen;
        const text = [isChosen ? cone.id.slice(0, 8) : "", cone.kind === "moved" && cone.shift_m !== null ? `${cone.shift_m.toFixed(2)} m` : ""]
          .filter(Boolean).join(" · "); // prettier-ignore
        const node = el("span", { class: isChosen ? "label chosen" : "label", textContent: text });
        node.style.setProperty("--colour", colourVariable(cone.kind));
        const near = cones.filter((c) => c !== cone && Math.abs(c.xyz[0] - cone.xyz[0]) < NEAR_M && Math.abs(c.xyz[1] - cone.xyz[1]) < NEAR_M);
        return { at: tipOf(cone), node, near: near.map(tipOf) };
      });
      labels.replaceChildren(...labelled.map(({ node }) => node));
      stage.draw();
    },
  };
}

function empty(group: Group): void {
  const children: Object3D[] = [...group.children];
  for (const child of children) {
    group.remove(child);
    if (child instanceof Mesh || child instanceof Line) child.geometry.dispose();
  }
}

function geometry(points: Vec3[]): BufferGeometry {
  return new BufferGeometry().setAttribute("position", new Float32BufferAttribute(points.flat(), 3));
}

/** A line at an offset to its left. */
function beside(line: Vec3[], left_m: number): Vec3[] {
  return line.map(([x, y, z], i) => {
    const [east, north] = leftAt(line, i);
    return [x + left_m * east, y + left_m * north, z];
  });
}

function rotate(R: [Vec3, Vec3, Vec3], v: Vec3): Vector3 {
  const [a, b, c] = R.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  return new Vector3(a, b, c);
}

/** Arrow heads along a path, in the direction of travel: in one mesh, as instances cost more than their two triangles. */
function chevrons(points: Vec3[]): Object3D[] {
  const shape = new ShapeGeometry(new Shape().moveTo(0.45, 0).lineTo(-0.3, 0.3).lineTo(-0.12, 0).lineTo(-0.3, -0.3).closePath());
  const heads: BufferGeometry[] = [];
  let since = ARROW_EVERY_M / 2;
  for (let i = 1; i < points.length; i++) {
    const [a, b] = [points[i - 1], points[i]];
    if (!a || !b) continue;
    since += Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (since < ARROW_EVERY_M) continue;
    since = 0;
    heads.push(shape.clone().rotateZ(Math.atan2(b[1] - a[1], b[0] - a[0])).translate(...b));
  }
  return heads.length ? [new Mesh(mergeGeometries(heads), new MeshBasicMaterial({ color: colours().path, side: DoubleSide }))] : [];
}
export type Overlays = ReturnType<typeof createOverlays>;
