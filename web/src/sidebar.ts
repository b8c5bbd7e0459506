// Left: map, search, and the legend, which is also the filter.
import type { BaseLayer, MapItem } from "./api";
import { el, fill, messageOf, plural, shortId } from "./dom";
import { icon, KIND_ORDER, STYLES, type Cone, type Kind } from "./kinds";
import type { State } from "./state";

export interface SidebarActions {
  chooseMap(name: string): void;
  /** Without `refetch` only what is loaded is drawn again. */
  change(values: Partial<State>, refetch?: boolean): void;
  find(beginning: string): Promise<{ feature_ids: string[]; truncated: boolean }>;
  select(id: string): void;
  fit(): void;
}

type Switch = "trajectory" | "points" | "lines";

export function createSidebar(host: HTMLElement, actions: SidebarActions) {
  const maps = el("select", { id: "map", onchange: () => actions.chooseMap(maps.value) });
  const search = el("input", {
    id: "search", type: "search", placeholder: "Id or first characters", autocomplete: "off", spellcheck: false, maxLength: 36,
  }); // prettier-ignore
  const found = el("div", { class: "found", aria: { live: "polite" } });
  const form = el("form", { class: "search", role: "search" }, el("label", { htmlFor: "search", textContent: "Find a cone" }), search, found);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void runSearch();
  });
  search.addEventListener("input", () => fill(found));

  async function runSearch(): Promise<void> {
    const text = search.value.trim().toLowerCase();
    const answer = (message: string, bad = false) => fill(found, el("p", { class: bad ? "hint bad" : "hint", textContent: message }));
    if (!text) return fill(found);
    if (!/^[0-9a-f-]{1,36}$/.test(text)) return answer("An id contains only 0-9, a-f and dashes.");
    try {
      const { feature_ids: ids, truncated } = await actions.find(text);
      if (!ids.length) return answer(`No cone of this map has an id that begins with ${text}.`);
      if (ids.length === 1) {
        fill(found);
        return actions.select(ids[0] as string);
      }
      answer(`${truncated ? "More than " : ""}${ids.length} cones:`);
      found.append(...ids.map((id) => el("button", { type: "button", class: "link mono", textContent: shortId(id), title: id, onclick: () => actions.select(id) })));
    } catch (error) {
      answer(messageOf(error), true);
    }
  }

  const boxes = {} as Record<Switch, HTMLInputElement>;
  function switchRow(field: Switch, id: string, ...label: (Node | string)[]): HTMLLabelElement {
    const box = el("input", { type: "checkbox", id, onchange: () => actions.change({ [field]: box.checked }, field === "trajectory") });
    boxes[field] = box;
    return el("label", { class: "check" }, box, ...label);
  }
  const legend = el("div", { class: "legend" });
  const probability = el("input", { id: "probability", type: "range", min: "0", max: "1", step: "0.01", value: "0" });
  const probabilityText = el("output", { htmlFor: "probability" } as never);
  probability.addEventListener("input", () => actions.change({ minProbability: Number(probability.value) }, false));
  const pointsRow = switchRow("points", "points", el("i", { class: "swatch points" }), "LiDAR points ", el("kbd", { textContent: "1" }));
  const linesRow = switchRow("lines", "lines", el("i", { class: "swatch lines" }), "Lane boundaries ", el("kbd", { textContent: "2" }));
  const baseSection = el("section", { class: "base", hidden: true }, el("h2", { textContent: "Base layers" }), pointsRow, linesRow);

  host.append(
    el("section", {}, el("label", { htmlFor: "map", textContent: "Map" }), maps),
    el("section", {}, form),
    el("section", {}, el("h2", { textContent: "Cones shown" }), legend),
    el("section", {}, el("label", { htmlFor: "probability" }, "Existence probability ≥ ", probabilityText), probability),
    baseSection,
    el("section", {}, switchRow("trajectory", "way", el("i", { class: "swatch path" }), "Camera path (left)"),
      el("button", { type: "button", class: "wide", onclick: () => actions.fit() }, "Show everything ", el("kbd", { textContent: "Home" }))),
  ); // prettier-ignore

  function legendRow(state: State, kind: Kind, count: number): HTMLLabelElement {
    const box = el("input", { type: "checkbox", checked: !state.hidden.has(kind) });
    box.addEventListener("change", () => {
      const hidden = new Set(state.hidden);
      if (!hidden.delete(kind)) hidden.add(kind);
      actions.change({ hidden }, false);
    });
    const name = kind === "unchanged" && state.mode === "compare" ? "unchanged" : STYLES[kind].label;
    return el("label", { class: "check", data: { kind } }, box, icon(kind), name, el("b", { textContent: String(count) }));
  }

  return {
    focusSearch: () => search.focus(),
    showMaps(items: MapItem[], chosen: string): void {
      fill(maps, ...items.map((m) => el("option", { value: m.map_name, textContent: `${m.map_name} (${m.feature_count})` })),
        !items.some((m) => m.map_name === chosen) && el("option", { value: chosen, textContent: `${chosen} (empty)` })); // prettier-ignore
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
      const rows = KIND_ORDER.filter((kind) => counts.has(kind)).map((kind) => legendRow(state, kind, counts.get(kind) ?? 0));
      const hint = !rows.length ? "No cones on the road at this time." : shownCount < cones.length ? `${plural(cones.length - shownCount, "cone")} hidden by the filter.` : "";
      const focused = document.activeElement instanceof HTMLInputElement ? document.activeElement.closest("label")?.dataset["kind"] : undefined;
      fill(legend, ...rows, Boolean(hint) && el("p", { class: "hint", textContent: hint }));
      if (focused) legend.querySelector<HTMLInputElement>(`[data-kind="${focused}"] input`)?.focus();
      if (document.activeElement !== probability) probability.value = String(state.minProbability);
      probabilityText.textContent = state.minProbability.toFixed(2);
      for (const field of Object.keys(boxes) as Switch[]) boxes[field].checked = state[field];
    },
  };
}
