"""One point from all its stereo pairs of a drive: collinearity equations with correlated errors.

Unlike in `intersection.py`, the two image points of a pair share the pointing error of the detector, and all four share the error
of that frame's pose relative to the others. Both are in the weight matrix of the pair, so that near frames, whose relative motion
is well known, outweigh distant ones. Huber's weights limit the influence of single wrong boxes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.camera import intrinsics
from conetl.model.records import Rig

Floats = NDArray[np.float64]
_HUBER_SIGMAS = 2.5
#: Huber weights converge linearly where many observations do not fit.
_MAX_ITERATIONS = 200


@dataclass(frozen=True)
class JointFit:
    """Result of `fit_point`; `cov_m2` (3, 3) excludes errors that all frames have in common."""

    xyz_m: Floats
    cov_m2: Floats
    residuals_px: Floats
    """(F, 4): observed minus computed u_left, v_left, u_right, v_right."""
    weights: Floats
    """(F,): Huber weight of each pair; 1 where it fits."""
    shares: Floats
    """(F, 3, 3): derivative by each pair's own point; their sum is the identity."""
    iterations: int


def image_constants(rig: Rig) -> tuple[Floats, Floats]:
    """Focal lengths (4,) and principal points (4,) of a rectified rig, px, in the order of u_left, v_left, u_right, v_right."""
    both = np.stack([intrinsics(rig.left), intrinsics(rig.right)])
    return both[:, :2].ravel(), both[:, 2:].ravel()


def pair_jacobian(
    point_m: Floats, map_SE3_left: Floats, map_SE3_right: Floats, focal_px: Floats, principal_px: Floats
) -> tuple[Floats, Floats]:
    """Image points of one map point in F stereo pairs, and their derivatives (collinearity equations, linearised).

    point_m (3,); map_SE3_left, map_SE3_right (F, 4, 4); focal_px, principal_px (4,) in the order of u_left, v_left, u_right,
    v_right. Returns (F, 4) px and (F, 4, 3) px/m. Points behind a camera give NaN.
    """
    computed, jacobian = [], []
    for side, pose in enumerate((map_SE3_left, map_SE3_right)):
        to_camera = np.swapaxes(pose[:, :3, :3], 1, 2)
        local = np.einsum("fij,fj->fi", to_camera, point_m - pose[:, :3, 3])
        depth = np.where(local[:, 2] > 0, local[:, 2], np.nan)
        for axis in (0, 1):
            k = 2 * side + axis
            ratio = local[:, axis] / depth
            computed.append(principal_px[k] + focal_px[k] * ratio)
            jacobian.append(
                focal_px[k] * (to_camera[:, axis, :] - ratio[:, None] * to_camera[:, 2, :]) / depth[:, None]
            )
    return np.stack(computed, axis=1), np.stack(jacobian, axis=1)


def fit_point(
    observed_px: Floats,
    start_m: Floats,
    map_SE3_left: Floats,
    map_SE3_right: Floats,
    focal_px: Floats,
    principal_px: Floats,
    *,
    sigma_u_px: Floats,
    sigma_v_px: Floats,
    sigma_pointing_px: Floats,
    sigma_motion_m: Floats,
    convergence_m2: float = 1e-10,
) -> JointFit | None:
    """Least-squares point of F stereo pairs, None where it does not converge in front of every camera.

    observed_px (F, 4): u_left, v_left, u_right, v_right; start_m (3,) map frame; the sigmas (F,): independent per image point
    (along rows, across rows), common to both image points of a pair along the rows, and of the frame's position relative
    to the frame nearest to the cone. Stops when the sum of squares of the correction is below `convergence_m2`.
    """
    frames = len(observed_px)
    noise = np.zeros((frames, 4, 4))
    noise[:, 0, 0] = noise[:, 2, 2] = sigma_u_px**2 + sigma_pointing_px**2
    noise[:, 0, 2] = noise[:, 2, 0] = sigma_pointing_px**2
    noise[:, 1, 1] = noise[:, 3, 3] = sigma_v_px**2
    # Millimetre corrections on coordinates of millions of metres: work around the start.
    shift = start_m.copy()
    left, right = map_SE3_left.copy(), map_SE3_right.copy()
    left[:, :3, 3] -= shift
    right[:, :3, 3] -= shift
    point = np.zeros(3)
    huber = np.ones(frames)
    for iteration in range(1, _MAX_ITERATIONS + 1):
        computed, jacobian = pair_jacobian(point, left, right, focal_px, principal_px)
        if not np.isfinite(computed).all():
            return None
        residual = observed_px - computed
        spread = noise + sigma_motion_m[:, None, None] ** 2 * jacobian @ np.swapaxes(jacobian, 1, 2)
        information = np.linalg.inv(spread)
        misfit = np.sqrt(np.einsum("fi,fij,fj->f", residual, information, residual) / 4)
        huber = np.minimum(1.0, _HUBER_SIGMAS / np.maximum(misfit, 1e-9))
        weighted = np.swapaxes(jacobian, 1, 2) @ information * huber[:, None, None]
        normals = weighted @ jacobian
        normal = normals.sum(axis=0)
        try:
            cov = np.linalg.inv(normal)
        except np.linalg.LinAlgError:
            return None
        step = cov @ np.einsum("fij,fj->i", weighted, residual)
        point = point + step
        if float(step @ step) < convergence_m2:
            return JointFit(point + shift, (cov + cov.T) / 2, residual, huber, cov @ normals, iteration)
    return None
