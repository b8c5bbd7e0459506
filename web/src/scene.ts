// The stage: renderer, the two cameras (perspective, and the orthographic one of the plan) and their keys, ground grid, scale bar.
// Draws only when something changed.
import {
  BufferGeometry, Color, Float32BufferAttribute, LineBasicMaterial, LineSegments, MOUSE, OrthographicCamera,
  PerspectiveCamera, Scene, Spherical, TOUCH, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { FrameView, Vec3 } from "./api";
import { el } from "./dom";
import { createQuality } from "./quality";
import type { CameraPose } from "./state";
import { colours, onTheme } from "./theme";

const FIELD_DEG = 42;
const TAN = Math.tan((FIELD_DEG * Math.PI) / 360);
/** Polar angles: of the plan (straight down), and of the view in perspective to begin with. */
const PLAN_PHI = 0.001;
const PHI = 0.95;
/** Of the plan's camera over the ground. */
const PLAN_HEIGHT_M = 2000;
const [LEAST_M, MOST_M] = [0.6, 2e6];
/** To the point that is turned around, where the camera follows an image. */
const AHEAD_M = 10;
const GRID_LINES = 60;
const PIECE_CELLS = 12;
/** z is up in the map; three's spherical angles want y up. */
const toYUp = (v: Vector3) => v.set(v.x, v.z, -v.y);
const toZUp = (v: Vector3) => v.set(v.x, -v.z, v.y);

export type Stage = ReturnType<typeof createStage>;

export function createStage(host: HTMLElement) {
  const renderer = new WebGLRenderer({ powerPreference: "high-performance" });
  renderer.debug.checkShaderErrors = false; // asking for errors waits for the compiler
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("aria-label", "3D map. Arrow keys pan, plus and minus zoom, Home shows everything.");
  const scaleText = el("span");
  const scaleLine = el("i");
  const north = el("button", { class: "north", type: "button", title: "Turn north up", aria: { label: "Turn north up" }, textContent: "N" });
  host.append(canvas, el("div", { class: "scalebar" }, scaleLine, scaleText), north);

  const scene = new Scene();
  scene.background = new Color(colours().background);

  const camera = new PerspectiveCamera(FIELD_DEG, 1, 0.1, 5000);
  const planCamera = new OrthographicCamera();
  planCamera.far = 2 * PLAN_HEIGHT_M;
  let plan = false;
  /** The middle of the picture is drawn twice, side by side. */
  let split = false;
  camera.up.set(0, 0, 1);
  camera.position.set(0, -30, 20);
  const controls = new OrbitControls(camera, canvas);
  controls.enableDamping = false;
  controls.zoomToCursor = true;
  controls.minDistance = LEAST_M;
  controls.maxDistance = MOST_M;

  const minor = gridLines(colours().gridMinor);
  const major = gridLines(colours().gridMajor);
  scene.add(minor, major);
  onTheme(() => {
    (scene.background as Color).set(colours().background);
    (minor.material as LineBasicMaterial).color.set(colours().gridMinor);
    (major.material as LineBasicMaterial).color.set(colours().gridMajor);
    draw();
  });
  let ground = 0;
  let gridKey = "";
  const befores: (() => void)[] = [];
  const cameraCallbacks: ((pose: CameraPose) => void)[] = [];
  let renderWith: (() => void) | null = null;
  let gridStep = 1;
  /** While a frame is prepared the cameras are where they are drawn. */
  let drawing = false;
  const quality = createQuality(renderer, () => draw());
  let requested = false;
  let started = false;
  let frames = 0;

  /** Request a frame; many calls make one. */
  function draw(): void {
    if (requested || !started) return;
    requested = true;
    requestAnimationFrame(() => {
      requested = false;
      placeCameras();
      drawing = true;
      quality.adapt();
      updateGrid(camera.position.distanceTo(controls.target));
      for (const callback of befores) callback();
      drawing = false;
      quality.draw(renderWith ?? (() => renderer.render(scene, stage.camera)));
      frames += 1;
      canvas.dataset["frames"] = String(frames);
    });
  }

  /** The plan shows at its middle what the camera in perspective would show there, seen straight down. */
  function placeCameras(): void {
    const distance = camera.position.distanceTo(controls.target);
    camera.near = Math.max(distance / 500, 0.05);
    camera.far = distance * 40 + 500;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    const half = distance * TAN;
    [planCamera.top, planCamera.bottom, planCamera.right, planCamera.left] = [half, -half, half * camera.aspect, -half * camera.aspect];
    const turned = azimuth();
    planCamera.up.set(-Math.sin(turned), Math.cos(turned), 0);
    planCamera.position.set(controls.target.x, controls.target.y, ground + PLAN_HEIGHT_M);
    planCamera.lookAt(controls.target.x, controls.target.y, ground);
    planCamera.updateProjectionMatrix();
    planCamera.updateMatrixWorld();
  }

  function updateGrid(distance: number): void {
    const step = niceStep(distance / 12);
    gridStep = step;
    const at = [controls.target.x, controls.target.y].map((v) => Math.round(v / (step * 10)) * step * 10) as [number, number];
    const key = `${step} ${at.join(" ")} ${ground}`;
    if (key !== gridKey) {
      gridKey = key;
      setGrid(minor, major, at, step, ground);
    }
    const perMetre = pixelsAtDepth(camera.position.distanceTo(controls.target));
    const metres = niceStep(90 / perMetre);
    scaleLine.style.width = `${metres * perMetre}px`;
    scaleText.textContent = `${metreText(metres)}${minor.visible ? ` · grid ${metreText(step)}` : ""}`;
    north.style.transform = `rotate(${azimuth()}rad)`;
  }

  const offset = () => toYUp(camera.position.clone().sub(controls.target));
  const azimuth = () => new Spherical().setFromVector3(offset()).theta;

  function current(): CameraPose {
    const s = new Spherical().setFromVector3(offset());
    const t = controls.target;
    return [t.x, t.y, t.z, s.theta, s.phi, s.radius];
  }

  function setPose([x, y, z, theta, phi, radius]: CameraPose): void {
    controls.target.set(x, y, z);
    const s = new Spherical(radius, phi, theta).makeSafe();
    camera.position.copy(toZUp(new Vector3().setFromSpherical(s)).add(controls.target));
    controls.update();
    changed();
  }

  /** From where an image was taken, along its axis and with all of it in view; null: with the usual field of view. Its roll is left out. */
  function lookFrom(view: FrameView | null): void {
    const reach = (centre: number, size: number, focal: number) => Math.max(centre, size - centre) / focal;
    camera.zoom = view ? Math.min((TAN * camera.aspect) / reach(view.cx_px, view.width_px, view.fx_px), TAN / reach(view.cy_px, view.height_px, view.fy_px)) : 1;
    if (!view) return draw();
    const back = view.map_R_camera.map((row) => -row[2]) as Vec3;
    const { theta, phi } = new Spherical().setFromVector3(toYUp(new Vector3(...back)));
    const level = Math.min(phi, controls.maxPolarAngle);
    const from = toZUp(new Vector3().setFromSphericalCoords(AHEAD_M, level, theta));
    setPose([view.xyz_m[0] - from.x, view.xyz_m[1] - from.y, view.xyz_m[2] - from.z, theta, level, AHEAD_M]);
  }

  function changed(): void {
    const now = current();
    quality.moved();
    for (const callback of cameraCallbacks) callback(now);
    draw();
  }

  function fit(points: Vec3[]): void {
    if (!points.length) return;
    camera.zoom = 1;
    const [, , , theta, phi] = current();
    // In the axes of the present view: across, up and towards the camera.
    const view = toZUp(new Vector3().setFromSphericalCoords(1, phi, theta));
    const side = new Vector3(0, 0, 1).cross(view).normalize();
    const axes = [side, view.clone().cross(side), view];
    const seen = points.map((p) => axes.map((axis) => new Vector3(...p).dot(axis)));
    const middle = axes.map((_, i) => (least(seen.map((s) => s[i] ?? 0)) + most(seen.map((s) => s[i] ?? 0))) / 2);
    const tanV = TAN * 0.8;
    const tanH = (tanV * camera.aspect) / (split ? 2 : 1);
    const [across = 0, up = 0, towards = 0] = middle;
    const distance = ([a = 0, b = 0, c = 0]: number[]) =>
      c - towards + Math.max(Math.abs(a - across) / tanH, Math.abs(b - up) / tanV);
    const radius = Math.max(4, most(seen.map(distance)));
    const centre = axes.reduce((sum, axis, i) => sum.addScaledVector(axis, middle[i] ?? 0), new Vector3());
    setPose([centre.x, centre.y, centre.z, theta, phi, radius]);
  }

  /** Pixels per metre at a depth; in the plan everywhere the same. */
  function pixelsAtDepth(depth_m: number): number {
    const depth = plan ? camera.position.distanceTo(controls.target) : Math.max(depth_m, 0.05);
    return (canvas.clientHeight * (plan ? 1 : camera.zoom)) / (2 * TAN * depth);
  }

  const seenAt = new Vector3();
  /** True if something of this height at this position is in view and at least so many pixels tall. */
  function sees([x, y, z]: Vec3, height_m: number, least_px: number): boolean {
    seenAt.set(x, y, z + height_m / 2).applyMatrix4(stage.camera.matrixWorldInverse);
    const depth = -seenAt.z;
    if (depth < -height_m) return false;
    const pixels = pixelsAtDepth(depth);
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
      setPose([x + pan * (right * ahead[1] + up * ahead[0]), y + pan * (up * ahead[1] - right * ahead[0]), z, theta, phi, radius]);
    switch (event.key) {
      case "ArrowLeft": turn ? setPose([x, y, z, theta - 0.1, phi, radius]) : move(-1, 0); return true;
      case "ArrowRight": turn ? setPose([x, y, z, theta + 0.1, phi, radius]) : move(1, 0); return true;
      case "ArrowUp": turn && !plan ? setPose([x, y, z, theta, Math.max(phi - 0.08, 0.01), radius]) : move(0, 1); return true;
      case "ArrowDown": turn && !plan ? setPose([x, y, z, theta, Math.min(phi + 0.08, 1.55), radius]) : move(0, -1); return true;
      case "+": case "=": setPose([x, y, z, theta, phi, Math.max(radius / 1.2, LEAST_M)]); return true;
      case "-": case "_": setPose([x, y, z, theta, phi, Math.min(radius * 1.2, MOST_M)]); return true;
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

  /** The plan is moved like a paper map: left drag pans, right drag turns, the wheel zooms at the cursor. */
  function setControls(): void {
    const [pan, turn] = plan ? [MOUSE.PAN, MOUSE.ROTATE] : [MOUSE.ROTATE, MOUSE.PAN];
    controls.mouseButtons = { LEFT: pan, MIDDLE: MOUSE.DOLLY, RIGHT: turn };
    controls.touches = plan ? { ONE: TOUCH.PAN, TWO: TOUCH.DOLLY_ROTATE } : { ONE: TOUCH.ROTATE, TWO: TOUCH.DOLLY_PAN };
    [controls.minPolarAngle, controls.maxPolarAngle] = plan ? [PLAN_PHI, PLAN_PHI] : [0, Math.PI / 2 - 0.01];
  }

  canvas.addEventListener("wheel", (event) => {
    if (!plan) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    const [x, y, z, theta, phi, radius] = current();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    const next = Math.min(Math.max(radius * Math.exp(Math.min(Math.max(event.deltaY * lines, -300), 300) * 0.0018), LEAST_M), MOST_M);
    const at = groundAt(event.offsetX, event.offsetY) ?? [x, y];
    setPose([at[0] + ((x - at[0]) * next) / radius, at[1] + ((y - at[1]) * next) / radius, z, theta, phi, next]);
  }, { passive: false, capture: true }); // prettier-ignore

  const ray = new Vector3();
  /** The point of the ground under a pixel of the canvas; null above the horizon. */
  function groundAt(px: number, py: number): Vec3 | null {
    if (!drawing) placeCameras(); // it may have moved since the last frame
    ray.set((unsplit(px) / canvas.clientWidth) * 2 - 1, 1 - (py / canvas.clientHeight) * 2, 0.5).unproject(stage.camera);
    if (plan) return [ray.x, ray.y, ground];
    ray.sub(camera.position);
    const t = (ground - camera.position.z) / ray.z;
    return t > 0 && Number.isFinite(t) ? [camera.position.x + t * ray.x, camera.position.y + t * ray.y, ground] : null;
  }

  const halfShift = () => (split ? canvas.clientWidth / 4 : 0);
  /** From the half of a split picture to the whole one. */
  const unsplit = (px: number) => px + (px < canvas.clientWidth / 2 ? 1 : -1) * halfShift();

  controls.addEventListener("change", changed);
  new ResizeObserver(resize).observe(host);
  resize();

  const stage = {
    scene, canvas, renderer, quality, draw, fit, setPose, key, sees, groundAt, pixelsAtDepth, lookFrom, unsplit, halfShift,
    get camera(): PerspectiveCamera | OrthographicCamera {
      return plan ? planCamera : camera;
    },
    get plan(): boolean {
      return plan;
    },
    get ground(): number {
      return ground;
    },
    /** Spacing of the grid lines; every tenth is a major one. */
    get gridStep(): number {
      return gridStep;
    },
    pose: current,
    /** Plan (orthographic) or perspective; `keep` leaves the pose as it is, as a link has it. */
    setPlan(on: boolean, keep = false): void {
      if (on === plan) return;
      const [x, y, z, theta, , radius] = current();
      const at = groundAt(canvas.clientWidth / 2, canvas.clientHeight / 2) ?? [x, y, z];
      plan = on;
      setControls();
      if (keep) draw();
      else setPose([...at, on ? 0 : theta, on ? PLAN_PHI : PHI, radius] as CameraPose);
    },
    /** Both halves show the middle of the picture. */
    setSplit(on: boolean): void {
      split = on;
      controls.zoomToCursor = !on;
    },
    showGrid(on: boolean): void {
      minor.visible = major.visible = on;
      draw();
    },
    /** Draw frames by this function instead of one pass over the scene; null: as usual. */
    setRender(render: (() => void) | null): void {
      renderWith = render;
      draw();
    },
    /** From now on frames are drawn: before, there is nothing to show, and each frame costs time. */
    start(): void {
      started = true;
      draw();
    },
    /** Compile the shaders of the scene, without waiting. */
    warm: () => void renderer.compile(scene, stage.camera),
    /** Called before every frame. */
    beforeDraw: (callback: () => void) => void befores.push(callback),
    onCamera: (callback: (pose: CameraPose) => void) => void cameraCallbacks.push(callback),
    northUp(): void {
      const [x, y, z, , phi, radius] = current();
      setPose([x, y, z, 0, phi, radius]);
    },
    lookAt(point: Vec3, distance_m: number): void {
      camera.zoom = 1;
      const [, , , theta, phi] = current();
      setPose([...point, theta, phi, distance_m]);
    },
    setGround(height_m: number): void {
      ground = height_m;
      draw();
    },
    /** Pixels from the canvas's top left, of a split picture in its right half; null behind the camera, and beside that half. */
    project(point: Vec3): [number, number] | null {
      const v = new Vector3(...point).project(stage.camera);
      if (v.z > 1 || v.z < -1) return null;
      const x = ((v.x + 1) / 2) * canvas.clientWidth + halfShift();
      return split && x < canvas.clientWidth / 2 ? null : [x, ((1 - v.y) / 2) * canvas.clientHeight];
    },
  };
  setControls();
  north.addEventListener("click", () => stage.northUp());
  return stage;
}

const least = (values: number[]) => values.reduce((a, b) => Math.min(a, b), Infinity);
const most = (values: number[]) => values.reduce((a, b) => Math.max(a, b), -Infinity);

export function niceStep(atLeast: number): number {
  const power = 10 ** Math.floor(Math.log10(Math.max(atLeast, 1e-3)));
  const rest = atLeast / power;
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
