"""Errors that many observations share, and their effect on positions: of poses, of the calibration, of one cone's outline.

They move a cone, or all cones of a drive, as a whole and do not average out over frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from uuid import NAMESPACE_OID, UUID, uuid5

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from conetl.geometry.calibration.covariance import calibration_jacobian, shared_cov
from conetl.geometry.camera import pose_jacobian
from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.motion.chain_solver import cross_covariance, joint_covariance
from conetl.geometry.motion.pose_graph import POSE, motion_jacobians
from conetl.geometry.packing import cov_matrices, cov_matrix
from conetl.geometry.rig import map_SE3_left
from conetl.geometry.small_arrays import cross_matrix, nearest_index
from conetl.model.arrays import Floats, Ints
from conetl.model.drive import CommonError, FramePair, Pose, Position
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig
from conetl.tracking.association import MotionError
from conetl.tracking.matching.covariance import shared_disparity_px
from conetl.tracking.trajectory import RefinedTrajectory, log_errors

#: F frame indices, rising and unique -> (6F, 6F) covariance of their poses: easting, northing, height (m), roll, pitch, yaw (rad)
#: of the first frame, of the second ...
PoseCov = Callable[[Sequence[int]], Floats]
#: Added to the diagonal of correlations, so that equal errors remain invertible.
_LEAST_SHARE = 1e-10
#: Least sigma of each of the six pose errors (m, rad).
_LEAST_SIGMA = 1e-9
#: Motions between frames whose covariances are kept, for the next cone and the next estimate of all of them.
_MOTIONS_KEPT = 10_000
#: Frames whose poses' errors are followed together: others count as the nearest of them, because their number squared is kept.
_MOST_STATES = 200


def pose_cov(trajectory: RefinedTrajectory, params: TrajectoryParams) -> PoseCov:
    """Joint covariance of the poses of a drive: that of the adjustment, or of the log without one.

    The adjustment's attitude errors are about the body's axes, for a car those of roll, pitch and yaw.
    """
    rank = {pair.frame_index: k for k, pair in enumerate(trajectory.frame_pairs)}
    refined = trajectory.covariance

    def of_frames(frame_indices: Sequence[int]) -> Floats:
        states = [rank[index] for index in frame_indices]
        if refined is not None:
            return joint_covariance(refined, states, POSE)
        return log_errors([trajectory.frame_pairs[k] for k in states], params)

    return of_frames


def relative_cov(trajectory: RefinedTrajectory, start: int, end: int) -> Floats:
    """(6, 6) covariance of the left camera's motion between two frame pairs of a refined trajectory.

    start, end: positions in `frame_pairs` (not frame indices), in any order. Error (rotation rad, translation m) of
    end_SE3_start, in the left camera's frame at `end`.
    """
    if start == end:
        return np.zeros((6, 6))
    joint = trajectory.covariance
    assert joint is not None  # the trajectory was refined
    first, second = min(start, end), max(start, end)
    cross = cross_covariance(joint, first, second)[:POSE, :POSE]
    cross = cross if start <= end else cross.T
    from_start, from_end = motion_jacobians(
        trajectory.map_SE3_left[start], trajectory.map_SE3_left[end], trajectory.body_SE3_left
    )
    mixed = from_start @ cross @ from_end.T
    cov = (
        from_start @ joint.of(start)[:POSE, :POSE] @ from_start.T
        + from_end @ joint.of(end)[:POSE, :POSE] @ from_end.T
        + mixed
        + mixed.T
    )
    return np.asarray((cov + cov.T) / 2)


def motion_error(trajectory: RefinedTrajectory) -> MotionError | None:
    """Error of points that the motion transforms from frame to frame; None unless the trajectory was refined."""
    covariance = trajectory.covariance
    if covariance is None:
        return None
    rank = {pair.frame_index: k for k, pair in enumerate(trajectory.frame_pairs)}
    # Cones last observed in the same image have the same motion.
    relative = lru_cache(maxsize=_MOTIONS_KEPT)(partial(relative_cov, trajectory))

    def carried_cov_m2(start: int, end: int, point_m: Floats) -> Floats:
        cov = relative(rank[start], rank[end])
        first, second = trajectory.map_SE3_left[rank[start]], trajectory.map_SE3_left[rank[end]]
        turned = second[:3, :3].T @ first[:3, :3] @ point_m
        by_motion = np.hstack([-cross_matrix(turned), np.eye(3)])
        return np.asarray(by_motion @ cov @ by_motion.T)

    def changed_cov_m2(xyz_m: Floats, frame_indices: Sequence[Sequence[int]], shares: Sequence[Floats]) -> Floats:
        ranks = [len(rank) // 2, *(rank[index] for own in frame_indices for index in own)]
        chosen = np.array(evenly_spaced(np.unique(ranks).tolist(), _MOST_STATES))
        states, at = np.unique(chosen[nearest_index(chosen, np.array(ranks))], return_inverse=True)
        point = np.repeat(np.arange(len(xyz_m)), [len(own) for own in frame_indices])
        poses = [trajectory.frame_pairs[k].pose for k in states[at[1:]]]
        moved = np.concatenate(shares) @ moved_by_poses(xyz_m[point], poses)
        by_pose = np.zeros((len(xyz_m) * len(states), 3, POSE))
        np.add.at(by_pose, point * len(states) + at[1:], moved)
        np.subtract.at(by_pose, point * len(states) + at[0], moved)
        flat = by_pose.reshape(len(xyz_m), len(states), 3, POSE).transpose(0, 2, 1, 3).reshape(3 * len(xyz_m), -1)
        return np.asarray(flat @ joint_covariance(covariance, states.tolist(), POSE) @ flat.T)

    # The variance of a difference of two poses is at most twice the sum of theirs, and so is that of the sum of position error
    # and attitude error times lever.
    variances = covariance.variances
    position_m2, attitude_rad2 = (float(part.sum(axis=1).max()) for part in (variances[:, :3], variances[:, 3:POSE]))
    lever_m = float(np.linalg.norm(trajectory.body_SE3_left[:3, 3]))
    return MotionError(
        carried_cov_m2,
        most_m2=lambda range_m: 8 * (position_m2 + (range_m + lever_m) ** 2 * attitude_rad2),
        **({"changed_cov_m2": changed_cov_m2} if trajectory.changes else {}),
    )


def constant_and_change(cov: Floats) -> tuple[Floats, Floats]:
    """Covariance (6F, 6F) of the poses of F frames split into a constant error (6, 6) and the rest (6F, 6F).

    The best estimate of a constant (generalised least squares, e.g. Koch 1999, ch. 3.2) is uncorrelated with its residuals, so
    that the two parts are independent and add up exactly.
    """
    count = len(cov) // POSE
    sigma = np.maximum(np.sqrt(np.diagonal(cov)), _LEAST_SIGMA)
    correlation = cov / np.outer(sigma, sigma) + _LEAST_SHARE * np.eye(len(cov))
    alike = np.tile(np.eye(POSE), (count, 1))
    scaled = alike / sigma[:, None]
    constant = np.linalg.inv(scaled.T @ cho_solve(cho_factor(correlation), scaled))
    constant = (constant + constant.T) / 2
    return np.asarray(constant), np.asarray(cov - np.tile(constant, (count, count)))


def moved_by_poses(xyz_m: Floats, poses: Sequence[Pose]) -> Floats:
    """(N, 3, 6): derivatives of points (N, 3) by the errors of their own poses; see `pose_jacobian`."""
    return pose_jacobian(
        xyz_m,
        np.array([pose.map_R_body for pose in poses]).reshape(-1, 3, 3),
        np.array([pose.map_t_body_m for pose in poses]).reshape(-1, 3),
    )


def moved_cov(jacobian: Floats, rank: Ints, cov: Floats) -> Floats:
    """(3N, 3N) m^2: joint covariance of N points by the errors of F poses.

    jacobian (N, 3, 6): of each point by the pose of its own frame; rank (N,): the index of that frame; cov (6F, 6F).
    """
    count = len(jacobian)
    by_pose = np.zeros((count, 3, len(cov) // POSE, POSE))
    by_pose[np.arange(count), :, rank] = jacobian
    flat = by_pose.reshape(3 * count, -1)
    return np.asarray(flat @ cov @ flat.T)


def common_cov(
    group: Sequence[Position],
    shares: Floats,
    frame_pairs: Mapping[int, FramePair],
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    log: TrajectoryParams | None = None,
) -> Floats:
    """Covariance (3, 3) m^2 that pose and calibration add to the joint fit of the positions of one cone.

    shares: (F, 3, 3) of `fit_point`, in the order of `group`: derivatives of the joint point by that of one pair. The
    calibration's error is constant. Errors of logged poses are Gauss-Markov processes (`log`); those of refined poses (None)
    are constant while the cone is visible. Each frame has its own sigmas and lever from body to cone.
    """
    pairs = [frame_pairs[p.frame_index] for p in group]
    poses = [pair.pose for pair in pairs]
    moved = shares @ moved_by_poses(np.array([p.xyz_m for p in group]), poses)
    of_calibration = moved_by_calibration(group, shares, rig, map_SE3_left)
    if log is None:
        sigmas = np.array([(*pose.sigma_enu_m, *pose.sigma_rpy_rad) for pose in poses])
        total = (moved * sigmas[:, None, :]).sum(axis=0)
        of_poses = total @ total.T
    else:
        flat = moved.transpose(1, 0, 2).reshape(3, -1)
        of_poses = flat @ log_errors(pairs, log) @ flat.T
    return np.asarray((of_poses + of_poses.T) / 2 + shared_cov(of_calibration, rig))


def track_shares(members: Sequence[Position], poses: Sequence[Pose], rig: Rig, motion: MotionError | None) -> Floats:
    """(F, 3, 3) Jacobian of a track by each of its positions; their sum is the identity.

    Those of the fit (`JointFit.shares`), from positions alone.
    """
    turn = np.array([map_SE3_left(pose, rig)[:3, :3] for pose in poses])
    cov = cov_matrices([p.camera_cov_m2 for p in members])
    if motion is not None:
        closest = min(members, key=lambda p: p.range_m).frame_index
        added = [np.trace(motion.cov_m2(p.frame_index, closest, np.array(p.camera_xyz_m))) / 3 for p in members]
        cov = cov + np.array(added)[:, None, None] * np.eye(3)
    information = np.linalg.inv(turn @ cov @ np.swapaxes(turn, 1, 2))
    return np.asarray(np.linalg.inv(information.sum(axis=0)) @ information)


def moved_by_calibration(
    group: Sequence[Position], shares: Floats, rig: Rig, map_SE3_left: Mapping[int, Floats]
) -> Floats:
    """Derivative (3, K) of the joint fit by the calibration's parameters."""
    map_R_left = np.stack([map_SE3_left[p.frame_index][:3, :3] for p in group])
    by_calibration = map_R_left @ calibration_jacobian(np.array([p.camera_xyz_m for p in group]), rig)
    return np.asarray(np.einsum("fij,fjk->ik", shares, by_calibration))


def outline_errors(position: Position, rig: Rig) -> Floats:
    """(3, 3) m: change of one position by one sigma of each error common to all observations of a cone; left camera frame.

    Columns: to the right and down, the detector's foot and axis (`Position.sigma_outline_m`); along the ray, the cone's shape
    in matching (`shared_disparity_px`).
    """
    down_m, xyz_m = position.sigma_outline_m, np.array(position.camera_xyz_m)
    right_m = FEATURE_CLASSES[position.category].outline_aside * down_m
    per_px = xyz_m[2] ** 2 / (rig.left.fx_px * rig.baseline_m)
    away_m = shared_disparity_px(cov_matrix(position.camera_cov_m2)[2, 2] ** 0.5 / per_px) * per_px
    return np.column_stack([[right_m, 0.0, 0.0], [0.0, down_m, 0.0], xyz_m / xyz_m[2] * away_m])


def outline_jacobian(group: Sequence[Position], shares: Floats, map_SE3_left: Mapping[int, Floats], rig: Rig) -> Floats:
    """(3, 3) m: change of a joint fit by one sigma of each error of this cone's foot, axis and shape (`outline_errors`), in all
    images alike.

    From one side they do not average out; from several sides they partly cancel. Zero for boxes without feet (`sigma_outline_m`
    0).
    """
    errors = np.stack([outline_errors(p, rig) * (p.sigma_outline_m > 0) for p in group])
    turn = np.stack([map_SE3_left[p.frame_index][:3, :3] for p in group])
    return np.asarray(np.einsum("fij,fjk,fkl->il", shares, turn, errors))


def common_axes(error: CommonError, rotations: Floats) -> Floats:
    """(N, 3, 3) m: change of N positions of the body by one sigma of each part of an error that drives share.

    rotations: map_R_body (N, 3, 3).
    """
    axes = rotations if error.axes == "vehicle" else np.broadcast_to(np.eye(3), rotations.shape)
    return np.asarray(axes * error.sigma_m)


def shared_by_drives(
    errors: Sequence[CommonError], shares: Floats, poses: Sequence[Pose], of_poses: Floats, *, corrected: bool
) -> tuple[list[tuple[UUID, Floats]], Floats]:
    """Ids and Jacobians (3, 3) m of the part of the errors of a joint fit that drives share, and the covariance (3, 3) m^2 that
    the poses' part of it, `of_poses`, lacks to contain them.

    Nothing in a drive shows an error that is constant in it, so that the adjustment must not reduce it; what it states is too
    small where it takes all errors of the log to change. Control points show it (`corrected`): of the errors remains at most what
    the adjustment states. shares: as for `common_cov`.
    """
    if not errors:
        return [], np.zeros((3, 3))
    rotations = np.array([pose.map_R_body for pose in poses])
    moved = [(shares @ common_axes(error, rotations)).sum(axis=0) for error in errors]
    ids, stacked = [common_error_id(error) for error in errors], np.hstack(moved)
    if corrected:
        excess = float(np.linalg.eigvalsh(stacked.T @ np.linalg.solve(of_poses, stacked))[-1])
        return list(zip(ids, [part / max(excess, 1.0) ** 0.5 for part in moved], strict=True)), np.zeros((3, 3))
    values, vectors = np.linalg.eigh(stacked @ stacked.T - of_poses)
    return list(zip(ids, moved, strict=True)), (vectors * np.maximum(values, 0.0)) @ vectors.T


def common_error_id(error: CommonError) -> UUID:
    """Of an error of the positions among the shared errors of drives.

    With two sigmas of one error its value would follow from the difference of two drives: another sigma is another error.
    """
    return uuid5(NAMESPACE_OID, f"conetl:common:{error.axes}:{error.sigma_m}:{error.id}")


def class_error_id(category: str) -> UUID:
    """Of the outline errors that all objects of a class have in common, among the shared errors of drives: the network makes
    them in every drive."""
    return uuid5(NAMESPACE_OID, f"conetl:outline:{category}")
