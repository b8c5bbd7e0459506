"""An independent range to every matched cone from the drive's own LiDAR, and stereo ranges minus LiDAR ranges.

The points are selected by box and outline in the left image, never by stereo depth: those inside the silhouette and above the
foot. If their nearest cluster does not hold most of them, the cone is occluded and has no range. A beam ends on the surface;
the radius of the outline at that height is the distance from there to the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.evaluation.lidar_scene import SceneBias
from conetl.geometry.rig import infinity_shift_px
from conetl.model.records import Camera, Rig, StereoMatch
from conetl.tracking.matching.cone_outline import Outline

Floats = NDArray[np.float64]

#: Range bands of the summary (m).
BANDS_M = ((0.0, 8.0), (8.0, 12.0), (12.0, 16.0), (16.0, 25.0))
#: Range of the points of one cone: thickness of its body, with noise.
_CLUSTER_DEPTH_M = 0.35
_MIN_POINTS = 4
_MIN_CLUSTER_SHARE = 0.7
#: Rows of the body between tip (0) and foot (1): the tip is thin, and near the foot the beam meets plate and ground.
_ROWS = (0.05, 0.88)
#: Range error of one return (HDL-64E data sheet: below 2 cm, one sigma), and the common error of all returns of one cone:
#: calibration between scanner and camera, and the radius.
_SIGMA_RETURN_M = 0.02
_SIGMA_COMMON_M = 0.02


class LidarRange(NamedTuple):
    """LiDAR range to one cone."""

    ground_range_m: float
    """Level distance from the left camera to the cone's axis."""
    sigma_m: float
    point_count: int


class LidarResidual(NamedTuple):
    """Stereo minus LiDAR range of one match."""

    frame_index: int
    match_index: int
    lidar_range_m: float
    lidar_sigma_m: float
    stereo_range_m: float
    stereo_sigma_m: float
    residual_m: float
    """Positive where the stereo range is too long."""


class ResidualBand(NamedTuple):
    """Residuals of the matches in one band of LiDAR range."""

    from_m: float
    to_m: float
    pairs: int
    median_m: float | None
    """None without residuals."""
    median_abs_m: float | None
    robust_std_m: float | None
    """1.4826 times the median distance from the median."""
    ratio_std: float | None
    """The same for the residual over its stated sigma (stereo and LiDAR): 1 for correct sigmas."""


def lidar_range(points_left_m: Floats, outline: Outline, camera: Camera, up: Floats) -> LidarRange | None:
    """Ground range to the axis of the cone with this outline, or None where LiDAR has no clear range.

    points_left_m: (N, 3) in the left camera's frame (x right, y down, z forward). up: unit vector (3,) in that frame.
    """
    ahead = points_left_m[points_left_m[:, 2] > 0.5]
    u = camera.cx_px + camera.fx_px * ahead[:, 0] / ahead[:, 2]
    v = camera.cy_px + camera.fy_px * ahead[:, 1] / ahead[:, 2]
    share = outline.share(v)
    aside = np.abs(u - outline.axis(v))
    inside = (share > _ROWS[0]) & (share < _ROWS[1]) & (aside < outline.radius(v))
    points, rows = ahead[inside], v[inside]
    if len(points) < _MIN_POINTS:
        return None
    level = points - (points @ up)[:, None] * up
    reach = np.linalg.norm(level, axis=1)
    first = np.quantile(reach, 0.05)
    # The median ignores stray points in front of the cluster.
    starts = reach[reach <= first + _CLUSTER_DEPTH_M]
    near = (reach >= np.median(starts) - _CLUSTER_DEPTH_M) & (reach <= np.median(starts) + _CLUSTER_DEPTH_M)
    if near.sum() < _MIN_POINTS or near.mean() < _MIN_CLUSTER_SHARE:
        return None
    foot = np.array([outline.axis(np.array([outline.foot_row]))[0], outline.foot_row])
    ray = np.array([(foot[0] - camera.cx_px) / camera.fx_px, (foot[1] - camera.cy_px) / camera.fy_px, 1.0])
    bearing = ray - (ray @ up) * up
    bearing /= np.linalg.norm(bearing)
    across = np.cross(up, bearing)
    along, sideways = level[near] @ bearing, level[near] @ across
    radius = outline.radius(rows[near]) * points[near, 2] / camera.fx_px
    axis = along + np.sqrt(np.maximum(radius**2 - sideways**2, 0.0))
    middle = float(np.median(axis))
    scatter = 1.4826 * float(np.median(np.abs(axis - middle)))
    if scatter > 0.15:  # not one surface of revolution
        return None
    count = int(near.sum())
    sigma = np.hypot(max(scatter, _SIGMA_RETURN_M) * 1.25 / count**0.5, _SIGMA_COMMON_M)
    return LidarRange(middle, float(sigma), count)


def residual(
    match: StereoMatch, foot_left_m: Floats, foot_cov_m2: Floats, lidar: LidarRange, up: Floats
) -> LidarResidual:
    """Stereo minus LiDAR range. foot_left_m (3,), foot_cov_m2 (3, 3): the foot by intersection, in the left camera's frame."""
    level = foot_left_m - (foot_left_m @ up) * up
    reach = float(np.linalg.norm(level))
    along = level / reach
    return LidarResidual(
        frame_index=match.frame_index, match_index=match.match_index,
        lidar_range_m=lidar.ground_range_m, lidar_sigma_m=lidar.sigma_m,
        stereo_range_m=reach, stereo_sigma_m=float(np.sqrt(along @ foot_cov_m2 @ along)),
        residual_m=reach - lidar.ground_range_m,
    )  # fmt: skip


def without_scene_bias(found: LidarResidual, match: StereoMatch, rig: Rig, bias: SceneBias) -> LidarResidual:
    """The residual after correction by the scene's calibration errors, which leaves the error of the match."""
    foot = np.array(match.foot_left_uv_px)
    xy = (foot - [rig.left.cx_px, rig.left.cy_px]) / [rig.left.fx_px, rig.left.fy_px]
    disparity = match.foot_left_uv_px[0] - match.foot_right_uv_px[0] - float(infinity_shift_px(rig, foot)[0])
    stretch = disparity / (disparity - float(bias.disparity_error_px(xy)))
    # The offset is along the optical axis, the range is level and at an angle to it.
    offset = bias.range_offset_m / float(np.hypot(1.0, xy[0]))
    return found._replace(
        lidar_range_m=found.lidar_range_m + offset, stereo_range_m=found.stereo_range_m * stretch,
        residual_m=found.stereo_range_m * stretch - found.lidar_range_m - offset,
    )  # fmt: skip


def summarise(
    residuals: Sequence[LidarResidual], bands_m: Sequence[tuple[float, float]] = BANDS_M
) -> list[ResidualBand]:
    """Robust figures of the residuals by LiDAR range."""
    ranges = np.array([r.lidar_range_m for r in residuals])
    values = np.array([r.residual_m for r in residuals])
    ratios = np.array([r.residual_m / np.hypot(r.stereo_sigma_m, r.lidar_sigma_m) for r in residuals])
    table = []
    for low, high in bands_m:
        here = (ranges >= low) & (ranges < high)
        figures: tuple[float | None, ...] = (None, None, None, None)
        if here.any():
            median, median_abs = np.median(values[here]), np.median(np.abs(values[here]))
            figures = float(median), float(median_abs), _robust_std(values[here]), _robust_std(ratios[here])
        table.append(ResidualBand(low, high, int(here.sum()), *figures))
    return table


def _robust_std(values: Floats) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
