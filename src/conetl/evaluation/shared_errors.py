"""Jacobians of estimates by the errors that they share: poses, calibration, and the assumed outline of a cone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.calibration.covariance import calibration_jacobian, known_covariance
from conetl.geometry.packing import cov_matrix
from conetl.geometry.rig import map_SE3_left
from conetl.model.records import Pose, Position, Rig
from conetl.tracking.association import MotionError
from conetl.tracking.error_propagation import PoseCov, constant_and_change, moved_by_poses, moved_cov, outline_errors

Floats = NDArray[np.float64]


def pose_and_calibration(xyz_m: Floats, poses: Sequence[Pose], rig: Rig) -> tuple[Floats, Floats]:
    """(N, 3, 6 + K) Jacobian of points (N, 3) by the errors of pose and calibration, (N, 6) sigmas of the poses."""
    by_pose = moved_by_poses(xyz_m, poses)
    left = np.array([map_SE3_left(pose, rig) for pose in poses]).reshape(-1, 4, 4)
    in_camera = np.einsum("nji,nj->ni", left[:, :3, :3], xyz_m - left[:, :3, 3])
    by_calibration = left[:, :3, :3] @ calibration_jacobian(in_camera, rig)
    sigmas = np.array([(*pose.sigma_enu_m, *pose.sigma_rpy_rad) for pose in poses]).reshape(-1, 6)
    return np.concatenate([by_pose, by_calibration], axis=2), sigmas


def pose_parts(
    jacobian: Floats, frames: Sequence[int], variances: Floats, poses: PoseCov | None
) -> tuple[Floats, Floats | None]:
    """Covariance (6, 6) of the constant error of all poses, and (3N, 3N) of N points by the part that changes between frames.

    jacobian (N, 3, 6): of the points by their poses; frames (N,): their indices; variances (N, 6): stated.
    """
    if not frames:
        return np.zeros((6, 6)), None
    if poses is None:
        return np.diag(np.mean(variances, axis=0)), None
    order, rank = np.unique(frames, return_inverse=True)
    constant, change = constant_and_change(poses(order.tolist()))
    return constant, moved_cov(jacobian, rank, change)


def outline_parts(
    cone_ids: Sequence[str], positions: Sequence[Position], rig: Rig, turn: Floats, cov_m2: Floats
) -> tuple[Floats, Floats]:
    """(N, 3, 3C) Jacobian of N positions by the outline errors of C cones, in sigmas; (N, 3, 3) the rest of the covariances.

    turn (N, 3, 3): map_R_left of each position. cov_m2 (N, 3, 3): of image points and outline together, in the map.
    """
    order = sorted({name for name, p in zip(cone_ids, positions, strict=True) if p.sigma_outline_m > 0})
    jacobian = np.zeros((len(positions), 3, 3 * len(order)))
    own = cov_m2.copy()
    for n, (name, position) in enumerate(zip(cone_ids, positions, strict=True)):
        if position.sigma_outline_m > 0:
            moved = turn[n] @ outline_errors(position, rig)
            k = 3 * order.index(name)
            jacobian[n, :, k : k + 3] = moved
            own[n] -= moved @ moved.T
    return jacobian, own


def track_shares(members: Sequence[Position], poses: Sequence[Pose], rig: Rig, motion: MotionError | None) -> Floats:
    """(F, 3, 3) Jacobian of a track by each of its positions; their sum is the identity (`JointFit.shares`)."""
    turn = np.array([map_SE3_left(pose, rig)[:3, :3] for pose in poses])
    cov = np.stack([cov_matrix(p.camera_cov_m2) for p in members])
    if motion is not None:
        nearest = min(members, key=lambda p: p.range_m).frame_index
        added = [np.trace(motion(p.frame_index, nearest, np.array(p.camera_xyz_m))) / 3 for p in members]
        cov = cov + np.array(added)[:, None, None] * np.eye(3)
    information = np.linalg.inv(turn @ cov @ np.swapaxes(turn, 1, 2))
    return np.asarray(np.linalg.inv(information.sum(axis=0)) @ information)


def calibration_of(rig: Rig) -> Floats:
    """(K, K) covariance of the calibration, (0, 0) where it is unknown."""
    known = known_covariance(rig)
    return np.array(known.matrix) if known else np.zeros((0, 0))
