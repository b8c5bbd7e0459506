"""How errors of a rig's calibration move the points that are intersected with it.

The least-squares point moves by dX = -(A^T A)^-1 A^T B dp, A and B being the derivatives of the collinearity equations by point
and calibration (implicit function theorem on the normal equations; e.g. Mikhail & Ackermann 1976, ch. 4). These errors are common
to all images of a rig: over the sightings of one cone the Jacobians are averaged, never the covariances.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conetl.geometry import rig as rigs
from conetl.geometry.jacobians import project_with_jacobian
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.records import CalibrationCovariance, Rig

Array = NDArray[np.float64]

INTERIOR = ("fx_px", "fy_px", "cx_px", "cy_px")
RELATIVE = ("rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m")


def known_covariance(rig: Rig) -> CalibrationCovariance | None:
    """Covariance of the calibration that took the images: of the raw rig where there is one. None where it is unknown."""
    return (rig.rectified_from or rig).calibration_covariance


def calibration_jacobian(points_left_m: ArrayLike, rig: Rig) -> Array:
    """Derivative (P, 3, K) of two-view points (P, 3) in the rig's left camera frame with respect to the calibration.

    K parameters in the order of `known_covariance(rig).names`; K = 0 without a covariance. Equal weights for all four
    image coordinates. Points behind a camera give NaN. Raises ValueError for an unknown name.
    """
    points = np.asarray(points_left_m, dtype=np.float64).reshape(-1, 3)
    covariance = known_covariance(rig)
    if covariance is None:
        return np.zeros((len(points), 3, 0))
    taken = rig.rectified_from or rig
    taken_R_own = rigs.body_SE3_camera(taken, "left")[:3, :3].T @ rigs.body_SE3_camera(rig, "left")[:3, :3]
    in_left = points @ taken_R_own.T  # rectification turns a camera about its own centre
    relative = rigs.left_SE3_right(taken)
    rotation, shift = relative[:3, :3], relative[:3, 3]
    in_right = (in_left - shift) @ rotation
    left = project_with_jacobian(taken.left, in_left)
    right = project_with_jacobian(taken.right, in_right)
    by_point = np.concatenate([left.by_point, right.by_point @ rotation.T], axis=1)
    # (R exp(r), t + dt): the point in the right camera changes by x_right x r - R^T dt
    by_relative = np.concatenate(
        [right.by_point @ cross_matrix(in_right), -(right.by_point @ rotation.T)], axis=2
    )  # fmt: skip
    columns = np.stack(
        [_column(name, left.by_interior, right.by_interior, by_relative) for name in covariance.names], 2
    )
    normal = np.swapaxes(by_point, 1, 2) @ by_point
    moved = -np.linalg.solve(normal, np.swapaxes(by_point, 1, 2) @ columns)
    turned: Array = taken_R_own.T @ moved
    return turned


def calibration_cov(points_left_m: ArrayLike, rig: Rig) -> Array:
    """Covariance (P, 3, 3) in m^2 of two-view points (P, 3) in the left camera's frame from the calibration alone.

    Zero for a calibration without a covariance, which counts as exact.
    """
    return shared_cov(calibration_jacobian(points_left_m, rig), rig)


def shared_cov(jacobians: ArrayLike, rig: Rig) -> Array:
    """Covariance (..., 3, 3) of Jacobians (..., 3, K) of `calibration_jacobian`, summed with weights or turned as needed."""
    j = np.asarray(jacobians, dtype=np.float64)
    covariance = known_covariance(rig)
    if covariance is None:
        return np.zeros((*j.shape[:-1], 3))
    cov: Array = j @ np.array(covariance.matrix) @ np.swapaxes(j, -1, -2)
    return (cov + np.swapaxes(cov, -1, -2)) / 2


def _column(name: str, left: Array, right: Array, relative: Array) -> Array:
    """(P, 4) derivative of u_left, v_left, u_right, v_right with respect to one named parameter."""
    column = np.zeros((len(left), 4))
    part, _, field = name.partition(".")
    if part == "relative" and field in RELATIVE:
        column[:, 2:] = relative[:, :, RELATIVE.index(field)]
        return column
    interior, rows = (left, slice(0, 2)) if part == "left" else (right, slice(2, 4))
    if part in ("left", "right") and field in INTERIOR:
        column[:, rows] = interior[:, :, INTERIOR.index(field)]
        return column
    number = field.removeprefix("lens.")
    if part in ("left", "right") and field != number and number.isdigit() and 4 + int(number) < interior.shape[2]:
        column[:, rows] = interior[:, :, 4 + int(number)]
        return column
    raise ValueError(f"'{name}' is not a parameter of this rig's calibration")
