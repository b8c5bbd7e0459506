// The tabs “Cones” and “Changes”: what stands on the map, and what changed, as tables. The server filters and sorts them.
import { api, changesetName, type Query, type Timeline, type TimelineItem, type Vec3 } from "./api";
import { classCounts, classIcon, classOf, onlyCones } from "./classes";
import { el, probabilityText, shortId, utc } from "./dom";
import { createFilterBar, kindLabel, listFilter, type FilterActions } from "./filters";
import { icon, type Cone, type Kind } from "./kinds";
import type { ListPane } from "./list_pane";
import { createPages, PAGE_ROWS, type AskPage } from "./pages";
import { changed, standing } from "./query";
import type { State } from "./state";
import { createTable, type Column } from "./table";

export interface ListActions extends FilterActions {
  select(id: string, centre: boolean): void;
  /** Easting, northing of places around what is seen. */
  area(): string[];
  /** What people decided since. */
  withDecisions(cones: Cone[]): Cone[];
  failed(error: unknown): void;
}

/** What is listed: parameters of requests, and numbers without filters. */
export interface Listed {
  map: string;
  timeline: Timeline | null;
  features: Query;
  /** Null: none are shown. */
  changes: Query | null;
  featureCount: number;
  kinds: ReadonlyMap<Kind, number>;
  /** Another one after the map has changed. */
  version: number;
}

type Name = "cones" | "changes";
const DEFAULT_SORT: Record<Name, string> = { cones: "existence", changes: "shift-" };
const REST_MS = 150;
/** A list that could not be read is asked for again after this time. */
const RETRY_MS = 5000;

/** Names of drives often differ only at their end. */
const bothEnds = (name: string) => (name.length > 26 ? `${name.slice(0, 10)}…${name.slice(-14)}` : name);
const at = (row: Cone, axis: 0 | 1, origin: Vec3) => row.xyz[axis] + origin[axis];

export function createLists(pane: ListPane, actions: ListActions) {
  let state: State | null = null;
  let listed: Listed | null = null;
  let drives = new Map<number, string>();
  let scrollToChosen = true;

  const origin = (): Vec3 => listed?.timeline?.origin_m ?? [0, 0, 0];
  const items = (): TimelineItem[] => listed?.timeline?.changesets ?? [];
  const driveOf = (c: Cone) => drives.get(c.changeset) ?? "";

  const columns: Column<Cone>[] = [
    { id: "id", title: "Id", hint: "First 8 characters of the id", width: "80px", text: (c) => shortId(c.id) },
    { id: "class", title: "Class", width: "minmax(136px, 1fr)", text: (c) => classOf(c.category).label, icon: (c) => classIcon(c.category) },
    { id: "kind", title: "Kind", width: "minmax(140px, 1fr)", text: (c) => (state ? kindLabel(c.kind, state) : ""), icon: (c) => icon(c.kind) },
    { id: "existence", title: "Existence", hint: "Existence probability", width: "96px", number: true, text: (c) => probabilityText(c.probability) },
    { id: "sigma", title: "Sigma m", hint: "Horizontal sigma, along the major axis of the error ellipse", width: "92px", number: true, descending: true, text: (c) => c.sigma_m.toFixed(3) },
    { id: "height", title: "Object m", hint: "Height of the object", width: "88px", number: true, text: (c) => (c.height_m ? c.height_m.toFixed(2) : "") },
    { id: "shift", title: "Shift m", hint: "Horizontal shift. Sorted: moved, then added and removed, then confirmed", width: "84px", number: true, descending: true, text: (c) => (c.shift_m === null ? "" : c.shift_m.toFixed(3)) },
    { id: "drive", title: "Drive", hint: "Last drive that observed or changed it", width: "minmax(184px, 1.6fr)", text: (c) => bothEnds(driveOf(c)), whole: driveOf },
    { id: "seen", title: "Last seen (UTC)", width: "128px", descending: true, text: (c) => utc(new Date(c.seenAt).toISOString(), false) },
    { id: "observations", title: "Obs.", hint: "Observations in total", width: "58px", number: true, descending: true, text: (c) => c.observations.toLocaleString("en") },
    { id: "east", title: "East m", hint: "Easting in the map's CRS", width: "96px", number: true, text: (c) => at(c, 0, origin()).toFixed(2) },
    { id: "north", title: "North m", hint: "Northing in the map's CRS", width: "104px", number: true, text: (c) => at(c, 1, origin()).toFixed(2) },
  ]; // prettier-ignore

  const bar = createFilterBar(actions);
  const lists = { cones: list("Cones", "cones"), changes: list("Changes", "changes") };

  function list(title: string, name: Name) {
    const withClass = columns.filter((c) => name === "changes" || (c.id !== "shift" && c.id !== "kind"));
    const withoutClass = withClass.filter((c) => c.id !== "class");
    const shown = () => (classCounts().size > 1 ? withClass : withoutClass);
    const what = name === "cones" ? "features" : "changes";
    let [asked, read, timer]: [string, Query | null, number] = ["", null, 0];
    let count: number | null = null;
    const pages = createPages<Cone>(() => (table.draw(), chooseShown(false)), actions.failed);
    const table = createTable<Cone>({
      label: title, row: pages.row, wanted: pages.want,
      sort: (sort) => actions.change({ sort: sort === DEFAULT_SORT[name] ? null : sort }, false),
      chosen: (index) => void pages.rowAt(index).then((cone) => {
        if (!cone) return;
        scrollToChosen = false;
        actions.select(cone.id, true);
      }, actions.failed),
    }); // prettier-ignore
    const tab = pane.addTab(title, (host) => {
      if (!table.node.isConnected) host.append(table.node);
      host.prepend(bar.node);
      showBar();
      window.clearTimeout(timer);
      // While somebody types or drags, only the last value is asked for.
      timer = window.setTimeout(() => void update().catch(actions.failed), asked ? REST_MS : 0);
    });

    const total = () => (name === "cones" ? listed?.featureCount : [...(listed?.kinds.values() ?? [])].reduce((a, b) => a + b, 0)) ?? 0;
    const sortOf = () => {
      const given = state?.sort ?? null;
      return given !== null && shown().some((c) => c.id === given.replace(/-$/, "")) ? given : DEFAULT_SORT[name];
    };

    function showBar(): void {
      if (state) bar.show(state, name === "changes" ? listed?.kinds ?? new Map() : new Map(), total(), count ?? total(), items());
    }

    const ask = (of: Query): AskPage<Cone> => async (offset, after) => {
      const page = { ...of, limit: String(PAGE_ROWS), ...(after === null ? { offset: String(offset) } : { after }) };
      const map = listed?.map ?? "";
      if (name === "changes") {
        const { changes, next } = await api.changePage(map, page);
        return { rows: actions.withDecisions(changes.map(changed)), next };
      }
      const { features, next } = await api.featurePage(map, page);
      return { rows: features.map(standing), next };
    };

    /** Read the first page and the number of rows, if other ones than before are wanted. */
    async function update(): Promise<void> {
      if (!state || !listed) return;
      const source = name === "cones" ? listed.features : listed.changes;
      const filters = listFilter(state, name === "changes", actions.area);
      const of = source && { ...source, ...filters, sort: sortOf() };
      const key = JSON.stringify([listed.map, listed.version, of, total()]); // drawn before the numbers are known, it is drawn again
      if (key === asked) return void chooseShown(scrollToChosen);
      asked = key;
      const again = (error: unknown): never => {
        if (key === asked) {
          asked = "";
          timer = window.setTimeout(tab.redraw, RETRY_MS);
        }
        throw error;
      };
      const isFiltered = Object.values(filters).some((value) => value !== null);
      const [first, number] = of && total() ? await Promise.all([
        ask(of)(0, null), isFiltered ? api.listCount(listed.map, what, of).then((found) => found.count) : total(),
      ]).catch(again) : [{ rows: [], next: null }, 0]; // prettier-ignore
      if (key !== asked) return;
      [count, read] = [number, of];
      pages.open(of && ask(of), first);
      table.show(number, sortOf(), shown(), of ? "Nothing matches the filters, or nothing changed." : "Choose a drive, or two times, to see what changed.");
      table.choose(null, false);
      showTabs();
      showBar();
      chooseShown(true);
    }

    /** Index of a cone, read if it is on none of the pages that are there; null: not in the list. */
    async function indexOf(id: string): Promise<number | null> {
      const known = pages.find((cone) => cone.id === id);
      return known ?? (read && listed ? (await api.listCount(listed.map, what, { ...read, feature: id })).index : null);
    }

    function chooseShown(scroll: boolean): void {
      const id = state?.feature ?? null;
      const known = id === null ? null : pages.find((cone) => cone.id === id);
      if (id === null || known !== null) return table.choose(known, scroll);
      if (scroll) void indexOf(id).then((index) => id === state?.feature && table.choose(index, true), actions.failed);
    }

    return { table, tab, pages, chooseShown, indexOf, size: () => count ?? 0, number: () => (count !== null && tab.visible ? count : total()) };
  }

  const opened = () => lists[pane.opened === "changes" ? "changes" : "cones"];
  function showTabs(): void {
    lists.cones.tab.count(lists.cones.number(), onlyCones() ? "Cones" : "Objects");
    lists.changes.tab.count(lists.changes.number());
  }

  return {
    show(next: State, of: Listed): void {
      [state, listed] = [next, of];
      drives = new Map(items().map((t) => [t.changeset_no, changesetName(t)]));
      showTabs();
      for (const { tab } of Object.values(lists)) tab.redraw();
    },
    /** After the camera moved. */
    moved(): void {
      if (state?.inView) opened().tab.redraw();
    },
    choose(): void {
      const { tab, chooseShown } = opened();
      if (tab.visible) chooseShown(scrollToChosen);
      scrollToChosen = true;
    },
    /** The cone after the selected one in the order of the opened list; null at its end. */
    async next(by: number): Promise<Cone | null> {
      const { pages, indexOf, size } = opened();
      const index = state?.feature ? await indexOf(state.feature) : null;
      const at = index === null ? (by > 0 ? 0 : size() - 1) : index + by;
      return at < 0 || at >= size() ? null : (await pages.rowAt(at)) ?? null;
    },
  };
}

/** Where the number of changes of a kind is shown, it opens the list of them. */
export function changeChip(kind: Kind, text: string, open: (kind: Kind) => void): HTMLElement {
  return el("button", { type: "button", class: "chip", title: `List: ${text}`, data: { kind }, onclick: () => open(kind) }, icon(kind), text);
}
