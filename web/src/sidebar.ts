// Left: map, search, and the legend, which is the filter too.
import type { BaseLayer, MapItem } from "./api";
import { el, fill, plural, shortId } from "./dom";
import { icon, KIND_ORDER, STYLES, type Cone, type Kind } from "./kinds";
import type { State } from "./state";

export interface SidebarActions {
  chooseMap(name: string): void;
  toggleKind(kind: Kind): void;
  setProbability(value: number): void;
  setTrajectory(on: boolean): void;
  setPoints(on: boolean): void;
  setLines(on: boolean): void;
  setSafeColours(on: boolean): void;
  find(beginning: string): Promise<{ ids: string[]; truncated: boolean }>;
  select(id: string): void;
  fit(): void;
}

export function createSidebar(host: HTMLElement, actions: SidebarActions) {
  const maps = el("select", { id: "map", onchange: () => actions.chooseMap(maps.value) });
  const search = el("input", {
    id: "search", type: "search", placeholder: "Id or its beginning", autocomplete: "off", spellcheck: false, maxLength: 36,
  });
  const found = el("div", { class: "found", aria: { live: "polite" } });
  const form = el("form", { class: "search", role: "search" }, el("label", { htmlFor: "search", textContent: "Find a cone" }), search, found);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void runSearch();
  });
  search.addEventListener("input", () => fill(found));

  async function runSearch(): Promise<void> {
    const text = search.value.trim().toLowerCase();
    if (!text) return fill(found);
    if (!/^[0-9a-f-]{1,36}$/.test(text)) return fill(found, el("p", { class: "hint", textContent: "An id holds only 0-9, a-f and dashes." }));
    try {
      const { ids, truncated } = await actions.find(text);
      const first = ids[0];
      if (first === undefined) return fill(found, el("p", { class: "hint", textContent: `No cone of this map has an id that begins with ${text}.` }));
      if (ids.length === 1) {
        actions.select(first);
        return fill(found);
      }
      fill(
        found,
        el("p", { class: "hint", textContent: `${truncated ? "More than " : ""}${ids.length} cones:` }),
        ...ids.map((id) => el("button", { type: "button", class: "link mono", textContent: shortId(id), title: id, onclick: () => actions.select(id) })),
      );
    } catch (error) {
      fill(found, el("p", { class: "hint bad", textContent: error instanceof Error ? error.message : String(error) }));
    }
  }

  const legend = el("div", { class: "legend" });
  const probability = el("input", { id: "probability", type: "range", min: "0", max: "1", step: "0.01", value: "0" });
  const probabilityText = el("output", { htmlFor: "probability" } as never);
  probability.addEventListener("input", () => actions.setProbability(Number(probability.value)));
  const way = el("input", { type: "checkbox", id: "way", onchange: () => actions.setTrajectory(way.checked) });
  const points = el("input", { type: "checkbox", id: "points", onchange: () => actions.setPoints(points.checked) });
  const lines = el("input", { type: "checkbox", id: "lines", onchange: () => actions.setLines(lines.checked) });
  const safe = el("input", { type: "checkbox", id: "safe-colours", onchange: () => actions.setSafeColours(safe.checked) });
  const pointsRow = el("label", { class: "check" }, points, el("i", { class: "swatch points" }), "LiDAR points ", el("kbd", { textContent: "1" }));
  const linesRow = el("label", { class: "check" }, lines, el("i", { class: "swatch lines" }), "Lane boundaries ", el("kbd", { textContent: "2" }));
  const baseSection = el("section", { class: "base", hidden: true }, el("h2", { textContent: "Under the cones" }), pointsRow, linesRow,
    el("label", { class: "check", title: "Ochre points and brown lines instead of red and green" }, safe, "Colour-blind safe colours")); // prettier-ignore
  const fitButton = el("button", { type: "button", class: "wide", onclick: () => actions.fit() }, "Show everything ", el("kbd", { textContent: "Home" }));

  host.append(
    el("section", {}, el("label", { htmlFor: "map", textContent: "Map" }), maps),
    el("section", {}, form),
    el("section", {}, el("h2", { textContent: "Cones shown" }), legend),
    el(
      "section", {},
      el("label", { htmlFor: "probability" }, "Existence probability ≥ ", probabilityText),
      probability,
    ),
    baseSection,
    el("section", {}, el("label", { class: "check" }, way, el("i", { class: "swatch way" }), "Way of the left camera"), fitButton),
  );

  return {
    focusSearch: () => search.focus(),
    showMaps(items: MapItem[], chosen: string): void {
      const names = new Set(items.map((m) => m.map_name));
      fill(maps, ...items.map((m) => el("option", { value: m.map_name, textContent: `${m.map_name} (${m.feature_count})` })),
        !names.has(chosen) && el("option", { value: chosen, textContent: `${chosen} (empty)` })); // prettier-ignore
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
    show(state: State, cones: Cone[], shownCount: number): void {
      const counts = new Map<Kind, number>();
      for (const cone of cones) counts.set(cone.kind, (counts.get(cone.kind) ?? 0) + 1);
      const rows = KIND_ORDER.filter((kind) => counts.has(kind)).map((kind) => {
        const box = el("input", { type: "checkbox", checked: !state.hidden.has(kind), onchange: () => actions.toggleKind(kind) });
        const name = kind === "unchanged" && state.mode === "compare" ? "unchanged" : STYLES[kind].label;
        return el("label", { class: "check", data: { kind } }, box, icon(kind), name, el("b", { textContent: String(counts.get(kind)) }));
      });
      const focused = document.activeElement instanceof HTMLInputElement ? document.activeElement.closest("label")?.dataset["kind"] : undefined;
      fill(
        legend,
        ...rows,
        !rows.length && el("p", { class: "hint", textContent: "No cone stood on the road then." }),
        rows.length > 0 && shownCount < cones.length &&
          el("p", { class: "hint", textContent: `${plural(cones.length - shownCount, "cone")} hidden by the filter.` }),
      ); // prettier-ignore
      if (focused) legend.querySelector<HTMLInputElement>(`[data-kind="${focused}"] input`)?.focus();
      if (document.activeElement !== probability) probability.value = String(state.minProbability);
      probabilityText.textContent = state.minProbability.toFixed(2);
      way.checked = state.trajectory;
      points.checked = state.points;
      lines.checked = state.lines;
      safe.checked = state.safeColours;
      baseSection.dataset["colours"] = state.safeColours ? "safe" : "paper";
    },
  };
}
