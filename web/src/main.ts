// State of the page -> requests -> drawing.
import { api, requestEarly, type Decisions, type HistoryItem, type MapItem, type Timeline, type TimelineItem, type Trajectory, type Vec3 } from "./api";
import { createBase } from "./base";
import { createCones } from "./cones";
import { aboutFeature, createDecisionList } from "./decisions";
import { el, fill, messageOf, plural } from "./dom";
import type { Cone } from "./kinds";
import { createLayout } from "./layout";
import { listen } from "./live";
import { createOverlays, ellipse95, niceFactor } from "./overlays";
import { createPanel, stateAt, until, type Chosen } from "./panel";
import { changesetOf, drivesShown, readCones } from "./query";
import { createStage, type Stage } from "./scene";
import { createSidebar } from "./sidebar";
import { formatState, parseState, type State } from "./state";
import "./style.css";
import { themeSwitch } from "./theme";
import { createTimeline } from "./timeline";
import { createTools } from "./tools";

const layout = createLayout(document.getElementById("app") ?? document.body);
// The requests go out first: setting up WebGL keeps this thread for as long as they take.
layout.card("Loading the map …", "", { busy: true });
let state: State = parseState(location.hash);
try {
  const answer = await api.maps();
  const name = state.map || nameOf(answer);
  if (answer.maps.some((m) => m.map_name === name && m.changeset_count > 0)) requestEarly(name, answer);
} catch {
  // openMap requests them again, and reports errors
}
let stage: Stage;
try {
  stage = createStage(layout.view);
} catch (error) {
  layout.card("This browser cannot draw in 3D", "WebGL is disabled or missing. Enable hardware acceleration, or use another browser.");
  throw error;
}
const cones = createCones(stage);
const overlays = createOverlays(stage, layout.view);
const base = createBase(stage, (error) => layout.toast(`Base layers: ${messageOf(error)}`, null));

const tools = createTools(stage, layout.view, cones, {
  state: () => state,
  change: (scene) => {
    state = { ...state, scene: { ...state.scene, ...scene } };
    writeChoice();
    base.apply(state);
    tools.apply(state);
  },
  cones: () => visible(),
  trouble: (text) => layout.toast(text, null),
  redraw: () => draw(),
});

let maps: MapItem[] = [];
let timeline: Timeline | null = null;
let all: Cone[] = [];
let chosen: Chosen | null = null;
let fitted = false;
/** Number of the latest refresh: answers to earlier ones are dropped. */
let refreshNo = 0;
let decisions: Decisions | null = null;
let closeStream: (() => void) | null = null;
const paths = new Map<string, Trajectory>();

const sidebar = createSidebar(layout.sidebar, {
  chooseMap: (name) => {
    state = { ...parseState(""), map: name };
    writeAddress();
    void openMap();
  },
  change,
  find: (beginning) => api.find(state.map, beginning),
  select: (id) => void select(id, true),
  fit: () => fit(),
});
const showTimeline = createTimeline(layout.timeline, {
  change,
  writableMap: () => (decisions?.writable ? state.map : null),
  decided: () => void newDecision(),
  decisions: () => decisions?.decisions ?? [],
});
const panel = createPanel(layout.panel, {
  close: () => void select(null),
  showSighting: (sighting) => showSighting(sighting),
  showChangeset: (changeset) => change({ mode: "drive", changeset }),
  setFactor: (factor) => {
    if (chosen) chosen = { ...chosen, factor };
    drawChosen();
  },
  centre: () => centreChosen(),
  decided: () => void newDecision(),
});
const decisionSection = el("section", { class: "decisions", hidden: true });
layout.sidebar.append(decisionSection);
const showDecisionList = createDecisionList(decisionSection, (d) => {
  const reverted = timeline?.changesets.find((t) => t.changeset_id === d.changeset_id);
  if (reverted) change({ mode: "drive", changeset: reverted.changeset_no });
  else if (d.feature_id) void select(d.feature_id, true);
});

// --- state

function change(values: Partial<State>, refetch = true): void {
  state = { ...state, ...values };
  writeChoice();
  if (refetch) void refresh();
  else draw();
}

/** Delay of the address while something keeps moving: browsers refuse more than about 100 addresses in 30 s. */
const REST_MS = 120;
let addressTimer = 0;
let choiceAt = -Infinity;

/** At once: a reload right after a click shows what was clicked. */
function writeAddress(): void {
  window.clearTimeout(addressTimer);
  const hash = `#${formatState(state)}`;
  if (hash !== location.hash) history.replaceState(null, "", hash);
}

function writeAtRest(): void {
  window.clearTimeout(addressTimer);
  addressTimer = window.setTimeout(writeAddress, REST_MS);
}

/** At once too, unless choices follow each other fast: a slider is dragged, or a key held. */
function writeChoice(): void {
  const now = performance.now();
  if (now - choiceAt < REST_MS) writeAtRest();
  else writeAddress();
  choiceAt = now;
}

stage.onCamera((camera) => {
  state.camera = camera;
  writeAtRest();
});
window.addEventListener("hashchange", () => {
  const next = parseState(location.hash);
  const other = next.map !== state.map;
  state = next;
  if (other) void openMap();
  else {
    if (state.camera) tools.setPose(state.camera);
    tools.openMeasure();
    void refresh();
    void select(state.feature);
  }
});

const changeset = (no: number | null) => changesetOf(timeline?.changesets ?? [], no);

// --- loading

/** The map to show by default. */
function nameOf(answer: { maps: MapItem[]; chosen: string }): string {
  return answer.maps.some((m) => m.map_name === answer.chosen) || !answer.maps[0] ? answer.chosen : answer.maps[0].map_name;
}

async function openMap(): Promise<void> {
  closeStream?.();
  chosen = null;
  panel.hide();
  timeline = null;
  all = [];
  paths.clear();
  decisions = null;
  showDecisionList(null);
  base.close();
  sidebar.showBase([]);
  fitted = state.camera !== null;
  layout.card("Loading the map …", "", { busy: true });
  try {
    const answer = await api.maps();
    maps = answer.maps;
    if (!state.map) state.map = nameOf(answer);
    tools.basemap(answer.basemap);
    sidebar.showMaps(maps, state.map);
    document.title = `${state.map} · conetl`;
    if (maps.some((m) => m.map_name === state.map && m.changeset_count > 0)) {
      void openBase(state.map);
      stage.warm();
      await Promise.all([readTimeline(), readDecisions()]);
    }
    if (state.camera) tools.setPose(state.camera);
    await refresh();
    tools.openMeasure();
    if (state.feature) await select(state.feature);
  } catch (error) {
    fail(error, openMap);
  }
  let decided: number | null = null;
  let baseHead: string | null = null;
  const map = state.map;
  closeStream = listen(map, {
    newest: (no) => void newChangeset(no),
    decided: (no) => {
      if (decided !== null && no !== decided) void newDecision();
      decided = no;
    },
    base: (head) => {
      if (baseHead !== null && head !== baseHead) void openBase(map);
      baseHead = head;
    },
    status: layout.status,
  });
}

/** In parallel: cones never wait for the base layers. */
async function openBase(map: string): Promise<void> {
  try {
    base.apply(state);
    const layers = await base.open(map);
    if (map === state.map) sidebar.showBase(layers);
    tools.points(layers.some((l) => l.kind === "points"));
  } catch (error) {
    layout.toast(`The base layers cannot be shown: ${messageOf(error)}`, { text: "Try again", run: () => void openBase(map) });
  }
}

async function readTimeline(): Promise<void> {
  timeline = await api.timeline(state.map);
  tools.open(timeline);
}

async function newChangeset(no: number): Promise<void> {
  const known = timeline?.changesets.at(-1)?.changeset_no ?? 0;
  if (no <= known) return;
  try {
    await Promise.all([readTimeline(), readDecisions()]); // it may be on hold
    const item = timeline?.changesets.at(-1);
    if (!item) return;
    void api.maps().then((answer) => sidebar.showMaps((maps = answer.maps), state.map));
    const counts = [`${item.added_count} new`, `${item.moved_count} moved`, `${item.removed_count} removed`].join(", ");
    const follows = state.mode === "drive" && state.changeset === null;
    const said = item.counts ? `${item.drive_id} was committed: ${counts}.` : item.hold === null ? `${item.drive_id} does not count: see the decisions.` : `${item.drive_id} is on hold: ${item.hold}`;
    layout.toast(said, follows ? null : { text: "Show", run: () => change({ mode: "drive", changeset: null }) });
    await refresh();
    if (chosen) await select(chosen.id);
  } catch (error) {
    fail(error, () => newChangeset(no));
  }
}

/** The map is shown even if the decisions cannot be read. */
async function readDecisions(): Promise<void> {
  const map = state.map;
  try {
    const answer = await api.decisions(map);
    if (map !== state.map) return;
    decisions = answer;
    showDecisionList(answer);
    if (chosen) chosen = { ...chosen, decisions };
  } catch (error) {
    layout.toast(`The decisions cannot be read: ${messageOf(error)}`, { text: "Try again", run: () => void newDecision() });
  }
}

/** After a decision, other cones may stand and other drives count. */
async function newDecision(): Promise<void> {
  try {
    await Promise.all([readTimeline(), readDecisions()]);
    await refresh();
    if (chosen) await select(chosen.id);
  } catch (error) {
    fail(error, newDecision);
  }
}

async function refresh(): Promise<void> {
  const mine = ++refreshNo;
  if (!timeline || !timeline.changesets.length) {
    const there = maps.filter((m) => m.changeset_count > 0).map((m) => `“${m.map_name}”`);
    const unknown = there.length > 0 && !maps.some((m) => m.map_name === state.map);
    const title = unknown ? `There is no map “${state.map}”` : `The map “${state.map}” is empty`;
    const hint = unknown ? `This database holds ${there.join(", ")}: select one on the left. To create a new map, ingest a drive:` : "It appears here as soon as a drive is ingested:";
    layout.card(title, hint, { code: `${state.map === "default" ? "" : `CONETL_MAP_NAME=${state.map} `}conetl ingest path/to/drive` });
    layout.empty(true);
    show([], []);
    return;
  }
  layout.empty(false);
  layout.busy(true);
  showTimeline(state, timeline.changesets); // the controls react at once, the scene when the data is there
  try {
    const [[next, truncated], drives] = await Promise.all([readCones(state, timeline.changesets), readPaths(drivesShown(state, timeline.changesets))]);
    if (mine !== refreshNo) return;
    layout.card(null);
    layout.notice(truncated ? `Only the first ${plural(next.length, "cone")} are shown: the map exceeds the limit of one view.` : null);
    show(next, drives);
  } catch (error) {
    if (mine === refreshNo) fail(error, refresh);
  } finally {
    if (mine === refreshNo) layout.busy(false);
  }
}

function readPaths(drives: TimelineItem[]): Promise<Trajectory[]> {
  return Promise.all(drives.map(async ({ drive_uuid }) => {
    const path = paths.get(drive_uuid) ?? (await api.trajectory(state.map, drive_uuid));
    paths.set(drive_uuid, path);
    return path;
  })); // prettier-ignore
}

// --- drawing

function show(next: Cone[], drives: Trajectory[]): void {
  // A drive is shown as it was committed; later decisions are marked.
  const suppressed = state.mode === "drive" ? (decisions?.decisions ?? []).filter((d) => d.kind === "suppress") : [];
  all = suppressed.length ? next.map((c) => (aboutFeature(suppressed, c.id, c.xyz).length ? { ...c, kind: "suppressed" } : c)) : next;
  overlays.showPaths(drives);
  stage.start();
  const heights = all.map((c) => c.xyz[2]).sort((a, b) => a - b);
  const middle = heights[Math.floor(heights.length / 2)];
  if (middle !== undefined) stage.setGround(middle);
  draw();
  if (!fitted && (all.length || drives.length)) {
    fitted = true;
    fit();
  }
}

function visible(): Cone[] {
  return all.filter((c) => !state.hidden.has(c.kind) && c.probability >= state.minProbability);
}

function draw(): void {
  const shown = visible();
  cones.show(shown);
  base.apply(state);
  tools.show(all);
  tools.apply(state);
  overlays.showLabels(shown, state.feature);
  sidebar.show(state, all, shown.length);
  showTimeline(state, timeline?.changesets ?? []);
  drawChosen();
  document.documentElement.dataset["cones"] = String(shown.length);
}

/** Show everything from above and behind the drive. */
function fit(): void {
  const path = [...paths.values()].at(-1)?.xyz_m ?? [];
  const points: Vec3[] = all.flatMap((c) => [c.xyz, ...(c.old ? [c.old] : [])]);
  const near = path.filter((p) => points.some((q) => Math.hypot(p[0] - q[0], p[1] - q[1]) < 7));
  const [a, b] = [path[0], path.at(-1)];
  if (a && b && state.camera === null) {
    const heading = Math.atan2(b[1] - a[1], b[0] - a[0]);
    stage.setPose([a[0], a[1], a[2], heading - Math.PI / 2 + 0.5, 0.95, 30]);
  }
  stage.fit([...points, ...(points.length ? near : path)]);
}

function fail(error: unknown, again: () => unknown): void {
  stage.start();
  if (!all.length) layout.empty(true); // no controls without data
  layout.busy(false);
  const text = messageOf(error);
  layout.card("The map cannot be shown", text, { action: { text: "Try again", run: () => void again() } });
}

// --- the selected cone

let selecting = 0;
async function select(id: string | null, centre = false): Promise<void> {
  const mine = ++selecting;
  if (id !== state.feature) state.sighting = null;
  state.feature = id;
  writeAddress();
  overlays.showLabels(visible(), id);
  layout.panelOpen(id !== null);
  if (id === null) {
    chosen = null;
    panel.hide();
    drawChosen();
    return;
  }
  const map = state.map;
  if (chosen?.id !== id) {
    chosen = null;
    panel.loading(id);
    drawChosen();
  }
  try {
    const { history } = await api.history(map, id);
    if (mine !== selecting) return;
    chosen = { id, map, srid: timeline?.srid ?? 0, history, sightings: null, truncated: false, sightingIndex: 0, upTo: upTo(), factor: chosen?.factor ?? null, decisions };
    drawChosen();
    if (centre) centreChosen();
    const { sightings, truncated } = await api.sightings(map, id);
    if (mine !== selecting || !chosen) return;
    chosen = { ...chosen, sightings, truncated };
    drawChosen();
  } catch (error) {
    if (mine === selecting) panel.failed(id, error);
  }
}

function showSighting(index: number): void {
  if (!chosen?.sightings) return;
  const sightingIndex = Math.max(0, Math.min(index, chosen.sightings.length - 1));
  state.sighting = sightingIndex;
  writeChoice();
  drawChosen();
}

function upTo(): number {
  const item = state.mode === "drive" ? changeset(state.changeset) : undefined;
  return item ? Date.parse(item.captured_from) : Infinity;
}

function drawChosen(): void {
  if (!chosen) {
    overlays.showSelection(null, null, 1);
    overlays.showFrustum(null);
    return;
  }
  chosen = { ...chosen, upTo: upTo() };
  chosen.sightingIndex = sightingToShow(chosen);
  const now: HistoryItem | undefined = stateAt(chosen.history, chosen.upTo);
  if (now) {
    const ellipse = ellipse95(now.cov_m2);
    overlays.showSelection(now.xyz_m, ellipse, chosen.factor ?? niceFactor(ellipse));
  }
  overlays.showFrustum(chosen.sightings?.[chosen.sightingIndex] ?? null);
  panel.show(chosen);
}

/** The selected one, else the nearest one of the drive that is shown. */
function sightingToShow({ sightings, history, upTo }: Chosen): number {
  if (!sightings?.length) return 0;
  if (state.sighting !== null) return Math.min(state.sighting, sightings.length - 1);
  const no = history.filter((h) => until(h, upTo) && h.sighting_count > 0).at(-1)?.changeset_no;
  let best = -1;
  sightings.forEach((s, i) => {
    if ((s.changeset_no === no || no === undefined) && (best < 0 || s.range_m < (sightings[best]?.range_m ?? 0))) best = i;
  });
  return Math.max(best, 0);
}

function centreChosen(): void {
  const now = chosen && stateAt(chosen.history, chosen.upTo);
  if (now) stage.lookAt(now.xyz_m, 9);
}

// --- mouse and keyboard

let down: [number, number] | null = null;
stage.canvas.addEventListener("pointerdown", (event) => {
  down = [event.clientX, event.clientY];
});
stage.canvas.addEventListener("pointerup", (event) => {
  if (!down || event.button !== 0 || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 5) return;
  if (tools.click(event.offsetX, event.offsetY)) return layout.tip(null, 0, 0);
  const cone = tools.pick(event.offsetX, event.offsetY);
  if (!cone) return tools.clickGround(event.offsetX, event.offsetY);
  layout.tip(null, 0, 0); // the panel moves the scene, and the cone away from the pointer
  void select(cone.id);
});
let hovering = false;
stage.canvas.addEventListener("pointermove", (event) => {
  if (hovering || event.buttons || event.pointerType === "touch") return;
  hovering = true;
  requestAnimationFrame(() => {
    hovering = false;
    const cone = tools.pick(event.offsetX, event.offsetY);
    stage.canvas.classList.toggle("over", cone !== null);
    layout.tip(cone, event.offsetX, event.offsetY);
  });
});
stage.canvas.addEventListener("pointerleave", () => layout.tip(null, 0, 0));

window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const target = event.target instanceof HTMLElement ? event.target : document.body;
  const typing = target.matches("select, input:not([type=range]):not([type=checkbox])");
  if (event.key === "Escape") {
    if (typing) target.blur();
    else if (!layout.closeHelp() && !tools.escape()) void select(null);
    return;
  }
  if (typing) return;
  if (target.matches("input[type=range]") && event.key.startsWith("Arrow")) return;
  if (tools.key(event) || handleKey(event) || stage.key(event)) event.preventDefault();
});

function handleKey(event: KeyboardEvent): boolean {
  const items = timeline?.changesets ?? [];
  const at = items.findIndex((t) => t === changeset(state.changeset));
  const step = (by: number) => {
    const item = items[at + by];
    if (item) change({ mode: "drive", changeset: item === items.at(-1) ? null : item.changeset_no });
  };
  switch (event.key) {
    case "Home": fit(); return true;
    case ",": step(-1); return true;
    case ".": step(1); return true;
    case "b": case "B": change({ mode: "drive", side: state.side === "before" ? "after" : "before" }); return true;
    case "c": case "C": change({ mode: "drive", side: "changes" }); return true;
    case "n": case "N": if (chosen) showSighting(chosen.sightingIndex + 1); return true;
    case "p": case "P": if (chosen) showSighting(chosen.sightingIndex - 1); return true;
    case "1": change({ points: !state.points }, false); return true;
    case "2": change({ lines: !state.lines }, false); return true;
    case "/": sidebar.focusSearch(); return true;
    case "?": layout.openHelp(); return true;
    default: return false;
  }
}

declare global {
  interface Window {
    /** For tests: where a cone is on the canvas. */
    conetlProject?: (id: string) => [number, number] | null;
    /** For tests: how long finding the cone under a click takes, in milliseconds. */
    conetlPickTime?: (x: number, y: number) => number;
  }
}
window.conetlProject = (id) => {
  const cone = all.find((c) => c.id === id);
  return cone ? stage.project([cone.xyz[0], cone.xyz[1], cone.xyz[2] + cone.height_m / 2]) : null;
};

window.conetlPickTime = (x, y) => {
  const before = performance.now();
  tools.pick(x, y);
  return performance.now() - before;
};

fill(layout.brand, el("b", { textContent: "conetl" }), " map");
layout.brand.parentElement?.querySelector(".status")?.after(themeSwitch());
void openMap();
