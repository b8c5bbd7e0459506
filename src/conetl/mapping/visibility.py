"""What a drive can say about a spot at which it found no cone.

'We looked and it was not there' needs both halves: a frame pair counts as a look only where a cone standing on the spot would be
tall enough, wholly inside both images and not hidden behind something nearer that was detected. How much it means that no cone
was found is told by the detector's measured P(detect | apparent height, hidden share) (`detector_evidence.py`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.model.detector_evidence import UNMEASURED_ABSENCE, AbsenceFigures, absence_log_ratio
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams
from conetl.model.records import Detection, FramePair, Rig, Vec3
from conetl.tracking.apparent_boxes import Box, apparent_boxes, are_in_view, hidden_share, iou

Floats = NDArray[np.float64]
#: Cones farther from a spot than this do not explain what is seen at it.
_NEIGHBOUR_M = 6.0


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
    figures: AbsenceFigures
    """Of the detector that looked."""


def view_of_drive(
    rig: Rig,
    frame_pairs: Sequence[FramePair],
    detections: Sequence[Detection],
    spots: Sequence[tuple[int, Vec3]],
    figures: AbsenceFigures = UNMEASURED_ABSENCE,
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


def _is_shown(
    boxes: tuple[Box, Box],
    number: int,
    found: Sequence[Detection],
    others_m: Floats,
    cone_height_m: float,
    view: View,
) -> bool:
    """Whether a image shows a box where the cone should be, which no other cone explains better: far cones are placed to a
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
