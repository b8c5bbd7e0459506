// Lane markings: ribbons on the road in the true width of the paint, at least a pixel and a half wide, dashes in their true lengths.
import { BufferAttribute, BufferGeometry, Color, DoubleSide, Group, Matrix4, Mesh, ShaderMaterial } from "three";
import type { Marking, Vec3 } from "./api";
import { isGone, type Cone, type Kind } from "./kinds";
import type { Stage } from "./scene";
import { colourOf, colours } from "./theme";

const PICK_PX = 9;
/** Of the paint (src/conetl/exports/kind_marks.py, compared by a test). */
export const PAINT: Record<Marking["colour"], string> = { white: "#ffffff", yellow: "#f2b705", other: "#9aa5b0" };
/** Above the road, so that the map under it does not show through. */
const LIFT_M = 0.02;
/** Half widths: of unchanged paint, of changes, and of the rim around both. */
const [PAINT_PX, CHANGE_PX, RIM_PX] = [1, 1.8, 1];
/** A line that is gone is drawn in short pieces. */
const GONE = { dash_m: 0.7, gap_m: 0.7 };
/** Ends of stretches of one line are at most this far apart. */
const JOIN_M = 0.6;

/** Unchanged lines have the colour of their paint, others that of their change. */
export const isQuiet = (kind: Kind): boolean => kind === "standing" || kind === "confirmed" || kind === "unchanged";
const patternOf = ({ dash_m, gap_m }: { dash_m: number | null; gap_m: number | null }): string => `dashed, ${dash_m?.toFixed(1)} m with gaps of ${gap_m?.toFixed(1)} m`;
/** "white, dashed, 3.0 m with gaps of 9.0 m". */
export const wordsOf = (m: Marking): string => `${m.colour}, ${m.dash_m === null ? "solid" : patternOf(m)}`;

export function lengthOf(line: Vec3[]): number {
  return line.reduce((sum, p, i) => sum + (i ? Math.hypot(p[0] - line[i - 1]![0], p[1] - line[i - 1]![1], p[2] - line[i - 1]![2]) : 0), 0);
}

/** East and north of the unit vector to the left of a line at one of its vertices. */
export function leftAt(line: Vec3[], i: number): [number, number] {
  const [a, b] = [line[Math.max(i - 1, 0)]!, line[Math.min(i + 1, line.length - 1)]!];
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1;
  return [-(b[1] - a[1]) / length, (b[0] - a[0]) / length];
}

interface Ribbon {
  line: Vec3[];
  half_m: number;
  colour: string;
  least_px: number;
  dash_m: number;
  /** Dash and gap; 0 of solid lines. */
  period_m: number;
  /** Where along the dashes the line begins. */
  start_m: number;
}

export function createMarkings(stage: Stage) {
  const group = new Group();
  const material = ribbonMaterial();
  const mesh = new Mesh(new BufferGeometry(), material);
  mesh.frustumCulled = false;
  mesh.renderOrder = -0.5; // on the ground: everything else is drawn over it
  group.add(mesh);
  let stretches: Cone[] = [];
  const seen = new Matrix4();

  function show(next: Cone[]): void {
    stretches = next;
    mesh.geometry.dispose();
    mesh.geometry = geometryOf(ribbonsOf(stretches));
    mesh.visible = stretches.length > 0;
  }

  /** The stretch under a point of the canvas. */
  function pick(x: number, y: number): Cone | null {
    const e = seen.multiplyMatrices(stage.camera.projectionMatrix, stage.camera.matrixWorldInverse).elements;
    const at = (row: number, [px, py, pz]: Vec3) => e[row]! * px + e[row + 4]! * py + e[row + 8]! * pz + e[row + 12]!;
    const { clientWidth: width, clientHeight: height } = stage.canvas;
    let [best, least]: [Cone | null, number] = [null, PICK_PX];
    for (const stretch of stretches) {
      let before: [number, number] | null = null;
      for (const vertex of stretch.marking?.line_m ?? []) {
        const w = at(3, vertex);
        const here: [number, number] | null = w > 0 ? [((at(0, vertex) / w + 1) / 2) * width, ((1 - at(1, vertex) / w) / 2) * height] : null;
        const distance = here && before ? distanceToSegment(x, y, ...before, ...here) : Infinity;
        if (distance < least) [best, least] = [stretch, distance];
        before = here;
      }
    }
    return best;
  }

  return { group, show, pick };
}

export function distanceToSegment(x: number, y: number, ax: number, ay: number, bx: number, by: number): number {
  const dx = bx - ax;
  const dy = by - ay;
  const length2 = dx * dx + dy * dy;
  const t = length2 ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / length2)) : 0;
  return Math.hypot(x - ax - t * dx, y - ay - t * dy);
}

function ribbonsOf(stretches: Cone[]): Ribbon[] {
  const starts = dashStarts(stretches);
  return stretches.flatMap(({ id, kind, marking, oldLine }) => {
    if (!marking) return [];
    const half_m = marking.width_m / 2;
    const gone = isGone(kind);
    const { dash_m, gap_m } = gone ? GONE : marking;
    const pattern = { dash_m: dash_m ?? 0, period_m: (dash_m ?? 0) + (gap_m ?? 0), start_m: gone ? 0 : starts.get(id) ?? 0 };
    const now: Ribbon = {
      line: marking.line_m, half_m, colour: isQuiet(kind) ? PAINT[marking.colour] : colourOf(kind),
      least_px: isQuiet(kind) ? PAINT_PX : CHANGE_PX, ...pattern,
    };
    const old = kind === "moved" && oldLine ? [{ ...now, line: oldLine, dash_m: GONE.dash_m, period_m: GONE.dash_m + GONE.gap_m, start_m: 0 }] : [];
    return [...old, now];
  }); // prettier-ignore
}

/** The map does not hold where dashes begin: along a row of stretches they go on from each to the next. */
function dashStarts(stretches: Cone[]): Map<string, number> {
  const dashed = stretches.filter((s) => s.marking?.dash_m && !isGone(s.kind));
  const cell = ([x, y]: Vec3, dx = 0, dy = 0) => `${Math.floor(x / JOIN_M) + dx} ${Math.floor(y / JOIN_M) + dy}`;
  const ends = new Map<string, Cone[]>();
  for (const s of dashed) {
    const key = cell(s.marking!.line_m.at(-1)!);
    ends.set(key, [...(ends.get(key) ?? []), s]);
  }
  const near = [-1, 0, 1].flatMap((dx) => [-1, 0, 1].map((dy) => [dx, dy] as const));
  const before = (s: Cone): Cone | undefined => {
    const start = s.marking!.line_m[0]!;
    const found = near.flatMap(([dx, dy]) => ends.get(cell(start, dx, dy)) ?? []);
    return found.find((o) => o !== s && Math.hypot(...([0, 1] as const).map((k) => o.marking!.line_m.at(-1)![k] - start[k])) < JOIN_M);
  };
  const starts = new Map<string, number>();
  for (const s of dashed) {
    const row: Cone[] = [];
    const seen = new Set<string>();
    for (let at: Cone | undefined = s; at && !starts.has(at.id) && !seen.has(at.id); at = before(at)) {
      row.push(at);
      seen.add(at.id);
    }
    let last = row.length ? before(row.at(-1)!) : undefined;
    for (const one of row.reverse()) {
      starts.set(one.id, last && starts.has(last.id) ? starts.get(last.id)! + lengthOf(last.marking!.line_m) : 0);
      last = one;
    }
  }
  return starts;
}

/** Two vertices per vertex of a line, one on each side, and two triangles between neighbours. */
function geometryOf(ribbons: Ribbon[]): BufferGeometry {
  const count = ribbons.reduce((sum, r) => sum + r.line.length, 0);
  const make = (size: number) => new Float32Array(count * 2 * size);
  const [position, across, along, tint, shape] = [make(3), make(3), make(1), make(3), make(4)];
  const index: number[] = [];
  const colour = new Color();
  let at = 0;
  for (const { line, half_m, colour: css, least_px, dash_m, period_m, start_m } of ribbons) {
    const rgb = colour.set(css).toArray();
    let station = start_m;
    line.forEach(([x, y, z], i) => {
      const left = leftAt(line, i);
      if (i) station += Math.hypot(x - line[i - 1]![0], y - line[i - 1]![1], z - line[i - 1]![2]);
      for (const side of [-1, 1]) {
        position.set([x, y, z + LIFT_M], at * 3);
        across.set([...left, side], at * 3);
        along[at] = station;
        tint.set(rgb, at * 3);
        shape.set([half_m, least_px, dash_m, period_m], at * 4);
        at += 1;
      }
      if (i) index.push(at - 4, at - 3, at - 2, at - 2, at - 3, at - 1);
    });
  }
  return new BufferGeometry()
    .setAttribute("position", new BufferAttribute(position, 3)).setAttribute("across", new BufferAttribute(across, 3))
    .setAttribute("along", new BufferAttribute(along, 1)).setAttribute("tint", new BufferAttribute(tint, 3))
    .setAttribute("shape", new BufferAttribute(shape, 4)).setIndex(index); // prettier-ignore
}

function ribbonMaterial(): ShaderMaterial {
  const material = new ShaderMaterial({
    vertexShader: VERTEX, fragmentShader: FRAGMENT, side: DoubleSide,
    uniforms: { perMetre: { value: 1 }, rimPx: { value: RIM_PX }, rim: { value: new Color() } },
  }); // prettier-ignore
  material.onBeforeRender = (renderer, _scene, camera) => {
    const projection = camera.projectionMatrix.elements[5] ?? 1;
    material.uniforms["perMetre"]!.value = (renderer.domElement.clientHeight * projection) / 2;
    (material.uniforms["rim"]!.value as Color).set(colours().rim);
    material.uniformsNeedUpdate = true;
  };
  return material;
}

/** `shape`: half width (m), least half width (px), dash and period (m). */
const VERTEX = /* glsl */ `
attribute vec3 across;
attribute float along;
attribute vec3 tint;
attribute vec4 shape;
uniform float perMetre;
uniform float rimPx;
varying vec3 vTint;
varying float vAcross;
varying float vAlong;
varying vec2 vDash;
void main() {
  vec4 middle = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  float pixel_m = max(middle.w, 0.01) / perMetre;
  float paint = max(shape.x, shape.y * pixel_m);
  float whole = paint + rimPx * pixel_m;
  vTint = tint;
  vAcross = across.z * whole / paint;
  vAlong = along;
  vDash = shape.zw;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position + vec3(across.xy, 0.0) * across.z * whole, 1.0);
}`;
const FRAGMENT = /* glsl */ `
uniform vec3 rim;
varying vec3 vTint;
varying float vAcross;
varying float vAlong;
varying vec2 vDash;
void main() {
  // Dashes of less than three pixels would flicker: the line is drawn without its gaps.
  if (vDash.y > 0.0 && mod(vAlong, vDash.y) > vDash.x && 3.0 * fwidth(vAlong) < vDash.y) discard;
  float soft = 0.5 * fwidth(vAcross);
  gl_FragColor = vec4(mix(vTint, rim, smoothstep(1.0 - soft, 1.0 + soft, abs(vAcross))), 1.0);
  #include <colorspace_fragment>
}`;
