"""Errors that all sightings of one cone share: they move the cone as a whole and are not averaged away by more frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.calibration.covariance import calibration_jacobian, shared_cov
from conetl.model.params import TrajectoryParams
from conetl.model.records import FramePair, Position, Rig
from conetl.tracking.matching.covariance import SHARED_DISPARITY_PX
from conetl.tracking.pose_errors import moved_by_poses
from conetl.tracking.trajectory import log_errors

Floats = NDArray[np.float64]


def common_cov(
    group: Sequence[Position],
    shares: Floats,
    frame_pairs: Mapping[int, FramePair],
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    log: TrajectoryParams | None = None,
) -> Floats:
    """Covariance (3, 3) m^2 that pose and calibration add to the joint fit of the positions of one cone.

    shares: (F, 3, 3) of `joint_fit.fit_point`, in the order of `group`; they carry what moves the point of one pair over to the
    joint point. The calibration is one error for ever. Errors of GNSS/INS change slowly: with `log` as its Gauss-Markov
    processes with a white share, the model of the trajectory's adjustment; without, for poses that were refined, as one error for
    as long as the cone is in view. Each frame has its own sigmas and its own lever from body to cone.
    """
    sigmas = np.array(
        [(*frame_pairs[p.frame_index].pose.sigma_enu_m, *frame_pairs[p.frame_index].pose.sigma_rpy_rad) for p in group]
    )
    poses = [frame_pairs[p.frame_index].pose for p in group]
    by_pose = moved_by_poses(np.array([p.xyz_m for p in group]), poses)
    moved = shares @ by_pose
    of_calibration = moved_by_calibration(group, shares, rig, map_SE3_left)
    if log is None:
        total = (moved * sigmas[:, None, :]).sum(axis=0)
        of_poses = total @ total.T
    else:
        flat = moved.transpose(1, 0, 2).reshape(3, -1)
        of_poses = flat @ log_errors([frame_pairs[p.frame_index] for p in group], log) @ flat.T
    return np.asarray((of_poses + of_poses.T) / 2 + shared_cov(of_calibration, rig))


def moved_by_calibration(
    group: Sequence[Position], shares: Floats, rig: Rig, map_SE3_left: Mapping[int, Floats]
) -> Floats:
    """Derivative (3, K) of the joint fit with respect to the rig's calibration, one error of all its images."""
    map_R_left = np.stack([map_SE3_left[p.frame_index][:3, :3] for p in group])
    by_calibration = map_R_left @ calibration_jacobian(np.array([p.camera_xyz_m for p in group]), rig)
    return np.asarray(np.einsum("fij,fjk->ik", shares, by_calibration))


def outline_errors(position: Position, rig: Rig) -> Floats:
    """(3, 3) m: how one sigma of each error that all sightings of a cone share moves one of them; left camera frame.

    Columns: to the right and down, what the detector takes for foot and axis (`Position.sigma_outline_m`); away along the ray,
    what the matching takes for the cone's shape (`SHARED_DISPARITY_PX`).
    """
    sigma_m, xyz_m = position.sigma_outline_m, np.array(position.camera_xyz_m)
    away_m = SHARED_DISPARITY_PX * xyz_m[2] ** 2 / (rig.left.fx_px * rig.baseline_m)
    return np.column_stack([[sigma_m, 0.0, 0.0], [0.0, sigma_m, 0.0], xyz_m / xyz_m[2] * away_m])


def outline_cov(group: Sequence[Position], shares: Floats, map_SE3_left: Mapping[int, Floats], rig: Rig) -> Floats:
    """Covariance (3, 3) m^2 of a joint fit by what is taken for this cone's foot, axis and shape, in all images alike.

    Three errors (`outline_errors`), each as large at every sighting as it says. From one side they stay what they are, however
    many frames; seen from several sides, they work against each other. None where boxes alone tell feet (`sigma_outline_m` 0).
    """
    errors = np.stack([outline_errors(p, rig) * (p.sigma_outline_m > 0) for p in group])
    turn = np.stack([map_SE3_left[p.frame_index][:3, :3] for p in group])
    moved = np.einsum("fij,fjk,fkl->il", shares, turn, errors)
    return np.asarray(moved @ moved.T)
