// Base layers: LiDAR points and lane boundaries under the cones, in muted colours.
import { BufferAttribute, BufferGeometry, Color, DoubleSide, Line3, Mesh, ShaderMaterial, Vector2, Vector3 } from "three";
import { api, type BaseLayer, type BaseLine } from "./api";
import { createPoints } from "./points";
import type { Stage } from "./scene";
import type { State } from "./state";
import { colours } from "./theme";

export function createBase(stage: Stage, onTrouble: (error: unknown) => void) {
  const points = createPoints(stage, onTrouble);
  const lines = createLines(stage);
  let opening = 0;

  return {
    /** Read the layers of a map; they are drawn as they arrive. */
    async open(map: string): Promise<BaseLayer[]> {
      const mine = ++opening;
      const [base, found] = await Promise.all([api.base(map), api.baseLines(map)]);
      if (mine !== opening) return [];
      points.setTiles(base.tiles, (sha256) => api.baseTile(map, sha256));
      lines.show(found.lines);
      stage.warm();
      document.documentElement.dataset["lines"] = String(found.lines.length);
      if (base.truncated || found.truncated) onTrouble(new Error("The base layers are too large for this page: some of them are not shown."));
      return base.layers;
    },
    close(): void {
      opening += 1;
      points.setTiles([], () => Promise.reject(new Error("no map")));
      lines.show([]);
    },
    apply(state: State): void {
      points.setStyle(colours(), state.scene);
      lines.setColour(colours().line);
      points.setVisible(state.points);
      lines.setVisible(state.lines);
    },
  };
}

/** Above the road, so that points on it do not hide them. */
const LIFT_M = 0.05;
const NEAR_M = 0.01;
const nearest = new Vector3();
/** Width in pixels; dashes and gaps of 3 m; share of the background in the colour. */
const STYLES = {
  painted: { width_px: 1.5, dashed: 0, faint: 0 },
  dashed: { width_px: 1.5, dashed: 1, faint: 0 },
  edge: { width_px: 1.2, dashed: 0, faint: 0.2 },
  virtual: { width_px: 1, dashed: 0, faint: 0.6 },
} as const;

function styleOf({ kind, subtype }: BaseLine): keyof typeof STYLES {
  const words = `${kind} ${subtype ?? ""}`.toLowerCase();
  if (/virtual|reference|lane_border|centerline/.test(words)) return "virtual";
  if (/dashed|broken/.test(words)) return "dashed";
  if (/curb|kerb|border|wall|fence|guard|rail|edge|grass/.test(words)) return "edge";
  return "painted";
}

/** Lane boundaries: painted and dashed lines, kerbs and edges, virtual lines; all in one mesh. */
function createLines(stage: Stage) {
  const material = new ShaderMaterial({
    vertexShader: VERTEX, fragmentShader: FRAGMENT, side: DoubleSide,
    uniforms: { colour: { value: new Color() }, background: { value: new Color() }, canvas: { value: new Vector2() } },
  }); // prettier-ignore
  material.onBeforeRender = ({ domElement: { clientWidth, clientHeight } }) => {
    (material.uniforms["canvas"]!.value as Vector2).set(clientWidth, clientHeight);
    material.uniformsNeedUpdate = true;
  };
  const mesh = new Mesh(new BufferGeometry(), material);
  mesh.frustumCulled = false;
  stage.scene.add(mesh);

  return {
    show(lines: BaseLine[]): void {
      mesh.geometry.dispose();
      mesh.geometry = geometryOf(lines);
      stage.draw();
    },
    setVisible(on: boolean): void {
      mesh.visible = on;
      stage.draw();
    },
    setColour(css: string): void {
      (material.uniforms["colour"]!.value as Color).set(css);
      (material.uniforms["background"]!.value as Color).set(colours().background);
      stage.draw();
    },
  };
}

const verticesOf = ({ xyz_m }: BaseLine): Vector3[] => Array.from({ length: xyz_m.length / 3 }, (_, i) => new Vector3(...xyz_m.slice(3 * i, 3 * i + 3)));

/** Without the vertices that are nearer than NEAR_M to the line through the others (Douglas and Peucker 1973). */
function simplified(line: Vector3[]): Vector3[] {
  const [first, last] = [line[0], line.at(-1)];
  if (!first || !last || line.length < 3) return line;
  const chord = new Line3(first, last);
  let [far, most] = [0, NEAR_M];
  line.forEach((vertex, i) => {
    const apart = chord.closestPointToPoint(vertex, true, nearest).distanceTo(vertex);
    if (apart > most) [far, most] = [i, apart];
  });
  return far ? [...simplified(line.slice(0, far + 1)), ...simplified(line.slice(far)).slice(1)] : [first, last];
}

/** Two vertices per vertex of a line, one on each side; the shader moves them apart. */
function geometryOf(lines: BaseLine[]): BufferGeometry {
  const polylines = lines.map((line) => ({ style: STYLES[styleOf(line)], vertices: simplified(verticesOf(line)) }));
  const count = polylines.reduce((sum, { vertices }) => sum + vertices.length, 0);
  const make = (size: number) => new Float32Array(count * 2 * size);
  const [position, ahead, shape] = [make(3), make(3), make(4)];
  const index: number[] = [];
  let at = 0;
  for (const { style: { width_px, dashed, faint }, vertices } of polylines) {
    let station = 0;
    vertices.forEach((vertex, i) => {
      const [before, after] = [vertices[i - 1] ?? vertex, vertices[i + 1] ?? vertex];
      station += vertex.distanceTo(before);
      const direction = after.clone().sub(before);
      for (const side of [-1, 1]) {
        position.set([vertex.x, vertex.y, vertex.z + LIFT_M], at * 3);
        ahead.set(direction.toArray(), at * 3);
        shape.set([side * width_px, dashed, station, faint], at * 4);
        at += 1;
      }
      if (i) index.push(at - 4, at - 3, at - 2, at - 2, at - 3, at - 1);
    });
  }
  return new BufferGeometry().setAttribute("position", new BufferAttribute(position, 3)).setAttribute("ahead", new BufferAttribute(ahead, 3))
    .setAttribute("shape", new BufferAttribute(shape, 4)).setIndex(index); // prettier-ignore
}

/** `shape`: width to the left (px), whether dashed, metres from the start, share of the background. */
const VERTEX = /* glsl */ `
attribute vec3 ahead;
attribute vec4 shape;
uniform vec2 canvas;
varying vec2 vDash;
varying float vFaint;
void main() {
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  vec4 along = projectionMatrix * modelViewMatrix * vec4(ahead, 0.0);
  // Direction on the canvas: the derivative of xy / w. It is the same at both ends of a piece, also where one is behind the camera.
  vec2 direction = (along.xy * gl_Position.w - gl_Position.xy * along.w) * canvas;
  gl_Position.xy += vec2(-direction.y, direction.x) / max(length(direction), 1e-9) * shape.x / canvas * gl_Position.w;
  vDash = shape.yz;
  vFaint = shape.w;
}`;
const FRAGMENT = /* glsl */ `
uniform vec3 colour;
uniform vec3 background;
varying vec2 vDash;
varying float vFaint;
void main() {
  if (vDash.x > 0.5 && mod(vDash.y, 6.0) > 3.0) discard;
  gl_FragColor = vec4(mix(colour, background, vFaint), 1.0);
  #include <colorspace_fragment>
}`;
