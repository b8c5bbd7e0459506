// Below: one drive before and after, two drives compared, or any point in time.
import { changesetName, type ChangeKind, type Decision, type TimelineItem } from "./api";
import { createDecider, revertChoice, withdrawChoice, type Choice } from "./decisions";
import { el, fill, plural, utc, when } from "./dom";
import { STYLES, type Kind } from "./kinds";
import { changeChip } from "./lists";
import type { Mode, Side, State } from "./state";
import { colourVariable } from "./theme";
import { createTimeAxis } from "./timeaxis";

export interface TimelineActions {
  /** Without `refetch` only what is loaded is drawn again. */
  change(values: Partial<State>, refetch?: boolean): void;
  /** Open the list of what a drive changed, of one kind. */
  showChanges(changeset: number | null, kind: Kind): void;
  /** Map whose drives may be reverted here; null where this server is read-only. */
  writableMap(): string | null;
  decided(): void;
  /** Those in effect, and the drives on hold. */
  decisions(): Decision[];
}

const MODES: [Mode, string][] = [["instant", "The road"], ["drive", "Drive by drive"], ["compare", "Compare two"]];
const SIDES: [Side, string][] = [["before", "Before"], ["changes", "Changes"], ["after", "After"]];
const CHANGED: ChangeKind[] = ["added", "moved", "removed", "split", "merged", "height_changed", "missed", "confirmed"];
const BAR_PX = 30;

const objectsOf = (t: TimelineItem, kind: ChangeKind) => t.change_counts.points[kind] ?? 0;
const linesOf = (t: TimelineItem, kind: ChangeKind) => t.change_counts.lines[kind] ?? 0;
const bothOf = (t: TimelineItem, kind: ChangeKind) => objectsOf(t, kind) + linesOf(t, kind);

function changes(items: TimelineItem[], count: (t: TimelineItem, kind: ChangeKind) => number, noun: (sum: number) => string) {
  return CHANGED.flatMap((kind) => {
    const sum = items.reduce((all, t) => all + count(t, kind), 0);
    return sum ? [{ kind, count: sum, text: `${noun(sum)} ${STYLES[kind].label}` }] : [];
  });
}

const stretches = (sum: number) => plural(sum, "stretch of lane markings", "stretches of lane markings");
/** Of objects, then of lane markings. */
export const changesOf = (items: TimelineItem[]) => [...changes(items, objectsOf, (sum) => sum.toLocaleString("en")), ...changes(items, linesOf, stretches)];

export function createTimeline(host: HTMLElement, actions: TimelineActions) {
  let [now, drives]: [State | null, TimelineItem[]] = [null, []];
  const modeTabs = segmented("View mode", MODES, (mode) => {
    // On low screens all but these tabs is folded away until one is chosen, and when it is chosen again.
    host.classList.toggle("open", mode !== now?.mode || !host.classList.contains("open"));
    const neverChosen = mode === "compare" && now?.from === 0 && now.to === null;
    actions.change({ mode, ...(neverChosen && { from: beforeLastDay(drives) }) });
  });
  const body = el("div", { class: "timeline-body" });
  host.append(modeTabs.node, body);
  const views = { drive: driveView(actions), compare: compareView(actions), instant: instantView(actions) };

  return (state: State, items: TimelineItem[]) => {
    [now, drives] = [state, items];
    modeTabs.set(state.mode);
    const view = views[state.mode];
    if (body.firstElementChild !== view.node) fill(body, view.node);
    view.update(state, items);
  };
}

function segmented<T extends string>(label: string, choices: [T, string][], choose: (value: T) => void) {
  const buttons = choices.map(([value, text]) => el("button", { type: "button", textContent: text, data: { value }, onclick: () => choose(value) }));
  return {
    node: el("div", { class: "segmented", role: "group", aria: { label } }, ...buttons),
    set: (value: T) => {
      for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset["value"] === value));
    },
  };
}

/** The last changeset of an earlier day than the newest one; 0 without. */
function beforeLastDay(items: TimelineItem[]): number {
  const days = items.map((t) => utc(t.captured_from).slice(0, 10));
  return items.filter((_, i) => days[i] !== days.at(-1)).at(-1)?.changeset_no ?? 0;
}

/** The changes of some drives: a bar per kind, as high as its share of `most`. */
function barsOf(items: TimelineItem[], most: number): { bars: Node[]; title: string } {
  const bars: Node[] = changes(items, bothOf, String).map(({ kind, count }) => {
    const bar = el("i", {});
    bar.style.height = `${Math.max(2, (count / most) * BAR_PX).toFixed(1)}px`;
    bar.style.background = colourVariable(kind);
    return bar;
  });
  const held = items.filter((t) => t.hold !== null);
  if (held.length) bars.push(el("i", { class: "held" }));
  const counts = changesOf(items).map((change) => change.text).join(", ");
  const [only] = items;
  if (items.length === 1 && only) return { bars, title: `${changesetName(only)}, ${utc(only.captured_from)} UTC: ${only.hold === null ? counts : `on hold. ${only.hold}`}` };
  return { bars, title: `${counts || "no changes"}${held.length ? `, ${held.length} on hold` : ""}` };
}

function driveAxis(items: () => TimelineItem[], choose: (index: number) => void, zoomed?: () => void) {
  const drives = (indices: number[]) => indices.flatMap((i) => items()[i] ?? []);
  const total = (t: TimelineItem) => CHANGED.reduce((sum, kind) => sum + bothOf(t, kind), 0);
  return createTimeAxis({
    choose,
    zoomed,
    weight: (indices) => drives(indices).reduce((sum, t) => sum + total(t), 0),
    entry: (indices, most) => barsOf(drives(indices), most),
  });
}

function driveView(actions: TimelineActions) {
  const slider = el("input", { type: "range", class: "changeset-slider", min: "0", step: "1", aria: { label: "Drive" } });
  const step = (by: number, text: string, label: string, key: string) =>
    el("button", { type: "button", class: "step", title: `${label} (${key})`, textContent: text, aria: { label }, onclick: () => go(index + by) });
  const previous = step(-1, "‹", "Previous drive", ",");
  const next = step(1, "›", "Next drive", ".");
  const sides = segmented("Before or after this drive", SIDES, (side) => actions.change({ side }));
  const text = el("div", { class: "drive-text", aria: { live: "polite" } });
  const deciderHost = el("div", { class: "drive-decide" });
  const decider = createDecider(deciderHost);
  let items: TimelineItem[] = [];
  let index = 0;
  const go = (i: number) => {
    const item = items[i];
    if (item) actions.change({ changeset: i === items.length - 1 ? null : item.changeset_no });
  };
  slider.addEventListener("input", () => go(Number(slider.value)));
  const axis = driveAxis(() => items, go);

  return {
    node: el("div", { class: "drive-view" },
      el("div", { class: "drive-line" }, text, deciderHost, sides.node),
      el("div", { class: "drive-track" }, previous, slider, axis.node, next)), // prettier-ignore
    update(state: State, now: TimelineItem[]): void {
      items = now;
      const found = items.findIndex((t) => t.changeset_no === state.changeset);
      const unknown = found < 0 && state.changeset !== null;
      index = found < 0 ? items.length - 1 : found;
      slider.max = String(Math.max(items.length - 1, 0));
      slider.value = String(index);
      slider.disabled = items.length < 2;
      previous.disabled = index <= 0;
      next.disabled = index >= items.length - 1;
      sides.set(state.side);
      axis.show(items, unknown ? -1 : index);
      const t = items[index];
      deciderHost.hidden = unknown;
      if (unknown) return fill(text, el("strong", { textContent: `No changeset ${state.changeset}` }));
      if (!t) return fill(text);
      const map = actions.writableMap();
      const about = actions.decisions().filter((d) => d.changeset_id === t.changeset_id);
      const reverted = about.some((d) => d.kind === "revert");
      const mayRevert = !reverted && (t.counts || t.hold !== null);
      const choices: Choice[] = map === null ? [] : [...about.map(withdrawChoice), ...(mayRevert ? [revertChoice(t)] : [])];
      decider.show(`${t.changeset_id} ${about.map((d) => d.decision_id).join(" ")} ${String(t.counts)} ${String(map)}`, choices, { map: map ?? "", changed: () => actions.decided() });
      const drives = items.filter((one) => one.kind === "drive");
      const position = t.kind === "drive" ? `drive ${drives.indexOf(t) + 1} of ${drives.length}` : "imported map";
      slider.setAttribute("aria-valuetext", `${t.drive_id}, ${position}`);
      fill(
        text,
        el("strong", { textContent: t.drive_id }),
        el("span", { textContent: [position, ...(t.kind === "drive" ? [`recorded ${when(t.captured_from)}`, plural(t.frame_pair_count, "frame pair")] : [`state of the road on ${when(t.captured_from)}`]), `saved ${when(t.committed_at)}, as known then`].join(" · ") }),
        el("span", { class: "chips" }, ...changesOf([t]).map((c) => changeChip(c.kind, c.text, (kind) => actions.showChanges(state.changeset, kind))),
          !t.counts && notCounted(about, t.hold),
          t.hold !== null && el("span", { class: "hold-reason", title: t.hold, textContent: t.hold })),
      ); // prettier-ignore
    },
  };
}

function notCounted(about: Decision[], hold: string | null): HTMLElement {
  if (hold !== null) return el("span", { class: "chip off", title: hold, textContent: "on hold" });
  const reverted = about.some((d) => d.kind === "revert");
  return el("span", { class: "chip off", title: reverted ? "Reverted by a decision: not part of the map." : "Not part of the map: reverted, or replaced by a later analysis or delivery of the same recording.", textContent: reverted ? "reverted" : "not counted" });
}

function knownSelect(actions: TimelineActions) {
  let filled: TimelineItem[] | null = null; // thousands of drives are filled in once
  const select = el("select", { onchange: () => actions.change({ known: select.value === "now" ? null : Number(select.value) }) });
  return {
    node: el("label", {}, "As known ", select),
    update: (state: State, items: TimelineItem[]) => {
      if (filled !== items) {
        filled = items;
        fill(select, el("option", { value: "now", textContent: "now" }),
          ...items.map((t) => el("option", { value: String(t.changeset_no), textContent: `at ${utc(t.committed_at)} UTC · after ${changesetName(t)}` }))); // prettier-ignore
      }
      select.value = state.known === null ? "now" : String(state.known);
    },
  };
}

function compareView(actions: TimelineActions) {
  const [from, to] = [el("select", {}), el("select", {})];
  const known = knownSelect(actions);
  const number = (select: HTMLSelectElement) => (select.value === "latest" ? null : Number(select.value));
  const [swipe, split] = [el("input", { type: "checkbox", id: "swipe" }), el("input", { type: "checkbox", id: "split" })];
  let latest: State | null = null;
  for (const [box, value] of [[swipe, 0.5], [split, "split"]] as const)
    box.addEventListener("change", () => latest && actions.change({ scene: { ...latest.scene, swipe: box.checked ? value : null } }, false));
  let newest = 0;
  let filled: TimelineItem[] | null = null;
  const choose = () => actions.change({ from: number(from) ?? newest, to: number(to) });
  from.addEventListener("change", choose);
  to.addEventListener("change", choose);
  const swap = el("button", { type: "button", class: "step", textContent: "⇄", title: "Swap", aria: { label: "Swap" } });
  swap.addEventListener("click", () => actions.change({ from: number(to) ?? newest, to: number(from) ?? newest }));
  return {
    node: el("div", { class: "form-line" }, el("label", {}, "From ", from), swap, el("label", {}, "to ", to), known.node,
      el("label", { class: "check", title: "Show the first state left of a divider, the second right of it" }, swipe, "Swipe"),
      el("label", { class: "check", title: "Show both states, each in a half of the picture" }, split, "Side by side"),
      el("p", { class: "hint", textContent: "A cone counts as moved if it shifted by more than min_gate_m, a parameter of the newest drive (0.5 m by default)." })), // prettier-ignore
    update(state: State, items: TimelineItem[]): void {
      latest = state;
      newest = items.at(-1)?.changeset_no ?? 0;
      if (filled !== items) fillChoices(items);
      from.value = state.from === newest ? "latest" : String(state.from);
      to.value = state.to === null || state.to === newest ? "latest" : String(state.to);
      swap.disabled = state.from === 0;
      swipe.checked = typeof state.scene.swipe === "number";
      split.checked = state.scene.swipe === "split";
      known.update(state, items);
    },
  };

  function fillChoices(items: TimelineItem[]): void {
    filled = items;
    const drives = () => items.map((t, i) =>
      el("option", { value: i === items.length - 1 ? "latest" : String(t.changeset_no), textContent: `${utc(t.captured_from, false)} · after ${changesetName(t)}` })); // prettier-ignore
    fill(from, el("option", { value: "0", textContent: "empty map, before the first drive" }), ...drives());
    fill(to, ...drives());
  }
}

function instantView(actions: TimelineActions) {
  const slider = el("input", { type: "range", class: "instant-slider", min: "0", max: "1000", step: "1", aria: { label: "Time on the road" } });
  const input = el("input", { type: "text", size: 19, placeholder: "2026-03-02 09:41:07", spellcheck: false, autocomplete: "off" });
  const latest = el("button", { type: "button", textContent: "Now", title: "The road now", onclick: () => actions.change({ valid: null }) });
  const known = knownSelect(actions);
  const last = el("div", { class: "drive-text" });
  let items: TimelineItem[] = [];
  let valid: string | null = null;
  const show = (time: number) => actions.change({ valid: new Date(time).toISOString() });
  /** Just after the drive. */
  const axis = driveAxis(() => items, (i) => items[i] && show(Date.parse(items[i].valid_at) + 1), () => place());
  slider.addEventListener("input", () => {
    const t = Number(slider.value);
    const { start, end } = axis.span();
    if (t >= 1000 && end >= axis.whole().end) actions.change({ valid: null });
    else show(start + ((end - start) * t) / 1000);
  });
  input.addEventListener("change", () => {
    const text = input.value.trim().replace(" ", "T");
    const time = Date.parse(text.includes("T") ? `${text}Z` : text);
    input.setCustomValidity(Number.isNaN(time) ? "Enter a UTC time such as 2026-03-02 or 2026-03-02 09:41:07" : "");
    if (input.reportValidity()) show(time);
  });

  const time = () => (valid === null ? axis.whole().end : Date.parse(valid));
  function place(): void {
    const { start, end } = axis.span();
    if (document.activeElement !== slider) slider.value = String(Math.round(((time() - start) / (end - start)) * 1000));
  }

  return {
    node: el("div", { class: "instant-view" },
      el("div", { class: "form-line" }, el("label", {}, "Time on the road (UTC) ", input), latest, known.node, last),
      el("div", { class: "instant-track" }, axis.node, slider)), // prettier-ignore
    update(state: State, now: TimelineItem[]): void {
      if (!now.length) return;
      items = now;
      valid = state.valid;
      axis.show(items, items.findIndex((t) => Date.parse(t.valid_at) + 1 === time()));
      place();
      if (input.validity.valid) input.value = utc(new Date(time()).toISOString());
      latest.disabled = state.valid === null;
      const t = items.filter((one) => Date.parse(one.valid_at) <= time()).at(-1);
      const no = t === items.at(-1) ? null : t?.changeset_no ?? null;
      fill(last, t && el("span", {}, "Last drive ", el("button", { type: "button", class: "link", title: "Show its changes", textContent: t.drive_id, onclick: () => actions.change({ mode: "drive", changeset: no, side: "changes" }) })),
        t && el("span", { class: "chips" }, ...changesOf([t]).map((c) => changeChip(c.kind, c.text, (kind) => actions.showChanges(no, kind))), !t.counts && notCounted([], t.hold))); // prettier-ignore
      known.update(state, items);
    },
  };
}
