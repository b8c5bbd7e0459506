// How the scene is drawn: colouring, size and opacity of LiDAR points, base map, grid; and the buttons of the map.
import { el, popup } from "./dom";
import { SCENE, type Colouring, type Grid, type SceneState } from "./scene_state";

export interface LayerActions {
  change(values: Partial<SceneState>): void;
  measure(): void;
  /** The last drive in the paper's colours, before beside after; or the ordinary picture again. */
  paper(on: boolean): void;
}

export function createLayers(host: HTMLElement, actions: LayerActions) {
  const select = <T extends string>(id: string, choices: [T, string][], chosen: (value: T) => void) => {
    const node = el("select", { id, onchange: () => chosen(node.value as T) });
    node.append(...choices.map(([value, textContent]) => el("option", { value, textContent })));
    return node;
  };
  const range = (id: string, min: number, max: number, step: number, chosen: (value: number) => void) => {
    const node = el("input", { id, type: "range", min: String(min), max: String(max), step: String(step) });
    node.addEventListener("input", () => chosen(Number(node.value)));
    return node;
  };
  const colouring = select<Colouring>("point-colour", [["intensity", "intensity"], ["height", "height above ground"], ["one", "one colour"]], (c) => actions.change({ colouring: c }));
  const size = range("point-size", 0.5, 4, 0.5, (v) => actions.change({ size: v }));
  const opacity = range("point-opacity", 0.1, 1, 0.05, (v) => actions.change({ opacity: v }));
  const basemap = range("basemap-opacity", 0, 1, 0.05, (v) => actions.change({ basemap: v }));
  const grid = select<Grid>("grid", [["lines", "lines"], ["labels", "lines with coordinates (plan only)"], ["none", "none"]], (g) => actions.change({ grid: g }));
  const shading = el("input", { id: "shading", type: "checkbox", onchange: () => actions.change({ shading: shading.checked }) });
  const row = (text: string, control: HTMLElement) => el("label", { htmlFor: control.id }, el("span", { textContent: text }), control);
  const points = el("div", { class: "group" }, row("Point colour", colouring), row("Point size", size), row("Point opacity", opacity), row("Light by depth", shading));
  const tiles = row("Base map opacity", basemap);
  const reset = el("button", { type: "button", class: "link", textContent: "Reset", onclick: () => {
    const { colouring, shading, size, opacity, basemap, grid } = SCENE;
    actions.change({ colouring, shading, size, opacity, basemap, grid });
  } }); // prettier-ignore
  const paper = el("button", { type: "button", id: "paper", textContent: "Paper", title: "As in Figure 6 of the paper: LiDAR red, lane boundaries green, the new cone blue; before | after side by side",
    onclick: () => actions.paper(paper.getAttribute("aria-pressed") !== "true") }); // prettier-ignore
  const panel = el("div", { class: "layers-panel", id: "layers-panel", hidden: true }, row("Show as in", paper), points, tiles, row("Grid", grid), reset);
  const toggle = el("button", { type: "button", textContent: "Layers", aria: { expanded: "false", controls: "layers-panel" } });
  popup(toggle, panel);
  const plan = el("button", { type: "button", id: "plan", title: "Switch between plan and 3D (T)", onclick: () => actions.change({ plan: plan.textContent === "Plan" }) });
  const measure = el("button", { type: "button", id: "measure", textContent: "Measure", title: "Measure distances and areas (M)", onclick: () => actions.measure() });
  host.append(el("div", { class: "map-tools", role: "toolbar", aria: { label: "Map" } }, plan, measure, toggle, panel));

  return {
    /** Which controls have anything to do. */
    offer(what: { points?: boolean; basemap?: boolean }): void {
      if (what.points !== undefined) points.hidden = !what.points;
      if (what.basemap !== undefined) tiles.hidden = !what.basemap;
    },
    show(scene: SceneState): void {
      plan.textContent = scene.plan ? "3D" : "Plan";
      measure.setAttribute("aria-pressed", String(scene.measure !== null));
      paper.setAttribute("aria-pressed", String(scene.paper));
      shading.checked = scene.shading;
      colouring.value = scene.colouring;
      grid.value = scene.grid;
      for (const [node, value] of [[size, scene.size], [opacity, scene.opacity], [basemap, scene.basemap]] as const) {
        if (document.activeElement !== node) node.value = String(value);
      }
    },
  };
}
