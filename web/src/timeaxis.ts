// An axis of time with the drives on it: years and days, clusters where drives are closer than they can be drawn, zoom and pan.
import type { TimelineItem } from "./api";
import { el, fill, plural } from "./dom";

/** Milliseconds since 1970. */
export interface Span {
  start: number;
  end: number;
}

export interface Cluster {
  /** Its drives in the order of time, first and last. */
  first: number;
  last: number;
  /** Where it is, 0 to the width. */
  x: number;
}

const [MINUTE, HOUR, DAY] = [60_000, 3_600_000, 86_400_000];
/** Closer drives are one entry. */
const LEAST_PX = 15;
const LABEL_PX = 84;
const MARGIN_PX = 12;
/** Steps of the labels: so many minutes, hours, days, months or years. */
const STEPS: ["time" | "month" | "year", number][] = [
  ["time", MINUTE], ["time", 5 * MINUTE], ["time", 15 * MINUTE], ["time", HOUR], ["time", 3 * HOUR], ["time", 6 * HOUR], ["time", 12 * HOUR],
  ["time", DAY], ["time", 2 * DAY], ["time", 7 * DAY], ["month", 1], ["month", 3], ["month", 6], ["year", 1], ["year", 2], ["year", 5], ["year", 10],
]; // prettier-ignore
const MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];
const SIZE = { time: 1, month: 30.4 * DAY, year: 365.2 * DAY };
const MOST_LABELS = 500;

/** From the first to the last of some times, with a margin; around now without any. */
export function spanOf(times: number[]): Span {
  const known = times.filter(Number.isFinite);
  const [least, most] = known.length ? [known.reduce((a, b) => Math.min(a, b)), known.reduce((a, b) => Math.max(a, b))] : [Date.now(), Date.now()];
  const margin = Math.max((most - least) * 0.03, 10 * MINUTE);
  return { start: least - margin, end: most + margin };
}

/** Neighbours nearer than LEAST_PX are one cluster; times ascending. */
export function clusters(times: number[], { start, end }: Span, width: number): Cluster[] {
  const found: Cluster[] = [];
  const at = (t: number) => MARGIN_PX + ((t - start) / (end - start)) * (width - 2 * MARGIN_PX);
  let from = 0;
  for (let i = 0; i < times.length; i++) {
    const x = at(times[i]!);
    const last = found.at(-1);
    if (last && x - from < LEAST_PX) {
      last.last = i;
      last.x = (from + x) / 2;
    } else {
      if (x < 0) continue;
      if (x > width) break;
      found.push({ first: i, last: i, x });
      from = x;
    }
  }
  return found;
}

/** Where labels are, and their texts: "2025", "Mar", "03-02", "09:30". */
export function labels({ start, end }: Span, width: number): { time: number; text: string; major: boolean }[] {
  const most = Math.max(width / LABEL_PX, 1);
  const [unit, step] = STEPS.find(([u, n]) => (end - start) / (SIZE[u] * n) <= most) ?? ["year", 10 ** Math.ceil(Math.log10((end - start) / SIZE.year / most))];
  const first = new Date(start);
  const months = unit === "year" ? 12 * step : step;
  const month = Math.floor((first.getUTCFullYear() * 12 + first.getUTCMonth()) / months) * months;
  const at = (i: number) => (unit === "time" ? (Math.ceil(start / step) + i) * step : Date.UTC(Math.floor(month / 12), (month % 12) + i * months));
  const count = Math.min(Math.floor((end - start) / (SIZE[unit] * step)) + 3, MOST_LABELS);
  const times = Array.from({ length: count || 0 }, (_, i) => at(i)).filter((t) => t >= start && t <= end);
  // The year stands at the first label and where it changes, below a day the whole date; what a long label covers is left out.
  let [before, until] = ["", -Infinity];
  const found: { time: number; text: string; short: string; major: boolean }[] = [];
  for (const time of times) {
    const iso = new Date(time).toISOString();
    const context = unit === "time" && step < DAY ? iso.slice(0, 10) : iso.slice(0, 4);
    const text = unit === "year" ? iso.slice(0, 4) : unit === "month" ? MONTHS[new Date(time).getUTCMonth()]! : step >= DAY ? iso.slice(5, 10) : iso.slice(11, 16);
    const x = ((time - start) / (end - start)) * width;
    const major = context !== before;
    if (x < until && !major) continue;
    const last = found.at(-1);
    if (x < until && last) Object.assign(last, { text: last.short, major: false }); // its date is a few pixels long
    before = context;
    const long = unit === "year" ? text : step >= DAY && unit === "time" ? `${context}-${text}` : `${context} ${text}`;
    const shown = !major ? text : unit === "time" && step < DAY && text === "00:00" ? context : long;
    until = x + 7 * shown.length + 10;
    found.push({ time, text: shown, short: text, major });
  }
  return found;
}

export interface AxisActions {
  /** A single drive was chosen. */
  choose(index: number): void;
  /** How much these drives changed. */
  weight(indices: number[]): number;
  /** What an entry of these drives shows; `most` is the largest weight of an entry. */
  entry(indices: number[], most: number): { bars: Node[]; title: string };
  zoomed?: (() => void) | undefined;
}

export function createTimeAxis(actions: AxisActions) {
  const entries = el("div", { class: "axis-entries" });
  const scale = el("div", { class: "axis-scale", aria: { hidden: "true" } });
  const zoomButton = (text: string, label: string, run: () => void) => el("button", { type: "button", class: "step", textContent: text, title: label, aria: { label }, onclick: run });
  const zoomOut = zoomButton("−", "Zoom out", () => zoom(2));
  const zoomIn = zoomButton("+", "Zoom in", () => zoom(0.5));
  const all = zoomButton("↔", "Show the whole timeline", () => setSpan(full));
  const track = el("div", { class: "axis-track" }, entries, scale);
  const node = el("div", { class: "axis" }, track, el("div", { class: "axis-zoom" }, zoomIn, zoomOut, all));
  let times: number[] = [];
  /** Indices of the drives in the order of time; they may have been committed in another one. */
  let order: number[] = [];
  let items: TimelineItem[] = [];
  let chosen = -1;
  let full = spanOf([]);
  let seen = full;
  let drawnWidth = 0;
  let drawn: [HTMLElement, number, number][] = [];

  function setSpan({ start, end }: Span): void {
    const length = Math.min(Math.max(end - start, 10 * MINUTE), full.end - full.start);
    const from = Math.min(Math.max((start + end - length) / 2, full.start), full.end - length);
    seen = { start: from, end: from + length };
    draw();
    actions.zoomed?.();
  }

  function zoom(by: number, at = times[chosen] ?? (seen.start + seen.end) / 2): void {
    const inside = at >= seen.start && at <= seen.end ? at : (seen.start + seen.end) / 2;
    setSpan({ start: inside - (inside - seen.start) * by, end: inside + (seen.end - inside) * by });
  }

  const timeAt = (x: number) => seen.start + ((x - MARGIN_PX) / Math.max(track.clientWidth - 2 * MARGIN_PX, 1)) * (seen.end - seen.start);
  track.addEventListener("wheel", (event) => {
    event.preventDefault();
    const x = event.clientX - track.getBoundingClientRect().left;
    const shift = ((seen.end - seen.start) * event.deltaX) / Math.max(track.clientWidth, 1);
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) setSpan({ start: seen.start + shift, end: seen.end + shift });
    else zoom(Math.exp(Math.min(Math.max(event.deltaY, -200), 200) * 0.003), timeAt(x));
  }, { passive: false }); // prettier-ignore

  let dragged: { x: number; span: Span; moved: boolean } | null = null;
  track.addEventListener("pointerdown", (event) => {
    dragged = { x: event.clientX, span: seen, moved: false };
  });
  track.addEventListener("pointermove", (event) => {
    if (!dragged || !event.buttons) return;
    const by = event.clientX - dragged.x;
    if (!dragged.moved && Math.abs(by) < 5) return;
    if (!dragged.moved) track.setPointerCapture(event.pointerId);
    dragged.moved = true;
    const { start, end } = dragged.span;
    const shift = (-by / Math.max(track.clientWidth, 1)) * (end - start);
    setSpan({ start: start + shift, end: end + shift });
  });
  track.addEventListener("click", (event) => {
    if (dragged?.moved) event.stopPropagation();
    dragged = null;
  }, true); // prettier-ignore

  function draw(): void {
    const width = track.clientWidth;
    drawnWidth = width;
    drawn = [];
    if (!width || !times.length) return fill(entries);
    const found = clusters(times, seen, width);
    const most = found.reduce((m, c) => Math.max(m, actions.weight(order.slice(c.first, c.last + 1))), 1);
    fill(entries, ...found.map(({ first, last, x }) => {
      const count = last - first + 1;
      const { bars, title } = actions.entry(order.slice(first, last + 1), most);
      const enter = () => {
        const mine = chosen >= first && chosen <= last;
        // As deep as it helps: drives of the same minute stay one entry, and the next one of them is chosen.
        const [from, to] = [times[first]!, times[last]!];
        const length = Math.max((to - from) * 1.3, 10 * MINUTE);
        if (count > 1 && length < (seen.end - seen.start) * 0.9) setSpan({ start: (from + to - length) / 2, end: (from + to + length) / 2 });
        else actions.choose(order[mine && chosen < last ? chosen + 1 : mine && count > 1 ? first : last] ?? -1);
      };
      const button = el("button", { type: "button", class: count > 1 ? "column cluster" : "column", tabIndex: -1,
        title: count > 1 ? `${plural(count, "drive")}, ${title}. Click to zoom in.` : title, onclick: enter },
        el("span", { class: "bars" }, ...bars), count > 1 && el("span", { class: "count", textContent: String(count) })); // prettier-ignore
      button.style.left = `${x.toFixed(1)}px`;
      drawn.push([button, first, last]);
      if (count === 1) button.dataset["changeset"] = String(items[order[first] ?? -1]?.changeset_no);
      return button;
    }));
    fill(scale, ...labels(seen, width).map(({ time, text, major }) => {
      const label = el("span", { class: major ? "major" : "", textContent: text });
      label.style.left = `${(MARGIN_PX + ((time - seen.start) / (seen.end - seen.start)) * (width - 2 * MARGIN_PX)).toFixed(1)}px`;
      return label;
    }));
    const whole = seen.end - seen.start >= (full.end - full.start) * 0.999;
    zoomOut.disabled = all.disabled = whole;
    zoomIn.disabled = seen.end - seen.start <= 10 * MINUTE;
    mark();
  }

  function mark(): void {
    for (const [button, first, last] of drawn) button.classList.toggle("chosen", chosen >= first && chosen <= last);
  }

  new ResizeObserver(() => {
    if (track.clientWidth !== drawnWidth) draw();
  }).observe(track);

  return {
    node,
    span: () => seen,
    whole: () => full,
    /** The drives, and the chosen one. */
    show(next: TimelineItem[], index: number): void {
      const other = next !== items;
      if (other) {
        items = next;
        const began = next.map((t) => Date.parse(t.captured_from));
        order = began.map((_, i) => i).sort((a, b) => began[a]! - began[b]!);
        times = order.map((i) => began[i]!);
        const wasWhole = seen.end - seen.start >= (full.end - full.start) * 0.999;
        full = spanOf([...times, ...next.map((t) => Date.parse(t.valid_at))]);
        if (wasWhole) seen = full;
      } else if (order[chosen] === index) return;
      chosen = order.indexOf(index);
      const t = times[chosen];
      const half = (seen.end - seen.start) / 2;
      if (t !== undefined && (t < seen.start || t > seen.end)) setSpan({ start: t - half, end: t + half });
      else if (other) setSpan(seen);
      else mark();
    },
  };
}
