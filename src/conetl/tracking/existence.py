"""How sure a drive is that something it saw is a cone: log-likelihood ratios of all images in which it should show.

Two explanations compete for the boxes of a group: a cone, and a lookalike, a thing that is no cone but gets boxes now and then.
What each of them does was measured for the detector in use (`detector_evidence.py`, in the model's sidecar):

- before any look, the odds are expected cones to false boxes, a image;
- a box where the cone should be: p(box with this score | cone, apparent height, hidden share) over the same for a lookalike;
- no box there: (1 - P(detect | height, hidden)) over (1 - P(found again)) of a lookalike. Misses of one camera running may have
  one cause, something in front that is no detection: with a small probability the whole run says nothing;
- a box that other positions are made of is another thing's: where only such a box covers the place, the look says nothing;
- looks at one thing fail together, most where it appears equally tall (`detector_evidence.joint_log_ratio`), so that no number
  of images makes up for what they have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.rig import camera_of, left_SE3_right
from conetl.model.detector_evidence import (
    DetectorEvidence,
    box_log_ratio,
    false_boxes_per_image,
    joint_log_ratio,
    miss_log_ratio,
)
from conetl.model.params import IngestParams
from conetl.model.records import Detection, Position, Rig, Side
from conetl.tracking.apparent_boxes import Box, apparent_boxes, are_in_view, hidden_share, iou
from conetl.tracking.matching.epipolar_search import is_within, right_region

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Look:
    """One image in which the cone should show."""

    height_px: float
    """Apparent height that the cone should have."""
    hidden: float
    """Share of its box behind nearer detections."""
    score: float | None
    """Of the best box in its place; None where there is none."""


def existence_probability(
    group: Sequence[Position],
    cone_height_m: float,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    detections: Mapping[int, Sequence[Detection]],
    params: IngestParams,
    evidence: DetectorEvidence,
    is_anothers: Callable[[Detection], bool],
) -> float:
    """Belief (0 to 1) that the positions of `group` are a cone.

    Every left image in which it should be in plain view speaks, and every right one that the left one had searched there. Where
    it should be is carried over from the nearest frame of the group by the relative motion, so that a sliding trajectory does not
    turn hits into misses. map_SE3_left: (4, 4) by frame index; detections: of both images; evidence: the detector's figures;
    is_anothers: whether another group is made of a box.
    """
    looks: dict[Side, list[Look]] = {"left": [], "right": []}
    for side, in_view in _boxes(group, cone_height_m, rig, map_SE3_left, params).items():
        for frame_index, box in in_view:
            of_pair = detections.get(frame_index, ())
            if side == "right" and not is_within(*_middle(box), right_region(of_pair, rig, params)):
                continue  # what is told by it must not depend on what it shows, only on what the left image did
            found = [d for d in of_pair if d.side == side]
            covering = [d for d in found if iou(box, d) >= evidence.match_iou]
            own = [d for d in covering if not is_anothers(d)]
            if covering and not own:
                continue
            hidden = hidden_share(box, [d for d in found if d not in own])
            score = max((d.score for d in own), default=None)
            looks[side].append(Look(height_px=box[3] - box[1], hidden=hidden, score=score))
    return existence_from_images(looks.values(), params, evidence)


def existence_from_images(looks: Iterable[Sequence[Look]], params: IngestParams, evidence: DetectorEvidence) -> float:
    """Belief (0 to 1) in a cone from the looks of each camera, in the order in which they were taken."""
    threshold, limits = params.detection.score_threshold, params.track
    lookalikes = false_boxes_per_image(evidence, params.reconcile.visible_min_height_px, threshold)
    prior = float(np.log(limits.expected_cones_per_picture / lookalikes))
    parts = [part for side in looks for part in _ratios(side, params, evidence)]
    ratios, heights_px = np.array(parts, dtype=np.float64).reshape(-1, 2).T
    log_odds = prior + joint_log_ratio(evidence, ratios, heights_px)
    return float(1 / (1 + np.exp(-np.clip(log_odds, -30, 30))))


def _ratios(looks: Sequence[Look], params: IngestParams, evidence: DetectorEvidence) -> list[tuple[float, float]]:
    """(log-likelihood ratio, apparent height in px) of every box and of every run of misses of one camera."""
    threshold, limits = params.detection.score_threshold, params.track
    parts: list[tuple[float, float]] = []
    run: list[tuple[float, float]] = []
    for look in looks:
        if look.hidden > evidence.hidden_most and look.score is None:
            continue  # it could not have been seen: neither evidence nor the end of a run
        missed = miss_log_ratio(evidence, look.height_px, look.hidden, threshold)
        if look.score is None:
            run.append((missed, look.height_px))
            continue
        ratio = box_log_ratio(evidence, look.score, look.height_px, look.hidden, limits.score_doubt)
        parts += [*_run_of_misses(run, limits.hidden_run_probability), (max(ratio, missed), look.height_px)]
        run = []
    # A weak box is never worse than none (max): half a cone behind a post gets weak boxes, which the scores of whole ones miss.
    return [*parts, *_run_of_misses(run, limits.hidden_run_probability)]


def _run_of_misses(run: Sequence[tuple[float, float]], hidden_probability: float) -> list[tuple[float, float]]:
    """Misses running as one look: hidden all the time, when they say nothing, or in plain view, when they add up."""
    if not run:
        return []
    total = sum(ratio for ratio, _ in run)
    either = float(np.logaddexp(np.log(hidden_probability), np.log1p(-hidden_probability) + total))
    return [(either, float(np.median([height_px for _, height_px in run])))]


def _middle(box: Box) -> tuple[float, float]:
    return (box[0] + box[2]) / 2, (box[1] + box[3]) / 2


def _boxes(
    group: Sequence[Position],
    cone_height_m: float,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    params: IngestParams,
) -> dict[Side, list[tuple[int, Box]]]:
    """Frame indices, rising, in which the cone should show in a camera's image, and where."""
    frames = np.array(sorted(map_SE3_left))
    poses = np.array([map_SE3_left[n] for n in frames.tolist()])
    known = sorted(group, key=lambda p: p.frame_index)
    seen = np.array([p.frame_index for p in known])
    after = np.minimum(np.searchsorted(seen, frames), len(seen) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(frames - seen[before]) <= np.abs(seen[after] - frames), before, after)
    # As `association.carry`, for all frames at once.
    starts = np.array([map_SE3_left[p.frame_index] for p in known])[nearest]
    frame_SE3_start = np.linalg.inv(poses) @ starts
    places = np.array([p.camera_xyz_m for p in known])[nearest]
    foot = (frame_SE3_start[:, :3, :3] @ places[:, :, None])[:, :, 0] + frame_SE3_start[:, :3, 3]
    tip = foot + cone_height_m * poses[:, 2, :3]
    right_SE3_left = np.linalg.inv(left_SE3_right(rig))
    rotation, translation = right_SE3_left[:3, :3], right_SE3_left[:3, 3]
    boxes: dict[Side, list[tuple[int, Box]]] = {}
    sides: tuple[tuple[Side, Floats, Floats], ...] = (
        ("left", foot, tip),
        ("right", foot @ rotation.T + translation, tip @ rotation.T + translation),
    )
    for side, of_foot, of_tip in sides:
        camera = camera_of(rig, side)
        all_boxes = apparent_boxes(of_foot, of_tip, camera)
        shown = np.flatnonzero(are_in_view(all_boxes, camera, params.reconcile))
        found = zip(frames[shown].tolist(), all_boxes[shown].tolist(), strict=True)
        boxes[side] = [(n, (x0, y0, x1, y1)) for n, (x0, y0, x1, y1) in found]
    return boxes
