// The state of the page, kept in the address bar: a link opens the same view.
import { KIND_ORDER, type Kind } from "./kinds";
import { formatScene, parseScene, SCENE, type SceneState } from "./scene_state";

export type Mode = "drive" | "compare" | "instant";
export type Side = "before" | "changes" | "after";
/** Target x, y, z, azimuth, polar angle (radians), distance. */
export type CameraPose = [number, number, number, number, number, number];

export interface State {
  map: string;
  mode: Mode;
  /** Chosen changeset; null follows the newest. */
  changeset: number | null;
  side: Side;
  /** Compare: the road after these changesets' drives; 0 is the empty road before the first, null the newest. */
  from: number;
  to: number | null;
  /** Instant: time on the road; null is the latest. */
  valid: string | null;
  /** Compare and instant: the state of the database after this changeset; null is now. */
  known: number | null;
  hidden: Set<Kind>;
  minProbability: number;
  feature: string | null;
  /** Index of the open sighting; null is the nearest one. */
  sighting: number | null;
  trajectory: boolean;
  /** Base layers. */
  points: boolean;
  lines: boolean;
  scene: SceneState;
  camera: CameraPose | null;
}

export function initialState(): State {
  return {
    map: "", mode: "drive", changeset: null, side: "changes", from: 0, to: null, valid: null, known: null,
    hidden: new Set(), minProbability: 0, feature: null, sighting: null, trajectory: true,
    points: true, lines: true, scene: SCENE, camera: null,
  };
}

const MODES: Mode[] = ["drive", "compare", "instant"];
const SIDES: Side[] = ["before", "changes", "after"];
/** Names in the address and fields of what is shown unless it is "0". */
const SWITCHES = [["way", "trajectory"], ["points", "points"], ["lines", "lines"]] as const;

function natural(text: string | null): number | null {
  return text !== null && /^\d{1,15}$/.test(text) ? Number(text) : null;
}

/** State from the part of an address after "#"; invalid values get their defaults. */
export function parseState(hash: string): State {
  const state = initialState();
  const p = new URLSearchParams(hash.replace(/^#/, ""));
  state.map = p.get("map") ?? "";
  state.mode = MODES.find((m) => m === p.get("mode")) ?? "drive";
  state.side = SIDES.find((s) => s === p.get("side")) ?? "changes";
  state.changeset = natural(p.get("changeset"));
  state.from = natural(p.get("from")) ?? 0;
  state.to = natural(p.get("to"));
  state.known = natural(p.get("known"));
  const valid = p.get("valid");
  state.valid = valid !== null && !Number.isNaN(Date.parse(valid)) ? new Date(valid).toISOString() : null;
  state.hidden = new Set(KIND_ORDER.filter((kind) => (p.get("hide") ?? "").split(",").includes(kind)));
  const probability = Number(p.get("p") ?? 0);
  state.minProbability = probability >= 0 && probability <= 1 ? probability : 0;
  const feature = p.get("feature");
  state.feature = feature !== null && /^[0-9a-f-]{36}$/.test(feature) ? feature : null;
  state.sighting = natural(p.get("sighting"));
  for (const [name, field] of SWITCHES) state[field] = p.get(name) !== "0";
  state.scene = parseScene(p);
  const camera = (p.get("cam") ?? "").split(",").map(Number);
  if (camera.length === 6 && camera.every(Number.isFinite) && (camera[5] ?? 0) > 0) state.camera = camera as CameraPose;
  return state;
}

/** The inverse of parseState; defaults are left out. */
export function formatState(state: State): string {
  const p = new URLSearchParams();
  p.set("map", state.map);
  if (state.mode !== "drive") p.set("mode", state.mode);
  if (state.mode === "drive") {
    if (state.changeset !== null) p.set("changeset", String(state.changeset));
    if (state.side !== "changes") p.set("side", state.side);
  }
  if (state.mode === "compare") {
    p.set("from", String(state.from));
    if (state.to !== null) p.set("to", String(state.to));
  }
  if (state.mode === "instant" && state.valid !== null) p.set("valid", state.valid);
  if (state.mode !== "drive" && state.known !== null) p.set("known", String(state.known));
  if (state.hidden.size) p.set("hide", [...state.hidden].join(","));
  if (state.minProbability > 0) p.set("p", String(state.minProbability));
  if (state.feature) p.set("feature", state.feature);
  if (state.feature && state.sighting !== null) p.set("sighting", String(state.sighting));
  for (const [name, field] of SWITCHES) if (!state[field]) p.set(name, "0");
  formatScene(p, state.scene, state.mode === "compare");
  if (state.camera) p.set("cam", state.camera.map((v) => v.toFixed(3).replace(/\.?0+$/, "")).join(","));
  return p.toString().replaceAll("%2C", ",").replaceAll("%3A", ":");
}
