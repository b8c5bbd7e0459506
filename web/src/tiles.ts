// What stands on the map in view: tiles with all features, or with clusters where there are many. A small map is one tile.
import { api, type Cluster, type Instant, type Summary, type TileAnswer, type Vec3 } from "./api";
import { footprint } from "./basemap";
import type { Cone } from "./kinds";
import { standingIn } from "./query";
import type { Stage } from "./scene";

export type Box = [number, number, number, number];

interface Tile {
  zoom: number;
  x: number;
  y: number;
  /** Offsets from the map's origin. */
  box: Box;
  answer: Promise<void>;
  cones: Cone[];
  clusters: Cluster[];
}

/** What is drawn: these features, and clusters of those that are not among them. */
export interface Standing {
  cones: Cone[];
  clusters: Cluster[];
}

/** Zoom 0 is a square of this side; the next one half of it. */
const SIDE_M = 2 ** 20;
const MOST_ZOOM = 20;
/** Maps with fewer features are read whole; as many as a tile holds. */
const WHOLE = 2_000;
const CELLS = 16;
/** A tile whose clusters are farther apart is replaced by its quarters. */
const CLUSTER_PX = 96;
/** Tiles at the zoom of the whole view, per side. */
const PER_SIDE = 2;
const MOST_TILES = 300;

/** Easting, northing of places around what is seen, in the map's CRS; empty: nothing. */
export function seenArea(stage: Stage, origin: Vec3): string[] {
  const places = footprint(stage);
  return places.length < 3 ? [] : places.flatMap(([x, y]) => [(x + origin[0]).toFixed(2), (y + origin[1]).toFixed(2)]);
}

/** A box around what is seen and half as much beside it, the same after small movements; offsets from the map's origin. */
export function seenBox(stage: Stage): Box {
  const places = footprint(stage);
  const [xs, ys] = [places.map((p) => p[0]), places.map((p) => p[1])];
  const [w, s, e, n] = places.length ? [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)] : [0, 0, 0, 0];
  const step = 2 ** Math.ceil(Math.log2(Math.max(e - w, n - s, 1))) / 4;
  return [Math.floor(w / step - 1) * step, Math.floor(s / step - 1) * step, Math.ceil(e / step + 1) * step, Math.ceil(n / step + 1) * step];
}

/** Zoom of cells of which about CELLS are beside each other in a box. */
export function cellZoom(box: Box | null): number {
  return Math.min(Math.max(Math.round(Math.log2((CELLS * SIDE_M) / (box ? box[2] - box[0] : SIDE_M))), 0), 30);
}

export function createTiles(stage: Stage) {
  let [map, at]: [string, Instant] = ["", { valid: null, known: null }];
  let found: Summary | null = null;
  let tiles = new Map<string, Tile>();
  let opening = 0;
  let loading = 0;
  let shown: Standing = { cones: [], clusters: [] };

  const total = () => Object.values(found?.categories ?? {}).reduce((sum, n) => sum + n, 0);
  const overlaps = (a: Box, b: Box) => a[0] <= b[2] && a[2] >= b[0] && a[1] <= b[3] && a[3] >= b[1];

  function tileAt(zoom: number, x: number, y: number, origin: Vec3): Tile {
    const key = `${zoom}/${x}/${y}`;
    const known = tiles.get(key);
    if (known) return known;
    const side = SIDE_M / 2 ** zoom;
    const [west, south] = [x * side - origin[0], y * side - origin[1]];
    const tile: Tile = { zoom, x, y, box: [west, south, west + side, south + side], cones: [], clusters: [], answer: Promise.resolve() };
    const fill = (answer: TileAnswer) => void ([tile.cones, tile.clusters] = [standingIn(answer), answer.clusters]);
    tile.answer = api.tile(map, key, at).then(fill);
    tiles.set(key, tile);
    return tile;
  }

  /** The tiles of one zoom over a box, at most PER_SIDE + 1 along each side. */
  function over(box: Box, origin: Vec3, zoom = Math.floor(Math.log2((PER_SIDE * SIDE_M) / Math.max(box[2] - box[0], box[3] - box[1], 1)))): Tile[] {
    const z = Math.min(Math.max(zoom, 0), MOST_ZOOM);
    const index = (edge: number, axis: 0 | 1) => Math.floor(((edge + origin[axis]) * 2 ** z) / SIDE_M);
    const list: Tile[] = [];
    for (let x = index(box[0], 0); x <= index(box[2], 0); x++) for (let y = index(box[1], 1); y <= index(box[3], 1); y++) list.push(tileAt(z, x, y, origin));
    return list;
  }

  /** What is seen of the map; null: nothing. */
  function seenOf({ box_m: box }: Summary): Box | null {
    const places = footprint(stage);
    if (!box || places.length < 3) return null;
    const [xs, ys] = [places.map((p) => p[0]), places.map((p) => p[1])];
    const seen: Box = [Math.max(Math.min(...xs), box[0]), Math.max(Math.min(...ys), box[1]), Math.min(Math.max(...xs), box[2]), Math.min(Math.max(...ys), box[3])];
    return seen[0] <= seen[2] && seen[1] <= seen[3] ? seen : null;
  }

  function isCoarse({ zoom, box }: Tile): boolean {
    if (zoom >= MOST_ZOOM) return false;
    const { x, y, z } = stage.camera.position;
    const away = Math.hypot(Math.max(box[0] - x, x - box[2], 0), Math.max(box[1] - y, y - box[3], 0), z - stage.ground);
    return ((box[2] - box[0]) / CELLS) * stage.pixelsAtDepth(away) > CLUSTER_PX;
  }

  /** This tile, or its quarters where its clusters are too far apart. */
  async function refine(tile: Tile, seen: Box, origin: Vec3): Promise<Tile[]> {
    await tile.answer;
    if (!tile.clusters.length || !isCoarse(tile)) return [tile];
    const quarters = [0, 1].flatMap((i) => [0, 1].map((j) => [2 * tile.x + i, 2 * tile.y + j] as const));
    const side = (tile.box[2] - tile.box[0]) / 2;
    const inside = quarters.filter(([x, y]) => {
      const [west, south] = [x * side - origin[0], y * side - origin[1]];
      return overlaps([west, south, west + side, south + side], seen);
    });
    return (await Promise.all(inside.map(([x, y]) => refine(tileAt(tile.zoom + 1, x, y, origin), seen, origin)))).flat();
  }

  return {
    /** Another state; `load` reads what is in view. */
    async open(ofMap: string, instant: Instant): Promise<Summary> {
      const mine = ++opening;
      const next = await api.summary(ofMap, instant);
      if (mine === opening) [map, at, found, tiles] = [ofMap, instant, next, new Map()];
      return next;
    },
    /** Read what is in view. True if it is something else than before. */
    async load(): Promise<boolean> {
      const mine = ++loading;
      const of = found;
      const whole = total() <= WHOLE;
      const seen = of && (whole ? of.box_m : seenOf(of));
      const origin = of?.origin_m ?? [0, 0, 0];
      const parts = of && seen ? await Promise.all(over(seen, origin, whole ? 0 : undefined).map((tile) => refine(tile, seen, origin))) : [];
      if (mine !== loading) return false;
      const next = parts.flat();
      const [before, cones, clusters] = [shown, next.flatMap((t) => t.cones), next.flatMap((t) => t.clusters)];
      shown = { cones, clusters };
      for (const key of [...tiles.keys()].slice(0, Math.max(tiles.size - MOST_TILES, 0))) tiles.delete(key);
      return before.cones.length !== cones.length || before.clusters.length !== clusters.length || cones.some((c, i) => c !== before.cones[i]) || clusters.some((c, i) => c !== before.clusters[i]);
    },
    /** A few clusters or features that show where the whole map is. */
    async overview(): Promise<Vec3[]> {
      const box = found?.box_m;
      if (!found || !box) return [];
      const list = over(box, found.origin_m);
      await Promise.all(list.map((t) => t.answer));
      return list.flatMap((t) => [...t.cones.map((c) => c.xyz), ...t.clusters.map((c) => c.xyz_m)]);
    },
    shown: () => shown,
    /** Whether all features of the map are among those that are shown. */
    isWhole: () => total() <= WHOLE,
    summary: () => found,
    /** Number of features of the map. */
    count: total,
    close(): void {
      opening += 1;
      loading += 1;
      [found, tiles, shown] = [null, new Map(), { cones: [], clusters: [] }];
    },
  };
}
export type Tiles = ReturnType<typeof createTiles>;
