"""Errors that all sightings of one cone share: they move the cone as a whole and are not averaged away by more frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.calibration_covariance import calibration_jacobian, shared_cov
from conetl.geometry.pose_covariance import pose_jacobian
from conetl.records import FramePair, Position, Rig

Floats = NDArray[np.float64]


def common_cov(
    group: Sequence[Position],
    shares: Floats,
    frame_pairs: Mapping[int, FramePair],
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
) -> Floats:
    """Covariance (3, 3) m^2 that pose and calibration add to the joint fit of the positions of one cone.

    shares: (F, 3, 3) of `joint_fit.fit_point`, in the order of `group`; they carry what moves the point of one pair over to the
    joint point. GNSS/INS errors vary over many seconds and a cone is in view for a few, so they are taken as one error
    of that time (each frame with its own sigmas and its own lever from body to cone); the calibration is one for ever.
    """
    sigmas = np.array(
        [(*frame_pairs[p.frame_index].pose.sigma_enu_m, *frame_pairs[p.frame_index].pose.sigma_rpy_rad) for p in group]
    )
    poses = [frame_pairs[p.frame_index].pose for p in group]
    by_pose = pose_jacobian(
        np.array([p.xyz_m for p in group]),
        np.array([pose.map_R_body for pose in poses]),
        np.array([pose.map_t_body_m for pose in poses]),
    )
    of_pose = np.einsum("fij,fjk->ik", shares, by_pose * sigmas[:, None, :])
    map_R_left = np.stack([map_SE3_left[p.frame_index][:3, :3] for p in group])
    by_calibration = map_R_left @ calibration_jacobian(np.array([p.camera_xyz_m for p in group]), rig)
    of_calibration = np.einsum("fij,fjk->ik", shares, by_calibration)
    return np.asarray(of_pose @ of_pose.T + shared_cov(of_calibration, rig))
