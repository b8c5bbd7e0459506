// How the map is looked at: part of the page's state, so that a link opens the same view.

export type Colouring = "intensity" | "height" | "one";
/** Where the divider between two states is, 0 to 1, or both side by side. */
export type Swipe = number | "split";
export type Grid = "none" | "lines" | "labels";

export interface SceneState {
  /** Orthographic, seen from above; else in perspective. */
  plan: boolean;
  colouring: Colouring;
  /** Eye-dome lighting of LiDAR points. */
  shading: boolean;
  /** Size of LiDAR points, a factor. */
  size: number;
  /** Of LiDAR points and of the base map, 0 to 1. */
  opacity: number;
  basemap: number;
  grid: Grid;
  /** Compare; null: one map with the changes. */
  swipe: Swipe | null;
  /** The camera is where the shown image was taken. */
  follow: boolean;
  /** The colours of the paper's Figure 6. */
  paper: boolean;
  /** What is measured, as measure.ts writes it; null while nothing is. */
  measure: string | null;
  /** A place that was clicked, as an offset from the map's origin. */
  at: [number, number] | null;
}

export const SCENE: SceneState = { plan: false, colouring: "intensity", shading: false, size: 1, opacity: 1, basemap: 1, grid: "lines", swipe: null, follow: false, paper: false, measure: null, at: null };
const COLOURINGS: Colouring[] = ["intensity", "height", "one"];
const GRIDS: Grid[] = ["none", "lines", "labels"];

function within(text: string | null, least: number, most: number, otherwise: number): number {
  const value = text === null || text === "" ? NaN : Number(text);
  return value >= least && value <= most ? value : otherwise;
}

export function parseScene(p: URLSearchParams): SceneState {
  p.get("colours"); // of older links: the safe colours are the only ones now
  const at = (p.get("at") ?? "").split(",").map((v) => (v === "" ? NaN : Number(v)));
  const swipe = within(p.get("swipe"), 0, 1, NaN);
  return {
    plan: p.get("view") === "plan",
    colouring: COLOURINGS.find((c) => c === p.get("colour")) ?? SCENE.colouring,
    shading: p.get("shading") === "1",
    size: within(p.get("size"), 0.5, 4, SCENE.size),
    opacity: within(p.get("opacity"), 0.05, 1, SCENE.opacity),
    basemap: within(p.get("basemap"), 0, 1, SCENE.basemap),
    grid: GRIDS.find((g) => g === p.get("grid")) ?? SCENE.grid,
    swipe: p.get("swipe") === "split" ? "split" : Number.isNaN(swipe) ? null : swipe,
    follow: p.get("follow") === "1",
    paper: p.get("look") === "paper",
    measure: p.get("measure"),
    at: at.length === 2 && at.every(Number.isFinite) ? (at as [number, number]) : null,
  };
}

/** The inverse of parseScene; defaults are left out. */
export function formatScene(p: URLSearchParams, scene: SceneState, compares: boolean): void {
  if (scene.plan) p.set("view", "plan");
  if (scene.colouring !== SCENE.colouring) p.set("colour", scene.colouring);
  if (scene.shading) p.set("shading", "1");
  for (const name of ["size", "opacity", "basemap"] as const) if (scene[name] !== SCENE[name]) p.set(name, String(scene[name]));
  if (scene.grid !== SCENE.grid) p.set("grid", scene.grid);
  if (compares && scene.swipe !== null) p.set("swipe", scene.swipe === "split" ? scene.swipe : scene.swipe.toFixed(3).replace(/\.?0+$/, "") || "0");
  if (scene.paper) p.set("look", "paper");
  if (scene.follow) p.set("follow", "1");
  if (scene.at !== null) p.set("at", scene.at.map((v) => v.toFixed(3)).join(","));
  if (scene.measure !== null) p.set("measure", scene.measure);
}
