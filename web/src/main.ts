// State of the page -> requests -> drawing.
import { api, requestEarly, type Decisions, type MapItem, type Sighting, type Timeline, type TimelineItem, type Trajectory, type Vec3 } from "./api";
import { createBase } from "./base";
import { countClasses, countOf } from "./classes";
import { createCones } from "./cones";
import { aboutFeature, createDecisionList } from "./decisions";
import { el, fill, messageOf, shortId } from "./dom";
import { isGone, type Cone, type Kind } from "./kinds";
import { createDownloads, pictureOf } from "./downloads";
import { acceptedBy, onlyKind } from "./filters";
import { createLayout } from "./layout";
import { createLists } from "./lists";
import { listen } from "./live";
import { createOverlays, ellipse95, niceFactor } from "./overlays";
import { createPanel, stateOf, type Chosen } from "./panel";
import { changesetOf, drivesShown, readCones, shownInstant, shownState, unknownChangeset } from "./query";
import { createReview } from "./review";
import { createStage, type Stage } from "./scene";
import { createMarker, createSearch } from "./search";
import { createSidebar } from "./sidebar";
import { createSites, nearTo } from "./sites";
import { formatState, parseState, type State } from "./state";
import "./style.css";
import "./table.css";
import { themeSwitch } from "./theme";
import { createTimeline, lineChanges } from "./timeline";
import { createTools } from "./tools";
import { createViewer, type Start } from "./viewer";

const layout = createLayout(document.getElementById("app") ?? document.body);
// The requests go out first: setting up WebGL keeps this thread for as long as they take.
layout.card("Loading the map …", "", { busy: true });
let state: State = readAddress();
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
  layout.card("The map cannot be drawn", "This browser has no WebGL. Turn on hardware acceleration in its settings, or use another browser.");
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
  fit: () => fit(),
});
const showSites = createSites(sidebar.sites, (points) => stage.fit(points));
const search = createSearch(layout.tools.search, {
  search: (text) => api.search(state.map, text),
  select: (id) => void select(id, true),
  showChangeset: (no) => change({ mode: "drive", changeset: no === timeline?.changesets.at(-1)?.changeset_no ? null : no }),
  flyTo: ({ xy_m: [x, y] }) => {
    state.mark = [x, y];
    writeAddress();
    stage.lookAt([x, y, groundAt(x, y)], 40);
    drawMark();
  },
});
const showMarker = createMarker(stage, layout.view, () => {
  state.mark = null;
  writeAddress();
  drawMark();
});
const lists = createLists(layout.listPane, { change, select: (id, centre) => void select(id, centre), inView });
createDownloads(layout.tools.download, {
  shown: () => timeline?.changesets.length && unknownChangeset(state, timeline.changesets) === null ? { map: state.map, drive: state.mode === "drive" ? changeset(state.changeset) ?? null : null, coneCount: all.filter((c) => !isGone(c.kind)).length, box: boxInView(), ...shownInstant(state, timeline.changesets) } : null,
  picture: () => new Promise((done, fail) => {
    stage.draw();
    // In the same frame, after it was drawn: later the canvas is empty.
    requestAnimationFrame(() => void pictureOf(stage.canvas, layout.view, `${state.map}, ${shownInstant(state, timeline?.changesets ?? []).title}`).then(done, fail));
  }),
  failed: (message) => layout.toast(message, null),
});
const showTimeline = createTimeline(layout.timeline, {
  change,
  showChanges: (kind) => change({ mode: "drive", side: "changes", hidden: onlyKind({ ...state, hidden: state.list === "changes" ? state.hidden : new Set() }, kind), list: "changes" }),
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
  openImages,
});
const viewer = createViewer(document.body);
const review = createReview((render) => layout.listPane.addTab("Review", render), {
  map: () => state.map,
  writable: () => decisions?.writable ?? false,
  show: (item) => {
    change({ mode: "drive", side: "changes", changeset: item.changeset_no === timeline?.changesets.at(-1)?.changeset_no ? null : item.changeset_no });
    void select(item.feature_id, true);
  },
  openImages: (item) => {
    const drive = timeline?.changesets.find((t) => t.changeset_no === item.changeset_no);
    if (item.feature_id !== null) openImages(null);
    else if (drive) void viewer.open({ map: state.map, id: null, title: item.drive_id, why: item.why, now: null, before: null, sightings: [] }, { drive_uuid: drive.drive_uuid, frame_index: 0 });
  },
  decided: () => void newDecision(),
  said: (text) => layout.toast(text, null),
});
layout.brand.after(review.button);
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
let movedTimer = 0;

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

layout.listPane.onChange((list) => {
  state.list = list;
  writeAddress();
});
stage.onCamera((camera) => {
  state.camera = camera;
  writeAtRest();
  window.clearTimeout(movedTimer);
  movedTimer = window.setTimeout(() => lists.moved(), REST_MS);
});
window.addEventListener("hashchange", () => {
  const next = readAddress();
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

/** The address says what is shown; what is not understood is reported. */
function readAddress(): State {
  const problems: string[] = [];
  const found = parseState(location.hash, problems);
  if (problems.length) layout.toast(`Part of this link was ignored: ${problems.join("; ")}.`, { text: "OK", run: () => undefined });
  return found;
}

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
    if (timeline) review.load();
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
    review.load();
    const item = timeline?.changesets.at(-1);
    if (!item) return;
    void api.maps().then((answer) => sidebar.showMaps((maps = answer.maps), state.map));
    const counts = [`${item.added_count} added`, `${item.moved_count} moved`, `${item.removed_count} removed`, ...lineChanges([item]).map((change) => change.text)].join(", ");
    const follows = state.mode === "drive" && state.changeset === null;
    const said = item.counts ? `${item.drive_id} was committed: ${counts}.` : item.hold === null ? `${item.drive_id} was committed, but is not part of the map: see the decisions.` : `${item.drive_id} is on hold: ${item.hold}`;
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
    review.load();
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
    const hint = unknown ? `Select one of the maps of this database: ${there.join(", ")}. To create a new map, ingest a drive:` : "Ingest a drive; it appears here at once:";
    layout.card(title, hint, { code: `conetl ingest ${state.map === "default" ? "" : `--map ${state.map} `}path/to/drive` });
    layout.empty(true);
    show([], []);
    return;
  }
  layout.empty(false);
  const unknown = unknownChangeset(state, timeline.changesets);
  if (unknown !== null) {
    const numbers = timeline.changesets.map((t) => t.changeset_no);
    const there = numbers.length === 1 ? `It has one changeset, number ${numbers[0]}.` : `It has ${numbers.length} changesets, numbers ${numbers.length > 8 ? `${numbers[0]} to ${numbers.at(-1)}` : numbers.join(", ")}.`;
    show([], []);
    layout.card(`The map “${state.map}” has no changeset ${unknown}`, there, { action: { text: "Show the latest", run: () => change({ changeset: null, from: 0, to: null, known: null }) } });
    return;
  }
  layout.busy(true);
  showTimeline(state, timeline.changesets); // the controls react at once, the scene when the data is there
  try {
    const [[next, truncated], drives] = await Promise.all([readCones(state, timeline.changesets), readPaths(drivesShown(state, timeline.changesets))]);
    if (mine !== refreshNo) return;
    layout.card(null);
    if (chosen && chosenKnown !== shownState(state, timeline.changesets).known) void select(chosen.id);
    layout.notice(truncated ? `Only the first ${countOf(next.length)} are shown: this map is too large for one view.` : null);
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

/** A drive is shown as it was committed; later decisions are marked, and classes are those that people stated. */
function withDecisions(cones: Cone[]): Cone[] {
  const later = (decisions?.decisions ?? []).filter((d) => d.kind === "suppress" || d.kind === "classify");
  if (!later.length) return cones;
  return cones.map((cone): Cone => {
    const about = aboutFeature(later, cone.id, cone.xyz, cone.marking !== null);
    const category = about.find((d) => d.found_as === cone.category)?.category ?? cone.category;
    return { ...cone, category, kind: about.some((d) => d.kind === "suppress") ? "suppressed" : cone.kind };
  });
}

function show(next: Cone[], drives: Trajectory[]): void {
  all = state.mode === "drive" ? withDecisions(next) : next;
  countClasses(all);
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
  return all.filter(acceptedBy(state));
}

function inView(point: Vec3): boolean {
  const pixel = stage.project(point);
  return pixel !== null && pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] <= stage.canvas.clientWidth && pixel[1] <= stage.canvas.clientHeight;
}

/** Around the cones in the view, in the map's CRS; null without any. */
function boxInView(): [number, number, number, number] | null {
  const [east, north] = timeline?.origin_m ?? [0, 0];
  const box = all.filter((c) => inView(c.xyz)).reduce(([w, s, e, n], { xyz: [x, y] }) => [Math.min(w, x), Math.min(s, y), Math.max(e, x), Math.max(n, y)] as const, [Infinity, Infinity, -Infinity, -Infinity] as const);
  const [w, s, e, n] = box;
  return Number.isFinite(w) ? [w + east - 0.5, s + north - 0.5, e + east + 0.5, n + north + 0.5] : null;
}

/** Height of the nearest cone. */
function groundAt(x: number, y: number): number {
  let [best, height] = [Infinity, 0];
  for (const { xyz } of all) {
    const distance = Math.hypot(xyz[0] - x, xyz[1] - y);
    if (distance < best) [best, height] = [distance, xyz[2]];
  }
  return height;
}

function drawMark(): void {
  showMarker(state.mark ? [...state.mark, groundAt(...state.mark)] : null);
}

function draw(): void {
  const shown = visible();
  cones.show(shown);
  layout.listPane.open(state.list);
  lists.show(state, all, timeline);
  showSites(all.filter((c) => !c.marking));
  drawMark();
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
  const near = path.filter(nearTo(points, 7));
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
/** Instant of the database of the history that is shown; null is now. */
let chosenKnown: string | null = null;
async function select(id: string | null, centre = false): Promise<void> {
  const mine = ++selecting;
  if (id !== state.feature) state.sighting = null;
  state.feature = id;
  writeAddress();
  overlays.showLabels(visible(), id);
  lists.choose(id);
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
    const { reached, known } = shownState(state, timeline?.changesets ?? []);
    const { history } = await api.history(map, id, known);
    if (mine !== selecting) return;
    chosenKnown = known;
    // The images of before stay until there are others.
    chosen = { id, map, srid: timeline?.srid ?? 0, history, sightings: chosen?.sightings ?? null, truncated: chosen?.truncated ?? false, sightingIndex: 0, reached, kind: null, factor: chosen?.factor ?? null, decisions };
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
  const sightingIndex = Math.max(0, Math.min(index, sightingsShown(chosen).length - 1));
  state.sighting = sightingIndex;
  writeChoice();
  drawChosen();
}

function drawChosen(): void {
  if (!chosen) {
    overlays.showSelection(null, null, 1);
    overlays.showFrustum(null);
    return;
  }
  const { reached } = shownState(state, timeline?.changesets ?? []);
  chosen = { ...chosen, reached };
  const shown: Chosen = { ...chosen, kind: kindShown(chosen), sightings: chosen.sightings && sightingsShown(chosen) };
  shown.sightingIndex = chosen.sightingIndex = sightingToShow(shown);
  const now = stateOf(shown);
  const ellipse = now && !now.marking ? ellipse95(now.cov_m2) : null;
  overlays.showSelection(now?.xyz_m ?? null, ellipse, ellipse ? chosen.factor ?? niceFactor(ellipse) : 1, now?.marking?.line_m);
  overlays.showFrustum(shown.sightings?.[shown.sightingIndex] ?? null);
  panel.show(shown);
}

/** As the scene draws it, or would. */
function kindShown(c: Chosen): Kind | null {
  const drawn = all.find((cone) => cone.id === c.id)?.kind;
  const now = stateOf(c);
  if (drawn || !now) return drawn ?? null;
  const about = aboutFeature(decisions?.decisions ?? [], c.id, c.history.at(-1)?.xyz_m, Boolean(c.history[0]?.marking));
  if (about.some((d) => d.kind === "suppress")) return "suppressed";
  return state.mode !== "drive" && !isGone(now.kind) ? "standing" : now.kind;
}

/** Of the drives until the chosen instant; drive by drive of all drives. */
function sightingsShown({ sightings, history, reached }: Chosen): Sighting[] {
  if (!sightings || state.mode === "drive") return sightings ?? [];
  const until = new Set(history.filter(reached).map((h) => h.changeset_no));
  return sightings.filter((s) => until.has(s.changeset_no));
}

/** The selected one, else the nearest one of the drive that is shown. */
function sightingToShow({ sightings, history, reached }: Chosen): number {
  if (!sightings?.length) return 0;
  if (state.sighting !== null) return Math.min(state.sighting, sightings.length - 1);
  const no = history.filter((h) => reached(h) && h.sighting_count > 0).at(-1)?.changeset_no;
  let best = -1;
  sightings.forEach((s, i) => {
    if ((s.changeset_no === no || no === undefined) && (best < 0 || s.range_m < (sightings[best]?.range_m ?? 0))) best = i;
  });
  return Math.max(best, 0);
}

function openImages(start: Start | null): void {
  if (!chosen) return;
  const now = stateOf(chosen) ?? chosen.history[0];
  if (!now || now.marking) return;
  const before = now.kind === "moved" ? chosen.history[chosen.history.indexOf(now) - 1] ?? null : null;
  const absent = now.kind === "removed" || now.kind === "missed";
  const sighting = absent ? undefined : sightingsShown(chosen)[chosen.sightingIndex];
  void viewer.open({ map: chosen.map, id: chosen.id, title: shortId(chosen.id), why: now.why, now, before, sightings: chosen.sightings ?? [] }, start ?? sighting ?? null);
}

function centreChosen(): void {
  const now = chosen && (stateOf(chosen) ?? chosen.history[0]);
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
  if (review.key(event)) return true;
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
    case "i": case "I": openImages(null); return true;
    case "1": change({ points: !state.points }, false); return true;
    case "2": change({ lines: !state.lines }, false); return true;
    case "l": case "L": layout.listPane.toggle(); return true;
    case "]": case "j": case "J": case "[": case "k": case "K": {
      const cone = lists.next(event.key === "]" || event.key.toLowerCase() === "j" ? 1 : -1);
      if (cone) void select(cone.id, true);
      return true;
    }
    case "/": search.focus(); return true;
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
