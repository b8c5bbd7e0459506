// State of the page -> requests -> drawing.
import { api, login, onLoginRequired, requestEarly, type Decisions, type MapItem, type Query, type Timeline, type DifferenceRow, type TimelineItem, type Trajectory, type Vec3 } from "./api";
import { createAddress, REST_MS } from "./address";
import { createBase } from "./base";
import { footprint } from "./basemap";
import { countClasses } from "./classes";
import { createChanges } from "./changes";
import { createClusters } from "./clusters";
import { createCones } from "./cones";
import { aboutFeature, createDecisionList, writer } from "./decisions";
import { el, fill, messageOf } from "./dom";
import { isGone, type Cone, type Kind } from "./kinds";
import { createDownloads, pictureOf } from "./downloads";
import { acceptedBy, onlyKind } from "./filters";
import { listenToInput } from "./input";
import { createLayout } from "./layout";
import { createLists } from "./lists";
import { listen } from "./live";
import { isQuiet } from "./markings";
import { createOverlays } from "./overlays";
import { changeQueue, differenceQueue, passesOf } from "./queues";
import { changesetOf, changesOfState, drivesShown, shownInstant, unknownChangeset, withChanges } from "./query";
import { createReview } from "./review";
import { createStage, type Stage } from "./scene";
import { createMarker, createSearch } from "./search";
import { createSelection, subjectAfter } from "./selection";
import { EMBEDDED, shareButton } from "./share";
import { createSidebar } from "./sidebar";
import { createSites, nearTo } from "./sites";
import { parseState, type State } from "./state";
import "./style.css";
import "./table.css";
import { setPaper, themeSwitch } from "./theme";
import { changesOf, createTimeline } from "./timeline";
import { createTiles, seenArea } from "./tiles";
import { createTools } from "./tools";
import { createViewer } from "./viewer";
import { createDifferences, createZones } from "./zones";

const layout = createLayout(document.getElementById("app") ?? document.body);
onLoginRequired(() => layout.logIn(login));
// The requests go out first: setting up WebGL keeps this thread for as long as they take.
layout.card("Loading the map …", "", { busy: true });
const address = createAddress(() => state, (text) => layout.toast(text, { text: "OK", run: () => undefined }));
let state: State = address.read();
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
const tiles = createTiles(stage);
const changes = createChanges(stage);
const clusters = createClusters(stage, layout.view);
const changeClusters = createClusters(stage, layout.view, "of-changes", "Δ ");
const zones = createZones(stage, layout.view);
const differences = createDifferences(stage, layout.view, (x, y) => groundAt(x, y));
const overlays = createOverlays(stage, layout.view);
const base = createBase(stage, (error) => layout.toast(`Base layers: ${messageOf(error)}`, null));

const tools = createTools(stage, layout.view, cones, {
  state: () => state,
  change: (scene) => {
    state = { ...state, scene: { ...state.scene, ...scene } };
    address.writeChoice();
    base.apply(state);
    tools.apply(state);
  },
  cones: () => visible(),
  paper: (on) => void showPaper(on),
  trouble: (text) => layout.toast(text, null),
  redraw: () => draw(),
});

/** Of the surroundings of a change that are shown with it. */
const AROUND_M = 6;
let maps: MapItem[] = [];
let embeddable = false;
let timeline: Timeline | null = null;
/** All that is drawn one by one: what changed, and what stands, in view. */
let all: Cone[] = [];
/** Number of each kind on the whole map. */
let counts = new Map<Kind, number>();
let fitted = false;
/** Where the whole map is, if it is too large to be read. */
let overview: Vec3[] = [];
/** What the picture shows; null before the first one. */
let drawn: State | null = null;
/** Number of the latest refresh: answers to earlier ones are dropped. */
let refreshNo = 0;
let decisions: Decisions | null = null;
/** Planned work zones against those that were found. */
let planned: DifferenceRow[] = [];
let closeStream: (() => void) | null = null;
const paths = new Map<string, Trajectory>();

const sidebar = createSidebar(layout.sidebar, {
  chooseMap: (name) => {
    state = { ...parseState(""), map: name };
    address.write();
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
    address.write();
    stage.lookAt([x, y, groundAt(x, y)], 40);
    drawMark();
  },
});
const showMarker = createMarker(stage, layout.view, () => {
  state.mark = null;
  address.write();
  drawMark();
});
const lists = createLists(layout.listPane, {
  change, withDecisions, select: (id, centre) => void select(id, centre),
  area: () => seenArea(stage, timeline?.origin_m ?? [0, 0, 0]),
  failed: (error) => layout.toast(`The list cannot be read: ${messageOf(error)}`, null),
}); // prettier-ignore
createDownloads(layout.tools.download, {
  shown: () => timeline?.changesets.length && unknownChangeset(state, timeline.changesets) === null ? { map: state.map, drive: state.mode === "drive" ? changeset(state.changeset) ?? null : null, coneCount: tiles.count(), box: boxInView(), ...shownInstant(state, timeline.changesets) } : null,
  picture: () => new Promise((done, fail) => {
    stage.draw();
    // In the same frame, after it was drawn: later the canvas is empty.
    requestAnimationFrame(() => void pictureOf(stage.canvas, layout.view, `${state.map}, ${shownInstant(state, timeline?.changesets ?? []).title}`).then(done, fail));
  }),
  failed: (message) => layout.toast(message, null),
});
const showTimeline = createTimeline(layout.timeline, {
  change,
  showChanges: (changeset, kind) => change({ mode: "drive", changeset, side: "changes", hidden: onlyKind({ ...state, hidden: state.list === "changes" ? state.hidden : new Set() }, kind), list: "changes" }),
  writableMap: () => (decisions?.decides_drives ? state.map : null),
  decided: () => void newDecision(),
  decisions: () => decisions?.decisions ?? [],
});
const viewer = createViewer(document.body, { walked: (start) => selection.walked(start), camera: (view) => selection.camera(view), follow: followImages });
const selection = createSelection(layout.panel, stage, overlays, viewer, {
  state: () => state,
  timeline: () => timeline,
  decisions: () => decisions,
  cones: () => all,
  writeAddress: address.write,
  writeChoice: address.writeChoice,
  chosen: (id) => {
    overlays.showLabels(visible(), id);
    lists.choose();
    layout.panelOpen(id !== null);
  },
  decided: () => void newDecision(),
  showChangeset: (changeset) => change({ mode: "drive", changeset }),
});
const { select } = selection;
viewer.dockIn(selection.images);
const reviewActions = (id: string) => ({
  map: () => state.map,
  writable: () => decisions?.writable ?? false,
  opened: (on: boolean) => {
    state.list = on ? id : null;
    address.write();
    if (!on) viewer.dockIn(selection.images);
    if (!on) selection.draw();
  },
  said: (text: string) => layout.toast(text, null),
});
const review = createReview(layout.app, viewer, reviewActions("review"), changeQueue({
  map: () => state.map,
  decidesDrives: () => decisions?.decides_drives ?? false,
  show: (item) => {
    change({ mode: "drive", side: "changes", changeset: item.changeset_no === timeline?.changesets.at(-1)?.changeset_no ? null : item.changeset_no });
    void select(item.feature_id, true);
  },
  subject: async (item) => {
    if (item.feature_id !== null) return subjectAfter(state.map, item.feature_id, item.changeset_no);
    const { drive_uuid } = timeline?.changesets.find((t) => t.changeset_no === item.changeset_no) ?? { drive_uuid: "" };
    return [{ map: state.map, id: null, title: item.drive_id, why: item.why, now: null, isLast: true, before: null, sightings: [] }, { drive_uuid, frame_index: 0 }];
  },
  decided: () => void newDecision(),
})); // prettier-ignore
const plans = createReview(layout.app, viewer, reviewActions("differences"), differenceQueue({
  map: () => state.map,
  rows: (rows, planCount) => {
    planned = rows;
    plans.button.hidden = planCount === 0;
    drawDifferences();
  },
  show: (row) => {
    change({ mode: "instant", valid: row.until_at === null ? null : passesOf(row)[0]?.at ?? row.passed_at, known: null, mark: null });
    void select(null);
    const [x, y, z] = row.at_m as [number, number, number | null];
    stage.lookAt([x, y, z ?? groundAt(x, y)], Math.max(40, 2.5 * row.radius_m));
  },
  subject: async (row) => {
    const stops = passesOf(row).map((pass, i) => ({ ...pass, title: `${i ? "first" : "last"} seen by ${pass.drive_id}` }));
    return [{ map: state.map, id: null, title: row.kind, why: row.text, now: null, isLast: true, before: null, sightings: [], stops }, stops[0] ?? null];
  },
  decided: () => plans.load(),
})); // prettier-ignore
plans.button.hidden = true;
const queues = [review, plans];
layout.brand.after(review.button, plans.button);
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
  address.writeChoice();
  if (refetch) void refresh();
  else draw();
}

let movedTimer = 0;
/** Other things may be in view. */
function moved(): void {
  window.clearTimeout(movedTimer);
  movedTimer = window.setTimeout(() => {
    lists.moved();
    tools.moved();
    if (drawn) void readView();
  }, REST_MS);
}

layout.listPane.onChange((list) => {
  state.list = list;
  address.write();
});
stage.onCamera((camera) => {
  state.camera = camera;
  address.writeAtRest();
  moved();
});
new ResizeObserver(moved).observe(layout.view);
window.addEventListener("hashchange", () => {
  const next = address.read();
  const other = next.map !== state.map;
  state = next;
  if (other) void openMap();
  else {
    if (state.camera) tools.setPose(state.camera);
    tools.openMeasure();
    void refresh();
    void select(state.feature);
    openQueue();
  }
});

function loadQueues(): void {
  for (const queue of queues) queue.load();
}

/** The one that the address names; the other ones close before. */
function openQueue(): void {
  const wanted = queues.find((queue) => queue.id === state.list);
  for (const queue of queues) if (queue !== wanted) queue.set(false);
  wanted?.set(true);
}

const changeset = (no: number | null) => changesetOf(timeline?.changesets ?? [], no);

// --- loading

/** The map to show by default. */
function nameOf(answer: { maps: MapItem[]; chosen: string }): string {
  return answer.maps.some((m) => m.map_name === answer.chosen) || !answer.maps[0] ? answer.chosen : answer.maps[0].map_name;
}

async function openMap(): Promise<void> {
  closeStream?.();
  selection.clear();
  timeline = drawn = null;
  all = [];
  tiles.close();
  changes.close();
  paths.clear();
  decisions = null;
  showDecisionList(null);
  base.close();
  zones.close();
  planned = [];
  plans.button.hidden = true;
  sidebar.showBase([]);
  fitted = state.camera !== null;
  layout.card("Loading the map …", "", { busy: true });
  try {
    const answer = await api.maps();
    maps = answer.maps;
    embeddable = answer.embeddable;
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
    if (timeline) loadQueues();
    openQueue();
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
    status: (status, text) => {
      layout.status(status, text);
      layout.notice(status === "live" || drawn === null ? null : text);
    },
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
    loadQueues();
    const item = timeline?.changesets.at(-1);
    if (!item) return;
    void readMaps();
    const counts = changesOf([item]).map((change) => change.text).join(", ") || "no changes";
    const follows = state.mode === "drive" && state.changeset === null;
    const said = item.counts ? `${item.drive_id} was saved: ${counts}.` : item.hold === null ? `${item.drive_id} was saved, but is not part of the map: see the decisions.` : `${item.drive_id} is on hold: ${item.hold}`;
    layout.toast(said, follows ? null : { text: "Show its changes", run: () => change({ mode: "drive", changeset: null, side: "changes" }) });
    await refresh();
    await selection.again();
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
    decisions = EMBEDDED ? { ...answer, writable: false, decides_drives: false } : answer;
    writer.logIn(answer.person);
    layout.person(answer.person);
    showDecisionList(answer);
  } catch (error) {
    layout.toast(`The decisions cannot be read: ${messageOf(error)}`, { text: "Try again", run: () => void newDecision() });
  }
}

async function readMaps(): Promise<void> {
  maps = (await api.maps()).maps;
  sidebar.showMaps(maps, state.map);
}

/** After a decision, other cones may stand and other drives count. */
async function newDecision(): Promise<void> {
  try {
    await Promise.all([readTimeline(), readDecisions(), readMaps()]);
    loadQueues();
    await refresh();
    await selection.again();
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
    clear();
    return;
  }
  layout.empty(false);
  const unknown = unknownChangeset(state, timeline.changesets);
  if (unknown !== null) {
    const numbers = timeline.changesets.map((t) => t.changeset_no);
    const there = numbers.length === 1 ? `It has one changeset, number ${numbers[0]}.` : `It has ${numbers.length} changesets, numbers ${numbers.length > 8 ? `${numbers[0]} to ${numbers.at(-1)}` : numbers.join(", ")}.`;
    clear();
    layout.card(`The map “${state.map}” has no changeset ${unknown}`, there, { action: { text: "Show the latest", run: () => change({ changeset: null, from: 0, to: null, known: null }) } });
    return;
  }
  layout.busy(true);
  const asked = state;
  showTimeline(state, timeline.changesets); // the controls react at once, the scene when the data is there
  try {
    const [drives] = await Promise.all([
      readPaths(drivesShown(state, timeline.changesets)), tiles.open(state.map, shownInstant(state, timeline.changesets).at),
      changes.open(state.map, timeline.origin_m, changesOfState(state, timeline.changesets)),
    ]); // prettier-ignore
    if (mine !== refreshNo) return;
    if (!fitted && !tiles.isWhole()) {
      fitted = true;
      all = [];
      fit();
    }
    const [places] = await Promise.all([tiles.isWhole() ? [] : tiles.overview(), tiles.load(), changes.load()]);
    if (mine !== refreshNo) return;
    overview = places;
    void readZones(asked);
    layout.card(null);
    selection.follow();
    show(drives);
    drawn = asked;
  } catch (error) {
    if (mine === refreshNo) fail(error, () => change(asked));
  } finally {
    if (mine === refreshNo) layout.busy(false);
  }
}

/** Work zones of the road as known now; other states, and very large maps, are shown without. */
async function readZones(of: State): Promise<void> {
  try {
    drawDifferences();
    if (of.mode === "instant" && of.known === null) await zones.open(of.map, of.valid);
    else zones.close();
  } catch (error) {
    layout.toast(`Work zones cannot be shown: ${messageOf(error)}`, null);
  }
}

function drawDifferences(): void {
  differences.show(state.mode === "instant" && state.known === null ? planned : [], state.valid);
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

/** Other tiles may be in view. */
async function readView(): Promise<void> {
  const mine = refreshNo;
  try {
    const news = await Promise.all([tiles.load(), changes.load()]);
    if (news.some(Boolean) && mine === refreshNo) merge();
  } catch (error) {
    fail(error, readView);
  }
}

function clear(): void {
  tiles.close();
  changes.close();
  show([]);
}

/** Numbers of the classes that stand in the state that is shown, and are not drawn one by one. */
function beyondByClass(): Map<string, number> {
  const rest = new Map(tiles.isWhole() ? [] : Object.entries(tiles.summary()?.categories ?? {}));
  if (rest.size) for (const { category } of tiles.shown().cones) rest.set(category, (rest.get(category) ?? 0) - 1);
  return rest;
}

const showsChanges = () => changes.isOpen() && !(state.mode === "drive" && state.side === "before");

/** Draw what changed with what is in view. */
function merge(): void {
  const there = tiles.shown().cones;
  const found = showsChanges() ? withChanges(there, changes.shown(), state, timeline?.changesets ?? []) : there;
  all = state.mode === "drive" ? withDecisions(found) : found;
  countKinds(found);
  countClasses(all, beyondByClass());
  draw();
}

/** `found`: what is drawn, as the drive left it. */
function countKinds(found: Cone[]): void {
  counts = new Map(showsChanges() ? changes.kinds() : []);
  if (state.mode === "drive" && state.side === "after") for (const kind of counts.keys()) if (isGone(kind)) counts.delete(kind);
  counts.set(restKind(), Math.max(tiles.count() - (showsChanges() ? changes.standing() : 0), 0));
  for (const [i, { kind }] of found.entries()) {
    if (all[i]?.kind !== "suppressed") continue;
    counts.set(kind, (counts.get(kind) ?? 0) - 1);
    counts.set("suppressed", (counts.get("suppressed") ?? 0) + 1);
  }
}

function show(drives: Trajectory[]): void {
  merge();
  overlays.showPaths(drives);
  stage.start();
  const heights = (all.length ? all.map((c) => c.xyz[2]) : tiles.shown().clusters.map((c) => c.xyz_m[2])).sort((a, b) => a - b);
  const middle = heights[Math.floor(heights.length / 2)];
  if (middle !== undefined && middle !== stage.ground) {
    stage.setGround(middle);
    draw();
  }
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

/** Around the cones in the view, of a large map around the view, in the map's CRS; null without any. */
function boxInView(): [number, number, number, number] | null {
  const [east, north] = timeline?.origin_m ?? [0, 0];
  const places = tiles.isWhole() ? all.map((c) => c.xyz).filter(inView) : footprint(stage);
  const box = places.reduce(([w, s, e, n], [x, y]) => [Math.min(w, x), Math.min(s, y), Math.max(e, x), Math.max(n, y)] as const, [Infinity, Infinity, -Infinity, -Infinity] as const);
  const [w, s, e, n] = box;
  return Number.isFinite(w) ? [w + east - 0.5, s + north - 0.5, e + east + 0.5, n + north + 0.5] : null;
}

/** Height of the nearest cone. */
function groundAt(x: number, y: number): number {
  let [best, height] = [Infinity, stage.ground];
  for (const { xyz } of all) {
    const distance = Math.hypot(xyz[0] - x, xyz[1] - y);
    if (distance < best) [best, height] = [distance, xyz[2]];
  }
  return height;
}

function drawMark(): void {
  showMarker(state.mark ? [...state.mark, groundAt(...state.mark)] : null);
}

/** What is neither drawn one by one nor changed. */
const restKind = (): Kind => (showsChanges() ? "unchanged" : "standing");

function draw(): void {
  setPaper(state.scene.paper);
  const shown = visible();
  cones.show(shown);
  input.shown(shown);
  layout.listPane.open(queues.some((queue) => queue.id === state.list) ? null : state.list);
  lists.show(state, {
    map: state.map, timeline, features: shownQuery(), changes: changesOfState(state, timeline?.changesets ?? []), featureCount: tiles.count(),
    kinds: changes.kinds(), version: refreshNo,
  }); // prettier-ignore
  showSites(tiles.isWhole() ? all.filter((c) => !c.marking) : null);
  showClusters();
  drawMark();
  base.apply(state);
  tools.show(tiles.isWhole() ? all : overview.map((xyz) => ({ xyz, kind: restKind() })));
  tools.apply(state);
  viewer.follows(state.scene.follow);
  overlays.showLabels(shown, state.feature);
  sidebar.show(state, all, shown.length, counts, tiles.isWhole() ? 0 : [...counts.values()].reduce((sum, n) => sum + n, 0) - all.length);
  showTimeline(state, timeline?.changesets ?? []);
  selection.draw();
  document.documentElement.dataset["cones"] = String(shown.length);
}

/** What stands in the state that is shown, as parameters of a request. */
function shownQuery(): Query {
  const { at } = shownInstant(state, timeline?.changesets ?? []);
  return { valid_at: at.valid, known_at: at.known };
}

function showClusters(): void {
  const isShown = (category: string) => !state.filter.hiddenClasses?.includes(category) && !state.hidden.has(restKind());
  const sum = (numbers: Record<string, number>, accepts: (name: string) => boolean) => Object.entries(numbers).reduce((n, [name, more]) => n + (accepts(name) ? more : 0), 0);
  const standing = tiles.shown().clusters.map(({ xyz_m, categories }) => ({ xyz_m, count: sum(categories, isShown) }));
  clusters.show(standing);
  document.documentElement.dataset["clustered"] = String(standing.reduce((n, { count }) => n + count, 0));
  // Confirmed ones are among those that stand.
  const changed = showsChanges() ? changes.shown().clusters : [];
  changeClusters.show(changed.map(({ xyz_m, kinds }) => ({ xyz_m, count: sum(kinds, (kind) => kind !== "confirmed" && !state.hidden.has(kind as Kind)) })));
}

/** Show everything from above and behind the drive. */
function fit(): void {
  const path = [...paths.values()].at(-1)?.xyz_m ?? [];
  const [w = 0, s = 0, e = 0, n = 0] = tiles.summary()?.box_m ?? [];
  const corners: Vec3[] = [w, e].flatMap((x) => [s, n].map((y): Vec3 => [x, y, stage.ground]));
  const points: Vec3[] = tiles.isWhole() ? all.flatMap((c) => [c.xyz, ...(c.old ? [c.old] : [])]) : corners;
  const near = path.filter(nearTo(points, 7));
  const [a, b] = [path[0], path.at(-1)];
  if (a && b && state.camera === null) {
    const heading = Math.atan2(b[1] - a[1], b[0] - a[0]);
    stage.setPose([a[0], a[1], a[2], heading - Math.PI / 2 + 0.5, 0.95, 30]);
  }
  stage.fit([...points, ...(points.length ? near : path)]);
}

function followImages(follow: boolean): void {
  change({ scene: { ...state.scene, follow, plan: state.scene.plan && !follow } }, false);
  selection.followImage();
}

/** The shown drive, else the last one of the map, in the paper's colours: before beside after, near to what changed. */
async function showPaper(on: boolean): Promise<void> {
  const items = timeline?.changesets ?? [];
  const last = state.mode === "drive" && state.changeset !== null ? changeset(state.changeset) : items.filter((t) => t.counts).at(-1);
  const at = items.findIndex((t) => t === last);
  const scene = { ...state.scene, paper: on, swipe: on ? "split" as const : null };
  state = !on ? { ...state, mode: "instant", valid: null, scene }
    : { ...state, mode: "compare", from: items[at - 1]?.changeset_no ?? 0, to: at === items.length - 1 ? null : last?.changeset_no ?? null, known: null, points: true, lines: true, scene }; // prettier-ignore
  address.writeChoice();
  await refresh();
  const changed = visible().filter((c) => !isQuiet(c.kind));
  if (on && changed.length) stage.fit(changed.flatMap(({ xyz: [x, y, z] }) => [-AROUND_M, AROUND_M].flatMap((d): Vec3[] => [[x + d, y, z], [x, y + d, z]])));
}

/** Before the first picture a card says why; later the picture stays, and the controls say again what it shows. */
function fail(error: unknown, again: () => unknown): void {
  stage.start();
  if (drawn) {
    const { mode, changeset, side, from, to, valid, known } = drawn;
    state = { ...state, mode, changeset, side, from, to, valid, known };
    address.write();
    layout.busy(false);
    showTimeline(state, timeline?.changesets ?? []);
    return layout.toast(`${messageOf(error)} The map still shows what it showed before.`, { text: "Try again", run: () => void again() });
  }
  if (!all.length) layout.empty(true); // no controls without data
  layout.busy(false);
  const text = messageOf(error);
  layout.card("The map cannot be shown", text, { action: { text: "Try again", run: () => void again() } });
}

// --- mouse and keyboard

const input = listenToInput(stage, layout, tools, { select: (id) => void select(id), key: handleKey, click: comeNearer,
  covering: (event, typing) => queues.find((queue) => queue.isOpen)?.key(event, typing) ?? null }); // prettier-ignore

function comeNearer(x: number, y: number): boolean {
  const at = clusters.pick(x, y) ?? changeClusters.pick(x, y);
  if (at) stage.lookAt(at, stage.pose()[5] / 4);
  return at !== null;
}

function handleKey(event: KeyboardEvent): boolean {
  if (EMBEDDED && "rRdDlL/?".includes(event.key)) return false;
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
    case "n": case "N": viewer.step(1); return true;
    case "p": case "P": viewer.step(-1); return true;
    case "i": case "I": viewer.cover(); return true;
    case "v": case "V": case "f": case "F": return viewer.key(event);
    case "1": change({ points: !state.points }, false); return true;
    case "2": change({ lines: !state.lines }, false); return true;
    case "r": case "R": review.set(true); return true;
    case "d": case "D": if (!plans.button.hidden) plans.set(true); return true;
    case "l": case "L": layout.listPane.toggle(); return true;
    case "]": case "j": case "J": case "[": case "k": case "K": {
      void lists.next(event.key === "]" || event.key.toLowerCase() === "j" ? 1 : -1).then((cone) => cone && select(cone.id, true), (error: unknown) => layout.toast(messageOf(error), null));
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
layout.tools.more.prepend(shareButton({ write: address.write, mayEmbed: () => embeddable, said: layout.toast }), themeSwitch());
void openMap();
