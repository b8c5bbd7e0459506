"""Stereo against the drive's own LiDAR: an independent range to every matched cone, and calibration errors from the scene.

The points of a cone are selected by box and outline in the left image, never by stereo depth: those inside the silhouette and
above the foot. If their nearest cluster does not hold most of them, the cone is occluded and has no range. A beam ends on the
surface; the radius of the outline at that height is the distance from there to the axis.

Stereo and LiDAR ranges of a cone differ for three reasons: the match of the cone, the rig's calibration, or the position and
time of the scanner relative to the camera. The scene without its cones reveals the last two: windows around projected LiDAR
points are matched, and a smooth field of disparity errors over the image (calibration) and one range offset (scanner) are
fitted to the differences. Cones are not used in the fit and are evaluated after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.geometry.calibration.covariance import calibration_cov
from conetl.geometry.camera import project, rays
from conetl.geometry.rig import infinity_shift_px
from conetl.geometry.small_arrays import robust_std
from conetl.model.arrays import Bools, Floats
from conetl.model.drive import Detection, StereoMatch
from conetl.model.rig import Camera, Rig
from conetl.tracking.matching.cone_outline import Outline

_HALF_PX = 5
_REACH_PX = 4
_MIN_SCORE = 0.85
_MIN_CONTRAST = 6.0
_MAX_POINTS = 600
#: Terms over x/z and y/z of the disparity errors by relative orientation, focal lengths and radial distortion; mostly across the
#: image, which is much wider than high.
_POWERS = ((0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (0, 1), (1, 1), (2, 1))
_MIN_SAMPLES = 500
Image = NDArray[np.float32]
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


class SceneBias(NamedTuple):
    """Calibration errors by the scene; see `fit_scene_bias`."""

    coefficients_px: Floats
    """(8,) of the disparity field (px), for the powers of x/z and y/z in `_POWERS`"""
    range_offset_m: float
    """Distance along the optical axis minus that by LiDAR and its calibration."""
    sample_count: int
    scatter_px: float
    """Robust standard deviation of one sample about the fit."""

    def disparity_error_px(self, xy: Floats) -> Floats:
        """(...) measured minus true disparity of a ray x/z, y/z (..., 2) of the left camera."""
        return np.asarray(_design(xy) @ self.coefficients_px)


def scene_samples(
    points_left_m: Floats,
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    rig: Rig,
    detections: Sequence[Detection],
    *,
    seed: int = 0,
) -> Floats:
    """(n, 4): x/z, y/z, LiDAR's disparity from infinity (px), stereo's disparity minus that, for windows that match well.

    points_left_m: (N, 3) LiDAR points in the left camera's frame. left, right: rectified images (H, W, 3), uint8. At most 600
    points are used, none within the boxes of `detections` (left image).
    """
    camera, focal_base = rig.left, rig.left.fx_px * rig.baseline_m
    points = points_left_m[points_left_m[:, 2] > 3.0]
    uv, xy, disparity = project(camera, points), points[:, :2] / points[:, 2:], focal_base / points[:, 2]
    u, v = uv.T
    shift = disparity + infinity_shift_px(rig, uv)[:, 0]
    edge = _HALF_PX + _REACH_PX + 2
    height, width = left.shape[:2]
    good = (u > edge) & (u < width - edge) & (v > edge) & (v < height - edge)
    good &= (u - shift > edge) & (u - shift < width - edge)
    for box in detections:
        in_x = (u > box.x_px - _HALF_PX) & (u < box.x_px + box.w_px + _HALF_PX)
        good &= ~(in_x & (v > box.y_px - _HALF_PX) & (v < box.y_px + box.h_px + _HALF_PX))
    chosen = np.flatnonzero(good)
    if len(chosen) > _MAX_POINTS:
        chosen = np.random.default_rng(seed).choice(chosen, _MAX_POINTS, replace=False)
    if not len(chosen):
        return np.zeros((0, 4))
    measured, fits = _match_windows(_grey(left), _grey(right), u[chosen], v[chosen], shift[chosen], rig)
    kept = chosen[fits]
    return np.column_stack([xy[kept], disparity[kept], measured[fits] - shift[kept]])


def fit_scene_bias(samples: Floats, rig: Rig) -> SceneBias | None:
    """Field and range offset by iteratively reweighted least squares; None with too few samples.

    samples: (n, 4) rows of `scene_samples`, of many frame pairs.
    """
    if len(samples) < _MIN_SAMPLES:
        return None
    focal_base = rig.left.fx_px * rig.baseline_m
    # d = f b / (z + offset): a range offset changes the disparity by -d^2 / (f b) per metre.
    design = np.column_stack([_design(samples[:, :2]), -(samples[:, 2] ** 2) / focal_base])
    weights: Floats = np.ones(len(samples))
    scatter = 1.0
    solution: Floats = np.zeros(design.shape[1])
    for _ in range(20):
        solution = np.asarray(
            np.linalg.lstsq(design * weights[:, None], samples[:, 3] * weights, rcond=None)[0], np.float64
        )
        residual = samples[:, 3] - design @ solution
        scatter = max(1.4826 * float(np.median(np.abs(residual))), 1e-3)
        # Square root of Cauchy-like weights: some windows are wrong.
        weights = 1.0 / (1.0 + (residual / (1.5 * scatter)) ** 2)
    return SceneBias(solution[:-1], float(solution[-1]), len(samples), scatter)


def _design(xy: Floats) -> Floats:
    return np.stack([xy[..., 0] ** i * xy[..., 1] ** j for i, j in _POWERS], axis=-1)


def _grey(image: NDArray[np.uint8]) -> Image:
    return np.asarray(image.mean(axis=2), dtype=np.float32)


def _match_windows(left: Image, right: Image, u: Floats, v: Floats, shift: Floats, rig: Rig) -> tuple[Floats, Bools]:
    """Disparities (n,) of square windows around (u, v), and a mask of the reliable ones."""
    column, row = np.round(u).astype(np.intp), np.round(v).astype(np.intp)
    down = round(rig.right.cy_px - rig.left.cy_px)
    span = np.arange(-_HALF_PX, _HALF_PX + 1)
    start = np.round(shift).astype(np.intp)
    templates = left[(row[:, None] + span)[:, :, None], (column[:, None] + span)[:, None, :]]
    wide = np.arange(-_HALF_PX - _REACH_PX, _HALF_PX + _REACH_PX + 1)
    strips = right[(row[:, None] + span + down)[:, :, None], ((column - start)[:, None] + wide)[:, None, :]]
    matched = [cv2.matchTemplate(*pair, cv2.TM_CCOEFF_NORMED)[0] for pair in zip(strips, templates, strict=True)]
    scores, contrast = np.array(matched, dtype=np.float64), templates.std(axis=(1, 2))
    best = np.clip(np.argmax(scores, axis=1), 1, 2 * _REACH_PX - 1)
    each = np.arange(len(u))
    low, mid, high = scores[each, best - 1], scores[each, best], scores[each, best + 1]
    bend = low - 2 * mid + high
    part = np.where(bend < -1e-6, 0.5 * (low - high) / np.minimum(bend, -1e-6), 1.0)
    fits = (mid > _MIN_SCORE) & (mid >= low) & (mid >= high) & (contrast > _MIN_CONTRAST) & (np.abs(part) < 1)
    return start - (best - _REACH_PX + part), fits


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
    """Of the match and of the calibration; of the match alone in a residual without the calibration's error."""
    match_sigma_m: float
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
    """The same for the residual over its stated sigma (stereo and LiDAR): 1 for correct sigmas, less where errors that the
    matches have in common are part of it."""
    within_2_sigmas: float | None
    """Share of the residuals below twice their stated sigma: 0.95 for correct ones."""


def lidar_range(points_left_m: Floats, outline: Outline, camera: Camera, up: Floats) -> LidarRange | None:
    """Ground range to the axis of the cone with this outline, or None where LiDAR has no clear range.

    points_left_m: (N, 3) in the left camera's frame (x right, y down, z forward). up: unit vector (3,) in that frame.
    """
    ahead = points_left_m[points_left_m[:, 2] > 0.5]
    u, v = project(camera, ahead).T
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
    ray = rays(camera, foot)
    bearing = ray - (ray @ up) * up
    bearing /= np.linalg.norm(bearing)
    across = np.cross(up, bearing)
    along, sideways = level[near] @ bearing, level[near] @ across
    radius = outline.radius(rows[near]) * points[near, 2] / camera.fx_px
    axis = along + np.sqrt(np.maximum(radius**2 - sideways**2, 0.0))
    middle = float(np.median(axis))
    scatter = robust_std(axis)
    if scatter > 0.15:  # not one surface of revolution
        return None
    count = int(near.sum())
    sigma = np.hypot(max(scatter, _SIGMA_RETURN_M) * 1.25 / count**0.5, _SIGMA_COMMON_M)
    return LidarRange(middle, float(sigma), count)


def residual(
    match: StereoMatch, foot_left_m: Floats, foot_cov_m2: Floats, rig: Rig, lidar: LidarRange, up: Floats
) -> LidarResidual:
    """Stereo minus LiDAR range.

    foot_left_m (3,), foot_cov_m2 (3, 3): the foot by intersection, in the left camera's frame, and its covariance by the match
    alone. rig: with the errors of its calibration.
    """
    level = foot_left_m - (foot_left_m @ up) * up
    reach = float(np.linalg.norm(level))
    along = level / reach
    whole = foot_cov_m2 + calibration_cov(foot_left_m, rig)[0]
    stereo_sigma_m, match_sigma_m = (float(np.sqrt(along @ cov @ along)) for cov in (whole, foot_cov_m2))
    return LidarResidual(
        frame_index=match.frame_index, match_index=match.match_index,
        lidar_range_m=lidar.ground_range_m, lidar_sigma_m=lidar.sigma_m,
        stereo_range_m=reach, stereo_sigma_m=stereo_sigma_m, match_sigma_m=match_sigma_m,
        residual_m=reach - lidar.ground_range_m,
    )  # fmt: skip


def without_scene_bias(found: LidarResidual, match: StereoMatch, rig: Rig, bias: SceneBias) -> LidarResidual:
    """The residual corrected by the scene's calibration errors: what remains is the error of the match."""
    foot = np.array(match.foot_left_uv_px)
    xy = rays(rig.left, foot)[:2]
    disparity = match.foot_left_uv_px[0] - match.foot_right_uv_px[0] - float(infinity_shift_px(rig, foot)[0])
    stretch = disparity / (disparity - float(bias.disparity_error_px(xy)))
    # The offset is along the optical axis, the range is level and at an angle to it.
    offset = bias.range_offset_m / float(np.hypot(1.0, xy[0]))
    return found._replace(
        lidar_range_m=found.lidar_range_m + offset, stereo_range_m=found.stereo_range_m * stretch,
        stereo_sigma_m=found.match_sigma_m,
        residual_m=found.stereo_range_m * stretch - found.lidar_range_m - offset,
    )  # fmt: skip


def summarise(residuals: Sequence[LidarResidual]) -> list[ResidualBand]:
    """Robust figures of the residuals by LiDAR range."""
    ranges = np.array([r.lidar_range_m for r in residuals])
    values = np.array([r.residual_m for r in residuals])
    ratios = np.array([r.residual_m / np.hypot(r.stereo_sigma_m, r.lidar_sigma_m) for r in residuals])
    table = []
    for low, high in BANDS_M:
        here = (ranges >= low) & (ranges < high)
        figures: tuple[float | None, ...] = (None,) * 5
        if here.any():
            median, median_abs = np.median(values[here]), np.median(np.abs(values[here]))
            figures = float(median), float(median_abs), robust_std(values[here]), robust_std(ratios[here])
            figures = *figures, float(np.mean(np.abs(ratios[here]) <= 2))
        table.append(ResidualBand(low, high, int(here.sum()), *figures))
    return table
