// The image viewer: whole images of a frame pair, zoomed and panned, with boxes, the projected cone and epipolar lines; played along
// the drive, and beside the drive before. It is docked in a part of the page, or covers the page.
import { api, type DrivePass, type Frame, type FrameView, type HistoryItem, type PassFrame, type Side, type Sighting, type Trajectory } from "./api";
import { el, fill, messageOf, MOVES_SLIDER, plural, utc, when } from "./dom";
import { createFrameCache, type LoadedImage } from "./frame_cache";
import { createPane, type Pane, type Picture, type Shape, type View } from "./image_pane";
import { isGone, STYLES } from "./kinds";
import { apart, bestFrame, bestSide, counterpart, firstOf, othersOf } from "./passes";
import { ellipseOutline, epipolarLine, outlineOf, project, type Point } from "./projection";
import "./viewer.css";

/** A cone, or with null a whole drive. */
export interface Subject {
  map: string;
  id: string | null;
  title: string;
  why: string;
  /** The state whose position is projected, and the one before a move. */
  now: HistoryItem | null;
  /** `now` is the last state: of its versions the server has the newest, whatever is decided meanwhile. */
  isLast: boolean;
  before: HistoryItem | null;
  sightings: Sighting[];
  /** Of a whole drive: frame pairs to choose from. */
  stops?: (Start & { title: string })[];
}

export interface Start {
  drive_uuid: string;
  frame_index: number;
}

/** `best`: of each frame pair the image that shows the position. */
type Sides = Side | "both" | "best";
const SIDES: [Sides, string, string][] = [["left", "Left", "1"], ["right", "Right", "2"], ["both", "Both", "3"]];
const SWITCHES = [["boxes", "Boxes", "B"], ["cone", "Projected cone", "O"], ["epipolar", "Epipolar line", "E"]] as const;
type Switch = (typeof SWITCHES)[number][0];
const STATES = { observed: "cone observed", empty: "position visible, no cone observed", occupied: "another object at the position", hidden: "position hidden" };
const PAN_PX = 60;
/** Screen pixels for the height of the cone after "zoom to the cone", and at most this share of the image's height; at first while docked. */
const CONE_PX = 220;
const [CONE_SHARE, FIRST_SHARE] = [0.6, 0.3];
const WHOLE: View = { scale: null, offset: [0, 0] };

interface Shown {
  frame: Frame;
  side: Side;
  image: LoadedImage;
  title: string;
}

export interface ViewerEvents {
  /** A person went to another frame pair. */
  walked(start: Start): void;
  /** Another image is shown; null: none. */
  camera(view: FrameView | null): void;
  /** A person wants the map's camera to follow the images, or not. */
  follow(on: boolean): void;
}

export function createViewer(host: HTMLElement, events: ViewerEvents) {
  const cache = createFrameCache();
  /** Requests of items that are shown next, each used once; paths never change. */
  const early = new Map<string, Promise<DrivePass[]>>();
  const trajectories = new Map<string, Promise<Trajectory>>();
  const title = el("b", { class: "viewer-title" });
  const why = el("p", { class: "viewer-why" });
  const drives = el("select", { aria: { label: "Drive" } });
  const others = el("select", { aria: { label: "Drive to Compare with" } });
  const compareBox = el("input", { type: "checkbox" });
  const sideButtons = SIDES.map(([value, text, key]) => el("button", { type: "button", textContent: text, title: `${text} (${key})`, data: { value }, onclick: () => setSides(value) }));
  const switches = SWITCHES.map(([name, text, key]) => {
    const box = el("input", { type: "checkbox", checked: name !== "epipolar", data: { name } });
    box.addEventListener("change", () => flip(name, box.checked));
    return { name, box, node: el("label", { class: "check", data: { name } }, box, text, el("kbd", { textContent: key })) };
  });
  const panesHost = el("div", { class: "panes" });
  const play = el("button", { type: "button", class: "step", title: "Play (space)", aria: { label: "Play" }, onclick: () => setPlaying(!playing) });
  const slider = el("input", { type: "range", min: "0", step: "1", aria: { label: "Frame pair" } });
  const ticks = el("div", { class: "viewer-ticks" });
  const text = el("p", { class: "viewer-text", role: "status", aria: { live: "polite" } });
  const stepper = (by: number, sign: string, label: string) => el("button", { type: "button", class: "step", textContent: sign, title: label, aria: { label }, onclick: () => step(by) });
  const button = (label: string, key: string, run: () => void) => el("button", { type: "button", title: `${label} (${key})`, textContent: label, onclick: run });
  const wipeBox = el("input", { type: "checkbox", class: "wipe-on", onchange: () => draw() });
  const wipeRow = el("label", { class: "check", title: "One over the other, with a divider (V)" }, wipeBox, "Swipe", el("kbd", { textContent: "V" }));
  const wipe = el("input", { type: "range", class: "wipe", min: "0", max: "100", value: "50", aria: { label: "Divider between before and after" }, oninput: () => wipeTo() });
  const followBox = el("input", { type: "checkbox", id: "follow", onchange: () => events.follow(followBox.checked) });
  const zoom = button("Zoom to the cone", "Z", () => zoomToCone(CONE_SHARE));
  const compareRow = el("label", { class: "check" }, compareBox, "Compare with", others, el("kbd", { textContent: "C" }));
  const dialog = el("dialog", { class: "viewer", aria: { label: "Images" } },
    el("header", {}, title, why, el("button", { type: "button", class: "close", textContent: "×", title: "Close (Esc)", aria: { label: "Close the images" }, onclick: () => dialog.close() })),
    el("div", { class: "viewer-tools" },
      el("div", { class: "segmented", role: "group", aria: { label: "Images shown" } }, ...sideButtons),
      compareRow,
      ...switches.map(({ node }) => node),
      el("span", { class: "space" }),
      zoom, button("Whole image", "0", () => setView(WHOLE))),
    panesHost, wipe,
    el("footer", {}, el("div", { class: "viewer-line" }, drives, play, stepper(-1, "‹", "Previous frame pair (←)"), el("div", { class: "viewer-track" }, ticks, slider), stepper(1, "›", "Next frame pair (→)"),
      el("button", { type: "button", class: "enlarge", textContent: "Enlarge", title: "Over the whole page, with all tools (I)", onclick: () => cover() })), text, el("div", { class: "viewer-line" }, wipeRow, el("label", { class: "check follow", title: "The map is seen from where the image was taken (F)" }, followBox, "Camera follows image", el("kbd", { textContent: "F" }))))); // prettier-ignore
  host.append(dialog);

  let subject: Subject | null = null;
  let passes: DrivePass[] = [];
  let path: Trajectory | null = null;
  let otherPath: Trajectory | null = null;
  let drive = "";
  let at = 0;
  let sides: Sides = "both";
  let compare = false;
  /** Docked: beside the drive before. */
  let compared = false;
  let view: View = WHOLE;
  /** Where it is docked; null: it covers the page, or is closed. */
  let dock: HTMLElement | null = null;
  /** Docked, another cone begins with the position in the middle. */
  let fresh = false;
  let picked: { drive: string; index: number; side: Side; point: Point } | null = null;
  let playing = false;
  let timer = 0;
  let shownNo = 0;
  let shown: Shown[] = [];
  let panes: Pane[] = [];

  new ResizeObserver(() => void (panesHost.dataset["columns"] = String(columns()))).observe(panesHost);
  slider.addEventListener("input", () => go(Number(slider.value)));
  drives.addEventListener("change", () => void openDrive(drives.value, null));
  others.addEventListener("change", () => setCompare(true));
  compareBox.addEventListener("change", () => setCompare(compareBox.checked));
  dialog.addEventListener("close", () => {
    setPlaying(false);
    if (dock) [sides, compare, fresh] = ["best", compared, true];
    layOut();
    void show();
  });
  dialog.addEventListener("keydown", (event) => {
    if (!isCovering()) return;
    event.stopPropagation(); // the map below keeps still
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
    if (key(event)) event.preventDefault();
  });

  function key(event: KeyboardEvent): boolean {
    if (event.target === wipe && MOVES_SLIDER.test(event.key)) return false;
    const box = SWITCHES.find(([, , letter]) => letter.toLowerCase() === event.key.toLowerCase())?.[0];
    const side = SIDES.find(([, , digit]) => digit === event.key)?.[0];
    if (box) flip(box, !on(box));
    else if (side) setSides(side);
    else if (event.shiftKey && event.key.startsWith("Arrow")) panBy(event.key);
    else if (event.key === "ArrowLeft") step(-1);
    else if (event.key === "ArrowRight") step(1);
    else if (event.key === " ") setPlaying(!playing);
    else if (event.key === "+" || event.key === "=") panes[0]?.zoom(1.5);
    else if (event.key === "-") panes[0]?.zoom(1 / 1.5);
    else if (event.key === "0") setView(WHOLE);
    else if (event.key.toLowerCase() === "z") zoomToCone(CONE_SHARE);
    else if (event.key.toLowerCase() === "c") setCompare(!compare);
    else if (event.key.toLowerCase() === "v" && !wipeRow.hidden) wipeBox.click();
    else if (event.key.toLowerCase() === "f" && isDocked()) followBox.click();
    else if (event.key.toLowerCase() === "i") isCovering() ? dialog.close() : cover();
    else return false;
    return true;
  }

  const on = (name: Switch) => switches.find((s) => s.name === name)?.box.checked ?? false;
  const passOf = (uuid: string) => passes.find((p) => p.drive_uuid === uuid);
  const passFrame = (uuid: string, index: number): PassFrame | undefined => passOf(uuid)?.frames.find((f) => f.frame_index === index);

  function flip(name: Switch, value: boolean): void {
    const found = switches.find((s) => s.name === name);
    if (found) found.box.checked = value;
    draw();
  }

  function setSides(value: Sides): void {
    sides = value;
    void show();
  }

  const wipes = () => wipeBox.checked && !wipeRow.hidden;

  function wipeTo(): void {
    panesHost.style.setProperty("--wipe", `${100 - Number(wipe.value)}%`);
    wipe.setAttribute("aria-valuetext", `${wipe.value} % before`);
  }

  function setView(next: View): void {
    view = next;
    for (const pane of panes) pane.setView(view);
    dialog.dataset["scale"] = view.scale === null ? "fit" : view.scale.toFixed(2);
  }

  function panBy(arrow: string): void {
    const [dx, dy] = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1] }[arrow] ?? [0, -1];
    panes[0]?.pan((dx ?? 0) * PAN_PX, (dy ?? 0) * PAN_PX);
  }

  const isDocked = () => dock !== null && !isCovering();
  const isCovering = () => dialog.matches(":modal");

  /** Docked, or closed. */
  function layOut(): void {
    dialog.classList.toggle("docked", dock !== null);
    (dock ?? host).append(dialog);
    dialog.toggleAttribute("open", dock !== null && subject !== null);
    draw();
  }

  function cover(): void {
    if (isCovering() || !subject) return;
    dialog.removeAttribute("open");
    dialog.classList.remove("docked");
    dialog.showModal();
    if (dock) [sides, compare] = ["both", false];
    compareBox.checked = compare;
    setView(WHOLE);
    void show();
    play.focus();
  }

  function zoomToCone(share: number): void {
    const first = shown[0];
    const outline = first && subject?.now && outlineOf(first.frame[first.side], subject.now);
    if (!outline) return;
    const rows = outline.map(([, v]) => v);
    const most = Math.min(CONE_PX, share * (panes[0]?.node.clientHeight || CONE_PX));
    const fit = panes[0]?.fit() ?? 1;
    setView({ scale: Math.min(Math.max(most / (Math.max(...rows) - Math.min(...rows)), fit), 24), offset: [0, 0] });
  }

  function setCompare(value: boolean): void {
    compare = value && others.options.length > 0;
    compareBox.checked = compare;
    otherPath = null;
    void show();
  }

  function setPlaying(value: boolean): void {
    playing = value;
    play.textContent = playing ? "❚❚" : "▶";
    play.setAttribute("aria-label", playing ? "Pause" : "Play");
    window.clearTimeout(timer);
    if (playing) schedule(0);
  }

  /** At the speed of the recording, or as fast as images come. */
  function schedule(ms: number): void {
    timer = window.setTimeout(() => {
      const count = path?.frame_index.length ?? 0;
      if (!playing || !path) return;
      if (at >= count - 1) return setPlaying(false);
      const [a, b] = [path.captured_at[at], path.captured_at[at + 1]];
      const interval = a && b ? Date.parse(b) - Date.parse(a) : 100;
      const began = performance.now();
      at += 1;
      void show().then(() => playing && schedule(Math.max(interval - (performance.now() - began), 0)));
    }, ms);
  }

  function step(by: number): void {
    setPlaying(false);
    go(at + by);
  }

  function go(index: number): void {
    const count = path?.frame_index.length ?? 0;
    at = Math.min(Math.max(index, 0), Math.max(count - 1, 0));
    const frameIndex = path?.frame_index[at];
    if (frameIndex !== undefined) events.walked({ drive_uuid: drive, frame_index: frameIndex });
    void show();
  }

  async function openDrive(uuid: string, frameIndex: number | null): Promise<void> {
    if (!subject) return;
    setPlaying(false);
    drive = uuid;
    drives.value = uuid;
    const { map, id } = subject;
    const found = await pathOf(map, uuid);
    if (subject?.id !== id || drive !== uuid) return;
    path = found;
    const pass = passOf(uuid);
    const best = frameIndex ?? (pass && bestFrame(pass)?.frame_index) ?? subject.stops?.find((s) => s.drive_uuid === uuid)?.frame_index ?? -1;
    fresh = true;
    at = Math.max(path.frame_index.indexOf(best), 0);
    slider.max = String(Math.max(path.frame_index.length - 1, 0));
    const span = Math.max(path.frame_index.length - 1, 1);
    fill(ticks, ...(pass?.frames ?? []).map((f) => {
      const tick = el("i", { class: f.state });
      tick.style.left = `calc(8px + (100% - 16px) * ${(path?.frame_index.indexOf(f.frame_index) ?? 0) / span})`;
      return tick;
    })); // prettier-ignore
    fillOthers();
    await show();
  }

  function fillOthers(): void {
    const own = passOf(drive);
    const sorted = own ? othersOf(passes, own) : passes;
    const kept = others.value;
    fill(others, ...sorted.map((p) => el("option", { value: p.drive_uuid, textContent: `${p.captured_from < (passOf(drive)?.captured_from ?? "") ? "before" : "after"}: ${nameOf(p)}` })));
    if (sorted.some((p) => p.drive_uuid === kept)) others.value = kept;
    compareBox.disabled = others.disabled = !sorted.length;
    if (!sorted.length) compare = compareBox.checked = false;
    otherPath = null;
  }

  const nameOf = (p: DrivePass) => `${p.drive_id} · ${p.kind ? STYLES[p.kind].label : "not evaluated"}${p.counts ? "" : " · not part of the map"}`;

  /** The frame pair of the other drive from the nearest position: among those that show the cone, if this one does. */
  async function otherFrame(index: number): Promise<Frame | null> {
    const pass = passOf(others.value);
    if (!subject || !pass || !path) return null;
    const own = passFrame(drive, index);
    if (own) return cache.frame(subject.map, pass.drive_uuid, counterpart(own, pass).frame_index);
    const here = path.xyz_m[at];
    if (!here) return null;
    otherPath ??= await pathOf(subject.map, pass.drive_uuid);
    const points = otherPath.xyz_m;
    const best = points.reduce((a, p, i) => (apart(p, here) < apart(points[a] ?? p, here) ? i : a), 0);
    return cache.frame(subject.map, pass.drive_uuid, otherPath.frame_index[best] ?? 0);
  }

  async function show(): Promise<void> {
    if (!subject || !path) return;
    const mine = ++shownNo;
    const { map, id } = subject;
    const index = path.frame_index[at];
    if (index === undefined) return;
    slider.value = String(at);
    dialog.classList.add("busy");
    try {
      const [frame, other] = await Promise.all([cache.frame(map, drive, index), compare ? otherFrame(index) : null]);
      const of = (f: Frame, title: string) => sidesOf(f).map((side) => ({ frame: f, side, title }));
      const wanted = [...(other ? of(other, other.captured_at < frame.captured_at ? "before" : "after") : []), ...of(frame, other ? "this drive" : "")];
      const images = await Promise.all(wanted.map((w) => cache.image(map, w.frame, w.side, id)));
      if (mine !== shownNo) return;
      shown = wanted.map((w, i) => ({ ...w, image: images[i] ?? { url: null, problem: null } }));
      draw();
      prefetch();
    } catch (error) {
      if (mine === shownNo) text.textContent = messageOf(error);
    } finally {
      if (mine === shownNo) dialog.classList.remove("busy");
    }
  }

  /** The next frame pairs, while there is time. */
  function prefetch(): void {
    const { map, id } = subject as Subject;
    for (const index of path?.frame_index.slice(at + 1, at + (playing ? 5 : 2)) ?? [])
      void cache.frame(map, drive, index).then((f) => sidesOf(f).map((side) => cache.image(map, f, side, id)), () => undefined);
  }

  function draw(): void {
    if (!subject || !path) return;
    while (panes.length < shown.length) {
      const pane: Pane = createPane({ view: setView, pick: (point) => pick(pane, point) });
      panes.push(pane);
    }
    panes = panes.slice(0, shown.length);
    wipeRow.hidden = new Set(shown.map((s) => s.title)).size < 2;
    wipe.hidden = !wipes();
    const tiles = wipes() ? panes.slice(0, panes.length / 2).map((p, i) => el("div", { class: "pair" }, p.node, panes[i + panes.length / 2]?.node)) : panes.map((p) => p.node);
    fill(panesHost, ...tiles);
    panesHost.dataset["count"] = String(tiles.length);
    panesHost.dataset["columns"] = String(columns());
    shown.forEach((one, i) => panes[i]?.show(pictureOf(one), view));
    if (fresh && isDocked()) subject.now ? zoomToCone(FIRST_SHARE) : setView(WHOLE);
    fresh = false;
    for (const b of sideButtons) b.setAttribute("aria-pressed", String(b.dataset["value"] === sides));
    const [own, ownSide] = [shown.at(-1)?.frame, shown.at(-1)?.side ?? "left"];
    events.camera(own?.[ownSide] ?? null);
    if (!own) return;
    const seen = passFrame(own.drive_uuid, own.frame_index);
    dialog.dataset["item"] = subject.title;
    dialog.dataset["frame"] = `${own.drive_id} ${own.frame_index}`;
    fill(text, el("b", { textContent: own.drive_id }), ` · frame pair ${own.frame_index} (${at + 1} of ${path.frame_index.length}) · ${when(own.captured_at)}`,
      subject.now && " · ", subject.now && (seen ? `${seen.range_m.toFixed(1)} m away, ${STATES[seen.state]}` : "position not in view"),
      own.pixelated && el("small", { textContent: " · pixelated outside detections (logins with the role review see all)" })); // prettier-ignore
  }

  /** One or two, whichever shows the images larger; four images as two rows of pairs. */
  function columns(): number {
    const own = shown[0]?.frame.left;
    const count = panesHost.children.length;
    if (!own || count === 1) return 1;
    if (count === 4) return 2;
    const [width, height] = [panesHost.clientWidth / own.width_px, panesHost.clientHeight / own.height_px];
    return Math.min(width / 2, height) >= Math.min(width, height / 2) ? 2 : 1;
  }

  function pick(pane: Pane, point: Point): void {
    const one = shown[panes.indexOf(pane)];
    if (!one) return;
    picked = { drive: one.frame.drive_uuid, index: one.frame.frame_index, side: one.side, point };
    flip("epipolar", true);
  }

  function pictureOf({ frame, side, image, title: name }: Shown): Picture {
    const { now } = subject as Subject;
    const own = frame[side];
    const tip = now && project(own, [now.xyz_m[0], now.xyz_m[1], now.xyz_m[2] + (now.object_height_m ?? 0) / 2]);
    const anchor: Point = tip ? [Math.min(Math.max(tip[0], 0), own.width_px), Math.min(Math.max(tip[1], 0), own.height_px)] : [own.width_px / 2, own.height_px / 2];
    return {
      ...image, anchor, size: [own.width_px, own.height_px],
      alt: `${side} image of frame pair ${frame.frame_index} of ${frame.drive_id}`,
      caption: isDocked() ? `${name || side} · ${utc(frame.captured_at, false)} UTC` : [side, name && `${name}: ${frame.drive_id}`, name && utc(frame.captured_at, false)].filter(Boolean).join(" · "),
      shapes: shapesOf(frame, side),
    };
  }

  function shapesOf(frame: Frame, side: Side): Shape[] {
    const { now, before, sightings } = subject as Subject;
    const own = frame[side];
    const matches = new Set(sightings.filter((s) => s.drive_uuid === frame.drive_uuid && s.frame_index === frame.frame_index).map((s) => s.match_index));
    const shapes: Shape[] = [];
    if (on("boxes"))
      for (const b of own.boxes) {
        const [x1, y1] = [b.x_px + b.w_px, b.y_px + b.h_px];
        const mine = b.match_index !== null && matches.has(b.match_index);
        shapes.push({ points: [[b.x_px, b.y_px], [x1, b.y_px], [x1, y1], [b.x_px, y1]], style: mine ? "box chosen" : "box", text: isDocked() ? "" : (b.score?.toFixed(2) ?? "") }); // prettier-ignore
      }
    if (now && on("cone")) {
      const style = matches.size ? "cone" : "cone dashed";
      const add = (points: Point[] | null, name: string, label?: string) => points && shapes.push({ points, style: name, ...(label ? { text: label } : {}) });
      add(outlineOf(own, now), style, matches.size ? undefined : isGone(now.kind) ? "removed" : "expected");
      add(ellipseOutline(own, now.xyz_m, now.cov_m2), "ellipse");
      if (before) add(outlineOf(own, before), "cone dashed old", "before the move");
    }
    if (on("epipolar")) shapes.push(...epipolar(frame, side));
    return shapes;
  }

  /** The clicked point and its line; the foot of the cone until a point was clicked. */
  function epipolar(frame: Frame, side: Side): Shape[] {
    const mine = picked && picked.drive === frame.drive_uuid && picked.index === frame.frame_index ? picked : null;
    const from: Side = mine?.side ?? "left";
    const { now } = subject as Subject;
    const point = mine?.point ?? (now && project(frame[from], now.xyz_m));
    if (!point) return [];
    if (side === from) {
      const [u, v] = point;
      return [{ points: [[u - 6, v], [u + 6, v]], style: "epipolar", closed: false }, { points: [[u, v - 6], [u, v + 6]], style: "epipolar", closed: false }];
    }
    const line = epipolarLine(frame[from], point, frame[side]);
    return line ? [{ points: line, style: "epipolar", closed: false }] : [];
  }

  const sidesOf = (f: Frame): Side[] => (sides === "both" ? ["left", "right"] : [sides === "best" ? bestSide(f, subject?.now ?? null) : sides]);

  function pathOf(map: string, uuid: string): Promise<Trajectory> {
    const found = trajectories.get(uuid) ?? api.trajectory(map, uuid);
    trajectories.set(uuid, found);
    found.catch(() => trajectories.delete(uuid));
    return found;
  }

  const keyOf = ({ map, id, now }: Subject) => `${map} ${id} ${now?.version}`;

  async function passesOf(next: Subject): Promise<DrivePass[]> {
    if (next.id === null || !next.now) return [];
    const key = keyOf(next);
    const found = early.get(key) ?? api.passes(next.map, next.id, next.isLast ? null : next.now.version).then((answer) => answer.passes);
    early.delete(key);
    return found;
  }

  /** Show another cone or drive where the viewer is. */
  async function load(next: Subject, start: Start | null): Promise<void> {
    const again = subject?.map === next.map && subject.id === next.id;
    subject = next;
    picked = null;
    if (!again) [passes, path, shown] = [[], null, []];
    if (!again && dock) fill(panesHost);
    zoom.hidden = compareRow.hidden = next.now === null;
    for (const { name, node } of switches) node.hidden = name === "cone" && next.now === null;
    fill(title, next.title);
    why.textContent = why.title = next.why;
    text.textContent = "Loading …";
    try {
      const found = await passesOf(next);
      if (subject !== next) return;
      passes = found;
      if (!next.now) fill(drives, ...(next.stops ?? [{ drive_uuid: start?.drive_uuid ?? "", title: next.title }]).map((s) => el("option", { value: s.drive_uuid, textContent: s.title })));
      else fill(drives, ...passes.map((p) => el("option", { value: p.drive_uuid, textContent: `${nameOf(p)} · ${plural(p.frames.length, "frame pair")}` })));
      const first = firstOf(next, passes, start);
      if (first) return await openDrive(first.drive_uuid, first.frame_index);
      text.textContent = "No drive has images of this position: its records were deleted, or the map was imported.";
    } catch (error) {
      if (subject === next) text.textContent = messageOf(error);
    }
  }

  return {
    get covers() {
      return isCovering();
    },
    key,
    step,
    follows: (on: boolean) => void (followBox.checked = on),
    get dock() {
      return dock;
    },
    dockIn(next: HTMLElement): void {
      if (isCovering()) dialog.close();
      dock = next;
      layOut();
    },
    /** Show a cone or a drive in the dock, with its best images; beside the drive before. */
    async show(next: Subject, start: Start | null, beside: boolean): Promise<void> {
      compared = beside;
      if (!isCovering()) [sides, compare] = ["best", beside];
      const loaded = load(next, start);
      layOut();
      compareBox.checked = compare;
      await loaded;
    },
    clear(): void {
      [subject, path, shown] = [null, null, []];
      events.camera(null);
      if (!isCovering()) layOut();
    },
    /** Read the images that `show` starts with. */
    async preload(next: Subject, start: Start | null, beside: boolean): Promise<void> {
      const found = passesOf(next);
      early.set(keyOf(next), found);
      found.catch(() => early.delete(keyOf(next)));
      const all = await found;
      const first = firstOf(next, all, start);
      if (!first) return;
      const pass = all.find((p) => p.drive_uuid === first.drive_uuid);
      const own = pass && (pass.frames.find((f) => f.frame_index === first.frame_index) ?? bestFrame(pass));
      const other = beside && pass ? othersOf(all, pass)[0] : undefined;
      const wanted = [[first.drive_uuid, own?.frame_index ?? first.frame_index ?? 0], ...(own && other ? [[other.drive_uuid, counterpart(own, other).frame_index]] : [])] as const;
      await Promise.all([pathOf(next.map, first.drive_uuid), ...wanted.map(async ([uuid, index]) => {
        const frame = await cache.frame(next.map, String(uuid), Number(index));
        await cache.image(next.map, frame, bestSide(frame, next.now), next.id);
      })]); // prettier-ignore
    },
    /** Show it over the whole page, with all tools, until it is closed. */
    cover,
  };
}

export type Viewer = ReturnType<typeof createViewer>;
