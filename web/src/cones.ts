// The cones, objects of other classes and lane markings: bodies in true size and paint (instanced), on a ring in the colour of a change, markers
// of fixed size above them, translucent old positions, arrows.
import {
  BoxGeometry, BufferAttribute, BufferGeometry, CanvasTexture, Color, ConeGeometry, CylinderGeometry, DynamicDrawUsage, Group, InstancedMesh,
  Matrix4, Mesh, Points, Quaternion, RingGeometry, ShaderMaterial, Vector3,
} from "three";
import { mergeGeometries } from "three/addons/utils/BufferGeometryUtils.js";
import type { Vec3 } from "./api";
import { classOrder, CONE, GLYPHS, onlyCones } from "./classes";
import { isGone, STYLES, type Cone } from "./kinds";
import { createMarkings, distanceToSegment, isQuiet } from "./markings";
import type { Stage } from "./scene";
import { colourOf, colours, newPaint } from "./theme";

const PICK_PX = 18;
/** Smaller cones are drawn as their marker alone; without a graphics card each body costs as much time as a hundred points. */
const leastBody = (stage: Stage) => (stage.quality.plain ? 12 : 4);
/** Marker's height above the tip; in the plan it is on the cone. */
const MARKER_LIFT_PX = 13;
const lift = (stage: Stage) => (stage.plan ? 0 : onlyCones() ? MARKER_LIFT_PX : 1.4 * MARKER_LIFT_PX);

export function createCones(stage: Stage) {
  const markings = createMarkings(stage);
  const solid = shaded(1);
  const group = new Group();
  stage.scene.add(group);
  const markers = markerPoints(stage);
  let cones: Cone[] = [];
  const seen = new Matrix4();

  const standing = bodies(solid);
  const unchanged = bodies(shaded(1, 0.65));
  const gone = bodies(shaded(0.35));
  const painted = shaded(1, 1);
  const fresh = bodies(painted);
  const rings = ringsOf(solid);
  const arrows = new Mesh(new BufferGeometry(), solid); // all in one: each draw call costs
  arrows.frustumCulled = false;
  arrows.visible = false;
  group.add(standing.holder, unchanged.holder, gone.holder, fresh.holder, rings.mesh, arrows, markers.group, markings.group);
  stage.beforeDraw(() => [standing, unchanged, gone, fresh, rings].forEach((each) => each.cull(stage)));

  function show(next: Cone[]): void {
    cones = next.filter((c) => !c.marking);
    markings.show(next.filter((c) => c.marking));
    const colour = (c: Cone) => colourOf(c.kind);
    const bodyAt = (c: Cone, at: Vec3): Body => ({ category: c.category, at, height: c.height_m });
    const there = cones.filter((c) => !isGone(c.kind));
    const paint = newPaint();
    painted.uniforms["tone"]!.value.set(paint ?? "white");
    fresh.set(there.filter((c) => paint && c.kind === "added").map((c) => bodyAt(c, c.xyz)));
    standing.set(there.filter((c) => c.kind !== "unchanged" && !(paint && c.kind === "added")).map((c) => bodyAt(c, c.xyz)));
    unchanged.set(there.filter((c) => c.kind === "unchanged").map((c) => bodyAt(c, c.xyz)));
    gone.set(
      cones.flatMap((c) => {
        const at = isGone(c.kind) ? c.xyz : c.kind === "moved" ? c.old : null;
        return at ? [bodyAt(c, at)] : [];
      }),
    );
    rings.set(cones.filter((c) => !isQuiet(c.kind)).map((c) => ({ at: c.xyz, height: c.height_m, colour: colour(c) })));
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
    return best ?? markings.pick(x, y);
  }

  return {
    show, pick,
    /** Whether they are drawn: the comparison by swipe draws two sets, one on each side. */
    setVisible: (on: boolean) => void (group.visible = on),
  };
}

interface Body {
  category: string;
  at: Vec3;
  height: number;
}

/** Objects of one material, a mesh for each class. Those smaller than a few pixels are left out: their marker represents them. */
function bodies(material: ShaderMaterial) {
  const matrix = new Matrix4();
  const scale = new Vector3();
  const holder = new Group();
  let classes: { items: Body[]; mesh: InstancedMesh; turned: boolean }[] = [];

  function set(next: Body[]): void {
    for (const { mesh } of classes) mesh.dispose();
    const others = onlyCones() ? [] : [...new Set(next.map((item) => item.category))].filter((category) => category !== CONE);
    const of = (category: string): [string, Body[]] => [category, others.length ? next.filter((item) => item.category === category) : next];
    // Cones are always there: their shader is compiled at the start.
    classes = [CONE, ...others].map(of).map(([category, items]) => ({ items, mesh: instances(bodyOf(category), material, items.length), turned: category !== CONE }));
    holder.clear().add(...classes.map((c) => c.mesh));
  }
  set([]);

  return {
    holder, set,
    cull(stage: Stage): void {
      const [azimuth, least_px] = [stage.pose()[3], leastBody(stage)];
      for (const { items, mesh, turned } of classes) {
        let count = 0;
        for (const { at, height } of items) {
          if (!stage.sees(at, height, least_px)) continue;
          // The map does not hold which way a sign or a board faces: it faces the viewer.
          if (turned) matrix.makeRotationZ(azimuth).scale(scale.setScalar(height));
          else matrix.makeScale(height, height, height);
          mesh.setMatrixAt(count, matrix.setPosition(...at));
          count += 1;
        }
        show(mesh, count);
      }
    },
  };
}

/** Rings on the ground around the foot of what changed, in the colour of its kind. */
function ringsOf(material: ShaderMaterial) {
  const matrix = new Matrix4();
  const colour = new Color();
  const ring = new RingGeometry(0.62, 0.85, 24).translate(0, 0, 0.03);
  const made = { mesh: new Group(), set, cull };
  let items: { at: Vec3; height: number; colour: string }[] = [];
  let mesh = instances(tinted(ring, new Color("white")), material, 0);

  function set(next: typeof items): void {
    items = next;
    mesh.dispose();
    mesh = instances(ring, material, items.length);
    mesh.setColorAt(0, colour); // with colours from the start: it is compiled once
    made.mesh.clear().add(mesh);
  }
  function cull(stage: Stage): void {
    const least_px = leastBody(stage);
    let count = 0;
    for (const { at, height, colour: css } of items) {
      if (!stage.sees(at, height, least_px)) continue;
      mesh.setMatrixAt(count, matrix.makeScale(height, height, 1).setPosition(...at));
      mesh.setColorAt(count, colour.set(css));
      count += 1;
    }
    show(mesh, count);
    if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
  }
  set([]);
  return made;
}

function instances(geometry: BufferGeometry, material: ShaderMaterial, most: number): InstancedMesh {
  const mesh = new InstancedMesh(geometry, material, Math.max(most, 1));
  mesh.frustumCulled = false;
  mesh.count = 0;
  return mesh;
}

function show(mesh: InstancedMesh, count: number): void {
  mesh.count = count;
  mesh.visible = count > 0;
  mesh.instanceMatrix.needsUpdate = true;
}

/** Paint, as under an overcast sky. */
const [ORANGE, RED, WHITE, YELLOW, BLACK, STEEL, GREY] = ["#ff6a13", "#c8102e", "#f7f7f2", "#ffc20e", "#2b2b2b", "#6d7479", "#9aa3ab"] as const;
type Part = [BufferGeometry, string];

function box(width: number, depth: number, from: number, to: number, paint: string, x = 0): Part {
  return [new BoxGeometry(width, depth, to - from).translate(x, 0, (from + to) / 2), paint];
}

function tube(below: number, above: number, from: number, to: number, paint: string): Part {
  return [new CylinderGeometry(above, below, to - from, 20, 1, false).rotateX(Math.PI / 2).translate(0, 0, (from + to) / 2), paint];
}

/** A square on its corner, or a disc, of height 1. */
const diamond = (size: number, depth: number, paint: string): Part => [new BoxGeometry(size * Math.SQRT1_2, depth, size * Math.SQRT1_2).rotateY(Math.PI / 4).translate(0, 0, 0.5), paint];
const disc = (size: number, depth: number, paint: string): Part => [new CylinderGeometry(size / 2, size / 2, depth, 32).translate(0, 0, 0.5), paint];

/** Objects of height 1 with their foot's centre at the origin and z up, plates facing south, in the paint of the most common make. */
const PARTS = new Map<string, () => Part[]>(Object.entries({
  traffic_cone: () => {
    const radius = (z: number) => 0.2 - 0.165 * z;
    const part = (from: number, to: number, paint: string) => tube(radius(from), radius(to), from, to, paint);
    return [box(0.56, 0.56, 0, 0.05, BLACK), part(0.05, 0.36, ORANGE), part(0.36, 0.54, WHITE), part(0.54, 0.66, ORANGE), part(0.66, 0.84, WHITE), part(0.84, 1.0, ORANGE)];
  },
  tubular_marker: () => [tube(0.16, 0.13, 0, 0.06, BLACK), tube(0.055, 0.055, 0.06, 0.55, ORANGE), tube(0.055, 0.055, 0.55, 0.68, WHITE), tube(0.055, 0.055, 0.68, 0.78, ORANGE), tube(0.055, 0.055, 0.78, 0.91, WHITE), tube(0.055, 0.05, 0.91, 1, ORANGE)],
  drum: () => [tube(0.33, 0.32, 0, 0.07, BLACK), tube(0.28, 0.275, 0.07, 0.3, ORANGE), tube(0.275, 0.265, 0.3, 0.47, WHITE), tube(0.265, 0.26, 0.47, 0.64, ORANGE), tube(0.26, 0.25, 0.64, 0.81, WHITE), tube(0.25, 0.22, 0.81, 1, ORANGE)],
  vertical_panel: () => [box(0.42, 0.3, 0, 0.06, BLACK), box(0.06, 0.03, 0.06, 0.2, STEEL), box(0.3, 0.03, 0.2, 1, RED), box(0.3, 0.035, 0.36, 0.52, WHITE), box(0.3, 0.035, 0.68, 0.84, WHITE)],
  barricade: () => [-0.45, 0.45].flatMap((x) => [box(0.06, 0.5, 0, 0.06, STEEL, x), box(0.06, 0.06, 0.06, 0.75, STEEL, x)])
    .concat([0.75, 0.4].flatMap((z) => [box(1.2, 0.05, z, z + 0.25, RED), box(0.24, 0.055, z, z + 0.25, WHITE, -0.3), box(0.24, 0.055, z, z + 0.25, WHITE, 0.3)])),
  work_zone_sign: () => [diamond(1, 0.03, BLACK), diamond(0.9, 0.035, ORANGE)],
  arrow_board: () => [box(0.5, 0.3, 0.05, 0.16, STEEL), box(0.06, 0.06, 0.16, 0.45, STEEL), box(1.2, 0.06, 0.45, 1, BLACK), box(0.7, 0.065, 0.7, 0.76, YELLOW), [new BoxGeometry(0.2, 0.065, 0.2).rotateY(Math.PI / 4).translate(0.3, 0, 0.73), YELLOW]],
  traffic_sign: () => [disc(1, 0.03, RED), disc(0.76, 0.035, WHITE)],
})); // prettier-ignore
const madeBodies = new Map<string, BufferGeometry>();

function bodyOf(category: string): BufferGeometry {
  const parts = () => (PARTS.get(category)?.() ?? [box(0.4, 0.4, 0, 1, GREY)]).map(([geometry, paint]) => tinted(geometry, new Color(paint)));
  const body = madeBodies.get(category) ?? mergeGeometries(parts());
  madeBodies.set(category, body);
  return body;
}

function tinted(geometry: BufferGeometry, { r, g, b }: Color): BufferGeometry {
  const tint = new Float32Array(geometry.getAttribute("position").count * 3);
  for (let i = 0; i < tint.length; i += 3) tint.set([r, g, b], i);
  return geometry.setAttribute("color", new BufferAttribute(tint, 3));
}

/** Lambert shading per vertex, with light from above and the south-west: without a graphics card much faster than three's material.
 * grey: share of the tone, a grey, in the paint. */
function shaded(opacity: number, grey = 0): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: SHADED_VERTEX, fragmentShader: SHADED_FRAGMENT, vertexColors: true, uniforms: { opacity: { value: opacity }, grey: { value: grey }, tone: { value: new Color(0.55, 0.55, 0.55) } },
    transparent: opacity < 1, depthWrite: opacity === 1,
  }); // prettier-ignore
}

const SHADED_VERTEX = /* glsl */ `
uniform float grey;
uniform vec3 tone;
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
  vTint = mix(vTint, tone, grey);
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
/** A slim body on a plate. */
float cone(vec2 p) { return min(max(abs(p.x) - 0.24 - 0.22 * p.y, abs(p.y + 0.1) - 0.55), max(abs(p.x) - 0.55, abs(p.y - 0.5) - 0.12)); }
/** Tip up; gl_PointCoord grows downwards. */
float triangle(vec2 p) { return max(p.y - 0.5, abs(p.x) * 0.88 - p.y * 0.47 - 0.36); }
void main() {
  vec2 p = gl_PointCoord * 2.0 - 1.0;
  float d = length(p) - 0.55;
  float w = max(abs(p.x), abs(p.y));
  if (vShape > 7.5) d = cone(p);
  else if (vShape > 6.5) d = triangle(vec2(p.x, -p.y));
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

/** Silhouettes of classes, side by side: opaque where drawn, red where the colour of the kind is full. */
function glyphAtlas(): CanvasTexture {
  const px = 64;
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [px * GLYPHS.length, px];
  const pen = canvas.getContext("2d");
  GLYPHS.forEach((d, i) => {
    if (!pen) return;
    pen.setTransform(px / 18, 0, 0, px / 18, (i + 1 / 18) * px, px / 18);
    pen.lineJoin = "round";
    for (const [width, red] of [[2, 0], [1, 255]] as const) {
      [pen.lineWidth, pen.strokeStyle] = [width, `rgb(${red} 0 0)`];
      pen.stroke(new Path2D(d));
    }
    pen.fillStyle = "rgb(130 0 0)";
    pen.fill(new Path2D(d));
  });
  return new CanvasTexture(canvas);
}

const GLYPH_FRAGMENT = /* glsl */ `
uniform vec3 halo;
uniform sampler2D glyphs;
varying vec3 vTint;
varying float vShape;
void main() {
  vec4 texel = texture2D(glyphs, vec2((vShape + gl_PointCoord.x) / ${GLYPHS.length.toFixed(1)}, 1.0 - gl_PointCoord.y));
  if (texel.a < 0.5) discard;
  gl_FragColor = vec4(mix(halo, vTint, texel.r), 1.0);
  #include <colorspace_fragment>
}`;

/** The marker of the kind, and under it the glyph of the class unless it is a cone. */
function markerPoints(stage: Stage): { group: Group; set(cones: Cone[]): void } {
  const group = new Group();
  const kinds = pointsOf(stage, group, 5, 17, FRAGMENT);
  let classes: ReturnType<typeof pointsOf> | null = null; // made when it is first needed
  function set(cones: Cone[]): void {
    // Important ones last, on top.
    const order = [...cones].sort((a, b) => STYLES[a.kind].shape - STYLES[b.kind].shape);
    // What stands is a cone, or the glyph of its class alone.
    kinds(order.filter((c) => c.kind !== "standing" || c.category === CONE), (c) => STYLES[c.kind].shape);
    const others = onlyCones() ? [] : order.filter((c) => c.category !== CONE);
    if (others.length) classes ??= pointsOf(stage, group, 4, 30, GLYPH_FRAGMENT, glyphAtlas());
    classes?.(others, (c) => classOrder(c.category));
  }
  set([]);
  return { group, set };
}

/** Points of `size_px`; the function that is returned sets them. */
function pointsOf(stage: Stage, group: Group, renderOrder: number, size_px: number, fragmentShader: string, glyphs: CanvasTexture | null = null) {
  const material = new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader,
    uniforms: { size: { value: size_px }, lift: { value: 0 }, halo: { value: new Color() }, glyphs: { value: glyphs } },
    depthTest: false, transparent: true, // drawn after areas
  });
  const points = new Points(new BufferGeometry(), material);
  group.add(points);
  points.frustumCulled = false;
  points.renderOrder = renderOrder;
  points.onBeforeRender = (renderer) => {
    const ratio = renderer.getPixelRatio();
    material.uniforms["size"]!.value = size_px * ratio;
    (material.uniforms["halo"]!.value as Color).set(colours().halo);
    material.uniforms["lift"]!.value = (2 * lift(stage)) / Math.max(renderer.domElement.clientHeight, 1);
    material.uniformsNeedUpdate = true;
  };
  const colour = new Color();
  return (cones: Cone[], shapeOf: (cone: Cone) => number): void => {
    const [position, tint, shape] = [new Float32Array(cones.length * 3), new Float32Array(cones.length * 3), new Float32Array(cones.length)];
    cones.forEach((cone, i) => {
      position.set([cone.xyz[0], cone.xyz[1], cone.xyz[2] + cone.height_m], i * 3);
      tint.set(colour.set(colourOf(cone.kind)).toArray(), i * 3);
      shape[i] = shapeOf(cone);
    });
    points.geometry.dispose();
    points.geometry = new BufferGeometry()
      .setAttribute("position", new BufferAttribute(position, 3).setUsage(DynamicDrawUsage))
      .setAttribute("tint", new BufferAttribute(tint, 3))
      .setAttribute("shape", new BufferAttribute(shape, 1));
    points.visible = cones.length > 0;
  };
}
