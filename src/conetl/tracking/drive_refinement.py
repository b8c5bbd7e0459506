"""Refinement of a whole drive: its clock, its poses by visual odometry and by cones, and the errors that all its poses share.

`trajectory.py` has the adjustment itself, `control_points.py` decides which cones stand on control points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.motion import chain_solver
from conetl.geometry.motion.chain_solver import ChainCovariance, cross_covariance
from conetl.geometry.motion.pose_graph import POSE, STATE, LoggedPoses
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.packing import cov3, cov_matrix, vec3
from conetl.geometry.rig import map_SE3_left
from conetl.model.drive import FramePair, Position, StereoMatch
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.model.rig import Rig
from conetl.tracking.association import CameraMotion, chain_positions
from conetl.tracking.clock import ClockOffset, at_images, estimate_clock
from conetl.tracking.error_propagation import motion_error
from conetl.tracking.positions import locate_positions
from conetl.tracking.rolling_shutter import row_time_sigma_s
from conetl.tracking.trajectory import (
    LEAST_STEP_S,
    ControlCone,
    RefinedTrajectory,
    RefinementOutcome,
    is_by_course,
    measured_motions,
    read_log,
    refine_trajectory,
)

#: Neighbouring observations of a cone are correlated (background, sun, calibration): this many count as one.
_CORRELATED = 4.0
#: Poses that change by less (m) within a drive have common errors only, by as many frames.
_LEAST_CHANGE_M, _COMPARED = 0.005, 9
#: Offsets of the clocks beside a course: each finds what the adjustment before it had put into the attitudes.
_ROUNDS = 3


def refine_with_cones(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    matches: Sequence[StereoMatch],
    params: IngestParams,
    control: Sequence[ControlCone] = (),
) -> RefinedTrajectory:
    """Refined poses by visual odometry, by cones observed often enough to be tracks, and by those on control points.

    Visual odometry follows points that change from frame to frame, and a calibration error scales all its distances; a cone is
    one fixed point in many frames. The poses are those of the adjustment with cones, their covariance that of the adjustment
    without: the same observations make the tracks afterwards and must count only once. Those on control points do count.

    A clock that the drive shows to be off is corrected first; its remaining offset, and the error of the lever arm, are in
    the covariance. frame_pairs: as logged. motions: as for `refine_trajectory`. The result is that of visual odometry alone
    without `trajectory.cone_landmarks`, beside good GNSS/INS, without such cones, and if the adjustment with cones fails.
    """
    log = read_log(frame_pairs, rig, params.trajectory)
    clock = _clock(frame_pairs, rig, motions, log, params.trajectory) if params.trajectory.refine else None
    if clock is not None and clock.is_applied(params.trajectory.clock_sigma_s):
        frame_pairs = at_images(frame_pairs, log, clock.offset_s)
    refined = refine_trajectory(frame_pairs, rig, motions, params.trajectory, control=control)
    if cones := _landmarks(refined, frame_pairs, rig, matches, params, control):
        together = refine_trajectory(frame_pairs, rig, motions, params.trajectory, cones, control, refined)
        if together.outcome is RefinementOutcome.REFINED:
            refined = replace(together, detail=f"{together.detail}; point objects used as landmarks: {len(cones)}")
    refined = replace(refined, clock=clock, logged=tuple(frame_pairs))
    if refined.covariance is None:
        return refined
    return _with_common_errors(refined, params.trajectory, row_time_sigma_s(matches, rig))


def _landmarks(
    alone: RefinedTrajectory, frame_pairs: Sequence[FramePair], rig: Rig, matches: Sequence[StereoMatch],
    params: IngestParams, control: Sequence[ControlCone],
) -> list[tuple[Position, ...]]:  # fmt: skip
    """Cones that take part in the adjustment, beside those on control points. alone: the poses without them; frame_pairs: as
    logged."""
    if not params.trajectory.cone_landmarks or alone.outcome is not RefinementOutcome.REFINED:
        return []
    if np.median([max(pair.pose.sigma_enu_m[:2]) for pair in frame_pairs]) < params.trajectory.cone_landmarks_from_m:
        return []
    known = {(p.frame_index, p.match_index) for cone in control for p in cone.positions}
    groups = cone_groups(alone, rig, matches, params)
    return [group for group in groups if known.isdisjoint((p.frame_index, p.match_index) for p in group)]


def _clock(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    log: LoggedPoses,
    params: TrajectoryParams,
) -> ClockOffset | None:
    """The offset of the clocks; beside a course with the attitudes of an adjustment, which depend on the offset themselves.

    An antenna behind the rear axle turns after the vehicle does, by as much as a clock that is 0.1 s off.
    """
    measured = measured_motions(frame_pairs, motions, params)
    if not is_by_course(frame_pairs):
        return estimate_clock(frame_pairs, log, measured)
    shifted, clock = frame_pairs, None
    for _ in range(_ROUNDS):
        left = refine_trajectory(shifted, rig, motions, params).map_SE3_left[:, :3, :3]
        adjusted = replace(log, rotations=left @ log.body_SE3_left[:3, :3].T)
        clock = estimate_clock(frame_pairs, adjusted, measured, by_speeds=True)
        if clock is None or not clock.is_applied(params.clock_sigma_s):
            break
        shifted = at_images(frame_pairs, log, clock.offset_s)
    return clock


def _with_common_errors(
    refined: RefinedTrajectory, params: TrajectoryParams, row_time_s: float = 0.0
) -> RefinedTrajectory:
    """The trajectory with the errors that move all poses together: of clock, lever arm and rows of unknown time
    (`row_time_sigma_s`). Where images and log show different paths, the log may have drifted by the difference.
    """
    assert refined.covariance is not None
    poses = np.stack([se3.map_SE3_body(pair.pose) for pair in refined.frame_pairs])
    times_s = np.array([pair.captured_at_ns for pair in refined.frame_pairs], dtype=np.float64) * 1e-9
    turn = Rotation.from_matrix(np.swapaxes(poses[:-1, :3, :3], 1, 2) @ poses[1:, :3, :3]).as_rotvec()
    steps = np.hstack([np.diff(poses[:, :3, 3], axis=0), turn]) / np.maximum(np.diff(times_s), LEAST_STEP_S)[:, None]
    drifts = refined.path.drifts() if refined.path is not None else np.zeros((len(poses), 3, 0))
    reach = np.zeros((len(poses), STATE, 4 + drifts.shape[2]))
    reach[:, :POSE, 0] = (np.vstack([steps[:1], steps]) + np.vstack([steps, steps[-1:]])) / 2
    reach[:, :3, 1:4], reach[:, :3, 4:] = poses[:, :3, :3], drifts
    clock_s = params.clock_sigma_s if refined.clock is None else refined.clock.remaining_s(params.clock_sigma_s)
    clock_s = float(np.hypot(clock_s, row_time_s))
    sigmas = np.array([clock_s, *[params.lever_arm_sigma_m] * 3, *[1.0] * drifts.shape[2]])
    cov = chain_solver.with_common_errors(refined.covariance, reach, sigmas)
    sigma = np.sqrt(cov.variances[:, :POSE])
    pairs = tuple(
        pair.with_pose(sigma_enu_m=vec3(own[:3]), sigma_rpy_rad=vec3(own[3:]))
        for pair, own in zip(refined.frame_pairs, sigma, strict=True)
    )
    return replace(refined, frame_pairs=pairs, covariance=cov, changes=_most_change_m(cov) > _LEAST_CHANGE_M)


def _most_change_m(cov: ChainCovariance) -> float:
    """Largest sigma of the change of a coordinate from the middle of the drive to some other frames."""
    last, middle = len(cov.chain) - 1, len(cov.chain) // 2
    variances = [
        np.diag(cov.of(k) + cov.of(middle) - 2 * cross_covariance(cov, min(k, middle), max(k, middle)))[:3]
        for k in evenly_spaced(range(last + 1), _COMPARED)
    ]
    return float(np.sqrt(np.max(variances, initial=0.0)))


def cone_groups(
    trajectory: RefinedTrajectory, rig: Rig, matches: Sequence[StereoMatch], params: IngestParams
) -> list[tuple[Position, ...]]:
    """The positions of each cone that is observed often enough to be a track, with covariances as of landmarks."""
    refined = [match for match in matches if match.refined]
    positions, _ = locate_positions(refined, trajectory.frame_pairs, rig, params.position)
    left = {pair.frame_index: map_SE3_left(pair.pose, rig) for pair in trajectory.frame_pairs}
    groups = chain_positions(positions, CameraMotion(left, params.track, motion_error(trajectory)))
    return [tuple(map(_down_weighted, group)) for group in groups if len(group) >= params.track.min_observations]


def _down_weighted(position: Position) -> Position:
    return position.model_copy(update={"camera_cov_m2": cov3(_CORRELATED * cov_matrix(position.camera_cov_m2))})
