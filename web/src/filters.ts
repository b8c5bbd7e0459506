// Which cones are shown, on the map and in the lists: the filter in the address, what it accepts, and its controls.
import { changesetName, type Query, type TimelineItem } from "./api";
import { countOf } from "./classes";
import { el, fill, utc } from "./dom";
import { icon, KIND_ORDER, STYLES, type Cone, type Kind } from "./kinds";
import type { State } from "./state";

/** What the kinds and the existence probability of `State` do not say; null: any. */
export interface Filter {
  maxProbability: number | null;
  maxSigma_m: number | null;
  minHeight_m: number | null;
  maxHeight_m: number | null;
  /** Number of the changeset that wrote the version. */
  drive: number | null;
  /** Days of the last observation, YYYY-MM-DD in UTC. */
  seenFrom: string | null;
  seenTo: string | null;
  /** Categories that are not shown. */
  hiddenClasses: string[] | null;
}

type NumberName = Exclude<keyof Filter, "seenFrom" | "seenTo" | "hiddenClasses">;

/** Names in the address, and the bounds of numbers. */
const NUMBERS: [NumberName, string, number][] = [
  ["maxProbability", "pmax", 1], ["maxSigma_m", "smax", 100], ["minHeight_m", "hmin", 100], ["maxHeight_m", "hmax", 100],
  ["drive", "drive", 1e15],
]; // prettier-ignore
const DAYS: ["seenFrom" | "seenTo", string][] = [["seenFrom", "seenfrom"], ["seenTo", "seento"]];
const CLASSES = "hideclass";
const DAY_MS = 86_400_000;

export const anyCone = (): Filter => ({
  maxProbability: null, maxSigma_m: null, minHeight_m: null, maxHeight_m: null, drive: null, seenFrom: null, seenTo: null, hiddenClasses: null,
}); // prettier-ignore

const isDay = (text: string) => /^\d{4}-\d\d-\d\d$/.test(text) && !Number.isNaN(Date.parse(text));

export function parseFilter(p: URLSearchParams, wrong: (name: string, expected: string) => void): Filter {
  const filter = anyCone();
  for (const [field, name, most] of NUMBERS) {
    const text = p.get(name);
    if (text === null) continue;
    const value = Number(text);
    if (text.trim() && value >= 0 && value <= most) filter[field] = value;
    else wrong(name, `a number from 0 to ${most}`);
  }
  for (const [field, name] of DAYS) {
    const text = p.get(name);
    if (text === null) continue;
    if (isDay(text)) filter[field] = text;
    else wrong(name, "a day such as 2026-03-02");
  }
  filter.hiddenClasses = p.get(CLASSES)?.split(",") ?? null;
  return filter;
}

export function formatFilter(filter: Filter, p: URLSearchParams): void {
  for (const [field, name] of [...NUMBERS, ...DAYS, ["hiddenClasses", CLASSES] as const]) if (filter[field] !== null) p.set(name, String(filter[field]));
}

/** Whether a cone is shown. */
export function acceptedBy(state: State): (cone: Cone) => boolean {
  const { hidden, minProbability, filter: f } = state;
  const from = f.seenFrom === null ? -Infinity : Date.parse(f.seenFrom);
  const to = f.seenTo === null ? Infinity : Date.parse(f.seenTo) + DAY_MS;
  const maxP = f.maxProbability ?? 1;
  const maxSigma_m = f.maxSigma_m ?? Infinity;
  const [low, high] = [f.minHeight_m ?? 0, f.maxHeight_m ?? Infinity];
  const classes = f.hiddenClasses;
  return (c) =>
    !hidden.has(c.kind) && !classes?.includes(c.category) && c.probability >= minProbability && c.probability <= maxP && c.sigma_m <= maxSigma_m &&
    c.height_m >= low && c.height_m <= high && (f.drive === null || c.changeset === f.drive) && c.seenAt >= from && c.seenAt < to; // prettier-ignore
}

/** The same for lists of the server. Only changes have kinds. */
export function listFilter({ hidden, minProbability, filter: f, inView }: State, isOfChanges: boolean, area: () => string[]): Query {
  const text = (value: number | null) => (value === null ? null : String(value));
  const shown = KIND_ORDER.filter((kind) => !hidden.has(kind));
  return {
    kinds: isOfChanges && hidden.size ? (shown.length ? shown : ["none"]) : null, hidden_classes: f.hiddenClasses,
    least_existence: text(minProbability || null), most_existence: text(f.maxProbability), most_sigma_m: text(f.maxSigma_m),
    least_height_m: text(f.minHeight_m), most_height_m: text(f.maxHeight_m), of_changeset: text(f.drive),
    seen_from: f.seenFrom && `${f.seenFrom}T00:00:00Z`, seen_before: f.seenTo && new Date(Date.parse(f.seenTo) + DAY_MS).toISOString(),
    area: inView ? area() : null,
  }; // prettier-ignore
}

/** Number of filters that are set, kinds as one. */
export const filterCount = ({ hidden, minProbability, filter }: State): number =>
  Number(hidden.size > 0) + Number(minProbability > 0) + Object.values(filter).filter((v) => v !== null).length;

export const noFilters = (): Partial<State> => ({ hidden: new Set(), minProbability: 0, filter: anyCone() });

/** Only this kind, or all again if it was the only one already. */
export function onlyKind(state: State, kind: Kind): Set<Kind> {
  const others = KIND_ORDER.filter((k) => k !== kind);
  const isOnly = !state.hidden.has(kind) && others.every((k) => state.hidden.has(k));
  return new Set(isOnly ? [] : others);
}

/** The filter with this class hidden, or shown again. */
export function toggleClass(filter: Filter, category: string): Filter {
  const { hiddenClasses } = filter;
  const hidden = hiddenClasses?.includes(category) ? hiddenClasses.filter((c) => c !== category) : [...(hiddenClasses ?? []), category];
  return { ...filter, hiddenClasses: hidden.length ? hidden : null };
}

export interface FilterActions {
  /** Without `refetch` only what is loaded is drawn again. */
  change(values: Partial<State>, refetch?: boolean): void;
}

/** The bar above a list: chips of kinds, the other filters, and how many cones they hide. */
export function createFilterBar(actions: FilterActions) {
  let state: State | null = null;
  const set = (values: Partial<Filter>) => state && actions.change({ filter: { ...state.filter, ...values } }, false);
  const chips = el("div", { class: "kind-chips", role: "group", aria: { label: "Kinds" } });
  const summary = el("span", { class: "filter-summary", role: "status" });
  const clear = el("button", { type: "button", class: "link", textContent: "clear", onclick: () => actions.change(noFilters(), false) });
  const more = el("button", { type: "button", class: "filter-more", aria: { expanded: "false", controls: "filter-fields" } });
  const inView = el("input", { type: "checkbox", id: "in-view", onchange: () => actions.change({ inView: inView.checked }, false) });

  function numberField(label: string, step: string, show: () => number | null, write: (value: number | null) => void) {
    const input = el("input", { type: "number", min: "0", step, aria: { label } });
    input.addEventListener("input", () => {
      if (input.validity.valid) write(input.value === "" ? null : Number(input.value));
    });
    return { input, show: () => document.activeElement !== input && (input.value = String(show() ?? "")) };
  }
  const filterField = (label: string, step: string, name: NumberName) => numberField(label, step, () => state?.filter[name] ?? null, (value) => set({ [name]: value }));
  const minP = numberField("Minimum existence probability", "0.01", () => state?.minProbability || null, (value) => actions.change({ minProbability: Math.min(value ?? 0, 1) }, false)); // prettier-ignore
  const maxP = filterField("Maximum existence probability", "0.01", "maxProbability");
  const sigma = filterField("Maximum horizontal sigma in metres", "0.001", "maxSigma_m");
  const low = filterField("Minimum object height in metres", "0.01", "minHeight_m");
  const high = filterField("Maximum object height in metres", "0.01", "maxHeight_m");
  for (const { input } of [minP, maxP]) input.max = "1";
  const drive = el("select", { aria: { label: "Drive that last observed or changed the cone" }, onchange: () => set({ drive: drive.value === "" ? null : Number(drive.value) }) });
  const day = (label: string, name: "seenFrom" | "seenTo") => {
    const input = el("input", { type: "date", aria: { label } });
    input.addEventListener("change", () => set({ [name]: input.value || null }));
    return { input, show: () => document.activeElement !== input && (input.value = state?.filter[name] ?? "") };
  };
  const [from, to] = [day("Last seen from", "seenFrom"), day("Last seen until", "seenTo")];
  const group = (text: string, ...nodes: (Node | string)[]) => el("div", { class: "filter-field" }, el("span", { textContent: text }), ...nodes);
  const fields = el("div", { class: "filter-fields", id: "filter-fields", hidden: true },
    group("Existence", minP.input, "–", maxP.input), group("Sigma ≤", sigma.input, "m"), group("Object height", low.input, "–", high.input, "m"),
    group("Drive", drive), group("Last seen", from.input, "–", to.input)); // prettier-ignore
  more.addEventListener("click", () => {
    fields.hidden = !fields.hidden;
    more.setAttribute("aria-expanded", String(!fields.hidden));
  });
  const node = el("div", { class: "filter-bar" },
    el("div", { class: "filter-line" }, chips, more, el("label", { class: "check" }, inView, "Only in view"), el("span", { class: "space" }), summary),
    fields); // prettier-ignore
  let drives: TimelineItem[] | null = null;

  return {
    node,
    /** `kinds`: number of each, and `total` of all, whatever the filters; `shownCount`: rows that are left. */
    show(next: State, kinds: ReadonlyMap<Kind, number>, total: number, shownCount: number, items: TimelineItem[]): void {
      state = next;
      const focused = chips.contains(document.activeElement) ? (document.activeElement as HTMLElement).dataset["kind"] : undefined;
      fill(chips, ...KIND_ORDER.filter((kind) => kinds.has(kind)).map((kind) => chip(next, kind, kinds.get(kind) ?? 0)));
      if (focused) chips.querySelector<HTMLElement>(`[data-kind="${focused}"]`)?.focus();
      const set = filterCount(next) - Number(next.hidden.size > 0) - Number(next.filter.hiddenClasses !== null);
      more.textContent = set ? `Filters (${set})` : "Filters";
      inView.checked = next.inView;
      if (items !== drives) {
        drives = items;
        fill(drive, el("option", { value: "", textContent: "any" }),
          ...[...items].reverse().map((t) => el("option", { value: String(t.changeset_no), textContent: `${utc(t.captured_from, false).slice(0, 10)} · ${changesetName(t)}` }))); // prettier-ignore
      }
      drive.value = String(next.filter.drive ?? "");
      for (const field of [minP, maxP, sigma, low, high, from, to]) field.show();
      const left = total - shownCount;
      const why = next.inView ? (filterCount(next) ? "by filters or outside the view" : "outside the view") : "by filters";
      fill(summary, left ? `${countOf(left)} hidden ${why}` : countOf(total), filterCount(next) > 0 && " – ", filterCount(next) > 0 && clear);
    },
  };

  function chip(now: State, kind: Kind, count: number): HTMLElement {
    const shown = !now.hidden.has(kind);
    const label = kindLabel(kind, now);
    const title = `${shown ? "Hide" : "Show"} “${label}”; double-click: show only these`;
    const toggle = () => {
      const hidden = new Set(now.hidden);
      if (!hidden.delete(kind)) hidden.add(kind);
      actions.change({ hidden }, false);
    };
    return el("button", { type: "button", class: "chip", title, data: { kind }, aria: { pressed: String(shown) }, onclick: toggle, ondblclick: () => actions.change({ hidden: onlyKind(now, kind) }, false) },
      icon(kind), label, el("b", { textContent: count.toLocaleString("en") })); // prettier-ignore
  }
}

export const kindLabel = (kind: Kind, state: State): string => (kind === "unchanged" && state.mode === "compare" ? "unchanged" : STYLES[kind].label);
