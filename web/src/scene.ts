// The stage: renderer, camera and its keys, ground grid, scale bar. Draws only when something changed.
import {
  BufferGeometry, Color, Float32BufferAttribute, LineBasicMaterial, LineSegments, MOUSE,
  PerspectiveCamera, Scene, Spherical, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { Vec3 } from "./api";
import { el } from "./dom";
import type { CameraPlace } from "./state";

export const BACKGROUND = "#eef1f4";
const FIELD_DEG = 42;
const GRID_LINES = 60;
const PIECE_CELLS = 5;
/** z is up in the map; three's spherical angles want y up. */
const toYUp = (v: Vector3) => v.set(v.x, v.z, -v.y);
const toZUp = (v: Vector3) => v.set(v.x, -v.z, v.y);

export interface Stage {
  scene: Scene;
  camera: PerspectiveCamera;
  canvas: HTMLCanvasElement;
  /** Ask for a new picture; many calls make one. */
  draw(): void;
  /** From now on pictures are drawn: before, there is nothing to see, and each picture costs time. */
  start(): void;
  /** Compile what is in the scene, without waiting for it. */
  warm(): void;
  /** Called before every picture. */
  beforeDraw(callback: () => void): void;
  onCamera(callback: (place: CameraPlace) => void): void;
  place(place: CameraPlace): void;
  fit(points: Vec3[]): void;
  topView(): void;
  lookAt(point: Vec3, distance_m?: number): void;
  setGround(height_m: number): void;
  /** Pixels from the canvas's top left; null behind the camera. */
  project(point: Vec3): [number, number] | null;
  key(event: KeyboardEvent): boolean;
  /** True where something of this height at this place is in the picture and at least so many pixels tall. */
  sees(point: Vec3, height_m: number, least_px: number): boolean;
}

export function createStage(host: HTMLElement): Stage {
  const renderer = new WebGLRenderer({ antialias: true, powerPreference: "high-performance" });
  renderer.debug.checkShaderErrors = false; // asking for errors waits for the compiler
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("aria-label", "Map in three dimensions. Arrow keys move, plus and minus zoom, Home shows everything.");
  const scaleText = el("span");
  const scaleLine = el("i");
  const north = el("button", { class: "north", type: "button", title: "North up, seen from above (T)", textContent: "N" });
  host.append(canvas, el("div", { class: "scalebar" }, scaleLine, scaleText), north);

  const scene = new Scene();
  scene.background = new Color(BACKGROUND);

  const camera = new PerspectiveCamera(FIELD_DEG, 1, 0.1, 5000);
  camera.up.set(0, 0, 1);
  camera.position.set(0, -30, 20);
  const controls = new OrbitControls(camera, canvas);
  controls.enableDamping = false;
  controls.zoomToCursor = true;
  controls.minDistance = 0.6;
  controls.maxDistance = 20000;
  controls.maxPolarAngle = Math.PI / 2 - 0.01;
  controls.mouseButtons = { LEFT: MOUSE.ROTATE, MIDDLE: MOUSE.DOLLY, RIGHT: MOUSE.PAN };

  const minor = gridLines("#dde2e8");
  const major = gridLines("#c3cbd4");
  scene.add(minor, major);
  let ground = 0;
  let gridKey = "";
  const befores: (() => void)[] = [];
  const cameraCallbacks: ((place: CameraPlace) => void)[] = [];
  let asked = false;
  let started = false;
  let frames = 0;

  function draw(): void {
    if (asked || !started) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      const distance = camera.position.distanceTo(controls.target);
      camera.near = Math.max(distance / 500, 0.05);
      camera.far = distance * 40 + 500;
      camera.updateProjectionMatrix();
      camera.updateMatrixWorld();
      updateGrid(distance);
      for (const callback of befores) callback();
      renderer.render(scene, camera);
      frames += 1;
      canvas.dataset["frames"] = String(frames);
    });
  }

  function updateGrid(distance: number): void {
    const step = niceStep(distance / 12);
    const at = [controls.target.x, controls.target.y].map((v) => Math.round(v / (step * 10)) * step * 10) as [number, number];
    const key = `${step} ${at.join(" ")} ${ground}`;
    if (key !== gridKey) {
      gridKey = key;
      setGrid(minor, major, at, step, ground);
    }
    const metres = niceStep(90 / pixelsPerMetre([controls.target.x, controls.target.y, controls.target.z]));
    scaleLine.style.width = `${metres * pixelsPerMetre([controls.target.x, controls.target.y, controls.target.z])}px`;
    scaleText.textContent = `${metreText(metres)} · grid ${metreText(step)}`;
    north.style.transform = `rotate(${azimuth()}rad)`;
  }

  const offset = () => toYUp(camera.position.clone().sub(controls.target));
  const azimuth = () => new Spherical().setFromVector3(offset()).theta;

  function current(): CameraPlace {
    const s = new Spherical().setFromVector3(offset());
    const t = controls.target;
    return [t.x, t.y, t.z, s.theta, s.phi, s.radius];
  }

  function place([x, y, z, theta, phi, radius]: CameraPlace): void {
    controls.target.set(x, y, z);
    const s = new Spherical(radius, phi, theta).makeSafe();
    camera.position.copy(toZUp(new Vector3().setFromSpherical(s)).add(controls.target));
    controls.update();
    changed();
  }

  function changed(): void {
    const now = current();
    for (const callback of cameraCallbacks) callback(now);
    draw();
  }

  function fit(points: Vec3[]): void {
    if (!points.length) return;
    const [, , , theta, phi] = current();
    // In the axes of the present view: across, up and towards the camera.
    const view = toZUp(new Vector3().setFromSphericalCoords(1, phi, theta));
    const side = new Vector3(0, 0, 1).cross(view).normalize();
    const axes = [side, view.clone().cross(side), view];
    const seen = points.map((p) => axes.map((axis) => new Vector3(...p).dot(axis)));
    const middle = axes.map((_, i) => (least(seen.map((s) => s[i] ?? 0)) + most(seen.map((s) => s[i] ?? 0))) / 2);
    const tanV = Math.tan((FIELD_DEG * Math.PI) / 360) * 0.8;
    const tanH = tanV * camera.aspect;
    const [across = 0, up = 0, towards = 0] = middle;
    const wish = ([a = 0, b = 0, c = 0]: number[]) =>
      c - towards + Math.max(Math.abs(a - across) / tanH, Math.abs(b - up) / tanV);
    const radius = Math.max(4, most(seen.map(wish)));
    const centre = axes.reduce((sum, axis, i) => sum.addScaledVector(axis, middle[i] ?? 0), new Vector3());
    place([centre.x, centre.y, centre.z, theta, phi, radius]);
  }

  function pixelsPerMetre(point: Vec3): number {
    const depth = new Vector3(...point).sub(camera.position).dot(camera.getWorldDirection(new Vector3()));
    return canvas.clientHeight / (2 * Math.tan((FIELD_DEG * Math.PI) / 360) * Math.max(depth, 0.01));
  }

  const seenAt = new Vector3();
  function sees([x, y, z]: Vec3, height_m: number, least_px: number): boolean {
    seenAt.set(x, y, z + height_m / 2).applyMatrix4(camera.matrixWorldInverse);
    const depth = -seenAt.z;
    if (depth < -height_m) return false;
    const pixels = canvas.clientHeight / (2 * Math.tan((FIELD_DEG * Math.PI) / 360) * Math.max(depth, 0.05));
    if (height_m * pixels < least_px) return false;
    const reach = 2 * height_m;
    return Math.abs(seenAt.x) * pixels < canvas.clientWidth / 2 + reach * pixels && Math.abs(seenAt.y) * pixels < canvas.clientHeight / 2 + reach * pixels;
  }

  function key(event: KeyboardEvent): boolean {
    const [x, y, z, theta, phi, radius] = current();
    const turn = event.shiftKey;
    const pan = radius * 0.08;
    const ahead: [number, number] = [-Math.sin(theta), Math.cos(theta)];
    const move = (right: number, up: number) =>
      place([x + pan * (right * ahead[1] + up * ahead[0]), y + pan * (up * ahead[1] - right * ahead[0]), z, theta, phi, radius]);
    switch (event.key) {
      case "ArrowLeft": turn ? place([x, y, z, theta - 0.1, phi, radius]) : move(-1, 0); return true;
      case "ArrowRight": turn ? place([x, y, z, theta + 0.1, phi, radius]) : move(1, 0); return true;
      case "ArrowUp": turn ? place([x, y, z, theta, Math.max(phi - 0.08, 0.01), radius]) : move(0, 1); return true;
      case "ArrowDown": turn ? place([x, y, z, theta, Math.min(phi + 0.08, 1.55), radius]) : move(0, -1); return true;
      case "+": case "=": place([x, y, z, theta, phi, Math.max(radius / 1.2, 0.6)]); return true;
      case "-": case "_": place([x, y, z, theta, phi, Math.min(radius * 1.2, 20000)]); return true;
      case "t": case "T": stage.topView(); return true;
      default: return false;
    }
  }

  function resize(): void {
    const { clientWidth: width, clientHeight: height } = host;
    if (!width || !height) return;
    renderer.setSize(width, height);
    camera.aspect = width / height;
    draw();
  }

  controls.addEventListener("change", changed);
  new ResizeObserver(resize).observe(host);
  resize();

  const stage: Stage = {
    scene, camera, canvas, draw,
    start: () => {
      if (started) return;
      started = true;
      draw();
    },
    warm: () => void renderer.compile(scene, camera),
    fit, place, key, sees,
    beforeDraw: (callback) => void befores.push(callback),
    onCamera: (callback) => void cameraCallbacks.push(callback),
    topView: () => {
      const [x, y, z, , , radius] = current();
      place([x, y, z, 0, 0.001, radius]);
    },
    lookAt: (point, distance_m) => {
      const [, , , theta, phi, radius] = current();
      place([...point, theta, phi, distance_m ?? radius]);
    },
    setGround: (height_m) => {
      ground = height_m;
      draw();
    },
    project: (point) => {
      const v = new Vector3(...point).project(camera);
      if (v.z > 1 || v.z < -1) return null;
      return [((v.x + 1) / 2) * canvas.clientWidth, ((1 - v.y) / 2) * canvas.clientHeight];
    },
  };
  north.addEventListener("click", () => stage.topView());
  return stage;
}

const least = (values: number[]) => values.reduce((a, b) => Math.min(a, b), Infinity);
const most = (values: number[]) => values.reduce((a, b) => Math.max(a, b), -Infinity);

function niceStep(wish: number): number {
  const power = 10 ** Math.floor(Math.log10(Math.max(wish, 1e-3)));
  const rest = wish / power;
  return power * (rest >= 5 ? 5 : rest >= 2 ? 2 : 1);
}

const metreText = (m: number) => (m >= 1000 ? `${m / 1000} km` : m < 0.995 ? `${Math.round(m * 100)} cm` : `${m} m`);

function gridLines(colour: string): LineSegments {
  const lines = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: colour, depthWrite: false }));
  lines.renderOrder = -1;
  lines.frustumCulled = false;
  return lines;
}

/** Lines at whole multiples of `step` in map coordinates (the origin is a multiple of 100 m); every tenth is a major one.
 * They are made of short pieces: some drivers drop a line that begins far behind the camera. */
function setGrid(minor: LineSegments, major: LineSegments, at: [number, number], step: number, z: number): void {
  const points: [number[], number[]] = [[], []];
  const half = GRID_LINES * step;
  const piece = PIECE_CELLS * step;
  for (let i = -GRID_LINES; i <= GRID_LINES; i++) {
    const into = points[i % 10 === 0 ? 1 : 0];
    const [x, y] = [at[0] + i * step, at[1] + i * step];
    for (let from = -half; from < half; from += piece) {
      into.push(x, at[1] + from, z, x, at[1] + from + piece, z);
      into.push(at[0] + from, y, z, at[0] + from + piece, y, z);
    }
  }
  for (const [lines, values] of [[minor, points[0]], [major, points[1]]] as const) {
    lines.geometry.dispose();
    lines.geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(values, 3));
  }
}
