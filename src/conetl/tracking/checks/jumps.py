"""Health checks of the poses for jumps: GNSS/INS moves or turns between frame pairs where the images do not.

All take the drive's frame pairs as logged, its measured motions, and which of these are plausible (M,).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.motion.pose_graph import MeasuredMotions
from conetl.geometry.motion.steps import unexplained_step_m
from conetl.geometry.motion.stereo_tracks import PAUSE_S, expected_motions
from conetl.geometry.rig import map_SE3_left
from conetl.model.arrays import Bools
from conetl.model.check_params import JumpCheckParams
from conetl.model.drive import FramePair
from conetl.model.health import Finding
from conetl.model.rig import Rig

JUMPS = "jumps of the poses"
#: Where no motion was measured, a jump of the attitude is beyond what a vehicle may gain in turn rate (rad/s^2) against this many
#: neighbours on each side.
_TURN_ACCELERATION, _NEIGHBOURS = 1.0, 4
#: Least time between two frame pairs.
_LEAST_STEP_S = 1e-3


def check_jumps(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    measured: MeasuredMotions,
    good: Bools,
    limits: JumpCheckParams,
    clock_sigma_s: float,
) -> Finding:
    """The interval in which the log moves most unlike the images or, where these do not show it, unlike the intervals around.

    Whatever the spectrum of its errors, both ends of a step err by the stated sigmas.
    """
    times_s = np.array([pair.captured_at_ns - frame_pairs[0].captured_at_ns for pair in frame_pairs]) * 1e-9
    times_s = np.maximum.accumulate(times_s + _LEAST_STEP_S * np.arange(len(times_s)))
    left = np.array([map_SE3_left(pair.pose, rig) for pair in frame_pairs])
    steps_m, speeds = np.diff(left[:, :3, 3], axis=0), np.full((len(left) - 1, 3), np.nan)
    start, in_images_m, step_s = measured.start, np.full_like(steps_m, np.nan), np.diff(times_s)
    in_images_m[start] = se3.compose(left[start], se3.invert(measured.next_SE3_first))[:, :3, 3] - left[start, :3, 3]
    speeds[start[good]] = (in_images_m / step_s[:, None])[start[good]]
    sigma_m = np.array([(max(pair.pose.sigma_enu_m[:2]), pair.pose.sigma_enu_m[2]) for pair in frame_pairs])
    sigma_m[:, 0] = np.hypot(sigma_m[:, 0], clock_sigma_s * float(np.median(np.linalg.norm(steps_m, axis=1) / step_s)))
    worst_m, worst = 0.0, 0
    for k in range(len(steps_m)):
        errors_m = np.maximum(limits.least_m, limits.sigmas * np.hypot(*sigma_m[k : k + 2]))
        off_m = 0.0
        if np.isnan(speeds[k, 0]):
            off_m = unexplained_step_m(steps_m, speeds, times_s, k, errors_m)
        if step_s[k] > PAUSE_S or not np.isnan(speeds[k, 0]):
            east_m, north_m, up_m = steps_m[k] - in_images_m[k]
            if ((np.hypot(east_m, north_m), abs(up_m)) > errors_m).any():
                off_m = float(np.hypot(np.hypot(east_m, north_m), up_m))
        if off_m > worst_m:
            worst_m, worst = off_m, k
    first, second = frame_pairs[worst].frame_index, frame_pairs[worst + 1].frame_index
    return Finding(check=JUMPS, value=worst_m, found=worst_m > 0, facts={"first": first, "second": second})


def check_turn_jumps(
    frame_pairs: Sequence[FramePair], rig: Rig, measured: MeasuredMotions, good: Bools, limits: JumpCheckParams
) -> Finding:
    """Intervals that no accepted motion confirms, and in which the log does not turn like the images or the intervals around.

    A wrong measured motion is rejected too: then that motion differs from its neighbours.
    """
    to_camera = np.array(rig.body_SE3_left)[:3, :3].T ** 2
    sigma = np.sqrt(np.array([pair.pose.sigma_rpy_rad for pair in frame_pairs]) ** 2 @ to_camera.T)
    times_s = np.array([pair.captured_at_ns - frame_pairs[0].captured_at_ns for pair in frame_pairs]) * 1e-9
    step_s = np.maximum(np.diff(times_s), _LEAST_STEP_S)
    logged = Rotation.from_matrix([motion[:3, :3] for motion in expected_motions(frame_pairs, rig)]).as_rotvec()
    accepted, rejected = np.full_like(logged, np.nan), np.full_like(logged, np.nan)
    if len(measured.start):
        turns = Rotation.from_matrix(measured.next_SE3_first[:, :3, :3]).as_rotvec()
        accepted[measured.start[good]], rejected[measured.start[~good]] = turns[good], turns[~good]
    known = ~np.isnan(accepted[:, 0])
    worst, first = 0.0, 0
    for k in np.flatnonzero(~known).tolist():
        begin, end = max(k - _NEIGHBOURS, 0), min(k + _NEIGHBOURS + 1, len(known))
        near = begin + np.flatnonzero(known[begin:end])
        if min((near < k).sum(), (near > k).sum()) < 2:
            continue
        usual = np.median(accepted[near] / step_s[near, None], axis=0) * step_s[k]
        limit = np.maximum(np.radians(limits.turn_deg), limits.sigmas * sigma[k : k + 2].max(axis=0))
        if np.isnan(rejected[k, 0]):
            off = np.abs(logged[k] - usual)
            limit = limit + _TURN_ACCELERATION * step_s[k] * (times_s[end] - times_s[begin]) / 8
        else:
            log_is_odd = np.abs(logged[k] - usual) > np.abs(rejected[k] - usual)
            off = np.abs(logged[k] - rejected[k]) * log_is_odd
        beyond = off[off > limit]
        if len(beyond) and beyond.max() > worst:
            worst, first = float(beyond.max()), k
    frames = {"first": frame_pairs[first].frame_index, "second": frame_pairs[first + 1].frame_index}
    return Finding(check="jumps of the attitude", value=float(np.degrees(worst)), found=worst > 0, facts=frames)
