"""Logged poses and visual odometry -> refined poses with a joint covariance.

`log_errors.py` has the model of GNSS/INS errors, which is estimated for each drive. Visual odometry connects successive frame
pairs; `geometry/motion/pose_graph.py` has the adjustment. Motions that contradict GNSS/INS beyond its errors are rejected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.motion import chain_solver
from conetl.geometry.motion.chain_solver import ChainCovariance
from conetl.geometry.motion.pose_graph import (
    POSE,
    LandmarkObservation,
    LandmarkPrior,
    LoggedPoses,
    MeasuredMotions,
    Measurements,
    adjust,
    adjust_with_cones,
)
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.packing import cov_matrix
from conetl.model.arrays import Bools, Floats
from conetl.model.drive import FramePair, Position
from conetl.model.health import Finding
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig
from conetl.tracking.clock import ClockOffset
from conetl.tracking.log.log_errors import (
    LogErrors,
    StatedErrors,
    assumed_errors,
    estimate_log_errors,
    rough_errors,
    sigma_levels,
)
from conetl.tracking.log.path_difference import rising
from conetl.tracking.log.path_fit import PathFit, fit_path
from conetl.tracking.log.plausible_motions import log_steps, plausible_motions

#: Least sigmas (m, rad) and time step (s): zero would have no finite weight.
_LEAST_SIGMA_M, _LEAST_SIGMA_RAD, LEAST_STEP_S, _LEAST_SHARE = 1e-4, 1e-6, 1e-3, 1e-6
#: Visual odometry turns about the optical axis by this much per metre (one sigma) in all intervals: points are followed less
#: well where the road comes nearer. Recorded attitudes hold it, a course does not show it.
_TURN_RAD_PER_M = 5e-5
#: Share of the motions that has to be plausible for the others to be wrong.
_MOST = 0.5
#: Steps of the smooth error, in its length scales over the root of 3, that leave as much of it as `STEP_CHANGE`.
_SMOOTH_STEP = 1.68
#: The error of interpolation comes and goes between two records: from one of n frame pairs to the next this share over n of it.
_CHANGING = 4.0


class RefinementOutcome(StrEnum):
    """Outcome of the refinement of a trajectory."""

    REFINED = "refined"
    SWITCHED_OFF = "switched_off"
    NO_MEASUREMENT = "no_measurement"
    AGAINST_STATED_SIGMAS = "against_stated_sigmas"
    NOT_CONVERGED = "not_converged"


@dataclass(frozen=True)
class RefinedTrajectory:
    """Poses of a drive, adjusted or as logged, with their joint covariance (`error_propagation.relative_cov`)."""

    frame_pairs: tuple[FramePair, ...]
    """With new poses if `outcome` is REFINED; their sigmas are those of the adjustment."""
    outcome: RefinementOutcome
    detail: str
    """One sentence for a person."""
    map_SE3_left: Floats
    """(K, 4, 4) of these poses."""
    body_SE3_left: Floats
    """(4, 4)"""
    covariance: ChainCovariance | None
    """Of the states; None unless refined."""
    path: PathFit | None = None
    """What the path of GNSS/INS and that of the images differ by; None unless refined."""
    clock: ClockOffset | None = None
    """Between cameras and GNSS/INS; None where the drive does not show it."""
    changes: bool = False
    """Whether errors of the poses change within the drive by more than cones err: GNSS/INS may drift, or has few records."""
    logged: tuple[FramePair, ...] = ()
    """Poses as logged, at the instants of the images where the clock was corrected."""
    control: Finding | None = None
    """What the control points say; None without them."""
    errors: LogErrors | None = None
    """Of the log, as the drive shows them; None unless images could be compared with it."""


@dataclass(frozen=True)
class ControlCone:
    """A cone that stands on a control point."""

    positions: tuple[Position, ...]
    xyz_m: Floats
    """(3,) of the point."""
    cov_m2: Floats
    """(3, 3) of the survey, and of what all positions of the cone err in common."""


def refine_trajectory(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    params: TrajectoryParams,
    cones: Sequence[Sequence[Position]] = (),
    control: Sequence[ControlCone] = (),
    alone: RefinedTrajectory | None = None,
) -> RefinedTrajectory:
    """Adjust a drive's poses to visual odometry and, optionally, to groups of positions of one cone each and control points.

    motions: any subset of the drive's intervals, each once. alone: the adjustment without the cones; errors of the log, sigmas,
    covariance and path of the result are its own, as the same cones are located afterwards. Without motions, and if the
    adjustment would move a pose beyond its stated sigmas, the poses are unchanged and `outcome` has the reason.
    """
    errors = None if alone is None else alone.errors

    def as_logged(outcome: RefinementOutcome, detail: str) -> RefinedTrajectory:
        own = np.array(rig.body_SE3_left)
        poses = np.stack([se3.compose(se3.map_SE3_body(pair.pose), own) for pair in frame_pairs])
        return RefinedTrajectory(tuple(frame_pairs), outcome, detail, poses, own, None, errors=errors)

    if not params.refine:
        return as_logged(RefinementOutcome.SWITCHED_OFF, "refinement is switched off")
    measured = measured_motions(frame_pairs, motions, params)
    if not len(measured.start):
        return as_logged(RefinementOutcome.NO_MEASUREMENT, "no two consecutive frame pairs could be compared")
    sparse = is_interpolated(frame_pairs)
    common_sigmas = [params.scale_sigma, _TURN_RAD_PER_M] if sparse else [params.scale_sigma]
    rough = rough_log(frame_pairs, rig, measured, params)
    errors = errors or _log_errors_of(frame_pairs, rough, measured, params)
    log = read_log(frame_pairs, rig, params, errors, rough.renewed)
    good = plausible_motions(log, measured, params.scale_sigma, rough)

    def path_of(rotations: Floats, positions: Floats | None = None) -> PathFit:
        # Where most motions contradict the log, they show what is wrong with it.
        shown = good if good.mean() > _MOST else np.ones_like(good)
        return fit_path(
            log,
            rotations,
            positions,
            only(measured, shown),
            stated_errors(frame_pairs, log.renewed),
            errors or assumed_errors(params),
            params,
        )

    if not good.any():
        detail = f"all {len(good)} measured motions contradict GNSS/INS or each other"
        return replace(as_logged(RefinementOutcome.NO_MEASUREMENT, detail), path=path_of(log.rotations))
    observed = _observations(frame_pairs, [*(cone.positions for cone in control), *cones])
    priors = [LandmarkPrior(k, cone.xyz_m, np.asarray(np.linalg.inv(cone.cov_m2))) for k, cone in enumerate(control)]
    given = Measurements(log, only(measured, good), observed, params.robust_sigmas, common_sigmas, priors)
    solved: tuple[Floats, Floats, ChainCovariance] | None
    if alone is not None and alone.covariance is not None:
        both = adjust_with_cones(given)
        solved = None if both is None else (*both, alone.covariance)
    else:
        own = adjust(given)
        solved = None if own is None else (*own[:2], chain_solver.covariance(own[2]))
    if solved is None:
        found = as_logged(RefinementOutcome.NOT_CONVERGED, "the adjustment did not converge")
        return replace(found, path=path_of(log.rotations))
    rotations, places, cov = solved
    shift = places - log.positions
    turn = Rotation.from_matrix(np.swapaxes(log.rotations, 1, 2) @ rotations).as_rotvec()
    path = path_of(rotations, places) if alone is None else alone.path
    worst = float(np.max(np.sum((shift / log.sigma_p) ** 2, axis=1)))
    if worst > params.max_shift_chi2:
        detail = (
            f"visual odometry would move a pose by {worst**0.5:.1f} of its stated sigmas, more than "
            f"{params.max_shift_chi2**0.5:.1f}; the stated sigmas of GNSS/INS or of the calibration are too small"
        )
        return replace(as_logged(RefinementOutcome.AGAINST_STATED_SIGMAS, detail), path=path)
    sigma = np.sqrt(cov.variances[:, :POSE])
    map_SE3_body = se3.se3(rotations, places)
    poses = map(se3.to_pose, map_SE3_body, sigma)
    pairs = tuple(pair.model_copy(update={"pose": pose}) for pair, pose in zip(frame_pairs, poses, strict=True))
    detail = (
        f"{len(good)} of {len(frame_pairs) - 1} intervals measured, {int((~good).sum())} rejected; "
        f"poses moved by up to {np.linalg.norm(shift, axis=1).max():.2f} m and {np.degrees(np.abs(turn).max()):.2f} degrees"
    )
    map_SE3_left = se3.compose(map_SE3_body, log.body_SE3_left)
    return RefinedTrajectory(
        pairs, RefinementOutcome.REFINED, detail, map_SE3_left, log.body_SE3_left, cov,
        path, errors=errors,
    )  # fmt: skip


def _log_errors_of(
    frame_pairs: Sequence[FramePair], log: LoggedPoses, measured: MeasuredMotions, params: TrajectoryParams
) -> LogErrors | None:
    """The errors of the log by the motions that do not contradict them; None if none could be compared.

    Two rounds: which motions are plausible depends on the errors.
    """
    kept = only(measured, plausible_motions(log, measured, params.scale_sigma))
    given = Measurements(log, kept, (), params.robust_sigmas, [params.scale_sigma])
    solved = adjust(given) if len(kept.start) else None
    records = stated_errors(frame_pairs, log.renewed)
    return None if solved is None else estimate_log_errors(log, *solved[:2], kept, records, params)


def rough_log(
    frame_pairs: Sequence[FramePair], rig: Rig, measured: MeasuredMotions, params: TrajectoryParams
) -> LoggedPoses:
    """The log with errors as they are known before they are estimated, and with its steps."""
    log = read_log(frame_pairs, rig, params)
    renewed = np.append(0.0, np.cumsum(log_steps(log, measured)))
    return read_log(frame_pairs, rig, params, rough_errors(log, measured, params), renewed)


def only(motions: MeasuredMotions, chosen: Bools) -> MeasuredMotions:
    """Some of M motions."""
    return MeasuredMotions(motions.start[chosen], motions.next_SE3_first[chosen], motions.cov[chosen])


def log_errors(frame_pairs: Sequence[FramePair], params: TrajectoryParams) -> Floats:
    """(6K, 6K) covariance of the errors of K logged poses (Gauss-Markov with a white share), position before attitude."""
    times_s = np.array([pair.captured_at_ns for pair in frame_pairs], dtype=np.int64)
    apart_s = np.abs(times_s[:, None] - times_s) * 1e-9
    count = len(frame_pairs)
    sigma = np.array([(*pair.pose.sigma_enu_m, *pair.pose.sigma_rpy_rad) for pair in frame_pairs])
    between, gap_s = _interpolation(frame_pairs)
    sigma = _without(sigma, between)
    shared = np.exp(-apart_s / np.maximum(gap_s, LEAST_STEP_S)) if between.any() else np.eye(count)
    cov = np.zeros((count, POSE, count, POSE))
    errors = assumed_errors(params)
    white, lasts_s = errors.by_axis("white"), errors.by_axis("slow_s")
    for column in range(POSE):
        correlation = (1 - white[column]) * np.exp(-apart_s / lasts_s[column]) + white[column] * shared
        cov[:, column, :, column] = correlation * np.outer(sigma[:, column], sigma[:, column])
        cov[:, column, :, column] += shared * np.outer(between[:, column], between[:, column])
    return cov.reshape(count * POSE, count * POSE)


def read_log(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    params: TrajectoryParams,
    errors: LogErrors | None = None,
    renewed: Floats | None = None,
) -> LoggedPoses:
    """The log with the model of its errors: estimated ones, or as assumed. renewed: see `StatedErrors`."""
    errors = errors or assumed_errors(params)
    white, fast, slow, smooth, fast_s, slow_s, smooth_s, jitter_s, factor = (
        errors.by_axis(field)
        for field in ("white", "fast", "slow", "smooth", "fast_s", "slow_s", "smooth_s", "jitter_s", "factor")
    )
    times_s, stated, between, apart_s, renewed = records = stated_errors(frame_pairs, renewed)
    step_s = np.maximum(np.diff(times_s), LEAST_STEP_S)
    usual_s = float(np.median(step_s)) if step_s.size else np.inf
    poses = np.stack([se3.map_SE3_body(pair.pose) for pair in frame_pairs])
    variance = factor * stated**2
    jitter = np.zeros_like(stated)
    if jitter_s.any() and len(times_s) > 1:
        jitter[:, :3] = (jitter_s[:3] * np.gradient(poses[:, :3, 3], rising(times_s), axis=0)) ** 2
    alone = np.maximum(white, _LEAST_SHARE) * variance + jitter
    lasts, changing = fast * variance, fast * variance * (1 - np.exp(-usual_s / fast_s))
    own, noise = alone + lasts + between**2, alone + changing
    independent = alone + lasts * np.maximum(2 * fast_s / usual_s, 1.0)
    if between.any():
        # All frame pairs between two records together count as one record; from one to the next their errors change
        # by a part only.
        sharing = np.maximum(apart_s / usual_s, 1.0)[:, None]
        noise = noise + (between * np.minimum(_CHANGING / sharing, 1.0)) ** 2
        independent = sharing * (alone + between**2) + lasts * np.maximum(2 * fast_s / usual_s, 1.0)
    levels, changes = sigma_levels(stated, renewed)
    # Where a stated sigma exceeds the smallest one, what exceeds it is slow.
    lasting = (slow + smooth) * levels**2 - smooth * records.least**2
    keep = np.exp(-step_s[:, None] / slow_s - np.diff(changes, axis=0))
    return LoggedPoses(
        poses[:, :3, :3], poses[:, :3, 3], np.sqrt(variance + jitter + between**2)[:, :3], np.sqrt(independent),
        np.sqrt(factor * np.maximum(lasting, _LEAST_SHARE * levels**2)), keep, np.array(rig.body_SE3_left),
        np.sqrt(noise), np.sqrt(own), (np.sqrt(factor * smooth) * records.least)[:3],
        3**0.5 * step_s[:, None] / smooth_s[:3] + _SMOOTH_STEP * np.diff(renewed)[:, None], renewed,
    )  # fmt: skip


def stated_errors(frame_pairs: Sequence[FramePair], renewed: Floats | None = None) -> StatedErrors:
    """What the log states of its errors."""
    stated = np.array([(*pair.pose.sigma_enu_m, *pair.pose.sigma_rpy_rad) for pair in frame_pairs])
    stated = np.maximum(stated, np.repeat([_LEAST_SIGMA_M, _LEAST_SIGMA_RAD], 3))
    times_s = np.array([pair.captured_at_ns - frame_pairs[0].captured_at_ns for pair in frame_pairs]) * 1e-9
    between, apart_s = _interpolation(frame_pairs)
    return StatedErrors(
        times_s, _without(stated, between), between, apart_s, np.zeros(len(times_s)) if renewed is None else renewed
    )


def is_interpolated(frame_pairs: Sequence[FramePair]) -> bool:
    """Whether the poses are those of sparse records, or of a course."""
    return any(pair.pose.interpolated is not None for pair in frame_pairs)


def is_by_course(frame_pairs: Sequence[FramePair]) -> bool:
    """Whether the attitudes are not recorded, but those of a course, which has no roll that could be interpolated."""
    found = [pair.pose.interpolated for pair in frame_pairs]
    return any(found) and all(part is None or part.sigma_rpy_rad[0] == 0 for part in found)


def _interpolation(frame_pairs: Sequence[FramePair]) -> tuple[Floats, Floats]:
    """(K, 6) sigmas (m, rad) that interpolation between sparse records adds to those of poses; (K,) s between the records."""
    found = [pair.pose.interpolated for pair in frame_pairs]
    sigma = [(0.0,) * 6 if part is None else (*part.sigma_enu_m, *part.sigma_rpy_rad) for part in found]
    return np.array(sigma), np.array([0.0 if part is None else part.apart_s for part in found])


def _without(sigma: Floats, between: Floats) -> Floats:
    """(K, 6) stated sigmas without the part that comes from interpolation."""
    if not between.any():
        return sigma
    least = np.repeat([_LEAST_SIGMA_M, _LEAST_SIGMA_RAD], 3)
    return np.asarray(np.sqrt(np.maximum(sigma**2 - between**2, least**2)))


def measured_motions(
    frame_pairs: Sequence[FramePair], motions: Sequence[RelativeMotion], params: TrajectoryParams
) -> MeasuredMotions:
    """Measured intervals with the error floors added to their covariance."""
    rank = {pair.frame_index: k for k, pair in enumerate(frame_pairs)}
    found: dict[int, tuple[Floats, Floats]] = {}
    for motion in motions:
        start, end = rank.get(motion.first_frame_index), rank.get(motion.second_frame_index)
        if motion.second_SE3_first is None or start is None or end != start + 1:
            continue
        pose, cov = np.array(motion.second_SE3_first), motion.cov_matrix()
        distance_m = float(np.linalg.norm(pose[:3, 3]))
        cov[:3, :3] += params.floor_rad**2 * np.eye(3)
        cov[3:, 3:] += (params.floor_m**2 + (params.floor_relative * distance_m) ** 2) * np.eye(3)
        found[start] = pose, cov
    starts = sorted(found)
    return MeasuredMotions(
        np.array(starts, dtype=np.intp),
        np.array([found[k][0] for k in starts]).reshape(-1, 4, 4),
        np.array([found[k][1] for k in starts]).reshape(-1, 6, 6),
    )


def _observations(frame_pairs: Sequence[FramePair], cones: Sequence[Sequence[Position]]) -> list[LandmarkObservation]:
    rank = {pair.frame_index: k for k, pair in enumerate(frame_pairs)}
    return [
        LandmarkObservation(
            cone, rank[p.frame_index], np.array(p.camera_xyz_m), np.asarray(np.linalg.inv(cov_matrix(p.camera_cov_m2)))
        )
        for cone, group in enumerate(cones)
        for p in group
        if p.frame_index in rank
    ]
