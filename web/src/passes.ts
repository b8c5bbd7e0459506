// Which frame pair and which image show a position best, of a drive that passed it and of the one beside it.
import type { DrivePass, Frame, HistoryItem, PassFrame, Side } from "./api";
import { project } from "./projection";
import type { Start, Subject } from "./viewer";

/** The frame pair of a drive that shows a position best: the nearest one in which it was observed, else visible and empty. */
export function bestFrame(pass: DrivePass): PassFrame | undefined {
  const rank: PassFrame["state"][] = ["observed", "empty", "occupied", "hidden"];
  return [...pass.frames].sort((a, b) => rank.indexOf(a.state) - rank.indexOf(b.state) || a.range_m - b.range_m)[0];
}

/** The drive before comes first. */
export function othersOf(passes: DrivePass[], own: DrivePass): DrivePass[] {
  const at = passes.indexOf(own);
  return [...passes.slice(at + 1), ...passes.slice(0, at).reverse()];
}

/** Where to begin; undefined if there is nothing to show. */
export function firstOf(subject: Subject, passes: DrivePass[], start: Start | null): { drive_uuid: string; frame_index: number | null } | undefined {
  const wanted = start?.drive_uuid ?? subject.now?.drive_uuid;
  const own = passes.find((p) => p.drive_uuid === wanted) ?? passes[0];
  if (!own) return start ?? undefined;
  return { drive_uuid: own.drive_uuid, frame_index: own.drive_uuid === start?.drive_uuid ? start.frame_index : null };
}

export const apart = (p: readonly number[], q: readonly number[]) => Math.hypot((p[0] ?? 0) - (q[0] ?? 0), (p[1] ?? 0) - (q[1] ?? 0));

/** The frame pair of another drive from the nearest position. */
export const counterpart = (own: PassFrame, other: DrivePass): PassFrame =>
  other.frames.reduce((a, b) => (apart(b.camera_xyz_m, own.camera_xyz_m) < apart(a.camera_xyz_m, own.camera_xyz_m) ? b : a));

/** The left image, unless the right one alone shows the position. */
export function bestSide(frame: Frame, now: HistoryItem | null): Side {
  const margin = (side: Side) => {
    const at = now && project(frame[side], now.xyz_m);
    return at ? Math.min(at[0], frame[side].width_px - at[0]) : -Infinity;
  };
  return margin("left") < 0 && margin("right") > 0 ? "right" : "left";
}
