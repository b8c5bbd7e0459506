"""One camera, with or without a lens: x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.

The horizon is that of a camera without a lens: a straight row. Derivatives are those of image points by point and camera
(collinearity equations), and of map points by the pose of the body.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from conetl.geometry import lens as lenses
from conetl.model.arrays import Floats
from conetl.model.rig import Camera


def intrinsics(camera: Camera) -> Floats:
    """(4,) array fx, fy, cx, cy in pixels, as `intersection.intersect` takes it."""
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])


def matrix_k(camera: Camera) -> Floats:
    """(3, 3) calibration matrix K."""
    return np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])


def project(camera: Camera, points_cam_m: ArrayLike) -> Floats:
    """Image points (..., 2) in pixels of camera-frame points (..., 3), the camera's lens included.

    Raises ValueError if a point is not in front of the camera: it has no image. A point beyond the lens's
    `field_radius` gets the number that the model gives there, as in OpenCV; see `lens.field_radius`.
    """
    p = np.asarray(points_cam_m, dtype=np.float64)
    z = p[..., 2]
    if not np.all(z > 0):
        raise ValueError("project: every point must lie in front of the camera (z > 0)")
    if camera.lens.model == "none":
        uv = [camera.fx_px * p[..., 0] / z + camera.cx_px, camera.fy_px * p[..., 1] / z + camera.cy_px]
    else:
        xy = lenses.distort(camera.lens, p[..., :2] / z[..., None])
        uv = [camera.fx_px * xy[..., 0] + camera.cx_px, camera.fy_px * xy[..., 1] + camera.cy_px]
    return np.stack(uv, axis=-1)


def rays(camera: Camera, uv_px: ArrayLike) -> Floats:
    """Directions (..., 3) in the camera frame with z = 1 through image points (..., 2), with the distortion removed.

    x and y are NaN where the lens has no such image point (see `lens.undistort`); a camera without a lens has no NaN.
    """
    uv = np.asarray(uv_px, dtype=np.float64)
    xy = lenses.undistort(camera.lens, (uv - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px))
    return np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)


def horizon_row_px(camera: Camera, map_R_cam: ArrayLike, u_px: float | None = None) -> float:
    """Row at which level rays cross column `u_px` (default: the principal point's column), for one rotation (3, 3).

    Raises ValueError where the camera looks straight up or down or lies on its side: it has no horizon row.
    """
    up = np.asarray(map_R_cam, dtype=np.float64)[2]  # in the camera's frame
    x = 0.0 if u_px is None else (u_px - camera.cx_px) / camera.fx_px
    if abs(up[1]) < 1e-6:
        raise ValueError("horizon_row_px: the camera looks straight up or down or lies on its side")
    return float(camera.cy_px - camera.fy_px * (up[2] + up[0] * x) / up[1])


def first_road_row(camera: Camera, map_R_cams: Iterable[ArrayLike], margin_rad: float) -> int:
    """First row of a camera's images that lies at most `margin_rad` above the highest horizon of rotations (3, 3).

    Objects on the road that are no taller than the rig appear at or below it; the margin is for slopes. 0 without a horizon row.
    """
    corners = (0.0, camera.width_px - 1.0)
    try:
        highest = min(horizon_row_px(camera, rotation, u_px) for rotation in map_R_cams for u_px in corners)
    except ValueError:
        return 0
    row = highest - camera.fy_px * float(np.tan(margin_rad))
    return int(np.clip(np.floor(row), 0, camera.height_px - 1))


class Projection(NamedTuple):
    """Image points of points in one camera's frame, with their derivatives."""

    uv_px: Floats
    """(..., 2)"""
    by_point: Floats
    """(..., 2, 3) px/m, with respect to the point in the camera's frame."""
    by_interior: Floats
    """(..., 2, 4 + n) with respect to fx, fy, cx, cy and the lens's n coefficients."""


def project_with_jacobian(camera: Camera, points_cam_m: ArrayLike) -> Projection:
    """Project points (..., 3) of the camera's frame (x right, y down, z forward) and differentiate.

    Points that are not in front of the camera give NaN.
    """
    points = np.asarray(points_cam_m, dtype=np.float64)
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    xy = points[..., :2] / z[..., None]
    bent = lenses.distort(camera.lens, xy)
    by_xy, by_lens = lenses.distort_jacobian(camera.lens, xy)
    focal = np.array([camera.fx_px, camera.fy_px])
    xy_by_point = np.zeros((*xy.shape, 3))
    xy_by_point[..., 0, 0] = xy_by_point[..., 1, 1] = 1.0
    xy_by_point[..., 2] = -xy
    by_point = focal[:, None] * (by_xy @ xy_by_point) / z[..., None, None]
    by_interior = np.zeros((*xy.shape, 4 + len(camera.lens.coefficients)))
    by_interior[..., 0, 0], by_interior[..., 1, 1] = bent[..., 0], bent[..., 1]
    by_interior[..., 0, 2] = by_interior[..., 1, 3] = 1.0
    by_interior[..., 4:] = focal[:, None] * by_lens
    return Projection(bent * focal + (camera.cx_px, camera.cy_px), by_point, by_interior)


def pose_jacobian(xyz_m: ArrayLike, map_R_body: ArrayLike, map_t_body_m: ArrayLike) -> Floats:
    """(N, 3, 6): how map points move with errors of the body's easting, northing, height, roll, pitch and yaw.

    xyz_m (N, 3); the poses (3, 3) and (3,), or one per point. Roll turns the lever from body to point about the body's x axis,
    pitch about the level axis across it, yaw about the vertical, to first order. ValueError where the body points straight up.
    """
    rotation = np.asarray(map_R_body, dtype=np.float64)
    lever = np.asarray(xyz_m, dtype=np.float64) - np.asarray(map_t_body_m, dtype=np.float64)
    ahead = np.broadcast_to(rotation[..., :, 0], lever.shape)
    level = np.hypot(ahead[..., 0], ahead[..., 1])
    if np.any(level < 1e-9):
        raise ValueError("pose_jacobian: the body points straight up or down: roll and yaw are not separable")
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
) -> Floats:
    """Covariance (P, 3, 3) of map points: that of the image points plus that of the body's pose.

    cov_m2 (P, 3, 3) in the map frame; xyz_m (P, 3); the poses (3, 3) / (3,) or one per point; sigmas (3,) or (P, 3). The error of
    the position is common to all views of a drive (GNSS drifts slowly): it must not be averaged away over frames.
    """
    sigmas = np.concatenate(
        np.broadcast_arrays(np.asarray(sigma_enu_m, np.float64), np.asarray(sigma_rpy_rad, np.float64)), axis=-1
    )
    scaled = pose_jacobian(xyz_m, map_R_body, map_t_body_m) * sigmas[..., None, :]
    return np.asarray(np.asarray(cov_m2, dtype=np.float64) + scaled @ np.swapaxes(scaled, -1, -2))
