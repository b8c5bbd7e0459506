// What changed, in view: each change, or where there are too many, their numbers. Few changes are read whole.
import { api, type ChangeCluster, type Query, type Vec3 } from "./api";
import { isGone, type Cone, type Kind } from "./kinds";
import { changedIn } from "./query";
import type { Stage } from "./scene";
import { cellZoom, seenBox, type Box } from "./tiles";

/** As many as the server lists one by one. */
const WHOLE = 2_000;

export interface Changes {
  cones: Map<string, Cone>;
  /** Whether confirmed ones are not among them. */
  withoutConfirmed: boolean;
  clusters: ChangeCluster[];
  /** Where they were read, as offsets from the map's origin; null: everywhere. */
  box: Box | null;
}

const NONE: Changes = { cones: new Map(), withoutConfirmed: false, clusters: [], box: null };

export function createChanges(stage: Stage) {
  let map = "";
  let origin: Vec3 = [0, 0, 0];
  let source: Query | null = null;
  let kinds = new Map<Kind, number>();
  let shown: Changes = NONE;
  let [opening, loading] = [0, 0];
  /** What was read: the box as text. */
  let read: string | null = null;

  const total = () => [...kinds.values()].reduce((sum, n) => sum + n, 0);

  return {
    /** Other changes, null: none; `load` reads those in view. */
    async open(ofMap: string, from: Vec3, of: Query | null): Promise<void> {
      const mine = ++opening;
      const found = of ? (await api.changeSummary(ofMap, of)).kinds : {};
      if (mine !== opening) return;
      [map, origin, source, read] = [ofMap, from, of, null];
      kinds = new Map(Object.entries(found) as [Kind, number][]);
    },
    /** Read what is in view. True if it is something else than before. */
    async load(): Promise<boolean> {
      const mine = ++loading;
      const box = total() > WHOLE ? seenBox(stage) : null;
      const key = String(box);
      if (key === read) return false;
      const corners = box && ([0, 1, 2, 1, 2, 3, 0, 3] as const).map((edge, i) => String(box[edge] + origin[i % 2 === 0 ? 0 : 1]));
      const answer = source && total() ? await api.changesInView(map, { ...source, area: corners, cell_zoom: String(cellZoom(box)) }) : null;
      if (mine !== loading) return false;
      read = key;
      shown = answer ? { cones: new Map(changedIn(answer).map((c) => [c.id, c])), withoutConfirmed: "confirmed" in answer.kinds && !answer.listed.includes("confirmed"), clusters: answer.clusters, box } : NONE;
      return true;
    },
    shown: () => shown,
    /** Whether changes are shown at all. */
    isOpen: () => source !== null,
    /** Number of each kind, wherever they are. */
    kinds: (): ReadonlyMap<Kind, number> => kinds,
    /** Of what still stands. */
    standing: () => [...kinds].reduce((sum, [kind, n]) => sum + (isGone(kind) ? 0 : n), 0),
    close(): void {
      opening += 1;
      loading += 1;
      [source, kinds, shown, read] = [null, new Map(), NONE, null];
    },
  };
}
