"""Forward intersection of image rays: the collinearity equations for any number of views, by iterated least squares.

Equation 1 of Lagahit & Tseng ("A preliminary study on updating a detected traffic cone's coordinates obtained from a stereo
camera on a pseudo high definition map database"), for V views and P points at once:

    u = cx + fx * x/z,  v = cy + fy * y/z,  (x, y, z) = map_R_cam.T @ (X - C)

Iterated until the sum of squares of the correction is below 1e-10 m^2 (the paper's criterion), from the linear solution of the
same equations multiplied by the depth. Coordinates are relative to the first camera of each point, so that large map coordinates
lose no digits. Degenerate points get a status, never a number.

Inside, components come first and points last: arrays are (..., V, n), or (..., V, 1) where all points share a view.

`fit_point` fits one point to all its stereo pairs of a drive, with correlated errors: the two image points of a pair share the
pointing error of the detector, and all four share the error of that frame's pose relative to the others. Both are in the weight
matrix of the pair, so that near frames, whose relative motion is well known, outweigh distant ones. Huber's weights limit the
influence of single wrong boxes.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conetl.geometry.camera import project_with_jacobian
from conetl.model.arrays import Bools, Floats
from conetl.model.rig import Rig

#: Rows and columns of the upper triangle of a symmetric matrix (3, 3).
_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_HUBER_SIGMAS = 2.5
#: Huber weights converge linearly where many observations do not fit.
_MAX_FIT_ITERATIONS = 200


class IntersectionStatus(IntEnum):
    """Outcome of one point; rows of the result are NaN unless it is OK."""

    OK = 0
    INVALID_INPUT = 1
    """An image point, sigma or camera is not finite, or a sigma or focal length not positive."""
    RAY_ANGLE_TOO_SMALL = 3
    BEHIND_CAMERA = 4
    NOT_CONVERGED = 5


class IntersectionResult(NamedTuple):
    """P points from V views. Rows of points whose status is not OK are NaN, except `ray_angle_rad` and `iterations`."""

    status: NDArray[np.int8]
    """(P,) values of IntersectionStatus."""
    xyz_m: Floats
    """(P, 3) in the frame of the camera poses."""
    cov_m2: Floats
    """(P, 3, 3) from the image sigmas alone, at the last linearisation."""
    residuals_px: Floats
    """(P, V, 2) observed minus computed."""
    depth_m: Floats
    """(P, V) along the optical axis of each view."""
    ray_angle_rad: Floats
    """(P,) largest angle between any two rays; NaN where the input is invalid."""
    iterations: NDArray[np.int64]
    """(P,) solutions of the normal equations."""

    @property
    def ok(self) -> Bools:
        """(P,) True where the status is OK."""
        return np.asarray(self.status == IntersectionStatus.OK)


class _Views(NamedTuple):
    """Views of n points."""

    uv: Floats
    """(2, V, n) observed x/z, y/z"""
    focal: Floats
    """(2, V, 1 or n) fx, fy"""
    weight: Floats
    """(2, V, 1 or n) focal length over sigma: what x/z and y/z are multiplied with"""
    rot: Floats
    """(3, 3, V, 1 or n) cam_R_map"""
    centre: Floats
    """(3, V, n) relative to the point's origin"""

    def take(self, keep: Bools) -> _Views:
        """Only the points of a mask (n,)."""
        return _Views(*(a if a.shape[-1] == 1 else a[..., keep] for a in self))


def intersect(
    uv_px: ArrayLike,
    k_px: ArrayLike,
    map_R_cam: ArrayLike,
    centre_m: ArrayLike,
    sigma_uv_px: ArrayLike,
    *,
    convergence_m2: float = 1e-10,
    max_iterations: int = 20,
    min_ray_angle_rad: float = 0.008,
) -> IntersectionResult:
    """Intersect the rays of P points in V views each, of cameras without a lens.

    uv_px (P, V, 2): image points in pixels. k_px (V, 4) or (P, V, 4): fx, fy, cx, cy. map_R_cam (V, 3, 3) or (P, V, 3, 3) and
    centre_m (V, 3) or (P, V, 3): exterior orientation of the views in any common frame. sigma_uv_px: anything that broadcasts to
    (P, V, 2). Giving cameras as (V, ...) where all points share them is faster. Raises ValueError on arrays whose shapes do not
    fit; bad values only give a status.
    """
    uv = np.asarray(uv_px, dtype=np.float64)
    if uv.ndim != 3 or uv.shape[2] != 2:
        raise ValueError(f"uv_px must be (P, V, 2), found {uv.shape}")
    p, v = uv.shape[:2]
    k = _by_component(k_px, (v, 4), p, "k_px")
    rot = _by_component(map_R_cam, (v, 3, 3), p, "map_R_cam")
    centre = _by_component(centre_m, (v, 3), p, "centre_m")
    sigma = np.asarray(sigma_uv_px, dtype=np.float64)
    shared = sigma.ndim < 3 or sigma.shape[0] == 1
    sigma = np.ascontiguousarray(np.broadcast_to(sigma, (1 if shared else p, v, 2)).T)
    uv = np.ascontiguousarray(uv.T)
    usable = np.ones(p, dtype=bool)
    for a in (uv, k, rot, centre, sigma):
        usable &= np.isfinite(a).all(axis=tuple(range(a.ndim - 1)))
    usable &= (k[:2] > 0).all(axis=(0, 1)) & (sigma > 0).all(axis=(0, 1))
    result = IntersectionResult(
        np.where(usable, IntersectionStatus.RAY_ANGLE_TOO_SMALL, IntersectionStatus.INVALID_INPUT).astype(np.int8),
        np.full((p, 3), np.nan), np.full((p, 3, 3), np.nan), np.full((p, v, 2), np.nan), np.full((p, v), np.nan),
        np.full(p, np.nan), np.zeros(p, dtype=np.int64),
    )  # fmt: skip
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        origin = np.broadcast_to(centre[:, 0], (3, p))
        views = _Views((uv - k[2:]) / k[:2], k[:2], k[:2] * (1.0 / sigma), rot, centre - origin[:, None])
        result.ray_angle_rad[usable] = _ray_angle(views)[usable]
        good = usable & (result.ray_angle_rad >= min_ray_angle_rad)
        if not good.any():
            return result
        if not good.all():
            views, origin = views.take(good), origin[:, good]
        x, upper, iterations, converged = _gauss_newton(views, convergence_m2, max_iterations)
        local = _camera_points(views, x)
        real = np.isfinite(x).all(axis=0)
        solved = converged & real & np.isfinite(upper).all(axis=0)
        outcome = np.where(solved, IntersectionStatus.OK, IntersectionStatus.NOT_CONVERGED)
        outcome[(~(local[2] > 0)).any(axis=0) & real] = IntersectionStatus.BEHIND_CAMERA
        result.status[good], result.iterations[good] = outcome, iterations
        ok = outcome == IntersectionStatus.OK
        rows = np.flatnonzero(good)[ok]
        result.xyz_m[rows] = (x + origin)[:, ok].T
        for value, (i, j) in zip(upper, _UPPER, strict=True):
            result.cov_m2[rows, i, j] = result.cov_m2[rows, j, i] = value[ok]
        result.residuals_px[rows] = ((views.uv - local[:2] / local[2]) * views.focal)[..., ok].T
        result.depth_m[rows] = local[2][:, ok].T
    return result


def _by_component(value: ArrayLike, shape: tuple[int, ...], points: int, name: str) -> Floats:
    """A per-view array that may also be given per point, with its components first and points last."""
    a = np.asarray(value, dtype=np.float64)
    if a.shape not in (shape, (points, *shape)):
        raise ValueError(f"{name} must be {shape} or {(points, *shape)}, found {a.shape}")
    return np.ascontiguousarray(a.T if a.ndim > len(shape) else a.T[..., None])


def _ray_angle(views: _Views) -> Floats:
    """(n,) largest angle between two observed rays, from the chord of the unit vectors."""
    u, v = views.uv
    d = (views.rot[0] * u + views.rot[1] * v + views.rot[2]) * (1.0 / np.sqrt(u * u + v * v + 1.0))
    chord2 = [((d[:, i] - d[:, j]) ** 2).sum(axis=0) for i in range(len(u)) for j in range(i + 1, len(u))]
    return np.asarray(2.0 * np.arcsin(np.minimum(np.sqrt(np.max(chord2, axis=0)) / 2.0, 1.0)))


def _camera_points(views: _Views, x: Floats) -> Floats:
    """(3, V, n) points (3, n) in every view's camera frame."""
    return np.asarray((views.rot * (x[:, None] - views.centre)).sum(axis=1))


def _rows(views: _Views, weight: Floats | float, xy: Floats) -> Floats:
    """(2, 3, V, n): derivatives of x/z and y/z by the point, times the depth and a weight (2, V, n)."""
    return np.asarray(views.rot[:2] * np.expand_dims(weight, 1) - views.rot[2] * np.expand_dims(weight * xy, 1))


def _normal_equations(rows: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Upper triangle (6, n) of the inverse normal matrix, not finite where singular, and the solution (3, n).

    rows (2, 3, V, n), right (2, V, n): both equations of every view.
    """
    (a, b), (ra, rb) = rows, right
    xx, xy, xz, yy, yz, zz = ((a[i] * a[j] + b[i] * b[j]).sum(axis=0) for i, j in _UPPER)
    g0, g1, g2 = (a * ra + b * rb).sum(axis=1)
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    scale = 1.0 / (xx * c0 + xy * c1 + xz * c2)
    c3, c4, c5 = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    inverse = np.stack([c0, c1, c2, c3, c4, c5]) * scale
    xx, xy, xz, yy, yz, zz = inverse
    return inverse, np.stack([xx * g0 + xy * g1 + xz * g2, xy * g0 + yy * g1 + yz * g2, xz * g0 + yz * g1 + zz * g2])


def _gauss_newton(
    views: _Views, convergence_m2: float, max_iterations: int
) -> tuple[Floats, Floats, NDArray[np.int64], Bools]:
    """Points (3, n), upper triangles (6, n) of their covariance at the last linearisation, iterations and convergence (n,).

    Starts at the solution of the collinearity equations multiplied by the depth, which are linear in the point.
    """
    rows = _rows(views, np.ones((2, 1, 1)), views.uv)
    _, x = _normal_equations(rows, (rows * views.centre).sum(axis=1))
    n = x.shape[1]
    solution, cov = np.empty((3, n)), np.empty((6, n))
    iterations, converged = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=bool)
    active, going = np.arange(n), np.ones(n, dtype=bool)
    for _ in range(max_iterations):
        local = _camera_points(views, x)
        inverse = 1.0 / local[2]
        xy = local[:2] * inverse
        upper, dx = _normal_equations(_rows(views, views.weight * inverse, xy), views.weight * (views.uv - xy))
        dx = np.where(going, dx, 0.0)  # finished points stay, so that no result depends on other points of the chunk
        x = x + dx
        square = (dx * dx).sum(axis=0)
        iterations[active] += going
        converged[active] |= going & (square < convergence_m2)
        going = going & (square >= convergence_m2)
        left = int(np.count_nonzero(going))
        if left == 0:
            break
        if 2 * left < going.size:  # smaller arrays are worth the copy
            solution[:, active], cov[:, active] = x, upper
            active, x, views, going = active[going], x[:, going], views.take(going), going[going]
    solution[:, active], cov[:, active] = x, upper
    return solution, cov, iterations, converged


class JointFit(NamedTuple):
    """Result of `fit_point`; `cov_m2` (3, 3) excludes errors that all frames have in common."""

    xyz_m: Floats
    cov_m2: Floats
    of_images_m2: Floats
    """(3, 3): what errors of the image points alone make of it."""
    residuals_px: Floats
    """(F, 4): observed minus computed u_left, v_left, u_right, v_right."""
    shares: Floats
    """(F, 3, 3): derivative by each pair's own point; their sum is the identity."""


def pair_jacobian(point_m: Floats, map_SE3_left: Floats, map_SE3_right: Floats, rig: Rig) -> tuple[Floats, Floats]:
    """Image points of one map point in F stereo pairs, and their derivatives (collinearity equations, linearised).

    point_m (3,); map_SE3_left, map_SE3_right (F, 4, 4); a rectified rig. Returns (F, 4) px and (F, 4, 3) px/m in the order of
    u_left, v_left, u_right, v_right. Points behind a camera give NaN.
    """
    computed, jacobian = [], []
    for camera, pose in ((rig.left, map_SE3_left), (rig.right, map_SE3_right)):
        to_camera = np.swapaxes(pose[:, :3, :3], 1, 2)
        seen = project_with_jacobian(camera, np.einsum("fij,fj->fi", to_camera, point_m - pose[:, :3, 3]))
        computed.append(seen.uv_px)
        jacobian.append(seen.by_point @ to_camera)
    return np.concatenate(computed, axis=1), np.concatenate(jacobian, axis=1)


def fit_point(
    observed_px: Floats,
    start_m: Floats,
    map_SE3_left: Floats,
    map_SE3_right: Floats,
    rig: Rig,
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
    for _ in range(_MAX_FIT_ITERATIONS):
        computed, jacobian = pair_jacobian(point, left, right, rig)
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
            by_image = cov @ weighted
            of_images = (by_image @ noise @ np.swapaxes(by_image, 1, 2)).sum(axis=0)
            return JointFit(point + shift, (cov + cov.T) / 2, of_images, residual, cov @ normals)
    return None
