"""In which frame pairs of a drive a given cone should have been seen.

'We looked and it was not there' needs both halves: a spot counts as looked at only where a cone standing on it would be tall
enough, wholly inside both pictures and not hidden behind something nearer that was detected.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.params import ReconcileParams
from conetl.records import Camera, Detection, FramePair, MapFeature, Rig, Vec3

Floats = NDArray[np.float64]
#: Width of a cone's base plate over its height; between the 0.5 and 0.6 of common road cones.
_WIDTH_OVER_HEIGHT = 0.55
#: A spot with more than this share of its box behind a nearer box counts as hidden.
_HIDDEN_SHARE = 0.25
_NEAREST_M = 0.5
#: Middles of the cells into which a box is cut to see what of it is hidden, in shares of its side.
_GRID = (np.arange(24) + 0.5) / 24
Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels"""


@dataclass(frozen=True)
class Look:
    """What a drive saw of a feature's spot when it saw no cone there."""

    frames: int
    """Frame pairs in which the spot was in plain view and empty."""
    first_ns: int
    """Time of the first of them (UTC, ns since 1970)."""


@dataclass(frozen=True)
class View:
    """Where a drive looked and what it saw there, by frame index."""

    rig: Rig
    map_SE3_left: Mapping[int, Floats]
    """(4, 4) camera -> map."""
    map_SE3_right: Mapping[int, Floats]
    captured_at_ns: Mapping[int, int]
    detections: Mapping[int, Sequence[Detection]]
    """Of both images."""
    places_m: Mapping[int, Floats]
    """(N, 3) in the drive's map frame: where it saw cones."""


def view_of_drive(
    rig: Rig, frame_pairs: Sequence[FramePair], detections: Sequence[Detection], spots: Sequence[tuple[int, Vec3]]
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
        map_SE3_left={pair.frame_index: map_SE3_left(pair.pose, rig) for pair in frame_pairs},
        map_SE3_right={pair.frame_index: map_SE3_right(pair.pose, rig) for pair in frame_pairs},
        captured_at_ns={pair.frame_index: pair.captured_at_ns for pair in frame_pairs},
        detections=by_frame,
        places_m={frame_index: np.array(xyz_m) for frame_index, xyz_m in places.items()},
    )


def look_at_spot(feature: MapFeature, offset_m: Floats, view: View, params: ReconcileParams) -> Look | None:
    """What the drive saw of a feature's spot, or None where it was never in plain view, or a cone was seen there as often as not.

    offset_m (3,): add it to map coordinates to get the drive's. Frames from before the feature was last seen (drives may overlap
    in time) say nothing about whether it is gone.
    """
    spot = np.array(feature.xyz_m) + offset_m
    times_ns = view.captured_at_ns
    after = {frame: pose for frame, pose in view.map_SE3_left.items() if times_ns[frame] > feature.last_seen_ns}
    height_m = feature.cone_height_m
    visible = set(frames_in_plain_view(spot, height_m, view.rig, after, view.map_SE3_right, view.detections, params))
    occupied = {
        frame
        for frame in visible & view.places_m.keys()
        if np.hypot(*(view.places_m[frame] - spot)[:, :2].T).min() <= params.min_gate_m
    }
    empty = visible - occupied
    if not empty or len(occupied) >= len(empty):
        return None
    return Look(len(empty), min(times_ns[frame] for frame in empty))


def frames_in_plain_view(
    foot_m: Floats,
    cone_height_m: float,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    map_SE3_right: Mapping[int, Floats],
    detections: Mapping[int, Sequence[Detection]],
    params: ReconcileParams,
) -> list[int]:
    """Frame indices in which a cone at `foot_m` (3,) in the map frame would be in plain view of both cameras.

    map_SE3_left, map_SE3_right: (4, 4) camera -> map by frame index; detections: those of both images by frame index.
    """
    seen = []
    for frame_index, left_pose in map_SE3_left.items():
        boxes = {
            "left": _box_in_view(foot_m, cone_height_m, left_pose, rig.left, params),
            "right": _box_in_view(foot_m, cone_height_m, map_SE3_right[frame_index], rig.right, params),
        }
        if any(box is None for box in boxes.values()):
            continue
        if not any(is_hidden(box, d) for d in detections.get(frame_index, ()) if (box := boxes[d.side]) is not None):
            seen.append(frame_index)
    return seen


def apparent_box(foot_m: Floats, tip_m: Floats, camera: Camera) -> Box | None:
    """Box (px) that a cone would fill, its foot and tip (3,) given in the camera's frame; None where it is behind the camera."""
    if min(foot_m[2], tip_m[2]) < _NEAREST_M:
        return None
    y1 = camera.cy_px + camera.fy_px * foot_m[1] / foot_m[2]
    y0 = camera.cy_px + camera.fy_px * tip_m[1] / tip_m[2]
    half = (y1 - y0) * _WIDTH_OVER_HEIGHT / 2
    u = camera.cx_px + camera.fx_px * foot_m[0] / foot_m[2]
    return float(u - half), float(y0), float(u + half), float(y1)


def is_in_view(box: Box, camera: Camera, params: ReconcileParams) -> bool:
    """Whether a box is tall enough to be found and wholly inside the picture."""
    x0, y0, x1, y1 = box
    border = params.visible_border_px
    inside = x0 >= border and y0 >= border and x1 <= camera.width_px - border and y1 <= camera.height_px - border
    return inside and y1 - y0 >= params.visible_min_height_px


def is_hidden(box: Box, detection: Detection) -> bool:
    """Whether a detected box that stands nearer covers a good part of `box`."""
    return hidden_share(box, [detection]) > _HIDDEN_SHARE


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


def overlap_px2(box: Box, detection: Detection) -> float:
    """Area that a box and a detection share."""
    x0, y0, x1, y1 = box
    width = min(x1, detection.x_px + detection.w_px) - max(x0, detection.x_px)
    height = min(y1, detection.y_px + detection.h_px) - max(y0, detection.y_px)
    return max(width, 0.0) * max(height, 0.0)


def _box_in_view(
    foot_m: Floats, cone_height_m: float, map_SE3_camera: Floats, camera: Camera, params: ReconcileParams
) -> Box | None:
    to_camera, centre = map_SE3_camera[:3, :3].T, map_SE3_camera[:3, 3]
    tip_m = foot_m + np.array([0.0, 0.0, cone_height_m])
    box = apparent_box(to_camera @ (foot_m - centre), to_camera @ (tip_m - centre), camera)
    return box if box is not None and is_in_view(box, camera, params) else None
