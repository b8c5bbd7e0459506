"""The box of an object at a known position in an image, and overlap and occlusion of boxes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.model.arrays import Bools, Floats
from conetl.model.drive import Detection
from conetl.model.feature_classes import CONE, width_over_height
from conetl.model.params import ReconcileParams
from conetl.model.rig import Camera

Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels"""
_NEAREST_M = 0.5
#: Sampling grid for the hidden share of a box, in shares of its side.
_GRID = (np.arange(24) + 0.5) / 24


def apparent_boxes(foot_m: Floats, tip_m: Floats, camera: Camera, category: str = CONE) -> Floats:
    """(N, 4) boxes x0, y0, x1, y1 (px) of objects with feet and tips (N, 3) in the camera's frame; NaN behind the camera."""
    in_front = np.minimum(foot_m[:, 2], tip_m[:, 2]) >= _NEAREST_M
    foot_z, tip_z = (np.where(in_front, points[:, 2], np.nan) for points in (foot_m, tip_m))
    y1 = camera.cy_px + camera.fy_px * foot_m[:, 1] / foot_z
    y0 = camera.cy_px + camera.fy_px * tip_m[:, 1] / tip_z
    half = (y1 - y0) * width_over_height(category) / 2
    u = camera.cx_px + camera.fx_px * foot_m[:, 0] / foot_z
    return np.column_stack([u - half, y0, u + half, y1])


def are_in_view(boxes: Floats, camera: Camera, params: ReconcileParams) -> Bools:
    """(N,) whether boxes (N, 4) are tall enough and wholly inside the image; False for NaN."""
    x0, y0, x1, y1 = boxes.T
    border = params.visible_border_px
    inside = (x0 >= border) & (y0 >= border) & (x1 <= camera.width_px - border) & (y1 <= camera.height_px - border)
    return np.asarray(inside & (y1 - y0 >= params.visible_min_height_px))


def hidden_share(box: Box, detections: Sequence[Detection]) -> float:
    """Share (0 to 1) of `box` behind nearer detected boxes (with a lower foot in the image).

    Overlapping boxes count once, on a grid of 24 x 24 points, as in `learning/evidence/looks.py`.
    """
    x0, y0, x1, y1 = box
    nearer = nearer_boxes(box, detections)
    if not nearer:
        return 0.0
    u = x0 + _GRID * (x1 - x0)
    v = y0 + _GRID * (y1 - y0)
    covered = np.zeros((len(_GRID), len(_GRID)), dtype=bool)
    for d in nearer:
        rows = (v >= d.y_px) & (v <= d.y_px + d.h_px)
        covered |= rows[:, None] & ((u >= d.x_px) & (u <= d.x_px + d.w_px))[None, :]
    return float(covered.mean())


def nearer_boxes(box: Box, detections: Sequence[Detection]) -> list[Detection]:
    """The detections that overlap `box` and have a lower foot in the image."""
    lowest = box[3] + 0.1 * (box[3] - box[1])
    return [d for d in detections if d.y_px + d.h_px > lowest and overlap_px2(box, d) > 0]


def iou(box: Box, detection: Detection) -> float:
    """Overlap of a box and a detection over their union, 0 to 1."""
    shared = overlap_px2(box, detection)
    x0, y0, x1, y1 = box
    return shared / ((x1 - x0) * (y1 - y0) + detection.w_px * detection.h_px - shared)


def overlap_px2(box: Box, detection: Detection) -> float:
    """Common area of a box and a detection."""
    x0, y0, x1, y1 = box
    width = min(x1, detection.x_px + detection.w_px) - max(x0, detection.x_px)
    height = min(y1, detection.y_px + detection.h_px) - max(y0, detection.y_px)
    return max(width, 0.0) * max(height, 0.0)
