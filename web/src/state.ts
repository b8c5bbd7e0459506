// The state of the page, kept in the address bar: a link opens the same view.
import { anyCone, formatFilter, parseFilter, type Filter } from "./filters";
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
  filter: Filter;
  /** Lists show what is in the view only. */
  inView: boolean;
  /** Order of the lists: id of a column, with "-" at the end if descending; null is the order of each list. */
  sort: string | null;
  /** A found position, offset from the map's origin. */
  mark: [number, number] | null;
  feature: string | null;
  /** The frame pair that is shown of the feature; null: the best one. */
  image: { drive_uuid: string; frame_index: number } | null;
  trajectory: boolean;
  /** Base layers. */
  points: boolean;
  lines: boolean;
  /** Opened tab of the list; null is closed. */
  list: string | null;
  scene: SceneState;
  camera: CameraPose | null;
}

export function initialState(): State {
  return {
    map: "", mode: "instant", changeset: null, side: "changes", from: 0, to: null, valid: null, known: null,
    hidden: new Set(), minProbability: 0, filter: anyCone(), inView: false, sort: null, mark: null, feature: null, image: null, trajectory: true,
    points: true, lines: true, scene: SCENE, list: null, camera: null,
  };
}

const MODES: Mode[] = ["instant", "drive", "compare"];
const SIDES: Side[] = ["before", "changes", "after"];
/** Names in the address and fields of what is shown unless it is "0". */
const SWITCHES = [["way", "trajectory"], ["points", "points"], ["lines", "lines"]] as const;

/** Parameters that remember which names were asked for. */
class Parameters extends URLSearchParams {
  readonly asked = new Set<string>();
  override get(name: string): string | null {
    this.asked.add(name);
    return super.get(name);
  }
}

/** State from the part of an address after "#". What is not understood gets its default, and a sentence in `problems`. */
export function parseState(hash: string, problems: string[] = []): State {
  const state = initialState();
  const p = new Parameters(hash.replace(/^#/, ""));
  const wrong = (name: string, expected: string) => void problems.push(`${name}=${p.get(name) ?? ""} is not ${expected}`);
  /** The value that `read` makes of a text; undefined is a problem. */
  function value<T>(name: string, fallback: T, expected: string, read: (text: string) => T | undefined): T {
    const text = p.get(name);
    const found = text === null ? fallback : read(text);
    if (found === undefined) wrong(name, expected);
    return found ?? fallback;
  }
  const number = (name: string) => value<number | null>(name, null, "a number", (text) => (/^\d{1,15}$/.test(text) ? Number(text) : undefined));
  state.map = p.get("map") ?? "";
  // A link that names a drive shows that drive.
  state.mode = value("mode", p.has("changeset") || p.has("side") ? "drive" : "instant", `one of ${MODES.join(", ")}`, (text) => MODES.find((m) => m === text));
  state.side = value("side", "changes", `one of ${SIDES.join(", ")}`, (text) => SIDES.find((s) => s === text));
  state.changeset = number("changeset");
  state.from = number("from") ?? 0;
  state.to = number("to");
  state.known = number("known");
  state.valid = value<string | null>("valid", null, "a time such as 2026-03-02T12:00:00Z", (text) => (Number.isNaN(Date.parse(text)) ? undefined : new Date(text).toISOString()));
  const kinds = (name: string) => p.get(name)?.split(",") ?? null;
  const [hide, show] = [kinds("hide"), kinds("show")];
  state.hidden = new Set(KIND_ORDER.filter((kind) => (show ? !show.includes(kind) : hide?.includes(kind))));
  state.minProbability = value("p", 0, "a probability", (text) => (Number(text) >= 0 && Number(text) <= 1 ? Number(text) : undefined));
  state.filter = parseFilter(p, wrong);
  state.inView = p.get("inview") === "1";
  state.sort = value<string | null>("sort", null, "a column", (text) => (/^[a-z]{1,20}-?$/.test(text) ? text : undefined));
  state.list = value<string | null>("list", null, "a list", (text) => (/^[a-z]{1,20}$/.test(text) ? text : undefined));
  state.feature = value<string | null>("feature", null, "the id of a cone, 36 characters", (text) => (/^[0-9a-f-]{36}$/.test(text) ? text : undefined));
  state.image = value<State["image"]>("image", null, "a drive and a frame pair", (text) => {
    const [, drive_uuid, index] = /^([0-9a-f-]{36})\.(\d{1,9})$/.exec(text) ?? [];
    return drive_uuid && index ? { drive_uuid, frame_index: Number(index) } : undefined;
  });
  for (const [name, field] of SWITCHES) state[field] = p.get(name) !== "0";
  state.scene = parseScene(p);
  const numbers = (count: number) => (text: string) => {
    const found = text.split(",").map(Number);
    return found.length === count && found.every(Number.isFinite) ? found : undefined;
  };
  state.mark = value<number[] | null>("mark", null, "a position", numbers(2)) as State["mark"];
  const camera = value<number[] | null>("cam", null, "a camera", numbers(6));
  if (camera && (camera[5] ?? 0) > 0) state.camera = camera as CameraPose;
  for (const name of new Set(p.keys())) if (!p.asked.has(name)) problems.push(`${name} is unknown`);
  return state;
}

/** The inverse of parseState; defaults are left out. */
export function formatState(state: State): string {
  const p = new URLSearchParams();
  p.set("map", state.map);
  if (state.mode !== "instant") p.set("mode", state.mode);
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
  const shown = KIND_ORDER.filter((kind) => !state.hidden.has(kind));
  if (shown.length < state.hidden.size) p.set("show", shown.join(","));
  else if (state.hidden.size) p.set("hide", [...state.hidden].join(","));
  if (state.minProbability > 0) p.set("p", String(state.minProbability));
  formatFilter(state.filter, p);
  if (state.inView) p.set("inview", "1");
  if (state.sort !== null) p.set("sort", state.sort);
  if (state.mark) p.set("mark", state.mark.map((v) => v.toFixed(2)).join(","));
  if (state.feature) p.set("feature", state.feature);
  if (state.feature && state.image) p.set("image", `${state.image.drive_uuid}.${state.image.frame_index}`);
  for (const [name, field] of SWITCHES) if (!state[field]) p.set(name, "0");
  formatScene(p, state.scene, state.mode === "compare");
  if (state.list !== null) p.set("list", state.list);
  if (state.camera) p.set("cam", state.camera.map((v) => v.toFixed(3).replace(/\.?0+$/, "")).join(","));
  return p.toString().replaceAll("%2C", ",").replaceAll("%3A", ":");
}
