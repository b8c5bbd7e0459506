// Requests and answers for judging changes (src/conetl/web/frames.py, decisions.py).
import { ask, askMap, mapPath, query, type ChangeKind, type Vec3 } from "./api";

export type Side = "left" | "right";
export type FrameState = "observed" | "empty" | "occupied" | "hidden";

export interface PassFrame {
  frame_index: number;
  captured_at: string;
  range_m: number;
  state: FrameState;
  camera_xyz_m: Vec3;
}

/** One drive past a cone, with the frame pairs that contain its position. */
export interface DrivePass {
  changeset_no: number;
  drive_id: string;
  drive_uuid: string;
  captured_from: string;
  counts: boolean;
  kind: ChangeKind | null;
  frames: PassFrame[];
}

export interface FrameBox {
  x_px: number;
  y_px: number;
  w_px: number;
  h_px: number;
  score: number;
  match_index: number | null;
  range_m: number | null;
}

/** One image and its camera, without a lens. */
export interface FrameView {
  width_px: number;
  height_px: number;
  fx_px: number;
  fy_px: number;
  cx_px: number;
  cy_px: number;
  xyz_m: Vec3;
  map_R_camera: [Vec3, Vec3, Vec3];
  boxes: FrameBox[];
  /** Why there is no image. */
  problem: string | null;
}

export interface Frame {
  drive_id: string;
  drive_uuid: string;
  frame_index: number;
  captured_at: string;
  /** Images are pixelated away from detections. */
  pixelated: boolean;
  left: FrameView;
  right: FrameView;
}

export type ReviewKind = "held" | "removal" | "move" | "doubtful";

export interface ReviewItem {
  kind: ReviewKind;
  changeset_no: number;
  changeset_id: string | null;
  drive_id: string;
  at: string;
  why: string;
  checks: { name: string; figures: string; detail: string }[];
  feature_id: string | null;
  version: number | null;
  xyz_m: Vec3 | null;
  existence_probability: number | null;
}

export const judging = {
  passes: (map: string, id: string, version: number) =>
    askMap<{ passes: DrivePass[] }>(map, `features/${id}/passes${query({ version: String(version) })}`),
  frame: (map: string, drive: string, index: number) => askMap<Frame>(map, `drives/${drive}/frames/${index}`),
  image: async (map: string, drive: string, index: number, side: Side, feature: string | null): Promise<Blob> =>
    (await ask(mapPath(map, `drives/${drive}/frames/${index}/${side}.jpg${query({ feature_id: feature })}`))).blob(),
  review: (map: string, offset: number, limit: number) =>
    askMap<{ counts: Record<ReviewKind, number>; items: ReviewItem[] }>(map, `review${query({ offset: String(offset), limit: String(limit) })}`),
};

/** The frame pair of a drive that shows a position best: the nearest one in which it was observed, else visible and empty. */
export function bestFrame(pass: DrivePass): PassFrame | undefined {
  const rank: FrameState[] = ["observed", "empty", "occupied", "hidden"];
  return [...pass.frames].sort((a, b) => rank.indexOf(a.state) - rank.indexOf(b.state) || a.range_m - b.range_m)[0];
}
