"""What the error of the body's pose adds to the covariance of a point that was intersected from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def add_pose_covariance(
    cov_m2: ArrayLike,
    xyz_m: ArrayLike,
    map_R_body: ArrayLike,
    map_t_body_m: ArrayLike,
    sigma_enu_m: ArrayLike,
    sigma_rpy_rad: ArrayLike,
) -> Array:
    """Covariance (P, 3, 3) of map points with the error of the body's pose added to that of the image points.

    cov_m2 (P, 3, 3) in the map frame; xyz_m (P, 3); the poses (3, 3) / (3,) or one per point; sigmas (3,) or (P, 3).
    The error of the position is common to all views of a drive (GNSS drifts slowly), so it is added as it is and must not be
    averaged away over frames. Roll, pitch and yaw turn the lever from body to point about their own axes, to first order.
    """
    xyz = np.asarray(xyz_m, dtype=np.float64)
    rot = np.asarray(map_R_body, dtype=np.float64)
    lever = xyz - np.asarray(map_t_body_m, dtype=np.float64)
    roll_axis = rot[..., :, 0]
    level = np.hypot(roll_axis[..., 0], roll_axis[..., 1])
    zero = np.zeros_like(level)
    if np.any(level < 1e-9):
        raise ValueError("add_pose_covariance: the body stands on its nose, roll and yaw cannot be told apart")
    pitch_axis = np.stack([-roll_axis[..., 1] / level, roll_axis[..., 0] / level, zero], axis=-1)
    yaw_axis = np.broadcast_to(np.array([0.0, 0.0, 1.0]), roll_axis.shape)
    sigma_rpy = np.asarray(sigma_rpy_rad, dtype=np.float64)
    total = np.array(cov_m2, dtype=np.float64)
    enu = np.asarray(sigma_enu_m, dtype=np.float64)
    total = total + enu[..., :, None] ** 2 * np.eye(3)
    for i, axis in enumerate((roll_axis, pitch_axis, yaw_axis)):
        shift = np.cross(axis, lever) * sigma_rpy[..., i, None]
        total = total + shift[..., :, None] * shift[..., None, :]
    return total
