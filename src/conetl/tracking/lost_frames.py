"""A health check for frames that both cameras lose or repeat within a drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.geometry.linear_reference import evenly_spread
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import expected_motions, motions_between, motions_of
from conetl.geometry.packing import vec3
from conetl.model.drive import FramePair
from conetl.model.health import HealthCheck, hold_if
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig
from conetl.perception.visual_odometry import follow_drive
from conetl.perception.working_size import ImageReader

#: A lost frame shows where the log moves so far (m) in an interval, at an even speed; at most so many intervals are tried.
_LEAST_STEP_M, _UNEVEN_SHARE, _MOST_TRIED = 0.3, 0.2, 40


def check_lost_frames(
    pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    read: ImageReader,
    params: TrajectoryParams,
) -> HealthCheck:
    """Whether the images move twice or half as far as an even log between two frame pairs: both cameras lost a frame, or repeated
    one, and all later images are of other poses than their numbers or time stamps say.

    At speed such an interval is measured only from a guess of that length, so that those that were not are followed again.
    read: grey images of a frame pair.
    """
    at_s = np.array([pair.captured_at_ns - pairs[0].captured_at_ns for pair in pairs]) * 1e-9
    lengths_m = np.linalg.norm(np.diff([pair.pose.map_t_body_m for pair in pairs], axis=0), axis=1)
    speeds = lengths_m / np.maximum(np.diff(at_s), 1e-6)
    even = np.abs(speeds[1:-1] - (speeds[:-2] + speeds[2:]) / 2) < _UNEVEN_SHARE * speeds[1:-1]
    measured = motions_between(pairs, motions)
    ratios = np.array([np.nan if motion is None else _length_m(motion) for motion in measured])
    ratios /= [max(float(np.linalg.norm(expected[:3, 3])), 1e-6) for expected in expected_motions(pairs, rig)]
    usual = np.abs(ratios - 1) < 2 * _UNEVEN_SHARE
    alone = even & usual[:-2] & ~usual[1:-1] & usual[2:] & (lengths_m[1:-1] > _LEAST_STEP_M)
    suspected = (np.flatnonzero(alone) + 1).tolist()
    found = [
        pairs[k + 1].frame_index
        for k in evenly_spread(suspected, _MOST_TRIED)
        if any(
            _is_about(ratios[k], factor)
            or (np.isnan(ratios[k]) and _moves_by(factor, pairs[k], pairs[k + 1], rig, read, params))
            for factor in (2.0, 0.5)
        )
    ]
    detail = "No frame is lost or repeated by both cameras."
    if found:
        detail = (
            f"Both cameras lost a frame or repeated one before frame pair {found[0]}: there the images move twice or half as far "
            "as GNSS/INS, and all later ones are of other poses than their numbers say. Correct the numbers or time stamps of "
            "the images."
        )
    return hold_if(found, "frames lost by both cameras", detail, value=float(len(found)), limit=0.0)


def _moves_by(
    factor: float, first: FramePair, second: FramePair, rig: Rig, read: ImageReader, params: TrajectoryParams
) -> bool:
    """Whether the images of two frame pairs show so many times the motion of their poses."""
    start, end = np.array(first.pose.map_t_body_m), np.array(second.pose.map_t_body_m)
    guess = second.pose.model_copy(update={"map_t_body_m": vec3(start + factor * (end - start))})
    both = (first, second.model_copy(update={"pose": guess}))
    [motion] = motions_of(follow_drive(both, rig, read, params), both, rig, params)
    expected_m = float(np.linalg.norm(expected_motions(both, rig)[0][:3, 3]))
    return _is_about(_length_m(motion) / expected_m, 1.0)


def _length_m(motion: RelativeMotion) -> float:
    """NaN of a motion that was not measured."""
    return (
        np.nan if motion.second_SE3_first is None else float(np.linalg.norm(np.array(motion.second_SE3_first)[:3, 3]))
    )


def _is_about(ratio: float, factor: float) -> bool:
    return bool(abs(ratio - factor) < _UNEVEN_SHARE * factor)
