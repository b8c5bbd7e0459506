// The cones: true-size bodies (instanced), markers of fixed size above them, translucent old positions and arrows.
import {
  BoxGeometry, BufferAttribute, BufferGeometry, Color, ConeGeometry, CylinderGeometry, DynamicDrawUsage, Group, InstancedMesh,
  Matrix4, Mesh, Points, Quaternion, ShaderMaterial, Vector3,
} from "three";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";
import type { Vec3 } from "./api";
import { isGone, STYLES, type Cone } from "./kinds";
import type { Stage } from "./scene";
import { colourOf, colours } from "./theme";

const PICK_PX = 18;
/** Smaller cones are drawn as their marker alone. */
const MIN_BODY_PX = 4;
/** Marker's height above the tip; in the plan it is on the cone. */
const MARKER_LIFT_PX = 13;
const lift = (stage: Stage) => (stage.plan ? 0 : MARKER_LIFT_PX);

export function createCones(stage: Stage) {
  const body = coneGeometry();
  const solid = shaded(1);
  const ghost = shaded(0.3);
  const group = new Group();
  stage.scene.add(group);
  const markers = markerPoints(stage);
  stage.scene.add(markers.points);
  let cones: Cone[] = [];
  const seen = new Matrix4();

  const standing = bodies(body, solid);
  const gone = bodies(body, ghost);
  const arrows = new Mesh(new BufferGeometry(), solid); // all in one: each draw call costs
  arrows.frustumCulled = false;
  arrows.visible = false;
  group.add(standing.mesh, gone.mesh, arrows);
  stage.beforeDraw(() => {
    standing.cull(stage);
    gone.cull(stage);
  });

  function show(next: Cone[]): void {
    cones = next;
    const colour = (c: Cone) => colourOf(c.kind);
    standing.set(cones.filter((c) => !isGone(c.kind)).map((c) => ({ at: c.xyz, height: c.height_m, colour: colour(c) })));
    gone.set(
      cones.flatMap((c) => {
        const at = isGone(c.kind) ? c.xyz : c.kind === "moved" ? c.old : null;
        return at ? [{ at, height: c.height_m, colour: colour(c) }] : [];
      }),
    );
    const made = cones.flatMap((c) => (c.kind === "moved" && c.old ? arrow(c.old, c.xyz, 0.32 * c.height_m, colour(c)) : []));
    arrows.geometry.dispose();
    arrows.geometry = made.length ? mergeGeometries(made) : new BufferGeometry();
    arrows.visible = made.length > 0;
    markers.set(cones);
    stage.draw();
  }

  /** The cone under a point of the canvas. */
  function pick(x: number, y: number): Cone | null {
    let best: Cone | null = null;
    let bestScore = 1;
    // One matrix for all, and nothing allocated in the loop: with thousands of cones a click must not wait for the garbage collector.
    const e = seen.multiplyMatrices(stage.camera.projectionMatrix, stage.camera.matrixWorldInverse).elements;
    const at = (row: number, px: number, py: number, pz: number) => e[row]! * px + e[row + 4]! * py + e[row + 8]! * pz + e[row + 12]!;
    const { clientWidth: width, clientHeight: height } = stage.canvas;
    for (const cone of cones) {
      const [cx, cy, cz] = cone.xyz;
      const top = cz + cone.height_m;
      const wFoot = at(3, cx, cy, cz);
      const wTip = at(3, cx, cy, top);
      if (wFoot <= 0 || wTip <= 0 || at(2, cx, cy, cz) > wFoot) continue;
      const footX = ((at(0, cx, cy, cz) / wFoot + 1) / 2) * width;
      const footY = ((1 - at(1, cx, cy, cz) / wFoot) / 2) * height;
      const tipX = ((at(0, cx, cy, top) / wTip + 1) / 2) * width;
      const tipY = ((1 - at(1, cx, cy, top) / wTip) / 2) * height;
      // Distance to the line from the foot to the marker above the tip, in units of how near a click must be.
      const reach = Math.max(PICK_PX, Math.hypot(tipX - footX, tipY - footY) * 0.35);
      const score = distanceToSegment(x, y, footX, footY, tipX, tipY - lift(stage)) / reach;
      if (score < bestScore) {
        bestScore = score;
        best = cone;
      }
    }
    return best;
  }

  return {
    show, pick,
    /** Whether they are drawn: the comparison by swipe draws two sets, one on each side. */
    setVisible: (on: boolean) => void (group.visible = markers.points.visible = on),
  };
}

interface Body {
  at: Vec3;
  height: number;
  colour: string;
}

/** Cones of one material. Those smaller than a few pixels are left out: their marker represents them. */
function bodies(geometry: BufferGeometry, material: ShaderMaterial) {
  let items: Body[] = [];
  const matrix = new Matrix4();
  const colour = new Color();
  let mesh = make(1);
  const holder = new Group().add(mesh);

  function make(capacity: number): InstancedMesh {
    const made = new InstancedMesh(geometry, material, capacity);
    made.frustumCulled = false;
    made.count = 0;
    made.setColorAt(0, colour); // with colours from the start: it is compiled once
    return made;
  }

  return {
    mesh: holder,
    set(next: Body[]): void {
      items = next;
      holder.remove(mesh);
      mesh.dispose();
      mesh = make(Math.max(items.length, 1));
      holder.add(mesh);
    },
    cull(stage: Stage): void {
      let count = 0;
      for (const { at, height, colour: css } of items) {
        if (!stage.sees(at, height, MIN_BODY_PX)) continue;
        mesh.setMatrixAt(count, matrix.makeScale(height, height, height).setPosition(...at));
        mesh.setColorAt(count, colour.set(css));
        count += 1;
      }
      mesh.count = count;
      mesh.visible = count > 0;
      mesh.instanceMatrix.needsUpdate = true;
      if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
    },
  };
}

function distanceToSegment(x: number, y: number, ax: number, ay: number, bx: number, by: number): number {
  const dx = bx - ax;
  const dy = by - ay;
  const length2 = dx * dx + dy * dy;
  const t = length2 ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / length2)) : 0;
  return Math.hypot(x - ax - t * dx, y - ay - t * dy);
}

/** A cone of height 1 with its foot's centre at the origin and z up; shades of one colour, a light band as on the road. */
function coneGeometry(): BufferGeometry {
  const radius = (z: number) => 0.2 - 0.165 * z;
  const plate = new BoxGeometry(0.56, 0.56, 0.05).translate(0, 0, 0.025);
  const part = (from: number, to: number) =>
    new CylinderGeometry(radius(to), radius(from), to - from, 20, 1, false)
      .rotateX(Math.PI / 2)
      .translate(0, 0, (from + to) / 2);
  const parts: [BufferGeometry, number][] = [
    [plate, 0.62], [part(0.05, 0.45), 1.0], [part(0.45, 0.7), 1.9], [part(0.7, 1.0), 1.0],
  ];
  return mergeGeometries(parts.map(([geometry, shade]) => tinted(geometry, new Color(shade, shade, shade))));
}

function tinted(geometry: BufferGeometry, { r, g, b }: Color): BufferGeometry {
  const tint = new Float32Array(geometry.getAttribute("position").count * 3);
  for (let i = 0; i < tint.length; i += 3) tint.set([r, g, b], i);
  return geometry.setAttribute("color", new BufferAttribute(tint, 3));
}

/** Lambert shading per vertex, with light from above and the south-west: without a graphics card much faster than three's material. */
function shaded(opacity: number): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: SHADED_VERTEX, fragmentShader: SHADED_FRAGMENT, vertexColors: true, uniforms: { opacity: { value: opacity } },
    transparent: opacity < 1, depthWrite: opacity === 1,
  }); // prettier-ignore
}

const SHADED_VERTEX = /* glsl */ `
varying vec3 vTint;
void main() {
  vec4 at = vec4(position, 1.0);
  vec3 n = normal;
  vTint = color;
#ifdef USE_INSTANCING
  at = instanceMatrix * at;
  n = mat3(instanceMatrix) * n;
#endif
#ifdef USE_INSTANCING_COLOR
  vTint *= instanceColor;
#endif
  vTint *= 0.6 + 0.51 * max(dot(normalize(n), vec3(-0.296, -0.474, 0.829)), 0.0);
  gl_Position = projectionMatrix * modelViewMatrix * at;
}`;
const SHADED_FRAGMENT = /* glsl */ `
uniform float opacity;
varying vec3 vTint;
void main() {
  gl_FragColor = vec4(vTint, opacity);
  #include <colorspace_fragment>
}`;

/** From the old position to the rim of the cone at the new one, `short_m` before its centre. */
function arrow(from: Vec3, to: Vec3, short_m: number, colour: string): BufferGeometry[] {
  const [a, b] = [new Vector3(...from), new Vector3(...to)];
  const path = b.clone().sub(a);
  const length = Math.max(path.length() - short_m, 0.05);
  const head = Math.min(0.35, length * 0.35);
  const shaft = new CylinderGeometry(0.035, 0.035, Math.max(length - head, 0.01), 8).translate(0, (length - head) / 2, 0);
  const tip = new ConeGeometry(0.12, head, 12).translate(0, length - head / 2, 0);
  const turn = new Quaternion().setFromUnitVectors(new Vector3(0, 1, 0), path.normalize());
  return [shaft, tip].map((part) => tinted(part.applyQuaternion(turn).translate(a.x, a.y, a.z + 0.08), new Color(colour)));
}

// --- markers

const VERTEX = /* glsl */ `
attribute vec3 tint;
attribute float shape;
uniform float size;
uniform float lift;
varying vec3 vTint;
varying float vShape;
void main() {
  vTint = tint;
  vShape = shape;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  gl_Position.y += lift * gl_Position.w;
  gl_PointSize = shape < 0.5 ? size * 0.72 : size;
}`;
const FRAGMENT = /* glsl */ `
uniform vec3 halo;
varying vec3 vTint;
varying float vShape;
float bar(vec2 p) { return min(max(abs(p.x) - 0.15, abs(p.y) - 0.62), max(abs(p.y) - 0.15, abs(p.x) - 0.62)); }
/** Tip up; gl_PointCoord grows downwards. */
float triangle(vec2 p) { return max(p.y - 0.5, abs(p.x) * 0.88 - p.y * 0.47 - 0.36); }
void main() {
  vec2 p = gl_PointCoord * 2.0 - 1.0;
  float d = length(p) - 0.55;
  float w = max(abs(p.x), abs(p.y));
  if (vShape > 6.5) d = triangle(vec2(p.x, -p.y));
  else if (vShape > 5.5) d = triangle(p);
  else if (vShape > 4.5) d = w - 0.52;
  else if (vShape > 3.5) d = abs(length(p) - 0.47) - 0.17;
  else if (vShape > 2.5) d = bar(mat2(0.7071, 0.7071, -0.7071, 0.7071) * p);
  else if (vShape > 1.5) d = (abs(p.x) + abs(p.y)) - 0.72;
  else if (vShape > 0.5) d = bar(p);
  if (d > 0.2) discard;
  gl_FragColor = vec4(d > 0.02 ? halo : vTint, 1.0);
  #include <colorspace_fragment>
}`;

function markerPoints(stage: Stage): { points: Points; set(cones: Cone[]): void } {
  const material = new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: { size: { value: 17 }, lift: { value: 0 }, halo: { value: new Color() } },
    depthTest: false,
  });
  const points = new Points(new BufferGeometry(), material);
  points.frustumCulled = false;
  points.renderOrder = 5;
  points.onBeforeRender = (renderer) => {
    const ratio = renderer.getPixelRatio();
    material.uniforms["size"]!.value = 17 * ratio;
    (material.uniforms["halo"]!.value as Color).set(colours().halo);
    material.uniforms["lift"]!.value = (2 * lift(stage)) / Math.max(renderer.domElement.clientHeight, 1);
    material.uniformsNeedUpdate = true;
  };
  const colour = new Color();
  function set(cones: Cone[]): void {
    // Important ones last, on top.
    const order = [...cones].sort((a, b) => STYLES[a.kind].shape - STYLES[b.kind].shape);
    const [position, tint, shape] = [new Float32Array(order.length * 3), new Float32Array(order.length * 3), new Float32Array(order.length)];
    order.forEach((cone, i) => {
      position.set([cone.xyz[0], cone.xyz[1], cone.xyz[2] + cone.height_m], i * 3);
      tint.set(colour.set(colourOf(cone.kind)).toArray(), i * 3);
      shape[i] = STYLES[cone.kind].shape;
    });
    points.geometry.dispose();
    points.geometry = new BufferGeometry()
      .setAttribute("position", new BufferAttribute(position, 3).setUsage(DynamicDrawUsage))
      .setAttribute("tint", new BufferAttribute(tint, 3))
      .setAttribute("shape", new BufferAttribute(shape, 1));
    points.visible = order.length > 0;
  }
  set([]);
  return { points, set };
}
