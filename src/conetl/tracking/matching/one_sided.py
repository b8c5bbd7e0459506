"""Objects that the network found in one image only: the other one is searched along the epipolar line for what the box shows.

By area-based matching over all disparities at which the object has a height of its class. The match must be better than at any
other of them, and matching back from the other image must find the first one again. The other image then has no box of its own:
it adds a disparity, but neither evidence that the object exists, nor rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from conetl.geometry.rig import infinity_shift_px, left_SE3_right
from conetl.model.arrays import Floats, Image
from conetl.model.drive import Detection
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.params import MatchParams
from conetl.model.rig import SIDES, Rig
from conetl.tracking.matching.apparent_boxes import iou
from conetl.tracking.matching.area_matching import AreaMatch, body_pixels, least_squares, whole_pixel_disparity
from conetl.tracking.matching.cone_outline import Outline, find_outline
from conetl.tracking.matching.cone_pixels import BodyPixels
from conetl.tracking.matching.plate_pixels import Plate, find_plate

#: Heights of boxes are off by this share.
_HEIGHT_SLACK = 0.1
#: The best correlation exceeds by this much those at disparities that differ by more than this share of the box's width.
_LEAD, _LEAD_BEYOND = 0.1, 0.5
#: Half width (px) of the search back, and largest difference of both whole-pixel disparities.
_BACK_PX, _AGREE_PX = 3.0, 1
#: Overlap (intersection over union) of boxes of one object.
_SAME_IOU = 0.3
#: Edge of the image (px) that the interpolation needs.
_EDGE_PX = 4.0


class OneSided(NamedTuple):
    """A box, and where the other image shows the same."""

    left: Detection
    right: Detection
    area: AreaMatch
    """Of the left image against the right one."""
    outline: Outline | Plate
    """In the left image."""


def match_one_box(
    box: Detection,
    images: tuple[Image, Image],
    found: tuple[Sequence[Detection], Sequence[Detection]],
    rig: Rig,
    params: MatchParams,
    up_left: Floats,
) -> OneSided | None:
    """The object of one box in the other image; None if that does not show it clearly.

    images: left and right, rectified; found: the detections in them. up_left: as for `match_pair`.
    """
    at_infinity_px, rows_up = infinity_shift_px(
        rig, np.array([box.x_px + box.w_px / 2 - 0.5, box.y_px + box.h_px / 2 - 0.5])
    ).tolist()
    up_right = np.linalg.inv(left_SE3_right(rig))[:3, :3] @ up_left

    def shown(
        one: Detection, guess_px: float, reach_px: float, lead: tuple[float, float] | None
    ) -> tuple[int, BodyPixels, Outline | Plate] | None:
        """Whole-pixel disparity, left minus right, of a box against the other image."""
        k = SIDES.index(one.side)
        sign = 1 - 2 * k
        round_body = FEATURE_CLASSES[one.category].round_body
        outline = find_outline(images[k], one) if round_body else find_plate(one, found[k])
        pixels = body_pixels(images[k], outline, (rig.left, rig.right)[k], (up_left, up_right)[k])
        if pixels is None:
            return None
        disparity_px = whole_pixel_disparity(
            pixels, images[1 - k], sign * guess_px, reach_px, sign * at_infinity_px, round(-sign * rows_up), lead
        )
        return None if disparity_px is None else (sign * disparity_px, pixels, outline)

    least, most = _disparities_px(box, images[0].shape[1], at_infinity_px, rig, params)
    if least >= most:
        return None
    first = shown(box, (least + most) / 2 + at_infinity_px, (most - least) / 2, (_LEAD, _LEAD_BEYOND * box.w_px))
    if first is None:
        return None
    other = _displaced(box, first[0], rows_up)
    # A box that is there and could not be matched contradicts this one.
    place = other.x_px, other.y_px, other.x_px + other.w_px, other.y_px + other.h_px
    if any(iou(place, one) > _SAME_IOU for one in found[SIDES.index(other.side)]):
        return None
    back = shown(other, first[0], _BACK_PX, None)
    if back is None or abs(back[0] - first[0]) > _AGREE_PX:
        return None
    disparity_px, pixels, outline = first if box.side == "left" else back
    area = least_squares(pixels, images[1], float(disparity_px), at_infinity_px, -rows_up)
    if area is None:
        return None
    other = _displaced(box, area.disparity_px, rows_up)
    return OneSided(*((box, other) if box.side == "left" else (other, box)), area, outline)


def _disparities_px(
    box: Detection, width_px: int, at_infinity_px: float, rig: Rig, params: MatchParams
) -> tuple[float, float]:
    """Least and largest disparity, relative to that at infinity, at which the object has a height of its class and both images
    show it."""
    lowest_m, highest_m = FEATURE_CLASSES[box.category].heights_m
    height_base, focal_base = box.h_px * rig.baseline_m, rig.left.fx_px * rig.baseline_m
    least = max(height_base / highest_m * (1 - _HEIGHT_SLACK), focal_base / params.max_range_m)
    most = min(height_base / lowest_m * (1 + _HEIGHT_SLACK), focal_base / params.min_range_m)
    gap_px = box.x_px if box.side == "left" else width_px - box.x_px - box.w_px
    return least, min(most, gap_px - _EDGE_PX - at_infinity_px)


def _displaced(box: Detection, disparity_px: float, rows_up: float) -> Detection:
    """The box in the other image."""
    sign = 1 if box.side == "left" else -1
    left, up = sign * disparity_px, sign * rows_up

    def moved(point: tuple[float, float] | None) -> tuple[float, float] | None:
        return point and (point[0] - left, point[1] - up)

    place = {"x_px": box.x_px - left, "y_px": box.y_px - up, "foot_px": moved(box.foot_px), "tip_px": moved(box.tip_px)}
    return box.model_copy(update={"side": "right" if box.side == "left" else "left", **place})
