// The image viewer: whole images of a frame pair, zoomed and panned, with boxes, the projected cone and epipolar lines; played along
// the drive, and beside the drive before.
import { api, type HistoryItem, type Sighting, type Trajectory } from "./api";
import { el, fill, messageOf, plural, utc } from "./dom";
import { createFrameCache, type LoadedImage } from "./frame_cache";
import { createPane, type Pane, type Picture, type Shape, type View } from "./image_pane";
import { bestFrame, judging, type DrivePass, type Frame, type PassFrame, type Side } from "./judging";
import { isGone, STYLES } from "./kinds";
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
  before: HistoryItem | null;
  sightings: Sighting[];
}

export interface Start {
  drive_uuid: string;
  frame_index: number;
}

type Sides = Side | "both";
const SIDES: [Sides, string, string][] = [["left", "Left", "1"], ["right", "Right", "2"], ["both", "Both", "3"]];
const SWITCHES = [["boxes", "Boxes", "B"], ["cone", "Projected cone", "O"], ["epipolar", "Epipolar line", "E"]] as const;
type Switch = (typeof SWITCHES)[number][0];
const STATES = { observed: "cone observed", empty: "position visible, no cone observed", occupied: "another object at the position", hidden: "position hidden" };
const PAN_PX = 60;
/** Screen pixels for the height of the cone after "zoom to the cone". */
const CONE_PX = 220;

interface Shown {
  frame: Frame;
  side: Side;
  image: LoadedImage;
  title: string;
}

export function createViewer(host: HTMLElement) {
  const cache = createFrameCache();
  const title = el("h2", {});
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
  const zoom = button("Zoom to the cone", "Z", () => zoomToCone());
  const compareRow = el("label", { class: "check" }, compareBox, "Compare with", others, el("kbd", { textContent: "C" }));
  const dialog = el("dialog", { class: "viewer", aria: { label: "Images" } },
    el("header", {}, title, why, el("button", { type: "button", class: "close", textContent: "×", title: "Close (Esc)", aria: { label: "Close the images" }, onclick: () => dialog.close() })),
    el("div", { class: "viewer-tools" },
      el("div", { class: "segmented", role: "group", aria: { label: "Images shown" } }, ...sideButtons),
      compareRow,
      ...switches.map(({ node }) => node),
      el("span", { class: "space" }),
      zoom, button("Whole image", "0", () => setView({ scale: null, offset: [0, 0] }))),
    panesHost,
    el("footer", {}, el("div", { class: "viewer-line" }, drives, play, stepper(-1, "‹", "Previous frame pair (←)"), el("div", { class: "viewer-track" }, ticks, slider), stepper(1, "›", "Next frame pair (→)")), text)); // prettier-ignore
  host.append(dialog);

  let subject: Subject | null = null;
  let passes: DrivePass[] = [];
  let path: Trajectory | null = null;
  let otherPath: Trajectory | null = null;
  let drive = "";
  let at = 0;
  let sides: Sides = "both";
  let compare = false;
  let view: View = { scale: null, offset: [0, 0] };
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
  dialog.addEventListener("close", () => setPlaying(false));
  dialog.addEventListener("keydown", (event) => {
    event.stopPropagation(); // the map below keeps still
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement) return;
    if (key(event)) event.preventDefault();
  });

  function key(event: KeyboardEvent): boolean {
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
    else if (event.key === "0") setView({ scale: null, offset: [0, 0] });
    else if (event.key.toLowerCase() === "z") zoomToCone();
    else if (event.key.toLowerCase() === "c") setCompare(!compare);
    else if (event.key.toLowerCase() === "i") dialog.close();
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

  function setView(next: View): void {
    view = next;
    for (const pane of panes) pane.setView(view);
    dialog.dataset["scale"] = view.scale === null ? "fit" : view.scale.toFixed(2);
  }

  function panBy(arrow: string): void {
    const [dx, dy] = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1] }[arrow] ?? [0, -1];
    panes[0]?.pan((dx ?? 0) * PAN_PX, (dy ?? 0) * PAN_PX);
  }

  function zoomToCone(): void {
    const first = shown[0];
    const outline = first && subject?.now && outlineOf(first.frame[first.side], subject.now);
    if (!outline) return;
    const rows = outline.map(([, v]) => v);
    const most = Math.min(CONE_PX, 0.6 * (panes[0]?.node.clientHeight || CONE_PX));
    setView({ scale: Math.min(Math.max(most / (Math.max(...rows) - Math.min(...rows)), 1), 24), offset: [0, 0] });
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
    void show();
  }

  async function openDrive(uuid: string, frameIndex: number | null): Promise<void> {
    if (!subject) return;
    setPlaying(false);
    drive = uuid;
    drives.value = uuid;
    const { map, id } = subject;
    const found = await api.trajectory(map, uuid);
    if (subject?.id !== id || drive !== uuid) return;
    path = found;
    const pass = passOf(uuid);
    const best = frameIndex ?? (pass && bestFrame(pass)?.frame_index) ?? -1;
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

  /** The drive before comes first. */
  function fillOthers(): void {
    const own = passes.findIndex((p) => p.drive_uuid === drive);
    const sorted = [...passes.slice(own + 1), ...passes.slice(0, Math.max(own, 0)).reverse()].filter((p) => p.drive_uuid !== drive);
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
    const here = path.xyz_m[at];
    if (!here) return null;
    const distance = (p: readonly number[]) => Math.hypot((p[0] ?? 0) - here[0], (p[1] ?? 0) - here[1]);
    if (passFrame(drive, index)) {
      const nearest = pass.frames.reduce((a, b) => (distance(b.camera_xyz_m) < distance(a.camera_xyz_m) ? b : a));
      return cache.frame(subject.map, pass.drive_uuid, nearest.frame_index);
    }
    otherPath ??= await api.trajectory(subject.map, pass.drive_uuid);
    const points = otherPath.xyz_m;
    const best = points.reduce((a, p, i) => (distance(p) < distance(points[a] ?? p) ? i : a), 0);
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
      const of = (f: Frame, title: string) => (sides === "both" ? (["left", "right"] as const) : [sides]).map((side) => ({ frame: f, side, title }));
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
      void cache.frame(map, drive, index).then((f) => (sides === "both" ? (["left", "right"] as const) : [sides]).map((side) => cache.image(map, f, side, id)), () => undefined);
  }

  function draw(): void {
    if (!subject || !path) return;
    while (panes.length < shown.length) {
      const pane: Pane = createPane({ view: setView, pick: (point) => pick(pane, point) });
      panes.push(pane);
    }
    panes = panes.slice(0, shown.length);
    fill(panesHost, ...panes.map((p) => p.node));
    panesHost.dataset["columns"] = String(columns());
    shown.forEach((one, i) => panes[i]?.show(pictureOf(one), view));
    for (const b of sideButtons) b.setAttribute("aria-pressed", String(b.dataset["value"] === sides));
    const own = shown.at(-1)?.frame;
    if (!own) return;
    const seen = passFrame(own.drive_uuid, own.frame_index);
    dialog.dataset["frame"] = `${own.drive_id} ${own.frame_index}`;
    fill(text, el("b", { textContent: own.drive_id }), ` · frame pair ${own.frame_index} (${at + 1} of ${path.frame_index.length}) · ${utc(own.captured_at)} UTC`,
      subject.now && " · ", subject.now && (seen ? `${seen.range_m.toFixed(1)} m away, ${STATES[seen.state]}` : "position not in view"),
      own.pixelated && el("small", { textContent: " · pixelated outside detections (CONETL_IMAGES=full shows all)" })); // prettier-ignore
  }

  /** One or two, whichever shows the images larger; four images as two rows of pairs. */
  function columns(): number {
    const own = shown[0]?.frame.left;
    if (!own || shown.length === 1) return 1;
    if (shown.length === 4) return 2;
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
      caption: [side, name && `${name}: ${frame.drive_id}`, name && utc(frame.captured_at, false)].filter(Boolean).join(" · "),
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
        shapes.push({ points: [[b.x_px, b.y_px], [x1, b.y_px], [x1, y1], [b.x_px, y1]], style: mine ? "box chosen" : "box", text: b.score?.toFixed(2) ?? "" }); // prettier-ignore
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

  return {
    get opened() {
      return dialog.open;
    },
    async open(next: Subject, start: Start | null): Promise<void> {
      const again = subject?.map === next.map && subject.id === next.id;
      subject = next;
      picked = null;
      if (!again) [passes, path, shown] = [[], null, []];
      zoom.hidden = compareRow.hidden = next.now === null;
      for (const { name, node } of switches) node.hidden = name === "cone" && next.now === null;
      fill(title, next.title);
      why.textContent = why.title = next.why;
      setView({ scale: null, offset: [0, 0] });
      if (!dialog.open) dialog.showModal();
      text.textContent = "Loading …";
      try {
        if (next.id === null || next.now === null) {
          passes = [];
          fill(drives, el("option", { value: start?.drive_uuid ?? "", textContent: next.title }));
          if (start) await openDrive(start.drive_uuid, null);
          return play.focus();
        }
        const found = await judging.passes(next.map, next.id, next.now.version);
        if (subject !== next) return;
        passes = found.passes;
        fill(drives, ...passes.map((p) => el("option", { value: p.drive_uuid, textContent: `${nameOf(p)} · ${plural(p.frames.length, "frame pair")}` })));
        const wanted = start?.drive_uuid ?? next.now.drive_uuid;
        const own = passOf(wanted) ?? passes[0];
        if (!own && !start) {
          text.textContent = "No drive has images of this position: its records were deleted, or the map was imported.";
          return;
        }
        await openDrive(own?.drive_uuid ?? wanted, own?.drive_uuid === start?.drive_uuid ? (start?.frame_index ?? null) : null);
        play.focus();
      } catch (error) {
        text.textContent = messageOf(error);
      }
    },
    close: () => dialog.close(),
  };
}

export type Viewer = ReturnType<typeof createViewer>;
