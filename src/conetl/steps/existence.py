"""How sure a drive is that something it saw is a cone: log-odds over all pictures in which it should show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.packing import cov_matrix
from conetl.geometry.rig import left_SE3_right
from conetl.params import IngestParams
from conetl.records import Detection, Position, Rig, Side
from conetl.steps.association import carry
from conetl.steps.visibility import Box, apparent_box, is_hidden, is_in_view, overlap_px2

Floats = NDArray[np.float64]
#: Pictures follow each other at 10 Hz and come in pairs; they fail together: one in this many counts as independent evidence.
_PICTURES_PER_INDEPENDENT_LOOK = 6.0
#: A score of this size speaks neither for nor against a cone: street furniture reaches it, cones exceed it.
_NEUTRAL_SCORE = 0.45
#: A cone in plain view is missed in about every second picture where posts hide half of it: ln(0.5 / 0.98).
_MISS_LOGIT = -0.7
#: Misses in a row have one cause (a parked van that is no detection): only so many of them count.
_LONGEST_MISS = 6
_PRIOR_LOGIT = -1.0
_SAME_IOU = 0.3


def existence_probability(
    group: Sequence[Position],
    cone_height_m: float,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    detections: Mapping[int, Sequence[Detection]],
    params: IngestParams,
) -> float:
    """Belief (0 to 1) that the positions of `group` are a cone.

    Every picture in which it should be in plain view speaks: by the score of the box where it should be, or by the lack of
    one. Where it should be is carried over from the nearest frame of the group by the relative motion, so that a sliding
    trajectory does not turn hits into misses. map_SE3_left: (4, 4) by frame index; detections: of both images.
    """
    evidence = 0.0
    misses: dict[Side, int] = {"left": 0, "right": 0}
    for frame_index in map_SE3_left:
        for side, box in _boxes(frame_index, group, cone_height_m, rig, map_SE3_left, params).items():
            found = [d for d in detections.get(frame_index, ()) if d.side == side]
            scores = [d.score for d in found if _iou(box, d) >= _SAME_IOU]
            if scores:  # a weak box is never worse than none
                evidence += max(_logit(max(scores)) - _logit(_NEUTRAL_SCORE), _MISS_LOGIT)
                misses[side] = 0
            elif not any(is_hidden(box, d) for d in found):
                misses[side] += 1
                evidence += _MISS_LOGIT if misses[side] <= _LONGEST_MISS else 0.0
    logit = _PRIOR_LOGIT + evidence / _PICTURES_PER_INDEPENDENT_LOOK
    return float(1 / (1 + np.exp(-np.clip(logit, -30, 30))))


def _boxes(
    frame_index: int,
    group: Sequence[Position],
    cone_height_m: float,
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    params: IngestParams,
) -> dict[Side, Box]:
    """Where the cone should show in the two pictures of one frame pair, as far as it is in view there."""
    nearest = min(group, key=lambda p: abs(p.frame_index - frame_index))
    foot, _ = carry(
        np.array(nearest.camera_xyz_m),
        cov_matrix(nearest.camera_cov_m2),
        nearest.frame_index,
        frame_index,
        map_SE3_left,
        params.track,
    )
    tip = foot + cone_height_m * map_SE3_left[frame_index][2, :3]
    right_SE3_left = np.linalg.inv(left_SE3_right(rig))
    rotation, translation = right_SE3_left[:3, :3], right_SE3_left[:3, 3]
    boxes: dict[Side, Box] = {}
    left = apparent_box(foot, tip, rig.left)
    right = apparent_box(rotation @ foot + translation, rotation @ tip + translation, rig.right)
    if left is not None and is_in_view(left, rig.left, params.reconcile):
        boxes["left"] = left
    if right is not None and is_in_view(right, rig.right, params.reconcile):
        boxes["right"] = right
    return boxes


def _iou(box: Box, detection: Detection) -> float:
    shared = overlap_px2(box, detection)
    x0, y0, x1, y1 = box
    return shared / ((x1 - x0) * (y1 - y0) + detection.w_px * detection.h_px - shared)


def _logit(probability: float) -> float:
    p = float(np.clip(probability, 0.02, 0.98))
    return float(np.log(p / (1 - p)))
