// The tabs “Cones” and “Changes”: what the map shows, as tables.
import { changesetName, type TimelineItem, type Vec3 } from "./api";
import { classCounts, classIcon, classOf, classOrder, onlyCones } from "./classes";
import { el, probabilityText, shortId, utc } from "./dom";
import { acceptedBy, createFilterBar, kindLabel, type FilterActions } from "./filters";
import { icon, KIND_ORDER, type Cone, type Kind } from "./kinds";
import type { ListPane } from "./list_pane";
import type { State } from "./state";
import { createTable, inOrder, type Column } from "./table";

export interface ListActions extends FilterActions {
  select(id: string, centre: boolean): void;
  /** Whether a point of the map is in the view. */
  inView(point: Vec3): boolean;
}

type Name = "cones" | "changes";
const DEFAULT_SORT: Record<Name, string> = { cones: "existence", changes: "shift-" };
/** Whether the drive evaluated it. */
const isChange = (kind: Kind): boolean => kind !== "unchanged" && kind !== "standing";

/** Largest moves first, then added, removed and otherwise changed ones, then the small shifts of confirmed cones. */
function shiftOrder(c: Cone): number | null {
  if (c.kind === "moved") return 1e6 + (c.shift_m ?? 0);
  if (c.kind === "confirmed" || c.kind === "standing" || c.kind === "unchanged") return c.shift_m;
  return 1e3 - KIND_ORDER.indexOf(c.kind);
}

/** Names of drives often differ only at their end. */
const bothEnds = (name: string) => (name.length > 26 ? `${name.slice(0, 10)}…${name.slice(-14)}` : name);
const at = (row: Cone, axis: 0 | 1, origin: Vec3) => row.xyz[axis] + origin[axis];

export function createLists(pane: ListPane, actions: ListActions) {
  let state: State | null = null;
  let origin: Vec3 = [0, 0, 0];
  let items: TimelineItem[] = [];
  let drives = new Map<number, string>();
  let all: Cone[] = [];
  /** Number of cones of the map that are not drawn one by one, and not listed. */
  let beyond = 0;
  let scrollToChosen = true;

  const driveOf = (c: Cone) => drives.get(c.changeset) ?? "";

  const columns: Column<Cone>[] = [
    { id: "id", title: "Id", hint: "First 8 characters of the id", width: "80px", value: (c) => c.id, text: (c) => shortId(c.id) },
    { id: "class", title: "Class", width: "minmax(136px, 1fr)", value: (c) => classOrder(c.category), text: (c) => classOf(c.category).label, icon: (c) => classIcon(c.category) },
    { id: "kind", title: "Kind", width: "minmax(140px, 1fr)", value: (c) => KIND_ORDER.indexOf(c.kind), text: (c) => (state ? kindLabel(c.kind, state) : ""), icon: (c) => icon(c.kind) },
    { id: "existence", title: "Existence", hint: "Existence probability", width: "96px", number: true, value: (c) => c.probability, text: (c) => probabilityText(c.probability) },
    { id: "sigma", title: "Sigma m", hint: "Horizontal sigma, along the major axis of the error ellipse", width: "92px", number: true, descending: true, value: (c) => c.sigma_m, text: (c) => c.sigma_m.toFixed(3) },
    { id: "height", title: "Object m", hint: "Height of the object", width: "88px", number: true, value: (c) => c.height_m, text: (c) => (c.marking ? "" : c.height_m.toFixed(2)) },
    { id: "shift", title: "Shift m", hint: "Horizontal shift. Sorted: moved, then added and removed, then confirmed", width: "84px", number: true, descending: true, value: shiftOrder, text: (c) => (c.shift_m === null ? "" : c.shift_m.toFixed(3)) },
    { id: "drive", title: "Drive", hint: "Last drive that observed or changed it", width: "minmax(184px, 1.6fr)", value: (c) => c.changeset, text: (c) => bothEnds(driveOf(c)), whole: driveOf },
    { id: "seen", title: "Last seen (UTC)", width: "128px", descending: true, value: (c) => c.seenAt, text: (c) => utc(new Date(c.seenAt).toISOString(), false) },
    { id: "observations", title: "Obs.", hint: "Observations in total", width: "58px", number: true, descending: true, value: (c) => c.observations, text: (c) => c.observations.toLocaleString("en") },
    { id: "east", title: "East m", hint: "Easting in the map's CRS", width: "96px", number: true, value: (c) => c.xyz[0], text: (c) => at(c, 0, origin).toFixed(2) },
    { id: "north", title: "North m", hint: "Northing in the map's CRS", width: "104px", number: true, value: (c) => c.xyz[1], text: (c) => at(c, 1, origin).toFixed(2) },
  ]; // prettier-ignore

  const bar = createFilterBar(actions);
  const lists = { cones: list("Cones", "cones"), changes: list("Changes", "changes") };

  function list(title: string, name: Name) {
    const withClass = name === "cones" ? columns.filter((c) => c.id !== "shift") : columns;
    const withoutClass = withClass.filter((c) => c.id !== "class");
    const shown = () => (classCounts().size > 1 ? withClass : withoutClass);
    let [sortedFrom, sortedBy]: [Cone[] | null, string] = [null, ""];
    let [sorted, rows]: [Cone[], Cone[]] = [[], []];
    const table = createTable<Cone>({
      label: title, id: (c) => c.id,
      sort: (sort) => actions.change({ sort: sort === DEFAULT_SORT[name] ? null : sort }, false),
      chosen: (cone) => {
        scrollToChosen = false;
        actions.select(cone.id, true);
      },
    }); // prettier-ignore
    const tab = pane.addTab(title, (host) => {
      if (!table.node.isConnected) host.append(table.node);
      host.prepend(bar.node);
      if (!state) return;
      update();
      bar.show(state, sorted, rows.length, items, name === "cones" ? beyond : 0);
      table.show(rows, sortOf(), shown());
      table.choose(state.feature, true);
    });
    const sortOf = () => {
      const given = state?.sort ?? null;
      return given !== null && shown().some((c) => c.id === given.replace(/-$/, "")) ? given : DEFAULT_SORT[name];
    };

    /** Sorted once for all filters. */
    function update(): void {
      if (!state) return;
      if (sortedFrom !== all || sortedBy !== sortOf()) {
        [sortedFrom, sortedBy] = [all, sortOf()];
        sorted = inOrder(name === "cones" ? all : all.filter((c) => isChange(c.kind)), withClass, sortedBy);
      }
      const accepts = acceptedBy(state);
      rows = sorted.filter((c) => accepts(c) && (!state?.inView || actions.inView(c.xyz)));
    }
    return { table, tab, update, rows: () => rows };
  }

  const opened = () => lists[pane.opened === "changes" ? "changes" : "cones"];

  return {
    show(next: State, cones: Cone[], timeline: { origin_m: Vec3; changesets: TimelineItem[] } | null, rest: number): void {
      [state, beyond] = [next, rest];
      all = cones;
      origin = timeline?.origin_m ?? [0, 0, 0];
      if (timeline && items !== timeline.changesets) {
        items = timeline.changesets;
        drives = new Map(items.map((t) => [t.changeset_no, changesetName(t)]));
      }
      const accepts = acceptedBy(next);
      let [coneCount, changeCount] = [0, 0];
      for (const cone of cones) {
        if (!accepts(cone)) continue;
        coneCount += 1;
        if (isChange(cone.kind)) changeCount += 1;
      }
      lists.cones.tab.count(coneCount + beyond, onlyCones() ? "Cones" : "Objects");
      lists.changes.tab.count(changeCount);
      for (const { tab } of Object.values(lists)) tab.redraw();
    },
    /** After the camera moved. */
    moved(): void {
      if (state?.inView) opened().tab.redraw();
    },
    choose(id: string | null): void {
      for (const { table } of Object.values(lists)) table.choose(id, scrollToChosen);
      scrollToChosen = true;
    },
    /** The cone after the selected one in the order of the opened list; null at its end. */
    next(by: number): Cone | null {
      const list = opened();
      if (!list.tab.visible) list.update();
      const rows = list.rows();
      const index = rows.findIndex((c) => c.id === state?.feature);
      return rows[index < 0 ? (by > 0 ? 0 : rows.length - 1) : index + by] ?? null;
    },
  };
}

/** Where the number of changes of a kind is shown, it opens the list of them. */
export function changeChip(kind: Kind, text: string, open: (kind: Kind) => void): HTMLElement {
  return el("button", { type: "button", class: "chip", title: `List: ${text}`, data: { kind }, onclick: () => open(kind) }, icon(kind), text);
}
