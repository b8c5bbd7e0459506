"""One camera, with or without a lens: x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.

The horizon is that of a camera without a lens: a straight row.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conetl.geometry import lens as lenses
from conetl.model.records import Camera

Array = NDArray[np.float64]


def intrinsics(camera: Camera) -> Array:
    """(4,) array fx, fy, cx, cy in pixels: the form that `intersection.intersect` takes."""
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])


def matrix_k(camera: Camera) -> Array:
    """(3, 3) calibration matrix K."""
    return np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])


def project(camera: Camera, points_cam_m: ArrayLike) -> Array:
    """Image points (..., 2) in pixels of camera-frame points (..., 3), the camera's lens included.

    Raises ValueError where a point does not lie in front of the camera: it has no image. A point beyond the lens's
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


def rays(camera: Camera, uv_px: ArrayLike) -> Array:
    """Directions (..., 3) in the camera frame with z = 1 through image points (..., 2), with the distortion removed.

    x and y are NaN where the lens has no such image point (see `lens.undistort`); a camera without a lens has no NaN.
    """
    uv = np.asarray(uv_px, dtype=np.float64)
    x = (uv[..., 0] - camera.cx_px) / camera.fx_px
    y = (uv[..., 1] - camera.cy_px) / camera.fy_px
    if camera.lens.model != "none":
        xy = lenses.undistort(camera.lens, np.stack([x, y], axis=-1))
        x, y = xy[..., 0], xy[..., 1]
    return np.stack([x, y, np.ones_like(x)], axis=-1)


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
