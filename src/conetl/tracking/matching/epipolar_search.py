"""Regions of the right image that can contain partners of the left detections; only these are searched.

A partner is along the epipolar line, within the bounds of `matches.match_pair`. Since a dirty or covered left lens would then
hide cones from the map, every fifth pair is searched everywhere; if its right image shows something that the left one does not,
so are its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from conetl.geometry.rig import infinity_shift_px
from conetl.model.drive import Detection
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.params import IngestParams
from conetl.model.rig import Rig
from conetl.tracking.matching.matches import LEAST_DISPARITY_PX, disparity_bounds_px, row_tolerance_px

#: Self-calibration may rotate the rig slightly after the search.
_SLACK_PX = 4.0


class Region(NamedTuple):
    """Part of an image that contains the middles of boxes; pixels."""

    x0: float
    y0: float
    x1: float
    y1: float
    reach_px: float
    """Largest distance of box edges from their middles."""


def blocks_of(count: int, params: IngestParams) -> list[tuple[int, range]]:
    """Frame pairs in blocks: the middle one, which is searched everywhere, and all of them.

    A block has as many frame pairs as it takes to remove a cone, so that removal never rests on pairs without right images, and
    what the right images show outweighs what left images alone miss.
    """
    length = params.reconcile.removal_min_frames
    blocks = [range(first, min(first + length, count)) for first in range(0, count, length)]
    return [(block[len(block) // 2], block) for block in blocks]


def has_right_only_cone(found: Sequence[Detection], rig: Rig, params: IngestParams) -> bool:
    """Whether a pair that was searched everywhere shows a cone on the right without a left counterpart.

    It must be tall enough, and far enough inside the left image even for the tallest cone.
    """
    if params.detection.search_right == "everywhere":
        return False
    limits = params.reconcile
    # Of each left box alone: the area between two boxes is searched only while both are present.
    regions = [right_region([box], rig, params) for box in found if box.side == "left"]
    for box in found:
        if box.side == "left" or box.h_px < limits.visible_min_height_px:
            continue
        u_px, v_px = box.x_px + box.w_px / 2, box.y_px + box.h_px / 2
        least_disparity_px = box.h_px * rig.baseline_m / params.track.heights_m(box.category)[1]
        right_edge_px = box.x_px + box.w_px + least_disparity_px + rig.left.cx_px - rig.right.cx_px
        in_view = right_edge_px <= rig.left.width_px - limits.visible_border_px
        if in_view and not any(is_within(u_px, v_px, region) for region in regions):
            return True
    return False


def right_region(found: Iterable[Detection], rig: Rig, params: IngestParams) -> Region | None:
    """The searched part of a frame pair's right image, by the middle of boxes; None if it is not searched.

    found: detections of the pair, of which the left ones count. The bounding box of all partners: one large part is faster for
    the network than several small ones.
    """
    camera = rig.right
    if params.detection.search_right == "everywhere":
        return Region(0.0, 0.0, float(camera.width_px), float(camera.height_px), float(camera.height_px))
    left = [d for d in found if d.side == "left"]
    if not left:
        return None
    boxes = np.array([(d.x_px + d.w_px / 2, d.y_px + d.h_px / 2, d.w_px, d.h_px) for d in left])
    u, v, width, height = boxes.T
    at_infinity, rows_up = infinity_shift_px(rig, boxes[:, :2] - 0.5).T
    ratio = params.match.max_size_ratio
    # The partner may be larger or smaller by the size ratio.
    least, most = disparity_bounds_px(rig, params.match, width * (1 + ratio**2) / 2)
    shortest_m, tallest_m = np.array([FEATURE_CLASSES[d.category].match_heights_m for d in left]).T
    by_height = height * (1 + 1 / ratio) / 2 * rig.baseline_m / tallest_m
    least = np.where(by_height > LEAST_DISPARITY_PX, np.maximum(least, by_height), least)
    most = np.minimum(most, height * (1 + ratio) / 2 * rig.baseline_m / shortest_m)
    tolerance = row_tolerance_px(params.match, height * ratio) + _SLACK_PX
    x0, x1 = (u - at_infinity - most - _SLACK_PX).min(), (u - at_infinity - least + _SLACK_PX).max()
    y0, y1 = (v - rows_up - tolerance).min(), (v - rows_up + tolerance).max()
    x0, y0 = max(float(x0), 0.0), max(float(y0), 0.0)
    x1, y1 = min(float(x1), float(camera.width_px)), min(float(y1), float(camera.height_px))
    reach_px = max(float(height.max()) * ratio, float(width.max()) * ratio**2) / 2
    return Region(x0, y0, x1, y1, reach_px) if x0 < x1 and y0 < y1 else None


def is_within(u_px: float, v_px: float, region: Region | None) -> bool:
    """Whether a point is inside a region."""
    return region is not None and region.x0 <= u_px <= region.x1 and region.y0 <= v_px <= region.y1
