"""What the error of the body's pose adds to the covariance of a point that was intersected from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def pose_jacobian(xyz_m: ArrayLike, map_R_body: ArrayLike, map_t_body_m: ArrayLike) -> Array:
    """(N, 3, 6): how map points move with errors of the body's easting, northing, height, roll, pitch and yaw.

    xyz_m (N, 3); the poses (3, 3) and (3,), or one per point. Roll turns the lever from body to point about the body's x axis,
    pitch about the level axis across it, yaw about the vertical, to first order. Raises ValueError for a body on its nose.
    """
    rotation = np.asarray(map_R_body, dtype=np.float64)
    lever = np.asarray(xyz_m, dtype=np.float64) - np.asarray(map_t_body_m, dtype=np.float64)
    ahead = np.broadcast_to(rotation[..., :, 0], lever.shape)
    level = np.hypot(ahead[..., 0], ahead[..., 1])
    if np.any(level < 1e-9):
        raise ValueError("pose_jacobian: the body stands on its nose, roll and yaw cannot be told apart")
    across = np.stack([-ahead[..., 1] / level, ahead[..., 0] / level, np.zeros_like(level)], axis=-1)
    vertical = np.broadcast_to([0.0, 0.0, 1.0], lever.shape)
    jacobian = np.zeros((*lever.shape, 6))
    jacobian[..., :3] = np.eye(3)
    for column, axis in enumerate((ahead, across, vertical), 3):
        jacobian[..., column] = np.cross(axis, lever)
    return jacobian


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
    averaged away over frames.
    """
    sigmas = np.concatenate(
        np.broadcast_arrays(np.asarray(sigma_enu_m, np.float64), np.asarray(sigma_rpy_rad, np.float64)), axis=-1
    )
    scaled = pose_jacobian(xyz_m, map_R_body, map_t_body_m) * sigmas[..., None, :]
    total: Array = np.asarray(cov_m2, dtype=np.float64) + scaled @ np.swapaxes(scaled, -1, -2)
    return total
