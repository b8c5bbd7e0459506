"""Probability that a group of positions is a cone: log-likelihood ratios of all images in which it should be visible.

The alternative to a cone is a lookalike, an object that is not a cone but has boxes now and then. Both were measured for the
detector in use (`model/detector_evidence.py`):

- prior odds: expected cones over false boxes, per image;
- a box at the expected location: p(box with this score | cone, apparent height, hidden share) over that of a lookalike;
- no box: (1 - P(detect | height, hidden)) over (1 - P(box | lookalike)). Successive misses of one camera may have one cause, an
  undetected object in front: with a small probability the whole run is no evidence;
- a box that belongs to other positions: if only such a box covers the location, the image is not evidence;
- images of one object are correlated, most at equal apparent heights (`joint_log_ratio`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from conetl.geometry.rig import left_SE3_right
from conetl.geometry.small_arrays import nearest_index
from conetl.model.arrays import Floats
from conetl.model.detector_evidence import (
    DetectorEvidence,
    box_log_ratio,
    false_boxes_per_image,
    joint_log_ratio,
    miss_log_ratio,
)
from conetl.model.drive import Detection, Position
from conetl.model.feature_classes import CONE
from conetl.model.params import IngestParams
from conetl.model.rig import Camera, Rig, Side
from conetl.tracking.matching.apparent_boxes import Box, apparent_boxes, are_in_view, hidden_share, iou
from conetl.tracking.matching.epipolar_search import is_within, right_region


@dataclass(frozen=True)
class ImageEvidence:
    """One image in which the cone should be visible."""

    height_px: float
    """Expected apparent height."""
    hidden: float
    """Share of the expected box behind nearer detections."""
    score: float | None
    """Of the best box at the expected location; None without a box."""


def existence_probability(
    group: Sequence[Position],
    object_height_m: float,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    detections: Mapping[int, Sequence[Detection]],
    params: IngestParams,
    evidence: DetectorEvidence,
    is_of_other: Callable[[Detection], bool],
    category: str = CONE,
) -> float:
    """Probability (0 to 1) that the positions of `group` are an object of a category.

    Every left image in which it should be fully visible counts, and every right one that was searched there. The expected
    location is transformed from the nearest frame of the group by the relative motion, so that a drifting trajectory causes no
    misses. map_SE3_left: (4, 4) by frame index; detections: of both images, by frame index; is_of_other: whether a box belongs to
    another group.
    """
    images: dict[Side, list[ImageEvidence]] = {"left": [], "right": []}
    for side, in_view in _boxes(group, object_height_m, rig, map_SE3_left, params, category).items():
        for frame_index, box in in_view:
            of_pair = detections.get(frame_index, ())
            middle = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
            if side == "right" and not is_within(*middle, right_region(of_pair, rig, params)):
                continue  # whether a right image counts must follow from the left one only
            found = [d for d in of_pair if d.side == side]
            covering = [d for d in found if iou(box, d) >= evidence.match_iou]
            own = [d for d in covering if not is_of_other(d)]
            if covering and not own:
                continue
            hidden = hidden_share(box, [d for d in found if d not in own])
            score = max((d.score for d in own), default=None)
            images[side].append(ImageEvidence(height_px=box[3] - box[1], hidden=hidden, score=score))
    return existence_from_images(images.values(), params, evidence)


def existence_from_images(
    images: Iterable[Sequence[ImageEvidence]], params: IngestParams, evidence: DetectorEvidence
) -> float:
    """Probability (0 to 1) of a cone from the images of each camera, by time."""
    threshold, limits = params.detection.score_threshold, params.track
    lookalikes = false_boxes_per_image(evidence, params.reconcile.visible_min_height_px, threshold)
    prior = float(np.log(limits.expected_cones_per_picture / lookalikes))
    parts = [part for side in images for part in _ratios(side, params, evidence)]
    ratios, heights_px = np.array(parts, dtype=np.float64).reshape(-1, 2).T
    log_odds = prior + joint_log_ratio(evidence, ratios, heights_px)
    return float(1 / (1 + np.exp(-np.clip(log_odds, -30, 30))))


def _ratios(
    images: Sequence[ImageEvidence], params: IngestParams, evidence: DetectorEvidence
) -> list[tuple[float, float]]:
    """(log-likelihood ratio, apparent height in px) of every box and of every run of misses of one camera."""
    threshold, limits = params.detection.score_threshold, params.track
    parts: list[tuple[float, float]] = []
    run: list[tuple[float, float]] = []
    for image in images:
        if image.hidden > evidence.hidden_most and image.score is None:
            continue  # neither evidence nor the end of a run
        missed = miss_log_ratio(evidence, image.height_px, image.hidden, threshold)
        if image.score is None:
            run.append((missed, image.height_px))
            continue
        ratio = box_log_ratio(evidence, image.score, image.height_px, image.hidden, limits.score_doubt)
        parts += [*_run_of_misses(run, limits.hidden_run_probability), (max(ratio, missed), image.height_px)]
        run = []
    # A weak box is never worse than none (max): the scores of whole cones do not describe a half-hidden one.
    return [*parts, *_run_of_misses(run, limits.hidden_run_probability)]


def _run_of_misses(run: Sequence[tuple[float, float]], hidden_probability: float) -> list[tuple[float, float]]:
    """A run of misses as one image: hidden throughout and no evidence, or visible and their sum."""
    if not run:
        return []
    total = sum(ratio for ratio, _ in run)
    either = float(np.logaddexp(np.log(hidden_probability), np.log1p(-hidden_probability) + total))
    return [(either, float(np.median([height_px for _, height_px in run])))]


def _boxes(
    group: Sequence[Position],
    object_height_m: float,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    params: IngestParams,
    category: str,
) -> dict[Side, list[tuple[int, Box]]]:
    """Frame indices, rising, and boxes where the cone should be in a camera's image."""
    frames = np.array(sorted(map_SE3_left))
    poses = np.array([map_SE3_left[n] for n in frames.tolist()])
    known = sorted(group, key=lambda p: p.frame_index)
    observed = np.array([p.frame_index for p in known])
    start = nearest_index(observed, frames)
    # Like `CameraMotion.carry`, for all frames at once.
    starts = np.array([map_SE3_left[p.frame_index] for p in known])[start]
    frame_SE3_start = np.linalg.inv(poses) @ starts
    feet = np.array([p.camera_xyz_m for p in known])[start]
    foot = (frame_SE3_start[:, :3, :3] @ feet[:, :, None])[:, :, 0] + frame_SE3_start[:, :3, 3]
    tip = foot + object_height_m * poses[:, 2, :3]
    right_SE3_left = np.linalg.inv(left_SE3_right(rig))
    rotation, translation = right_SE3_left[:3, :3], right_SE3_left[:3, 3]

    def shown(points: tuple[Floats, Floats], camera: Camera) -> list[tuple[int, Box]]:
        boxes = apparent_boxes(*points, camera, category)
        rows = np.flatnonzero(are_in_view(boxes, camera, params.reconcile))
        return [
            (n, (x0, y0, x1, y1))
            for n, (x0, y0, x1, y1) in zip(frames[rows].tolist(), boxes[rows].tolist(), strict=True)
        ]

    in_right = foot @ rotation.T + translation, tip @ rotation.T + translation
    return {"left": shown((foot, tip), rig.left), "right": shown(in_right, rig.right)}
