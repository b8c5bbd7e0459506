// From the state of the page to the cones and drives that show it.
import type { Change, ChangesInView, Feature, HistoryItem, Instant, Marking, Query, TileAnswer, TimelineItem } from "./api";
import type { Changes } from "./changes";
import { knownText, utc } from "./dom";
import { isGone, type Cone, type Kind } from "./kinds";
import type { State } from "./state";

/** The changeset of this number; the newest one for null or a number that the map does not have. */
export function changesetOf(items: TimelineItem[], no: number | null): TimelineItem | undefined {
  return no === null ? items.at(-1) : items.find((t) => t.changeset_no === no) ?? items.at(-1);
}

export const standing = (f: Feature & { marking?: Marking }): Cone => ({
  id: f.feature_id, category: f.category, kind: "standing", xyz: f.xyz_m, old: null, shift_m: null, height_m: f.object_height_m ?? 0,
  probability: f.existence_probability, observations: f.observation_count, sigma_m: f.marking?.sigma_lateral_m ?? f.sigma_m, seenAt: Date.parse(f.last_seen_at),
  changeset: f.changeset_no, marking: f.marking ?? null, oldLine: null,
});

export const changed = (c: Change & { marking?: Marking; old_marking?: Marking | null }): Cone => {
  const moved = c.kind === "moved";
  return { ...standing(c), kind: c.kind, old: moved ? c.old_xyz_m : null, shift_m: c.shift_m, oldLine: (moved && c.old_marking?.line_m) || null };
};

/** Point objects and lane markings. */
export const standingIn = ({ features, markings }: TileAnswer): Cone[] => [...features, ...markings].map(standing);
export const changedIn = ({ changes, markings }: ChangesInView): Cone[] => [...changes, ...markings].map(changed);

/** The first changeset number of the address that the map does not have; null if it has them all. */
export function unknownChangeset(state: State, items: TimelineItem[]): number | null {
  const { mode, changeset, from, to, known } = state;
  const named = mode === "drive" ? [changeset] : mode === "compare" ? [from || null, to, known] : [known];
  return named.find((no) => no !== null && !items.some((t) => t.changeset_no === no)) ?? null;
}

/** What a state shows: its times, the earlier time of a comparison, and words for it. */
export function shownInstant(state: State, items: TimelineItem[]): { at: Instant; since: string | null; title: string } {
  const known = knownAt(state, items);
  if (state.mode === "instant") return { at: { valid: state.valid, known }, since: null, title: `${state.valid === null ? "latest state" : `at ${utc(state.valid)} UTC`}, ${knownText(known)}` };
  if (state.mode === "compare") {
    const [from, at] = comparedInstants(state, items);
    const after = (no: number | null) => (no === 0 ? "before the first drive" : `after ${changesetOf(items, no)?.drive_id ?? ""}`);
    return { at, since: from.valid, title: `${after(state.to)}, compared with ${after(state.from)}, ${knownText(known)}` };
  }
  // Before and after are two states of the database for the same instant on the road, the end of the drive: the changes of a
  // drive are shown even if it was committed after later ones.
  const item = changesetOf(items, state.changeset);
  const before = state.side === "before";
  const at = { valid: item?.valid_at ?? null, known: (before ? item?.known_before : item?.effective_at) ?? null };
  return { at, since: null, title: `${before ? "before" : "after"} ${item ? `${item.drive_id} of ${utc(item.captured_from, false)} UTC` : ""}, as known then` };
}

/** The changes of a state, as parameters of a request; null where it shows none. */
export function changesOfState(state: State, items: TimelineItem[]): Query | null {
  const item = state.mode === "drive" ? changesetOf(items, state.changeset) : undefined;
  if (state.mode === "instant" || (state.mode === "drive" && !item)) return null;
  if (item) return { changeset_no: String(item.changeset_no) };
  const [from, to] = comparedInstants(state, items);
  return { from_valid_at: from.valid, from_known_at: from.known, to_valid_at: to.valid, to_known_at: to.known };
}

/** The cones to draw: what changed, and the rest of what stood there. */
export function withChanges(there: Cone[], changes: Changes, state: State, items: TimelineItem[]): Cone[] {
  const { cones } = changes;
  const kindOf = restKinds(changes, state, items);
  const rest = there.filter((c) => !cones.has(c.id)).map((c): Cone => ({ ...c, kind: kindOf(c) }));
  const isAfter = state.mode === "drive" && state.side === "after";
  const after = () => [...cones.values()].filter((c) => !isGone(c.kind)).map((c): Cone => ({ ...c, old: null, oldLine: null, shift_m: null }));
  return [...(isAfter ? after() : cones.values()), ...rest];
}

/** The kind of a cone that is not among the changes that were listed: what the drives in question left as it was is unchanged; the
 * rest was confirmed, if other changes would be listed there, else it is unknown. */
function restKinds({ withoutConfirmed, clusters, box }: Changes, state: State, items: TimelineItem[]): (cone: Cone) => Kind {
  if (!box && !clusters.length && !withoutConfirmed) return () => "unchanged";
  const from = state.mode === "drive" ? "" : comparedInstants(state, items)[0].valid ?? "";
  const ours = state.mode === "drive" ? [changesetOf(items, state.changeset)] : items.filter((t) => Date.parse(t.captured_from) > Date.parse(from));
  const changesets = new Set(ours.map((t) => t?.changeset_no));
  const isInside = ([x, y]: Cone["xyz"]) => !box || (x >= box[0] && y >= box[1] && x <= box[2] && y <= box[3]);
  const inside: Kind = clusters.length ? "standing" : withoutConfirmed ? "confirmed" : "unchanged";
  return ({ changeset, xyz }) => (!changesets.has(changeset) ? "unchanged" : isInside(xyz) ? inside : "standing");
}

/** Whether a change had happened in the state that is shown; `known` is the instant of the database, null now. */
export function shownState(state: State, items: TimelineItem[]): { reached: (h: HistoryItem) => boolean; known: string | null } {
  const known = state.mode === "drive" ? null : knownAt(state, items);
  if (state.mode === "drive") {
    const from = changesetOf(items, state.changeset)?.captured_from;
    const [at, before] = [from === undefined ? Infinity : Date.parse(from), state.side === "before"];
    return { reached: (h) => (before ? Date.parse(h.captured_from) < at : Date.parse(h.captured_from) <= at), known };
  }
  const valid = state.mode === "instant" ? state.valid : instantAfter(items, state.to, known).valid;
  const at = valid === null ? Infinity : Date.parse(valid);
  return { reached: (h) => Date.parse(h.changed_at) <= at, known };
}

/** The state of the database that is shown. */
function knownAt(state: State, items: TimelineItem[]): string | null {
  return state.known === null ? null : changesetOf(items, state.known)?.committed_at ?? null;
}

/** The two states of "Compare two". */
export function comparedInstants(state: State, items: TimelineItem[]): [Instant, Instant] {
  const known = knownAt(state, items);
  return [instantAfter(items, state.from, known), instantAfter(items, state.to, known)];
}

function instantAfter(items: TimelineItem[], no: number | null, known: string | null): Instant {
  const first = items[0];
  if (no === 0 && first) return { valid: new Date(Date.parse(first.captured_from) - 1000).toISOString(), known };
  return { valid: changesetOf(items, no)?.valid_at ?? null, known };
}

/** The drives whose paths are drawn. */
export function drivesShown(state: State, items: TimelineItem[]): TimelineItem[] {
  if (!state.trajectory) return [];
  const pick = (...list: (TimelineItem | undefined)[]) => list.filter((t): t is TimelineItem => t !== undefined);
  if (state.mode === "drive") return pick(changesetOf(items, state.changeset));
  if (state.mode === "compare") return pick(state.from === 0 ? undefined : changesetOf(items, state.from), changesetOf(items, state.to));
  const until = state.valid === null ? Infinity : Date.parse(state.valid);
  return items.filter((t) => Date.parse(t.captured_from) <= until).slice(-10);
}
