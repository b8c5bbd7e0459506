"""Derivatives of the collinearity equations: what moves an image point, and by how much."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conetl.geometry.lens import distort, distort_jacobian
from conetl.model.records import Camera

Array = NDArray[np.float64]


class Projection(NamedTuple):
    """Image points of points in one camera's frame, with their derivatives."""

    uv_px: Array
    """(..., 2)"""
    by_point: Array
    """(..., 2, 3) px/m, with respect to the point in the camera's frame."""
    by_interior: Array
    """(..., 2, 4 + n) with respect to fx, fy, cx, cy and the lens's n coefficients."""


def project_with_jacobian(camera: Camera, points_cam_m: ArrayLike) -> Projection:
    """Project points (..., 3) of the camera's frame (x right, y down, z forward) and differentiate.

    Points that are not in front of the camera give NaN.
    """
    points = np.asarray(points_cam_m, dtype=np.float64)
    z = np.where(points[..., 2] > 0, points[..., 2], np.nan)
    xy = points[..., :2] / z[..., None]
    bent = distort(camera.lens, xy)
    by_xy, by_lens = distort_jacobian(camera.lens, xy)
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


def cross_matrix(vectors: ArrayLike) -> Array:
    """(..., 3, 3) matrices of the products v x . of vectors (..., 3)."""
    v = np.asarray(vectors, dtype=np.float64)
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return matrix
