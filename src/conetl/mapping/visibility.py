"""Evidence of absence: the location of a feature was visible to a drive, but no cone, or no lane marking, was observed there.

A location counts as visible in a frame pair if a cone there would be tall enough, wholly inside both images and not hidden by a
nearer detection. The weight of an empty frame pair follows from the detector's measured P(detect | apparent height, hidden share)
(`model/detector_evidence.py`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.linear_reference import spaced
from conetl.geometry.motion.rolling_shutter import as_exposed, camera_rates, readouts_s, right_rates
from conetl.geometry.rig import camera_of, map_SE3_camera, map_SE3_left
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.base import Vec3
from conetl.model.detector_evidence import UNMEASURED_ABSENCE, AbsenceFigures, absence_log_ratio, class_evidence
from conetl.model.drive import Detection, FramePair
from conetl.model.feature_classes import CONE, LANE_MARKING
from conetl.model.map_records import MapFeature
from conetl.model.markings import MarkingTrack
from conetl.model.params import MarkingParams, ReconcileParams
from conetl.model.rig import SIDES, Camera, Rig, Side
from conetl.tracking.matching.apparent_boxes import Box, apparent_boxes, are_in_view, hidden_share, iou

#: Cones farther from a location than this do not explain detections at it.
_NEIGHBOUR_M = 6.0
#: Of frame pairs recorded nearer to each other one is searched for lane markings.
_STEP_M = MarkingParams().pair_spacing_m


@dataclass(frozen=True)
class NotObserved:
    """A feature's location was visible to a drive, which observed no cone there."""

    frames: int
    """Frame pairs in which the location was visible and empty."""
    first_ns: int
    """Time of the first of them (UTC, ns since 1970)."""
    log_likelihood_ratio: float
    """ln P(no cone observed in these | it exists) / P(no cone observed | it does not)."""
    occupied: int = 0
    """Frame pairs in which a cone was observed all the same, fewer than the empty ones."""


class VisiblePair(NamedTuple):
    """A frame pair in which the location of a feature was visible."""

    row: int
    """In the drive's arrays."""
    occupied: bool
    """Whether a cone was observed there."""
    heights_px: tuple[float, float]
    """Of a cone at the location, left and right."""
    hidden: tuple[float, float]
    """Share of it behind nearer detections, 0 to 1."""


@dataclass(frozen=True)
class DriveObservations:
    """Poses, detections and positions of a drive; (N, ...) arrays have a row per frame pair, in the order of `frames`."""

    rig: Rig
    frames: tuple[int, ...]
    map_SE3_left: Floats
    """(N, 4, 4) camera -> map."""
    map_SE3_right: Floats
    captured_at_ns: NDArray[np.int64]
    shows_absence: tuple[bool, ...]
    """Whether the images of a frame pair show enough to say that a cone is gone."""
    detections: Mapping[int, Sequence[Detection]]
    """Of both images, by frame index."""
    positions_m: Mapping[tuple[int, str], Floats]
    """(M, 3) observed objects in the drive's map frame, by frame index and class."""
    figures: AbsenceFigures
    unclear: Mapping[str, Bools] = field(default_factory=dict)
    """By side: which squares (rows, columns) of the image show nothing or are blurred; empty where all are clear."""
    rates: Mapping[Side, Floats] = field(default_factory=dict)
    """By side, of cameras with a rolling shutter: (N, 6) rate of static points in the camera's frame; else empty."""

    def as_exposed(self, side: Side, points_m: Floats, rows: Ints) -> Floats:
        """Points (M, 3) of one camera's frame where a rolling shutter saw them. rows (M,): of their frame pairs."""
        if side not in self.rates:
            return points_m
        return as_exposed(points_m, camera_of(self.rig, side), self.rig, side, self.rates[side][rows])

    def is_unclear(self, side: Side, u_px: Floats, v_px: Floats) -> Bools:
        """Whether image points, arrays of one shape, lie where the lens shows nothing, or blurred."""
        if side not in self.unclear or self.figures.unclear is None:
            return np.zeros(np.shape(u_px), bool)
        grid, side_px = self.unclear[side], self.figures.unclear.side_px
        # The last square also stands for the rest of the image beyond it.
        row, column = (
            np.clip(np.nan_to_num(at) / side_px, 0, count - 1).astype(np.intp)
            for at, count in zip((v_px, u_px), grid.shape, strict=True)
        )
        return grid[row, column]


def observations_of_drive(
    rig: Rig,
    frame_pairs: Sequence[FramePair],
    detections: Sequence[Detection],
    positions: Sequence[tuple[int, str, Vec3]],
    figures: AbsenceFigures = UNMEASURED_ABSENCE,
) -> DriveObservations:
    """positions: frame index, class and map-frame coordinates (m) of every position; figures: of the detector in use."""
    by_frame: dict[int, list[Detection]] = defaultdict(list)
    for detection in detections:
        by_frame[detection.frame_index].append(detection)
    xyz_m: dict[tuple[int, str], list[Vec3]] = defaultdict(list)
    for frame_index, category, one in positions:
        xyz_m[frame_index, category].append(one)
    return DriveObservations(
        rig=rig,
        frames=tuple(pair.frame_index for pair in frame_pairs),
        map_SE3_left=np.array([map_SE3_left(pair.pose, rig) for pair in frame_pairs]),
        map_SE3_right=np.array([map_SE3_camera(pair.pose, rig, "right") for pair in frame_pairs]),
        captured_at_ns=np.array([pair.captured_at_ns for pair in frame_pairs], dtype=np.int64),
        shows_absence=tuple(pair.shows_absence for pair in frame_pairs),
        detections=by_frame,
        positions_m={key: np.array(some) for key, some in xyz_m.items()},
        figures=figures,
        unclear=_unclear_grids(rig, figures),
        rates=_rates(rig, frame_pairs),
    )


def _rates(rig: Rig, frame_pairs: Sequence[FramePair]) -> dict[Side, Floats]:
    """As `DriveObservations.rates`."""
    if not (readouts_s(rig).any() and frame_pairs):
        return {}
    left = camera_rates(frame_pairs, rig)
    return {"left": left, "right": right_rates(rig, left)}


def _unclear_grids(rig: Rig, figures: AbsenceFigures) -> dict[str, Bools]:
    """As `DriveObservations.unclear`."""
    unclear = figures.unclear
    if unclear is None:
        return {}
    grids = {}
    for side, camera, squares in (("left", rig.left, unclear.left), ("right", rig.right, unclear.right)):
        grid = np.zeros((int(camera.height_px // unclear.side_px), int(camera.width_px // unclear.side_px)), bool)
        rows, columns = np.array(squares, np.intp).reshape(-1, 2).T
        grid[rows, columns] = True
        grids[side] = grid
    return grids


def check_visibility(
    feature: MapFeature, offset_m: Floats, others_m: Floats, drive: DriveObservations, params: ReconcileParams
) -> NotObserved | None:
    """Evidence that a feature is absent; None if it was never visible, or observed in at least half of the frame pairs.

    None also if the drive did not search for its class. offset_m (3,): converts map coordinates to the drive's by addition.
    others_m (M, 3): other cones, in the drive's coordinates; an observation nearer to one of them is of that cone. Frame pairs
    recorded before the feature was last observed are ignored.
    """
    if feature.category not in drive.figures.categories:
        return None
    foot_m = np.array(feature.xyz_m) + offset_m
    seen = [
        pair
        for pair in visible_pairs(foot_m, feature.object_height_m, others_m, drive, params, feature.category)
        if drive.captured_at_ns[pair.row] > feature.last_seen_ns
    ]
    if not seen:
        return None
    occupied = np.array([pair.occupied for pair in seen])
    if occupied.sum() >= (~occupied).sum():
        return None
    ratio = absence_log_ratio(
        class_evidence(drive.figures.evidence, feature.category),
        drive.figures.score_threshold,
        np.array([pair.heights_px for pair in seen]),
        np.array([pair.hidden for pair in seen]),
        occupied,
        stray_probability=params.stray_probability,
        unseen_occluder_probability=params.unseen_occluder_probability,
    )
    first_ns = min(int(drive.captured_at_ns[pair.row]) for pair in seen if not pair.occupied)
    return NotObserved(int((~occupied).sum()), first_ns, ratio, int(occupied.sum()))


def visible_pairs(
    foot_m: Floats,
    object_height_m: float,
    others_m: Floats,
    drive: DriveObservations,
    params: ReconcileParams,
    category: str = CONE,
) -> list[VisiblePair]:
    """The frame pairs that show whether a cone stands at `foot_m` (3,) in the drive's map frame, in order.

    others_m (M, 3): other cones in the same frame; an observation nearer to one of them is of that cone. category: boxes of other
    classes do not show the cone, but may hide it.
    """
    evidence = class_evidence(drive.figures.evidence, category)
    rows, heights_px, boxes = pairs_in_view(foot_m, object_height_m, drive, params, category)
    near_m = others_m[np.hypot(*(others_m - foot_m)[:, :2].T) <= _NEIGHBOUR_M]
    visible = []
    for k, row in enumerate(rows.tolist()):
        frame = drive.frames[row]
        found = drive.detections.get(frame, ())
        alike = [d for d in found if d.category == category]
        occupied = _is_detected(boxes[k], row, alike, near_m, object_height_m, drive, category) or _is_occupied(
            foot_m, drive.positions_m.get((frame, category)), near_m, params.min_gate_m
        )
        left, right = (
            hidden_share(box, [d for d in found if d.side == side])
            for side, box in zip(("left", "right"), boxes[k], strict=True)
        )
        clear = not any(
            drive.is_unclear(side, *_corners_and_middle(box)).any() for side, box in zip(SIDES, boxes[k], strict=True)
        )
        if occupied or (drive.shows_absence[row] and clear and max(left, right) <= evidence.hidden_most):
            heights = float(heights_px[k, 0]), float(heights_px[k, 1])
            visible.append(VisiblePair(row, occupied, heights, (left, right)))
    return visible


def pairs_in_view(
    foot_m: Floats, object_height_m: float, drive: DriveObservations, params: ReconcileParams, category: str = CONE
) -> tuple[Ints, Floats, list[tuple[Box, Box]]]:
    """The frame pairs in which both images would contain a cone at `foot_m` (3,) in the drive's map frame, hidden or not.

    Returns their rows in `drive` (K,), the cone's apparent heights (K, 2) in px and its boxes, left and right.
    """
    tip_m = foot_m + np.array([0.0, 0.0, object_height_m])
    boxes, every = [], np.arange(len(drive.frames))
    inside = np.ones(len(every), dtype=bool)
    for side, poses, camera in _views(drive):
        to_camera = np.swapaxes(poses[:, :3, :3], 1, 2)
        still = (np.einsum("nij,nj->ni", to_camera, point - poses[:, :3, 3]) for point in (foot_m, tip_m))
        foot, tip = (drive.as_exposed(side, points, every) for points in still)
        box = apparent_boxes(foot, tip, camera, category)
        inside &= are_in_view(box, camera, params)
        boxes.append(box)
    rows = np.flatnonzero(inside)
    left, right = boxes[0][rows], boxes[1][rows]
    heights_px = np.column_stack([left[:, 3] - left[:, 1], right[:, 3] - right[:, 1]])
    return rows, heights_px, [(_box(a), _box(b)) for a, b in zip(left, right, strict=True)]


def _views(drive: DriveObservations) -> tuple[tuple[Side, Floats, Camera], ...]:
    """Side, (N, 4, 4) poses and camera."""
    return ("left", drive.map_SE3_left, drive.rig.left), ("right", drive.map_SE3_right, drive.rig.right)


def _is_detected(
    boxes: tuple[Box, Box],
    number: int,
    found: Sequence[Detection],
    others_m: Floats,
    object_height_m: float,
    drive: DriveObservations,
    category: str,
) -> bool:
    """Whether an image has a detection at the expected box that fits no other cone better; number: row of the frame pair.

    Far cones are located to a metre, but their boxes to a pixel.
    """
    threshold, rows = drive.figures.evidence.match_iou, np.full(len(others_m), number)
    for (side, poses, camera), box in zip(_views(drive), boxes, strict=True):
        own = [(d, share) for d in found if d.side == side and (share := iou(box, d)) >= threshold]
        if own and len(others_m):
            pose = poses[number]
            feet = drive.as_exposed(side, (others_m - pose[:3, 3]) @ pose[:3, :3], rows)
            tops_m = others_m + np.array([0.0, 0.0, object_height_m])
            tips = drive.as_exposed(side, (tops_m - pose[:3, 3]) @ pose[:3, :3], rows)
            others = [_box(other) for other in apparent_boxes(feet, tips, camera, category) if not np.isnan(other[0])]
            own = [(d, share) for d, share in own if all(iou(other, d) <= share for other in others)]
        if own:
            return True
    return False


def _is_occupied(foot_m: Floats, positions_m: Floats | None, others_m: Floats, gate_m: float) -> bool:
    """Whether one of the positions (M, 3) is within the gate and not nearer to one of the other cones (K, 3)."""
    if positions_m is None:
        return False
    near = positions_m[np.hypot(*(positions_m - foot_m)[:, :2].T) <= gate_m]
    if len(near) == 0 or len(others_m) == 0:
        return len(near) > 0
    own = np.hypot(*(near - foot_m)[:, :2].T)
    others = np.hypot(*np.moveaxis(near[:, None, :2] - others_m[None, :, :2], 2, 0)).min(axis=1)
    return bool((own <= others).any())


def _corners_and_middle(box: Box) -> tuple[Floats, Floats]:
    """Columns and rows (5,) of the points of a box that must be in clear squares; boxes are rarely larger than a square."""
    x0, y0, x1, y1 = box
    return np.array([x0, x1, x0, x1, (x0 + x1) / 2]), np.array([y0, y0, y1, y1, (y0 + y1) / 2])


def _box(row: Floats) -> Box:
    x0, y0, x1, y1 = row.tolist()
    return x0, y0, x1, y1


class MarkingView(NamedTuple):
    """The frame pairs (K,) that show any of some vertices (n,)."""

    captured_at_ns: NDArray[np.int64]
    in_view: Bools
    """(n, K)"""

    def after(self, instant_ns: int) -> MarkingView:
        """The frame pairs that were recorded after an instant."""
        later = self.captured_at_ns > instant_ns
        return MarkingView(self.captured_at_ns[later], self.in_view[:, later])

    def period_of(self, vertices: Bools) -> tuple[int, int, int] | None:
        """Number of the frame pairs that show any of the vertices (n,), and the instants of the first and the last; or None."""
        captured_ns = self.captured_at_ns[self.in_view[vertices].any(axis=0)]
        return (len(captured_ns), int(captured_ns.min()), int(captured_ns.max())) if len(captured_ns) else None


def empty_view(vertices_m: Floats) -> MarkingView:
    """The view of a drive that did not search for lane markings."""
    return MarkingView(np.empty(0, np.int64), np.empty((len(vertices_m), 0), bool))


def markings_in_view(
    vertices_m: Floats, drive: DriveObservations, blur_px: float, params: ReconcileParams
) -> MarkingView:
    """Where vertices (n, 3), in the drive's map frame, lie inside both images at the ranges in which markings are searched.

    blur_px: sigma by which the images blur the edges of markings; it limits the range at which they show absence. Empty for a
    drive that did not search for markings. A vertex inside the box of a detection is hidden. Images without detail show no
    absence.
    """
    rows = np.flatnonzero(drive.shows_absence) if LANE_MARKING in drive.figures.categories else np.empty(0, np.int64)
    middle_m = vertices_m.mean(axis=0)
    sharp_to_m = params.marking_max_blur_m * drive.rig.left.fx_px / max(blur_px, 1e-9)
    view_to_m = min(params.marking_view_to_m, max(sharp_to_m, params.marking_view_from_m + _STEP_M))
    reach_m = 2 * view_to_m + float(np.linalg.norm(vertices_m - middle_m, axis=1).max())
    rows = rows[np.linalg.norm(drive.map_SE3_left[rows, :3, 3] - middle_m, axis=1) <= reach_m]
    rows = rows[spaced(drive.map_SE3_left[rows, :3, 3], _STEP_M)]
    in_view = np.ones((len(vertices_m), len(rows)), bool)
    for side, every, camera in _views(drive):
        poses = every[rows]
        still = np.einsum("knj,kji->nki", vertices_m[None] - poses[:, None, :3, 3], poses[:, :3, :3])
        shown_m = drive.as_exposed(side, still.reshape(-1, 3), np.tile(rows, len(vertices_m)))
        x, y, z = np.moveaxis(shown_m.reshape(still.shape), 2, 0)
        in_view &= (z >= params.marking_view_from_m) & (z <= view_to_m)
        in_view &= np.abs(x) <= params.marking_view_aside_m
        depth = np.where(in_view, z, 1.0)
        u, v = camera.cx_px + camera.fx_px * x / depth, camera.cy_px + camera.fy_px * y / depth
        border = params.visible_border_px
        in_view &= (u >= border) & (u <= camera.width_px - border) & (v >= 0) & (v <= camera.height_px - 1)
        in_view &= ~drive.is_unclear(side, u, v)
        for k, row in enumerate(rows.tolist()):
            for box in drive.detections.get(drive.frames[row], ()):
                if box.side == side:
                    inside = (u[:, k] >= box.x_px) & (u[:, k] <= box.x_px + box.w_px)
                    in_view[:, k] &= ~(inside & (v[:, k] >= box.y_px) & (v[:, k] <= box.y_px + box.h_px))
    shown = in_view.any(axis=0)
    return MarkingView(drive.captured_at_ns[rows[shown]], in_view[:, shown])


#: (feature, offset_m, others_m) -> evidence that the feature is absent.
VisibilityCheck = Callable[[MapFeature, Floats, Floats], NotObserved | None]
#: Vertices (n, 3) in the drive's map frame -> when they were in view.
ViewCheck = Callable[[Floats], MarkingView]


def visibility_checks(
    view: Callable[[], DriveObservations], markings: Sequence[MarkingTrack], params: ReconcileParams
) -> tuple[VisibilityCheck, ViewCheck]:
    """For cones and for lane markings; view: of the drive, read on demand; markings: those that it observed."""
    blur_px = float(np.median([track.blur_px for track in markings])) if markings else 0.0
    return (
        lambda feature, offset_m, others_m: check_visibility(feature, offset_m, others_m, view(), params),
        lambda vertices_m: markings_in_view(vertices_m, view(), blur_px, params),
    )
