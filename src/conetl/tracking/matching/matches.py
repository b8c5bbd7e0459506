"""Detections of a frame pair -> stereo matches with image points.

Candidates in the rectified images are gated by rows, disparity, size and the resulting height; the one-to-one assignment of
least total cost is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from conetl.geometry.camera import project, rays
from conetl.geometry.rig import infinity_shift_px
from conetl.model.arrays import Image
from conetl.model.base import Vec2
from conetl.model.drive import Detection, StereoMatch
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.params import MatchParams
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import SIDES, Camera, Rig
from conetl.tracking.matching.apparent_boxes import hidden_share
from conetl.tracking.matching.area_matching import AreaMatch, match_area
from conetl.tracking.matching.cone_outline import Outline, find_outline
from conetl.tracking.matching.covariance import with_shared_part
from conetl.tracking.matching.one_sided import OneSided, match_one_box
from conetl.tracking.matching.plate_pixels import Plate, board_edges, find_plate

Number = TypeVar("Number", float, NDArray[np.float64])
#: Below this disparity the height of an object is undetermined.
LEAST_DISPARITY_PX = 0.5
#: A box this near to the image's border (px, or share of the box) may be cut: networks rarely draw boxes up to the edge.
_BORDER_PX = 2.0
_BORDER_SHARE = 0.15
#: Largest radius of a base as a share of its depth: of wider boxes, which are of nothing on a road.
_WIDEST = 0.5
#: Sigma of foot and axis from boxes alone: a floor plus a share of the box. With less, box edges with a sigma of 0.9 px give
#: overconfident tracks (tests/synthetic/test_drive.py).
_EDGE_SIGMA_PX = 0.6
_EDGE_SIGMA_SHARE = 0.025
#: Sigma of the network's foot, and of the edges of plates, which are what is located: a floor (px), a share of the box's height
#: or width, and a term divided by the height (px^2). Across the rows in each image, along the rows in both equally, and common to
#: all observations of one cone. Measured on the sample drives (benchmarks/RESULTS.md).
_FOOT_ACROSS, _FOOT_ALONG, _FOOT_OF_CONE = (0.8, 0.010, 11.0), (0.5, 0.007, 6.0), (0.2, 0.003, 2.0)
#: Share of the box's width by which a foot is off along the rows if a nearer object hides the whole lower half. Measured on
#: the sample drives and mixed worlds 4 and 5.
_FOOT_HIDDEN = 0.3
#: Ratio of the scatter of feet to the difference of both images, which have errors in common.
_BOTH_ALIKE = 1.5
#: Prior weight of the stated scatter, in matches; limit of a difference in sigmas; limits of the factor.
_USUAL_MATCHES, _LARGEST_RATIO = 10.0, 3.0
_SPREAD_BOUNDS = (0.5, 2.0)


def match_pair(
    left: Sequence[Detection],
    right: Sequence[Detection],
    rig: Rig,
    params: MatchParams,
    *,
    up_left: NDArray[np.float64],
    images: tuple[Image, Image] | None = None,
) -> tuple[list[StereoMatch], list[Rejection]]:
    """Match the detections of one frame pair.

    up_left: unit vector (3,) pointing up, in the left camera's frame; (0, -1, 0) for a level camera. images: the two rectified
    images, (H, W, 3) uint8; with them the correspondence is refined by area-based matching (`params.refine`), and a detection
    without a partner of its category is looked for in the other image (`one_sided.py`); else it gives no match. A box at the
    border of the image lacks foot or tip and is rejected.
    """
    rejections: list[Rejection] = []
    left_whole = [d for d in left if _is_whole(d, rig.left, rejections)]
    right_whole = [d for d in right if _is_whole(d, rig.right, rejections)]
    areas: dict[tuple[int, int], AreaMatch | None] = {}
    costs = np.full((len(left_whole), len(right_whole)), np.inf)
    middles = np.array([[d.x_px + d.w_px / 2 - 0.5, d.y_px + d.h_px / 2 - 0.5] for d in left_whole]).reshape(-1, 2)
    shifts = infinity_shift_px(rig, middles).tolist()
    outlines: list[Outline | Plate | None] = [None] * len(left_whole)
    for i, (a, (at_infinity_px, rows_up)) in enumerate(zip(left_whole, shifts, strict=True)):
        for j, b in enumerate(right_whole):
            alike = _compare_boxes(a, b, at_infinity_px, -rows_up, rig, params)
            if alike is None:
                continue
            costs[i, j], disparity_px = alike
            areas[i, j] = None
            if images is not None and params.refine:
                round_body = FEATURE_CLASSES[a.category].round_body
                outline = outlines[i] or (find_outline(images[0], a) if round_body else find_plate(a, left))
                area = match_area(
                    *images, outline, disparity_px + at_infinity_px, max(3.0, 0.3 * a.w_px),
                    camera=rig.left, up=up_left, at_infinity_px=at_infinity_px, row_offset_px=-rows_up,
                )  # fmt: skip
                outlines[i], areas[i, j] = outline, area and _at_axis(area, a.category, at_infinity_px, rig)
                costs[i, j] += 1.0 - (area.correlation if area else 0.0)
    # Forbidden pairs cost more than leaving both unmatched.
    rows, columns = linear_sum_assignment(np.where(np.isfinite(costs), costs, 1e6))
    pairs = [pair for pair in zip(rows.tolist(), columns.tolist(), strict=True) if pair in areas]
    matches = []
    for index, (i, j) in enumerate(pairs):
        a, b = left_whole[i], right_whole[j]
        hidden = (_hidden_foot(a, left) + _hidden_foot(b, right)) / 2
        ends, area = (a, b), areas[i, j]
        if images is not None and area is not None and FEATURE_CLASSES[a.category].end == "edges":
            ends = board_edges(images[0], a), board_edges(images[1], b)
        matches.append(_stereo_match(index, a, b, ends, float(costs[i, j]), area, outlines[i], hidden, rig, up_left))
    if images is not None and params.refine:
        own = {left_whole[i].detection_index for i, _ in pairs}, {right_whole[j].detection_index for _, j in pairs}
        for k, whole in enumerate((left_whole, right_whole)):
            for box in whole:
                if box.detection_index in own[k] or box.score < params.one_sided_min_score:
                    continue
                if (found := match_one_box(box, images, (left, right), rig, params, up_left)) is not None:
                    matches.append(_one_sided_match(len(matches), box, found, images, (left, right), rig, up_left))
    return matches, rejections


def _one_sided_match(
    index: int,
    box: Detection,
    found: OneSided,
    images: tuple[Image, Image],
    others: tuple[Sequence[Detection], Sequence[Detection]],
    rig: Rig,
    up: NDArray[np.float64],
) -> StereoMatch:
    """The record of a match of one box."""
    a, b, area, outline = found
    at_infinity_px = float(infinity_shift_px(rig, np.array([a.x_px + a.w_px / 2 - 0.5, a.y_px + a.h_px / 2 - 0.5]))[0])
    ends, area = (a, b), _at_axis(area, box.category, at_infinity_px, rig)
    if FEATURE_CLASSES[box.category].end == "edges":
        ends = board_edges(images[0], a), board_edges(images[1], b)
    hidden = _hidden_foot(box, others[SIDES.index(box.side)])
    match = _stereo_match(index, a, b, ends, 1.0 - area.correlation, area, outline, hidden, rig, up)
    # One box shows rows and bearing with the error of one, not of the mean of two.
    once = {"sigma_v_px": 2**0.5 * match.sigma_v_px, "sigma_pointing_px": 2**0.5 * match.sigma_pointing_px}
    return match.model_copy(update={**once, "left": None} if box.side == "right" else {**once, "right": None})


def with_measured_spread(matches: Sequence[StereoMatch]) -> list[StereoMatch]:
    """The matches of one drive, or a part of it, with the sigmas of their feet scaled by their scatter.

    The rows of a foot in both images differ by their errors times sqrt(2), plus a constant of the calibration. The same factor
    applies along the rows. Only for boxes with feet. A first estimate: errors common to both images do not appear in it (see
    `variance_components.py`).
    """
    feet = [m for m in matches if _has_feet(m)]
    if len(feet) < 2:
        return list(matches)
    apart = np.array([m.foot_left_uv_px[1] - m.foot_right_uv_px[1] for m in feet])
    apart -= np.median(apart)
    sigmas = np.array([m.sigma_v_px for m in feet])
    ratio = np.abs(apart) / (2**0.5 * sigmas)
    measured = _BOTH_ALIKE**2 * float(np.mean(np.minimum(ratio, _LARGEST_RATIO) ** 2))
    factor = ((_USUAL_MATCHES + len(feet) * measured) / (_USUAL_MATCHES + len(feet))) ** 0.5
    factor = float(np.clip(factor, *_SPREAD_BOUNDS))
    # Where the rows contradict each other, as with a box that reaches over a nearer object, no row is better known than that.
    sigmas *= factor
    sigmas = np.where(ratio > factor * _LARGEST_RATIO, np.abs(apart) / 2**0.5, sigmas)
    scaled = (
        m.model_copy(update={"sigma_v_px": sigma, "sigma_pointing_px": m.sigma_pointing_px * factor})
        for m, sigma in zip(feet, sigmas.tolist(), strict=True)
    )
    return [next(scaled) if _has_feet(m) else m for m in matches]


def _has_feet(match: StereoMatch) -> bool:
    return all(box is not None and box.foot_px is not None for box in (match.left, match.right))


def foot_image_point(box: Detection, camera: Camera, up: NDArray[np.float64]) -> Vec2:
    """Image point of the centre of a round base that stands on the ground, from its box.

    The sides of the box are tangents of the base, and its lower edge shows the rim that is nearest along the level part of the
    optical axis. up: unit vector (3,) in the camera's frame.
    """
    x, bottom = box.x_px - 0.5, box.y_px + box.h_px - 0.5
    corners = rays(camera, [(x, bottom), (x + box.w_px, bottom)])
    left, right = np.arctan(corners[:, 0])
    share = min(np.sin((right - left) / 2) / np.cos((left + right) / 2), _WIDEST)
    radius = share / (1 - share)  # in units of the rim's depth
    forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
    rim = np.array([np.tan((left + right) / 2) * (1 + radius), corners[0, 1], 1.0])
    u, v = project(camera, rim + radius * forward / np.linalg.norm(forward))
    return float(u), float(v)


def _hidden_foot(detection: Detection, others: Sequence[Detection]) -> float:
    """Share (0 to 1) of the lower half of its box behind the boxes of nearer objects; others: of the same image."""
    x, y, w, h = detection.x_px, detection.y_px, detection.w_px, detection.h_px
    return hidden_share((x, y + h / 2, x + w, y + h), others)


def _spread(parts: tuple[float, float, float], size_px: float, height_px: float) -> float:
    floor, share, tiny = parts
    return float(np.sqrt(floor**2 + (share * size_px) ** 2 + (tiny / height_px) ** 2))


def _is_whole(detection: Detection, camera: Camera, rejections: list[Rejection]) -> bool:
    right_gap = camera.width_px - (detection.x_px + detection.w_px)
    bottom_gap = camera.height_px - (detection.y_px + detection.h_px)
    across = max(_BORDER_PX, _BORDER_SHARE * detection.w_px)
    down = max(_BORDER_PX, _BORDER_SHARE * detection.h_px)
    if min(detection.x_px, right_gap) > across and min(detection.y_px, bottom_gap) > down:
        return True
    rejections.append(
        Rejection(
            step="matches",
            reason=RejectionReason.BOX_CUT_BY_BORDER,
            record=f"{detection.side} detection {detection.detection_index} of frame pair {detection.frame_index}",
            detail=f"box at the border of the {camera.width_px}x{camera.height_px} image: its foot, tip or axis is not visible",
            payload=detection.model_dump(mode="json"),
        )
    )
    return False


def _compare_boxes(
    a: Detection, b: Detection, at_infinity_px: float, row_offset_px: float, rig: Rig, params: MatchParams
) -> tuple[float, float] | None:
    """Cost of matching two detections by their boxes, and their disparity above that at infinity (px); None if forbidden.

    at_infinity_px, row_offset_px: disparity of points at infinity, and how much lower they are in the right image.
    """
    if a.category != b.category or a.category not in FEATURE_CLASSES:
        return None
    tallest = max(a.h_px, b.h_px)
    row_tolerance = row_tolerance_px(params, tallest)
    row_difference = abs((a.y_px + a.h_px / 2) - (b.y_px + b.h_px / 2) + row_offset_px)
    if row_difference > row_tolerance:
        return None
    height_ratio = tallest / min(a.h_px, b.h_px)
    width_ratio = max(a.w_px, b.w_px) / min(a.w_px, b.w_px)
    if height_ratio > params.max_size_ratio or width_ratio > params.max_size_ratio**2:
        return None
    score_difference = abs(a.score - b.score)
    if score_difference > params.max_score_difference:
        return None
    disparity = (a.x_px + a.w_px / 2) - (b.x_px + b.w_px / 2) - at_infinity_px
    least, most = disparity_bounds_px(rig, params, (a.w_px + b.w_px) / 2)
    if not least <= disparity <= most:
        return None
    height_m = (a.h_px + b.h_px) / 2 * rig.baseline_m / max(disparity, LEAST_DISPARITY_PX)
    lowest_m, highest_m = FEATURE_CLASSES[a.category].match_heights_m
    if not lowest_m <= height_m <= highest_m:
        return None
    cost = row_difference / row_tolerance + np.log(height_ratio) * 2 + np.log(width_ratio) + score_difference
    return float(cost), disparity


def _at_axis(area: AreaMatch, category: str, at_infinity_px: float, rig: Rig) -> AreaMatch:
    """The match with the disparity of the object's axis instead of that of its face."""
    parallax = area.disparity_px - at_infinity_px
    nearer = 1 + FEATURE_CLASSES[category].face_m * parallax / (rig.left.fx_px * rig.baseline_m)
    return area._replace(disparity_px=at_infinity_px + parallax / nearer)


def row_tolerance_px(params: MatchParams, height_px: Number) -> Number:
    """Allowed distance of the middles of two boxes of one object across the epipolar line; height_px: of the taller one."""
    return params.epipolar_tolerance_px + params.epipolar_tolerance_relative * height_px


def disparity_bounds_px(rig: Rig, params: MatchParams, width_px: Number) -> tuple[Number, Number]:
    """Least and largest disparity, relative to that at infinity; width_px: mean of both boxes."""
    focal_base, slack = rig.left.fx_px * rig.baseline_m, 1.0 + 0.1 * width_px
    return focal_base / params.max_range_m - slack, focal_base / params.min_range_m + slack


def _stereo_match(
    index: int,
    a: Detection,
    b: Detection,
    ends: tuple[Detection, Detection],
    cost: float,
    area: AreaMatch | None,
    outline: Outline | Plate | None,
    hidden: float,
    rig: Rig,
    up: NDArray[np.float64],
) -> StereoMatch:
    """The record of a match.

    ends: a and b, with the edges that the images show. area, outline: what both images, and the left one, show of it. hidden:
    share of the lower half of the boxes behind others.
    """
    foot_left, tip_left, centre_left = _foot_tip_centre(ends[0], rig.left, up)
    foot_right, tip_right, centre_right = _foot_tip_centre(ends[1], rig.right, up)
    pointing_sigma = _EDGE_SIGMA_PX + _EDGE_SIGMA_SHARE * (a.w_px + b.w_px) / 2
    width, height = (a.w_px + b.w_px) / 2, (a.h_px + b.h_px) / 2
    across, along, of_cone = _EDGE_SIGMA_PX + _EDGE_SIGMA_SHARE * height, pointing_sigma / 2**0.5, 0.0
    if (a.foot_px is not None and b.foot_px is not None) or not FEATURE_CLASSES[a.category].on_road:
        across, of_cone = _spread(_FOOT_ACROSS, height, height), _spread(_FOOT_OF_CONE, height, height)
        along = _spread(_FOOT_ALONG, width, height)
    share = FEATURE_CLASSES[a.category].outline_share
    if share is not None:
        of_cone = _spread((_FOOT_OF_CONE[0], share, 0.0), height, height)
    along = float(np.hypot(along, _FOOT_HIDDEN * hidden * width))
    axis_left, axis_right = foot_left[0], foot_right[0]
    sigma_u = pointing_sigma
    if area is not None:
        disparity = area.disparity_px
        # The axis is the mean of both images, with the matched disparity between them.
        axis_left = (axis_left + axis_right + disparity) / 2
        if isinstance(outline, Outline) and FEATURE_CLASSES[a.category].axis_from_outline:
            axis_left = float(outline.axis(np.array(foot_left[1])))
        axis_right = axis_left - disparity
        sigma_u = with_shared_part(area.sigma_px) / 2**0.5
    return StereoMatch(
        frame_index=a.frame_index,
        match_index=index,
        left=a,
        right=b,
        foot_left_uv_px=(axis_left, foot_left[1]),
        foot_right_uv_px=(axis_right, foot_right[1]),
        centre_left_uv_px=(axis_left, centre_left),
        centre_right_uv_px=(axis_right, centre_right),
        tip_left_uv_px=(axis_left, tip_left),
        tip_right_uv_px=(axis_right, tip_right),
        sigma_u_px=sigma_u,
        sigma_v_px=across,
        sigma_pointing_px=along,
        sigma_outline_px=of_cone,
        refined=area is not None,
        cost=cost,
    )


def _foot_tip_centre(detection: Detection, camera: Camera, up: NDArray[np.float64]) -> tuple[Vec2, float, float]:
    """Image point of the foot, row of the tip, row of the box's centre.

    Box edges (0 = the image's edge) become image points (0 = the centre of a pixel). With a foot from the network, a mean of that
    and the box's is taken.
    """
    its = FEATURE_CLASSES[detection.category]
    axis, bottom = detection.x_px + detection.w_px / 2 - 0.5, detection.y_px + detection.h_px - 0.5
    top = detection.y_px - 0.5
    u, v = foot_image_point(detection, camera, up) if its.rim_in_box else (axis, bottom)
    if detection.foot_px is not None:
        u += its.network_share * (detection.foot_px[0] - 0.5 - u)
        v += its.network_share * (detection.foot_px[1] - 0.5 - v)
    tip = top if detection.tip_px is None else detection.tip_px[1] - 0.5
    return (u, v), tip, (top + bottom) / 2
