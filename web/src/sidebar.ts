// Left: map, sites, and the legend, which is also the filter.
import type { BaseLayer, MapItem } from "./api";
import { classCounts, classIcon, classOf, countOf, onlyCones } from "./classes";
import { el, fill, plural } from "./dom";
import { filterCount, kindLabel, noFilters, toggleClass } from "./filters";
import { icon, KIND_ORDER, type Cone, type Kind } from "./kinds";
import type { State } from "./state";

export interface SidebarActions {
  chooseMap(name: string): void;
  /** Without `refetch` only what is loaded is drawn again. */
  change(values: Partial<State>, refetch?: boolean): void;
  fit(): void;
}

type Switch = "trajectory" | "points" | "lines";

export function createSidebar(host: HTMLElement, actions: SidebarActions) {
  const maps = el("select", { id: "map", onchange: () => actions.chooseMap(maps.value) });
  const boxes = {} as Record<Switch, HTMLInputElement>;
  function switchRow(field: Switch, id: string, ...label: (Node | string)[]): HTMLLabelElement {
    const box = el("input", { type: "checkbox", id, onchange: () => actions.change({ [field]: box.checked }, field === "trajectory") });
    boxes[field] = box;
    return el("label", { class: "check" }, box, ...label);
  }
  const sites = el("div", { class: "sites-host" });
  const heading = el("h2");
  const legend = el("div", { class: "legend" });
  const classes = el("div", { class: "classes" });
  const classSection = el("section", { hidden: true }, el("h2", { textContent: "Classes" }), classes);
  const clear = el("button", { type: "button", class: "link", textContent: "clear", onclick: () => actions.change(noFilters(), false) });
  const probability = el("input", { id: "probability", type: "range", min: "0", max: "1", step: "0.01", value: "0" });
  const probabilityText = el("output", { htmlFor: "probability" } as never);
  probability.addEventListener("input", () => actions.change({ minProbability: Number(probability.value) }, false));
  const pointsRow = switchRow("points", "points", el("i", { class: "swatch points" }), "LiDAR points ", el("kbd", { textContent: "1" }));
  const linesRow = switchRow("lines", "lines", el("i", { class: "swatch lines" }), "Lane boundaries ", el("kbd", { textContent: "2" }));
  const baseSection = el("section", { class: "base", hidden: true }, el("h2", { textContent: "Base layers" }), pointsRow, linesRow);

  host.append(
    el("section", {}, el("label", { htmlFor: "map", textContent: "Map" }), maps),
    sites,
    el("section", {}, heading, legend), classSection,
    el("section", {}, el("label", { htmlFor: "probability", title: "Existence probability" }, "Sure it stands ≥ ", probabilityText), probability),
    baseSection,
    el("section", {}, switchRow("trajectory", "way", el("i", { class: "swatch path" }), "Drive path"),
      el("button", { type: "button", class: "wide", onclick: () => actions.fit() }, "Show everything ", el("kbd", { textContent: "Home" }))),
  ); // prettier-ignore

  function legendRow(state: State, kind: Kind, count: number): HTMLLabelElement {
    const onchange = () => {
      const hidden = new Set(state.hidden);
      if (!hidden.delete(kind)) hidden.add(kind);
      actions.change({ hidden }, false);
    };
    const box = el("input", { type: "checkbox", id: `kind-${kind}`, checked: !state.hidden.has(kind), onchange });
    return el("label", { class: "check", data: { kind } }, box, icon(kind), kindLabel(kind, state), el("b", { textContent: count.toLocaleString("en") }));
  }

  function classRow({ filter }: State, category: string, count: number): HTMLLabelElement {
    const onchange = () => actions.change({ filter: toggleClass(filter, category) }, false);
    const box = el("input", { type: "checkbox", id: `class-${category}`, checked: !filter.hiddenClasses?.includes(category), onchange });
    return el("label", { class: "check" }, box, classIcon(category), classOf(category).label, el("b", { textContent: count.toLocaleString("en") }));
  }

  return {
    /** For the list of sites. */
    sites,
    showMaps(items: MapItem[], chosen: string): void {
      fill(maps, ...items.map((m) => el("option", { value: m.map_name, textContent: `${m.map_name} (${plural(m.feature_count, "feature")})` })),
        !items.some((m) => m.map_name === chosen) && el("option", { value: chosen, textContent: `${chosen} (no drives yet)` })); // prettier-ignore
      maps.value = chosen;
    },
    showBase(layers: BaseLayer[]): void {
      for (const [row, kind] of [[pointsRow, "points"], [linesRow, "lines"]] as const) {
        const mine = layers.filter((l) => l.kind === kind);
        row.hidden = !mine.length;
        row.title = mine.map((l) => `${l.layer_name}: ${plural(l.count, kind === "points" ? "point" : "line")}`).join("\n");
      }
      baseSection.hidden = !layers.length;
    },
    /** `counts`: of each kind on the whole map; `beyond`: how many of these are not among the cones. */
    show(state: State, cones: Cone[], shownCount: number, counts: ReadonlyMap<Kind, number>, beyond: number): void {
      const rows = KIND_ORDER.filter((kind) => counts.get(kind)).map((kind) => legendRow(state, kind, counts.get(kind) ?? 0));
      const hint = !rows.length ? "No cones on the map at this time." : shownCount < cones.length ? `${countOf(cones.length - shownCount)} hidden by filters` : "";
      const clustered = beyond > 0 && `${countOf(beyond)} in clusters or outside the view. Filters other than kind and class apply to what is drawn one by one: zoom in.`;
      const focused = document.activeElement?.id ?? "";
      heading.textContent = onlyCones() ? "Cones shown" : "Objects shown";
      classSection.hidden = classCounts().size < 2 && state.filter.hiddenClasses === null;
      fill(classes, ...[...classCounts()].map(([category, n]) => classRow(state, category, n)));
      fill(legend, ...rows, Boolean(hint) && el("p", { class: "hint" }, hint, filterCount(state) > 0 && " – ", filterCount(state) > 0 && clear), clustered && el("p", { class: "hint", textContent: clustered }));
      document.getElementById(focused)?.focus();
      if (document.activeElement !== probability) probability.value = String(state.minProbability);
      probabilityText.textContent = `${(100 * state.minProbability).toFixed(0)} %`;
      for (const field of Object.keys(boxes) as Switch[]) boxes[field].checked = state[field];
    },
  };
}
