// Sites: groups of cones that are far from each other, to jump from one to the next.
import type { Vec3 } from "./api";
import { countOf } from "./classes";
import { el, fill } from "./dom";
import type { Cone } from "./kinds";

/** Cones of different sites are at least about this far apart. */
const APART_M = 300;
/** Cones of one cell belong together. */
const CELL_M = 100;

export interface Site {
  points: Vec3[];
}

interface Cell {
  x: number;
  y: number;
  box: [number, number, number, number];
  points: Vec3[];
  site: number;
}

/** Groups of points with gaps of at most `APART_M` (measured between the boxes of their cells), largest group first. */
export function sitesOf(points: Vec3[]): Site[] {
  const cells = new Map<string, Cell>();
  for (const point of points) {
    const [x, y] = [Math.floor(point[0] / CELL_M), Math.floor(point[1] / CELL_M)];
    const key = `${x} ${y}`;
    let cell = cells.get(key);
    if (!cell) cells.set(key, (cell = { x, y, box: [point[0], point[1], point[0], point[1]], points: [], site: -1 }));
    const b = cell.box;
    cell.box = [Math.min(b[0], point[0]), Math.min(b[1], point[1]), Math.max(b[2], point[0]), Math.max(b[3], point[1])];
    cell.points.push(point);
  }
  const sites: Site[] = [];
  const reach = Math.ceil(APART_M / CELL_M) + 1;
  for (const start of cells.values()) {
    if (start.site >= 0) continue;
    const site: Site = { points: [] };
    start.site = sites.push(site) - 1;
    const open = [start];
    for (let cell = open.pop(); cell; cell = open.pop()) {
      for (const point of cell.points) site.points.push(point);
      for (let dx = -reach; dx <= reach; dx++) {
        for (let dy = -reach; dy <= reach; dy++) {
          const other = cells.get(`${cell.x + dx} ${cell.y + dy}`);
          if (!other || other.site >= 0 || gap(cell.box, other.box) > APART_M) continue;
          other.site = start.site;
          open.push(other);
        }
      }
    }
  }
  return sites.sort((a, b) => b.points.length - a.points.length);
}

const gap = (a: Cell["box"], b: Cell["box"]) =>
  Math.hypot(Math.max(a[0] - b[2], b[0] - a[2], 0), Math.max(a[1] - b[3], b[1] - a[3], 0));

/** Whether a point is near some of many points: within `reach_m`, or a little more. */
export function nearTo(points: Vec3[], reach_m: number): (point: Vec3) => boolean {
  const taken = new Set<string>();
  const cell = (v: number) => Math.floor(v / reach_m);
  for (const [x, y] of points) for (const dx of [-1, 0, 1]) for (const dy of [-1, 0, 1]) taken.add(`${cell(x) + dx} ${cell(y) + dy}`);
  return ([x, y]) => taken.has(`${cell(x)} ${cell(y)}`);
}

const DIRECTIONS = ["east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east"];

/** Where a site lies, seen from the largest one: "1.2 km north-east". */
function bearing(from: Vec3, to: Vec3): string {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  const distance = Math.hypot(dx, dy);
  const octant = (Math.round((Math.atan2(dy, dx) * 4) / Math.PI) + 8) % 8;
  return `${distance < 950 ? `${Math.round(distance / 10) * 10} m` : `${(distance / 1000).toFixed(1)} km`} ${DIRECTIONS[octant] ?? ""}`;
}

function middle({ points }: Site): Vec3 {
  const sum = points.reduce((s, p) => [s[0] + p[0], s[1] + p[1], s[2] + p[2]] as Vec3, [0, 0, 0]);
  return sum.map((v) => v / points.length) as Vec3;
}

/** The list of sites, hidden where there is only one. */
export function createSites(host: HTMLElement, fly: (points: Vec3[]) => void) {
  const list = el("ul", { class: "sites" });
  const section = el("section", { class: "sites-section", hidden: true }, el("h2", { textContent: "Sites" }), list);
  host.append(section);
  let of: Cone[] | null | undefined;
  /** Null: not all of them are known. */
  return (cones: Cone[] | null): void => {
    if (of === cones) return;
    of = cones;
    const sites = sitesOf(cones?.map((c) => c.xyz) ?? []);
    section.hidden = sites.length < 2;
    const [first] = sites;
    fill(list, ...(section.hidden || !first ? [] : sites.map((site, i) =>
      el("li", {}, el("button", { type: "button", onclick: () => fly(site.points) },
        el("span", { textContent: i === 0 ? "Site 1, the largest" : `Site ${i + 1}, ${bearing(middle(first), middle(site))}` }),
        el("b", { textContent: countOf(site.points.length) })))))); // prettier-ignore
  };
}
