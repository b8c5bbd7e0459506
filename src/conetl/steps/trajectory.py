"""Logged poses and visual odometry -> refined poses with a covariance that also holds between frames.

Errors of GNSS/INS change slowly: first-order Gauss-Markov processes with the stated sigmas, plus a small share that is new in
every record. Visual odometry ties each frame pair to the next; the adjustment itself is `geometry/pose_graph.py`. What visual
odometry says is believed only as far as GNSS/INS may err.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import chain_solver
from conetl.geometry import pose as se3
from conetl.geometry.chain_solver import ChainCovariance
from conetl.geometry.packing import cov_matrix, vec3
from conetl.geometry.pose_graph import (
    POSE,
    LoggedPoses,
    MeasuredMotion,
    Sighting,
    adjust,
    motion_jacobians,
    motion_residual,
    skew,
)
from conetl.geometry.stereo_motion import RelativeMotion
from conetl.params import TrajectoryParams
from conetl.records import FramePair, Pose, Position, Rig

Floats = NDArray[np.float64]
#: Poses stated to be better than this are taken to be this good: zero would have no weight to compare with.
_LEAST_SIGMA_M, _LEAST_SIGMA_RAD, _LEAST_STEP_S = 1e-4, 1e-6, 1e-3
#: Chi-square of 6 degrees of freedom at 1e-6: an interval beyond it contradicts GNSS/INS outright.
_GATE_CHI2 = 38.3
_NEIGHBOURS = 4
_LONE_SIGMAS = 6.0


class RefinementOutcome(StrEnum):
    """What became of a drive's trajectory."""

    REFINED = "refined"
    SWITCHED_OFF = "switched_off"
    NO_MEASUREMENT = "no_measurement"
    AGAINST_STATED_SIGMAS = "against_stated_sigmas"
    NOT_CONVERGED = "not_converged"


@dataclass(frozen=True)
class RefinedTrajectory:
    """Poses of a drive after the adjustment, or as logged, with their joint covariance (`relative_cov`)."""

    frame_pairs: tuple[FramePair, ...]
    """As given, with new poses where `outcome` is REFINED; their sigmas are those of the adjustment."""
    outcome: RefinementOutcome
    detail: str
    """One sentence for a person."""
    map_SE3_left: Floats
    """(K, 4, 4) of these poses."""
    body_SE3_left: Floats
    """(4, 4)"""
    covariance: ChainCovariance | None
    """Of the states; None unless refined."""
    used_intervals: int
    refused_intervals: tuple[int, ...]
    """First frame index of each measured interval that contradicts its neighbours or GNSS/INS."""
    largest_shift_m: float


def refine_trajectory(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    params: TrajectoryParams,
    cones: Sequence[Sequence[Position]] = (),
) -> RefinedTrajectory:
    """Adjust a drive's poses to visual odometry and, where given, to groups of positions of one cone each.

    motions: any subset of the drive's intervals, each once. Without any, and where the adjustment would move a pose by more than
    its stated sigmas allow, the poses stay as they are and `outcome` says why.
    """
    if not params.refine:
        return _as_logged(frame_pairs, rig, RefinementOutcome.SWITCHED_OFF, "refinement is switched off")
    log = _read_log(frame_pairs, rig, params)
    measured = _measured(frame_pairs, motions, params)
    if not measured:
        return _as_logged(
            frame_pairs, rig, RefinementOutcome.NO_MEASUREMENT, "no two consecutive frame pairs could be compared"
        )
    kept, refused = _check_intervals(log, measured)
    refused_frames = tuple(frame_pairs[m.start].frame_index for m in refused)
    if not kept:
        detail = f"all {len(measured)} measured motions contradict GNSS/INS or each other"
        return _as_logged(frame_pairs, rig, RefinementOutcome.NO_MEASUREMENT, detail, refused_frames)
    sightings = _sightings(frame_pairs, cones)
    solved = adjust(log, kept, sightings, params.robust_sigmas, params.scale_sigma)
    if solved is None:
        detail = "the adjustment did not settle"
        return _as_logged(frame_pairs, rig, RefinementOutcome.NOT_CONVERGED, detail, refused_frames)
    rotations, places, normal = solved
    shift = places - log.places
    turn = Rotation.from_matrix(np.swapaxes(log.rotations, 1, 2) @ rotations).as_rotvec()
    worst = float(np.max(np.sum((shift / log.sigma_p) ** 2, axis=1)))
    if worst > params.max_shift_chi2:
        detail = (
            f"visual odometry would move a pose by {worst**0.5:.1f} of its stated sigmas, allowed are "
            f"{params.max_shift_chi2**0.5:.1f}; the stated accuracy of GNSS/INS or the calibration is too good to be true"
        )
        return _as_logged(frame_pairs, rig, RefinementOutcome.AGAINST_STATED_SIGMAS, detail, refused_frames)
    cov = chain_solver.covariance(normal)
    sigma = np.sqrt(np.diagonal(cov.cov, axis1=1, axis2=2)[:, :POSE])
    pairs = tuple(
        pair.model_copy(
            update={
                "pose": Pose(
                    map_R_body=se3.to_matrix3(rotations[k]),
                    map_t_body_m=vec3(places[k]),
                    sigma_enu_m=vec3(sigma[k, :3]),
                    sigma_rpy_rad=vec3(sigma[k, 3:]),
                )
            }
        )
        for k, pair in enumerate(frame_pairs)
    )
    largest = float(np.linalg.norm(shift, axis=1).max())
    detail = (
        f"{len(kept)} of {len(frame_pairs) - 1} intervals measured, {len(refused)} refused; poses moved by up to {largest:.2f} m "
        f"and {np.degrees(np.abs(turn).max()):.2f} degrees"
    )
    return RefinedTrajectory(
        pairs, RefinementOutcome.REFINED, detail, se3.compose(se3.se3(rotations, places), log.body_SE3_left),
        log.body_SE3_left, cov, len(kept), refused_frames, largest,
    )  # fmt: skip


def relative_cov(trajectory: RefinedTrajectory, start: int, end: int) -> Floats | None:
    """(6, 6) covariance of the left camera's motion between two frame pairs, None where nothing is known of it.

    start, end: places in `frame_pairs` (not frame indices), in any order. Error (rotation rad, translation m) of end_SE3_start,
    in the left camera's frame at `end`.
    """
    if trajectory.covariance is None:
        return None
    joint = trajectory.covariance
    first, second = min(start, end), max(start, end)
    cross = chain_solver.cross_covariance(joint, first, second)[:POSE, :POSE]
    cross = cross if start <= end else cross.T
    from_start, from_end = motion_jacobians(
        trajectory.map_SE3_left[start], trajectory.map_SE3_left[end], trajectory.body_SE3_left
    )
    mixed = from_start @ cross @ from_end.T
    cov = (
        from_start @ joint.cov[start][:POSE, :POSE] @ from_start.T
        + from_end @ joint.cov[end][:POSE, :POSE] @ from_end.T
        + mixed
        + mixed.T
    )
    return np.asarray((cov + cov.T) / 2)


def carried_cov_m2(trajectory: RefinedTrajectory, start: int, end: int, point_m: Floats) -> Floats | None:
    """(3, 3) covariance that the motion adds to a point (3,) of the left camera's frame at `start`, seen in that at `end`.

    start, end: frame indices. None where the trajectory was not refined or does not hold both.
    """
    rank = {pair.frame_index: k for k, pair in enumerate(trajectory.frame_pairs)}
    if start not in rank or end not in rank:
        return None
    cov = relative_cov(trajectory, rank[start], rank[end])
    if cov is None:
        return None
    end_SE3_start = se3.compose(se3.invert(trajectory.map_SE3_left[rank[end]]), trajectory.map_SE3_left[rank[start]])
    by_motion = np.hstack([-skew(end_SE3_start[:3, :3] @ point_m), np.eye(3)])
    return np.asarray(by_motion @ cov @ by_motion.T)


def _read_log(frame_pairs: Sequence[FramePair], rig: Rig, params: TrajectoryParams) -> LoggedPoses:
    sigma_p = np.maximum([pair.pose.sigma_enu_m for pair in frame_pairs], _LEAST_SIGMA_M)
    sigma_a = np.maximum([pair.pose.sigma_rpy_rad for pair in frame_pairs], _LEAST_SIGMA_RAD)
    share = np.repeat([params.gnss_white_share, params.attitude_white_share], 3)
    stated = np.hstack([sigma_p, sigma_a])
    times_s = np.array([pair.captured_at_ns for pair in frame_pairs], dtype=np.float64) * 1e-9
    step_s = np.maximum(np.diff(times_s), _LEAST_STEP_S)
    keep = np.exp(-step_s[:, None] / np.repeat([params.gnss_correlation_s, params.attitude_correlation_s], 3))
    poses = np.stack([se3.map_SE3_body(pair.pose) for pair in frame_pairs])
    return LoggedPoses(
        poses[:, :3, :3], poses[:, :3, 3], sigma_p, sigma_a, np.maximum(share, 1e-3) * stated,
        np.sqrt(np.maximum(1 - share**2, 1e-6)) * stated, keep, np.array(rig.body_SE3_left),
    )  # fmt: skip


def _measured(
    frame_pairs: Sequence[FramePair], motions: Sequence[RelativeMotion], params: TrajectoryParams
) -> list[MeasuredMotion]:
    """Measured intervals with what their residuals do not show added to their covariance."""
    rank = {pair.frame_index: k for k, pair in enumerate(frame_pairs)}
    found: dict[int, MeasuredMotion] = {}
    for motion in motions:
        start, end = rank.get(motion.first_frame_index), rank.get(motion.second_frame_index)
        if motion.second_SE3_first is None or start is None or end != start + 1:
            continue
        pose, cov = np.array(motion.second_SE3_first), motion.cov_matrix()
        way_m = float(np.linalg.norm(pose[:3, 3]))
        cov[:3, :3] += params.floor_rad**2 * np.eye(3)
        cov[3:, 3:] += (params.floor_m**2 + (params.floor_relative * way_m) ** 2) * np.eye(3)
        found[start] = MeasuredMotion(start, pose, cov)
    return [found[k] for k in sorted(found)]


def _check_intervals(
    log: LoggedPoses, motions: Sequence[MeasuredMotion]
) -> tuple[list[MeasuredMotion], list[MeasuredMotion]]:
    """Measured intervals that may be true, and those that are not.

    An interval is refused where it contradicts GNSS/INS beyond what their errors allow, or where it alone departs from its
    neighbours while GNSS/INS runs on smoothly: errors of GNSS/INS do not come and go within one interval.
    """
    departures, measured_way, logged_way, refused = [], [], [], []
    for motion in motions:
        k = motion.start
        residual, from_first, _ = motion_residual(log, log.rotations, log.places, motion, 0.0)
        change = log.slow[k] ** 2 * 2 * (1 - log.keep[k]) + log.white[k] ** 2 + log.white[k + 1] ** 2
        spread = motion.cov + from_first @ np.diag(change) @ from_first.T
        refused.append(float(residual @ np.linalg.solve(spread, residual)) > _GATE_CHI2)
        departures.append(np.concatenate([residual, np.sqrt(np.diag(motion.cov))]))
        measured_way.append(motion.next_SE3_first[:3, 3])
        logged_way.append(motion.next_SE3_first[:3, 3] - residual[3:])
    table = np.array(departures)
    seen, told = np.array(measured_way), np.array(logged_way)
    for i, motion in enumerate(motions):
        near = [
            j
            for j in range(max(0, i - _NEIGHBOURS), min(len(motions), i + _NEIGHBOURS + 1))
            if j != i and abs(motions[j].start - motion.start) <= _NEIGHBOURS
        ]
        if len(near) < _NEIGHBOURS:
            continue
        centre = np.median(table[near, :6], axis=0)
        scatter = 1.4826 * np.median(np.abs(table[near, :6] - centre), axis=0)
        lone = np.abs(table[i, :6] - centre) > _LONE_SIGMAS * np.hypot(scatter, table[i, 6:])
        rougher = np.abs(seen[i] - np.median(seen[near], axis=0)) > np.abs(told[i] - np.median(told[near], axis=0))
        if lone[:3].any() or (lone[3:] & rougher).any():
            refused[i] = True
    return (
        [m for m, bad in zip(motions, refused, strict=True) if not bad],
        [m for m, bad in zip(motions, refused, strict=True) if bad],
    )


def _sightings(frame_pairs: Sequence[FramePair], cones: Sequence[Sequence[Position]]) -> list[Sighting]:
    rank = {pair.frame_index: k for k, pair in enumerate(frame_pairs)}
    return [
        Sighting(
            cone,
            rank[p.frame_index],
            np.array(p.camera_xyz_m),
            np.asarray(np.linalg.inv(cov_matrix(p.camera_cov_m2)), dtype=np.float64),
        )
        for cone, group in enumerate(cones)
        for p in group
        if p.frame_index in rank
    ]


def _information(position: Position) -> Floats:
    return np.asarray(np.linalg.inv(cov_matrix(position.camera_cov_m2)), dtype=np.float64)


def _as_logged(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    outcome: RefinementOutcome,
    detail: str,
    refused: tuple[int, ...] = (),
) -> RefinedTrajectory:
    body_SE3_left = np.array(rig.body_SE3_left)
    poses = np.stack([se3.compose(se3.map_SE3_body(pair.pose), body_SE3_left) for pair in frame_pairs])
    return RefinedTrajectory(tuple(frame_pairs), outcome, detail, poses, body_SE3_left, None, 0, refused, 0.0)
