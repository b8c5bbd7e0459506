// Requests and answers for judging changes.
import { ask, askMap, mapPath, query } from "./api";
import type { components } from "./schema";

type Schemas = components["schemas"];
export type Side = "left" | "right";
export type PassFrame = Schemas["PassFrame"];
export type FrameState = PassFrame["state"];
export type DrivePass = Schemas["DrivePass"];
export type FrameBox = Schemas["FrameBox"];
export type FrameView = Schemas["FrameView"];
export type Frame = Schemas["Frame"];
export type ReviewItem = Schemas["ReviewItem"];
export type ReviewKind = ReviewItem["kind"];

export const judging = {
  passes: (map: string, id: string, version: number | null) =>
    askMap<Schemas["Passes"]>(map, `features/${id}/passes${query({ version: version === null ? null : String(version) })}`),
  frame: (map: string, drive: string, index: number) => askMap<Frame>(map, `drives/${drive}/frames/${index}`),
  image: async (map: string, drive: string, index: number, side: Side, feature: string | null): Promise<Blob> =>
    (await ask(mapPath(map, `drives/${drive}/frames/${index}/${side}.jpg${query({ feature_id: feature })}`))).blob(),
  review: (map: string, offset: number, limit: number) =>
    askMap<Schemas["Review"]>(map, `review${query({ offset: String(offset), limit: String(limit) })}`),
};

/** The frame pair of a drive that shows a position best: the nearest one in which it was observed, else visible and empty. */
export function bestFrame(pass: DrivePass): PassFrame | undefined {
  const rank: FrameState[] = ["observed", "empty", "occupied", "hidden"];
  return [...pass.frames].sort((a, b) => rank.indexOf(a.state) - rank.indexOf(b.state) || a.range_m - b.range_m)[0];
}
