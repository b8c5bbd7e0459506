"""What a drive can say about a spot at which it found no cone.

'We looked and it was not there' needs both halves: a frame pair counts as a look only where a cone standing on the spot would be
tall enough, wholly inside both pictures and not hidden behind something nearer that was detected. How much it means that no cone
was found is told by the detector's measured P(detect | apparent height, hidden share) (`detector_evidence.py`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conetl.detector_evidence import UNMEASURED_LOOKS, LookFigures, absence_log_ratio
from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.map_records import MapFeature
from conetl.params import ReconcileParams
from conetl.records import Camera, Detection, FramePair, Rig, Vec3

Floats = NDArray[np.float64]
#: Width of a cone's base plate over its height; between the 0.5 and 0.6 of common road cones.
WIDTH_OVER_HEIGHT = 0.55
_NEAREST_M = 0.5
#: Cones farther from a spot than this do not explain what is seen at it.
_NEIGHBOUR_M = 6.0
#: Middles of the cells into which a box is cut to see what of it is hidden, in shares of its side.
_GRID = (np.arange(24) + 0.5) / 24
Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels"""


@dataclass(frozen=True)
class Look:
    """What a drive saw of a feature's spot when it saw no cone there."""

    frames: int
    """Frame pairs in which the spot was in view and empty."""
    first_ns: int
    """Time of the first of them (UTC, ns since 1970)."""
    log_likelihood_ratio: float
    """ln P(no cone found in these | it stands there) / P(no cone found | it does not)."""
    occupied: int = 0
    """Frame pairs in which a cone was found there all the same, fewer than the empty ones."""


@dataclass(frozen=True)
class View:
    """Where a drive looked and what it saw there; (N, ...) arrays have a row per frame pair, in the order of `frames`."""

    rig: Rig
    frames: tuple[int, ...]
    map_SE3_left: Floats
    """(N, 4, 4) camera -> map."""
    map_SE3_right: Floats
    captured_at_ns: NDArray[np.int64]
    detections: Mapping[int, Sequence[Detection]]
    """Of both images, by frame index."""
    places_m: Mapping[int, Floats]
    """(M, 3) in the drive's map frame, by frame index: where it saw cones."""
    figures: LookFigures
    """Of the detector that looked."""


def view_of_drive(
    rig: Rig,
    frame_pairs: Sequence[FramePair],
    detections: Sequence[Detection],
    spots: Sequence[tuple[int, Vec3]],
    figures: LookFigures = UNMEASURED_LOOKS,
) -> View:
    """spots: frame index and place in the map frame of every position."""
    by_frame: dict[int, list[Detection]] = defaultdict(list)
    for detection in detections:
        by_frame[detection.frame_index].append(detection)
    places: dict[int, list[Vec3]] = defaultdict(list)
    for frame_index, xyz_m in spots:
        places[frame_index].append(xyz_m)
    return View(
        rig=rig,
        frames=tuple(pair.frame_index for pair in frame_pairs),
        map_SE3_left=np.array([map_SE3_left(pair.pose, rig) for pair in frame_pairs]),
        map_SE3_right=np.array([map_SE3_right(pair.pose, rig) for pair in frame_pairs]),
        captured_at_ns=np.array([pair.captured_at_ns for pair in frame_pairs], dtype=np.int64),
        detections=by_frame,
        places_m={frame_index: np.array(xyz_m) for frame_index, xyz_m in places.items()},
        figures=figures,
    )


def look_at_spot(
    feature: MapFeature, offset_m: Floats, others_m: Floats, view: View, params: ReconcileParams
) -> Look | None:
    """What the drive saw of a feature's spot, or None where it was never in view, or a cone was seen there as often as not.

    offset_m (3,): add it to map coordinates to get the drive's. others_m (M, 3): places, in the drive's coordinates, of cones
    that are not this feature: what is nearer to one of them is that cone, so that a neighbour does not stand in for one that is
    gone. Frames from before the feature was last seen (drives may overlap in time) say nothing about whether it is gone.
    """
    spot = np.array(feature.xyz_m) + offset_m
    numbers, heights_px, boxes = looks_in_view(spot, feature.cone_height_m, view, params)
    near_m = others_m[np.hypot(*(others_m - spot)[:, :2].T) <= _NEIGHBOUR_M]
    looks: list[tuple[int, bool, float, float]] = []
    for row, number in enumerate(numbers):
        frame = view.frames[number]
        if view.captured_at_ns[number] <= feature.last_seen_ns:
            continue
        found = view.detections.get(frame, ())
        is_found = _is_shown(boxes[row], number, found, near_m, feature.cone_height_m, view) or _is_occupied(
            spot, view.places_m.get(frame), near_m, params.min_gate_m
        )
        left, right = (
            hidden_share(box, [d for d in found if d.side == side])
            for side, box in zip(("left", "right"), boxes[row], strict=True)
        )
        if is_found or max(left, right) <= view.figures.evidence.hidden_most:
            looks.append((row, is_found, left, right))
    if not looks:
        return None
    rows, occupied, *hidden = (np.array(column) for column in zip(*looks, strict=True))
    if occupied.sum() >= (~occupied).sum():
        return None
    ratio = absence_log_ratio(
        view.figures,
        heights_px[rows],
        np.column_stack(hidden),
        occupied,
        stray_probability=params.stray_probability,
        unseen_occluder_probability=params.unseen_occluder_probability,
    )
    first_ns = int(view.captured_at_ns[numbers[rows[~occupied]]].min())
    return Look(int((~occupied).sum()), first_ns, ratio, int(occupied.sum()))


def looks_in_view(
    foot_m: Floats, cone_height_m: float, view: View, params: ReconcileParams
) -> tuple[NDArray[np.intp], Floats, list[tuple[Box, Box]]]:
    """The frame pairs in which a cone at `foot_m` (3,) in the drive's map frame would be in view of both cameras, hidden or not.

    Returns their rows in `view` (K,), the cone's apparent heights (K, 2) in px and its boxes, each left and right.
    """
    tip_m = foot_m + np.array([0.0, 0.0, cone_height_m])
    boxes, inside = [], np.ones(len(view.frames), dtype=bool)
    for poses, camera in ((view.map_SE3_left, view.rig.left), (view.map_SE3_right, view.rig.right)):
        to_camera = np.swapaxes(poses[:, :3, :3], 1, 2)
        foot, tip = (np.einsum("nij,nj->ni", to_camera, point - poses[:, :3, 3]) for point in (foot_m, tip_m))
        box = apparent_boxes(foot, tip, camera)
        inside &= are_in_view(box, camera, params)
        boxes.append(box)
    rows = np.flatnonzero(inside)
    left, right = boxes[0][rows], boxes[1][rows]
    heights_px = np.column_stack([left[:, 3] - left[:, 1], right[:, 3] - right[:, 1]])
    return rows, heights_px, [(_box(a), _box(b)) for a, b in zip(left, right, strict=True)]


def apparent_boxes(foot_m: Floats, tip_m: Floats, camera: Camera) -> Floats:
    """(N, 4) boxes x0, y0, x1, y1 (px) that a cone would fill, its feet and tips (N, 3) given in the camera's frame; NaN where it
    is behind the camera."""
    in_front = np.minimum(foot_m[:, 2], tip_m[:, 2]) >= _NEAREST_M
    foot_z, tip_z = (np.where(in_front, points[:, 2], np.nan) for points in (foot_m, tip_m))
    y1 = camera.cy_px + camera.fy_px * foot_m[:, 1] / foot_z
    y0 = camera.cy_px + camera.fy_px * tip_m[:, 1] / tip_z
    half = (y1 - y0) * WIDTH_OVER_HEIGHT / 2
    u = camera.cx_px + camera.fx_px * foot_m[:, 0] / foot_z
    return np.column_stack([u - half, y0, u + half, y1])


def are_in_view(boxes: Floats, camera: Camera, params: ReconcileParams) -> NDArray[np.bool_]:
    """(N,) whether boxes (N, 4) are tall enough to be found and wholly inside the picture; NaN boxes are not."""
    x0, y0, x1, y1 = boxes.T
    border = params.visible_border_px
    inside = (x0 >= border) & (y0 >= border) & (x1 <= camera.width_px - border) & (y1 <= camera.height_px - border)
    return np.asarray(inside & (y1 - y0 >= params.visible_min_height_px))


def apparent_box(foot_m: Floats, tip_m: Floats, camera: Camera) -> Box | None:
    """As `apparent_boxes`, of one foot and tip (3,), many times as fast for one; None where it is behind the camera."""
    (foot_x, foot_y, foot_z), (_, tip_y, tip_z) = foot_m.tolist(), tip_m.tolist()
    if min(foot_z, tip_z) < _NEAREST_M:
        return None
    y1 = camera.cy_px + camera.fy_px * foot_y / foot_z
    y0 = camera.cy_px + camera.fy_px * tip_y / tip_z
    half = (y1 - y0) * WIDTH_OVER_HEIGHT / 2
    u = camera.cx_px + camera.fx_px * foot_x / foot_z
    return u - half, y0, u + half, y1


def is_in_view(box: Box, camera: Camera, params: ReconcileParams) -> bool:
    """As `are_in_view`, of one box."""
    x0, y0, x1, y1 = box
    border = params.visible_border_px
    inside = x0 >= border and y0 >= border and x1 <= camera.width_px - border and y1 <= camera.height_px - border
    return inside and y1 - y0 >= params.visible_min_height_px


def hidden_share(box: Box, detections: Sequence[Detection]) -> float:
    """Share (0 to 1) of `box` behind detected boxes that stand nearer (their foot is lower in the picture).

    Boxes that overlap each other are counted once, on a grid of 24 x 24 points, as `training/looks.py` counts them.
    """
    x0, y0, x1, y1 = box
    nearer = [d for d in detections if d.y_px + d.h_px > y1 + 0.1 * (y1 - y0) and overlap_px2(box, d) > 0]
    if not nearer:
        return 0.0
    u = x0 + _GRID * (x1 - x0)
    v = y0 + _GRID * (y1 - y0)
    covered = np.zeros((len(_GRID), len(_GRID)), dtype=bool)
    for d in nearer:
        rows = (v >= d.y_px) & (v <= d.y_px + d.h_px)
        covered |= rows[:, None] & ((u >= d.x_px) & (u <= d.x_px + d.w_px))[None, :]
    return float(covered.mean())


def iou(box: Box, detection: Detection) -> float:
    """Overlap of a box and a detection over their union, 0 to 1."""
    shared = overlap_px2(box, detection)
    x0, y0, x1, y1 = box
    return shared / ((x1 - x0) * (y1 - y0) + detection.w_px * detection.h_px - shared)


def overlap_px2(box: Box, detection: Detection) -> float:
    """Area that a box and a detection share."""
    x0, y0, x1, y1 = box
    width = min(x1, detection.x_px + detection.w_px) - max(x0, detection.x_px)
    height = min(y1, detection.y_px + detection.h_px) - max(y0, detection.y_px)
    return max(width, 0.0) * max(height, 0.0)


def _is_shown(
    boxes: tuple[Box, Box],
    number: int,
    found: Sequence[Detection],
    others_m: Floats,
    cone_height_m: float,
    view: View,
) -> bool:
    """Whether a picture shows a box where the cone should be, which no other cone explains better: far cones are placed to a
    metre, but their boxes to a pixel. boxes: left and right; number: row of the frame pair in `view`."""
    threshold = view.figures.evidence.match_iou
    for side, box in zip(("left", "right"), boxes, strict=True):
        own = [(d, share) for d in found if d.side == side and (share := iou(box, d)) >= threshold]
        if own and len(others_m):
            pose = (view.map_SE3_left if side == "left" else view.map_SE3_right)[number]
            camera = view.rig.left if side == "left" else view.rig.right
            feet = (others_m - pose[:3, 3]) @ pose[:3, :3]
            tips = (others_m + np.array([0.0, 0.0, cone_height_m]) - pose[:3, 3]) @ pose[:3, :3]
            others = [_box(other) for other in apparent_boxes(feet, tips, camera) if not np.isnan(other[0])]
            own = [(d, share) for d, share in own if all(iou(other, d) <= share for other in others)]
        if own:
            return True
    return False


def _is_occupied(spot_m: Floats, places_m: Floats | None, others_m: Floats, gate_m: float) -> bool:
    """Whether one of the places (M, 3) is a cone at the spot, and not one of the others (K, 3)."""
    if places_m is None:
        return False
    near = places_m[np.hypot(*(places_m - spot_m)[:, :2].T) <= gate_m]
    if len(near) == 0 or len(others_m) == 0:
        return len(near) > 0
    own = np.hypot(*(near - spot_m)[:, :2].T)
    others = np.hypot(*np.moveaxis(near[:, None, :2] - others_m[None, :, :2], 2, 0)).min(axis=1)
    return bool((own <= others).any())


def _box(row: Floats) -> Box:
    x0, y0, x1, y1 = row.tolist()
    return x0, y0, x1, y1
