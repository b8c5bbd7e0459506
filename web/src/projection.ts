// From the map into an image. Image points count from the image's edge: the centre of the first pixel is 0.5.
import type { FrameView, HistoryItem, Vec3 } from "./api";
import { classOf, CONE } from "./classes";
import { ellipse95 } from "./overlays";

export type Point = [number, number];

const NEAREST_M = 0.3;
/** Width of a cone's base plate and of its tip over its height, as in src/conetl/model/feature_classes.py. */
const [BASE_SHARE, TIP_SHARE] = [0.55, 0.08];
/** Depths (m) between which an epipolar line is drawn. */
const DEPTHS_M = [0.7, 400] as const;

function toCamera(view: FrameView, p: Vec3): Vec3 {
  const d = [p[0] - view.xyz_m[0], p[1] - view.xyz_m[1], p[2] - view.xyz_m[2]] as const;
  const R = view.map_R_camera;
  return [0, 1, 2].map((i) => R[0][i as 0] * d[0] + R[1][i as 0] * d[1] + R[2][i as 0] * d[2]) as Vec3;
}

/** Null behind the camera. */
export function project(view: FrameView, p: Vec3): Point | null {
  const [x, y, z] = toCamera(view, p);
  return z < NEAREST_M ? null : [view.cx_px + (view.fx_px * x) / z + 0.5, view.cy_px + (view.fy_px * y) / z + 0.5];
}

function all(points: (Point | null)[]): Point[] | null {
  return points.every((p): p is Point => p !== null) ? points : null;
}

/** Outline of an object, facing the camera: base plate, body and tip of a cone, of other classes a rectangle. */
export function outlineOf(view: FrameView, { category, xyz_m: foot, object_height_m }: HistoryItem): Point[] | null {
  const height_m = object_height_m ?? 0;
  const [dx, dy] = [foot[0] - view.xyz_m[0], foot[1] - view.xyz_m[1]];
  const range = Math.hypot(dx, dy) || 1;
  const aside = (share: number, up: number): Point | null => {
    const half = (share * height_m) / 2;
    return project(view, [foot[0] + (dy / range) * half, foot[1] - (dx / range) * half, foot[2] + up * height_m]);
  };
  const { width } = classOf(category);
  if (category !== CONE) return all([aside(-width, 0), aside(-width, 1), aside(width, 1), aside(width, 0)]);
  return all([aside(-BASE_SHARE, 0), aside(-BASE_SHARE, 0.05), aside(-0.62 * BASE_SHARE, 0.05), aside(-TIP_SHARE, 1), aside(TIP_SHARE, 1),
    aside(0.62 * BASE_SHARE, 0.05), aside(BASE_SHARE, 0.05), aside(BASE_SHARE, 0)]); // prettier-ignore
}

/** The ellipse on the ground that contains the foot with 95 %. */
export function ellipseOutline(view: FrameView, foot: Vec3, cov: [number, number, number, number, number, number]): Point[] | null {
  const { major_m, minor_m, angle_rad } = ellipse95(cov);
  const [c, s] = [Math.cos(angle_rad), Math.sin(angle_rad)];
  return all(Array.from({ length: 48 }, (_, i) => {
    const [a, b] = [major_m * Math.cos((i * Math.PI) / 24), minor_m * Math.sin((i * Math.PI) / 24)];
    return project(view, [foot[0] + a * c - b * s, foot[1] + a * s + b * c, foot[2]]);
  })); // prettier-ignore
}

/** Where in `to` the object may be that is seen at `point` of `from`. */
export function epipolarLine(from: FrameView, point: Point, to: FrameView): [Point, Point] | null {
  const x = (point[0] - 0.5 - from.cx_px) / from.fx_px;
  const y = (point[1] - 0.5 - from.cy_px) / from.fy_px;
  const at = (depth: number): Point | null =>
    project(to, from.map_R_camera.map((row, i) => (from.xyz_m[i] ?? 0) + depth * (row[0] * x + row[1] * y + row[2])) as Vec3);
  const [a, b] = [at(DEPTHS_M[0]), at(DEPTHS_M[1])];
  return a && b ? [a, b] : null;
}
