"""Calibration errors from the whole scene without its cones: stereo disparities against the drive's LiDAR.

Stereo and LiDAR ranges of a cone differ for three reasons: the match of the cone, the rig's calibration, or the position and
time of the scanner relative to the camera. The scene reveals the last two: windows around projected LiDAR points are matched,
and a smooth field of disparity errors over the image (calibration) and one range offset (scanner) are fitted to the
differences. Cones have no part in the fit and are evaluated after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.rig import infinity_shift_px
from conetl.model.records import Detection, Rig

Floats = NDArray[np.float64]

_HALF_PX = 5
_REACH_PX = 4
_MIN_SCORE = 0.85
_MIN_CONTRAST = 6.0
_MAX_POINTS = 600
#: Terms over x/z and y/z of the disparity errors by relative orientation, focal lengths and radial distortion; mostly across the
#: image, which is much wider than high.
_POWERS = ((0, 0), (1, 0), (2, 0), (3, 0), (4, 0), (0, 1), (1, 1), (2, 1))
_MIN_SAMPLES = 500


class SceneBias(NamedTuple):
    """Calibration errors by the scene; see `fit_scene_bias`."""

    coefficients: Floats
    """(8,) of the disparity field (px), for the powers of x/z and y/z in `_POWERS`"""
    range_offset_m: float
    """Distance along the optical axis minus that by LiDAR and its calibration."""
    sample_count: int
    scatter_px: float
    """Robust standard deviation of one sample about the fit."""

    def disparity_error_px(self, xy: Floats) -> Floats:
        """(...) measured minus true disparity of a ray x/z, y/z (..., 2) of the left camera."""
        return np.asarray(_design(xy) @ self.coefficients)


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
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    u, v = camera.cx_px + camera.fx_px * x, camera.cy_px + camera.fy_px * y
    disparity = focal_base / points[:, 2]
    at_infinity = infinity_shift_px(rig, np.stack([u, v], axis=1))
    shift = disparity + at_infinity[:, 0]
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
    return np.column_stack([x[kept], y[kept], disparity[kept], measured[fits] - shift[kept]])


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


def _grey(image: NDArray[np.uint8]) -> Floats:
    return np.asarray(image.astype(np.float64).mean(axis=2))


def _match_windows(
    left: Floats, right: Floats, u: Floats, v: Floats, shift: Floats, rig: Rig
) -> tuple[Floats, NDArray[np.bool_]]:
    """Disparities (n,) of square windows around (u, v), and a mask of the reliable ones."""
    column, row = np.round(u).astype(np.intp), np.round(v).astype(np.intp)
    down = round(rig.right.cy_px - rig.left.cy_px)
    span = np.arange(-_HALF_PX, _HALF_PX + 1)
    candidates = np.arange(-_REACH_PX, _REACH_PX + 1)
    start = np.round(shift).astype(np.intp)
    template = left[(row[:, None] + span)[:, :, None], (column[:, None] + span)[:, None, :]].reshape(len(u), -1)
    wide = np.arange(-_HALF_PX - _REACH_PX, _HALF_PX + _REACH_PX + 1)
    strips = right[(row[:, None] + span + down)[:, :, None], ((column - start)[:, None] + wide)[:, None, :]]
    windows = np.lib.stride_tricks.sliding_window_view(strips, len(span), axis=2)  # (n, rows, candidates, columns)
    windows = windows.transpose(0, 2, 1, 3).reshape(len(u), len(candidates), -1)
    template = template - template.mean(axis=1, keepdims=True)
    windows = windows - windows.mean(axis=2, keepdims=True)
    contrast = np.linalg.norm(template, axis=1) / template.shape[1] ** 0.5
    norms = np.linalg.norm(windows, axis=2) * np.linalg.norm(template, axis=1)[:, None]
    scores = np.einsum("nkp,np->nk", windows, template) / np.maximum(norms, 1e-9)
    best = np.clip(np.argmax(scores, axis=1), 1, len(candidates) - 2)
    each = np.arange(len(u))
    low, mid, high = scores[each, best - 1], scores[each, best], scores[each, best + 1]
    bend = low - 2 * mid + high
    part = np.where(bend < -1e-6, 0.5 * (low - high) / np.minimum(bend, -1e-6), 1.0)
    fits = (mid > _MIN_SCORE) & (mid >= low) & (mid >= high) & (contrast > _MIN_CONTRAST) & (np.abs(part) < 1)
    return start - (candidates[best] + part), fits
