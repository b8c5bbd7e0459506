"""Forward intersection of image rays: the collinearity equations for any number of views, by iterated least squares.

Equation 1 of Lagahit & Tseng ("A preliminary study on updating a detected traffic cone's coordinates obtained from a stereo
camera on a pseudo high definition map database"), for V views and P points at once:

    u = cx + fx * x/z,  v = cy + fy * y/z,  (x, y, z) = map_R_cam.T @ (X - C)

Iterated until the sum of squares of the correction is below 1e-10 m^2 (the paper's criterion), from the linear solution of the
same equations multiplied by the depth. Coordinates are relative to a camera of each point, so that large map coordinates cost no
digits. Degenerate points get a status, never a number. With a lens the adjustment is made in the distorted image, where the image
sigmas hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conetl.geometry.collinearity import (
    UPPER,
    Solution,
    Views,
    camera_point,
    directions,
    gauss_newton,
    ideal_points,
    image_point,
    inside_field,
    linear_start,
    make_views,
)
from conetl.model.records import Lens

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Points per chunk with two views: a compromise between numpy overhead and cache size.
CHUNK_POINTS = 8192


class IntersectionStatus(IntEnum):
    """Outcome of one point; rows of the result are NaN unless it is OK."""

    OK = 0
    INVALID_INPUT = 1
    """A used image point, sigma or camera is not finite, a sigma not positive, or the lens has no ray for the point."""
    TOO_FEW_VIEWS = 2
    RAY_ANGLE_TOO_SMALL = 3
    BEHIND_CAMERA = 4
    NOT_CONVERGED = 5
    """Or converged beyond the field that a lens maps one to one."""


@dataclass(frozen=True)
class IntersectionResult:
    """P points from V views. Rows of points whose status is not OK are NaN, except `ray_angle_rad` and `iterations`."""

    status: NDArray[np.int8]
    """(P,) values of IntersectionStatus."""
    xyz_m: Array
    """(P, 3) in the frame of the camera poses."""
    cov_m2: Array
    """(P, 3, 3) from the image sigmas alone, at the last linearisation."""
    residuals_px: Array
    """(P, V, 2) observed minus computed, in the image as given; NaN for views that were not used."""
    depth_m: Array
    """(P, V) along the optical axis of each view; NaN for views that were not used."""
    ray_angle_rad: Array
    """(P,) largest angle between any two used rays; NaN with fewer than two rays."""
    iterations: NDArray[np.int64]
    """(P,) solutions of the normal equations."""

    @property
    def ok(self) -> Bools:
        """(P,) True where the status is OK."""
        return np.asarray(self.status == IntersectionStatus.OK)


def intersect(
    uv_px: ArrayLike,
    valid: ArrayLike | None,
    k_px: ArrayLike,
    map_R_cam: ArrayLike,
    centre_m: ArrayLike,
    sigma_uv_px: ArrayLike,
    *,
    lenses: Sequence[Lens] | None = None,
    convergence_m2: float = 1e-10,
    max_iterations: int = 20,
    min_ray_angle_rad: float = 0.008,
    chunk_points: int = CHUNK_POINTS,
) -> IntersectionResult:
    """Intersect the rays of P points in up to V views each.

    uv_px (P, V, 2): image points in pixels. valid (P, V) bool: which of them exist (None: all). k_px (V, 4) or (P, V, 4):
    fx, fy, cx, cy. map_R_cam (V, 3, 3) or (P, V, 3, 3) and centre_m (V, 3) or (P, V, 3): exterior orientation of the views
    in any common frame. sigma_uv_px: anything that broadcasts to (P, V, 2). lenses: one for each of the V views, where the image
    points still have their distortion.
    Points with fewer views are padded and masked by `valid`; padding may hold NaN. Giving cameras as (V, ...) where all
    points share them is faster. Raises ValueError on arrays whose shapes do not fit; bad values only give a status.
    """
    uv = np.asarray(uv_px, dtype=np.float64)
    if uv.ndim != 3 or uv.shape[2] != 2:
        raise ValueError(f"uv_px must be (P, V, 2), found {uv.shape}")
    p, v = uv.shape[:2]
    mask = np.ones((p, v), dtype=bool) if valid is None else np.asarray(valid, dtype=bool)
    k = _camera_array(k_px, (v, 4), p, "k_px")
    rot = _camera_array(map_R_cam, (v, 3, 3), p, "map_R_cam")
    centre = _camera_array(centre_m, (v, 3), p, "centre_m")
    if mask.shape != (p, v):
        raise ValueError(f"valid must be ({p}, {v}), found {mask.shape}")
    sigma = np.asarray(sigma_uv_px, dtype=np.float64)
    per_point = sigma.ndim == 3 and sigma.shape[0] != 1
    sigma = np.broadcast_to(sigma, (p, v, 2)) if per_point else np.broadcast_to(sigma, (1, v, 2))[0]
    if lenses is not None and len(lenses) != v:
        raise ValueError(f"lenses must be one for each of the {v} views, found {len(lenses)}")
    bent = None if lenses is None or all(lens.model == "none" for lens in lenses) else tuple(lenses)
    result = _empty(p, v)
    step = max(1, min(chunk_points, chunk_points * 8 // (v * v))) if v > 2 else chunk_points
    for begin in range(0, p, step):
        part = slice(begin, min(begin + step, p))

        def cut(a: Array, shared_ndim: int, part: slice = part) -> Array:
            return a if a.ndim == shared_ndim else a[part]

        _intersect_chunk(
            result, part, uv[part], mask[part], cut(k, 2), cut(rot, 3), cut(centre, 2), cut(sigma, 2),
            bent, convergence_m2, max_iterations, min_ray_angle_rad,
        )  # fmt: skip
    return result


def _camera_array(value: ArrayLike, shape: tuple[int, ...], points: int, name: str) -> Array:
    """Check a per-view array that may also be given per point."""
    a = np.asarray(value, dtype=np.float64)
    if a.shape not in (shape, (points, *shape)):
        raise ValueError(f"{name} must be {shape} or {(points, *shape)}, found {a.shape}")
    return a


def _empty(p: int, v: int) -> IntersectionResult:
    def nan(*shape: int) -> Array:
        return np.full(shape, np.nan)

    status = np.zeros(p, dtype=np.int8)
    return IntersectionResult(
        status, nan(p, 3), nan(p, 3, 3), nan(p, v, 2), nan(p, v), nan(p), np.zeros(p, dtype=np.int64)
    )


def _intersect_chunk(
    result: IntersectionResult, part: slice, uv: Array, mask: Bools, k: Array, rot: Array, centre: Array,
    sigma: Array, lenses: tuple[Lens, ...] | None, convergence_m2: float, max_iterations: int, min_ray_angle_rad: float,
) -> None:  # fmt: skip
    """Fill the rows `part` of the result."""
    n = uv.shape[0]
    status = np.zeros(n, dtype=np.int8)
    sound = _sound(uv, k, rot, centre, sigma)
    ideal = ideal_points(uv, k, lenses)
    if ideal is not None:
        sound &= np.isfinite(ideal).all(axis=2)
    status[np.any(mask & ~sound, axis=1)] = IntersectionStatus.INVALID_INPUT
    status[(status == 0) & (mask.sum(axis=1) < 2)] = IntersectionStatus.TOO_FEW_VIEWS
    used = mask & sound
    origin = _origin(used, centre)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        views = make_views(uv, ideal, used, k, rot, centre, sigma, origin, lenses)
        angle = _ray_angle(views, used)
        result.ray_angle_rad[part] = angle
        status[(status == 0) & ~(angle >= min_ray_angle_rad)] = IntersectionStatus.RAY_ANGLE_TOO_SMALL
        rows = np.flatnonzero(status == 0)
        if rows.size:
            if rows.size < n:
                views, origin, used = views.take(status == 0), origin[rows], used[rows]
            solution = gauss_newton(views, linear_start(views), convergence_m2, max_iterations)
            status[rows] = _store(result, part.start + rows, views, solution, origin, used)
    result.status[part] = status


def _sound(uv: Array, k: Array, rot: Array, centre: Array, sigma: Array) -> Bools:
    """(n, V) True where image point, sigma and camera can be used."""
    if np.isfinite(sum(float(a.sum()) for a in (uv, k, rot, centre, sigma))) and min(sigma.min(), k[..., :2].min()) > 0:
        return np.ones(uv.shape[:2], dtype=bool)  # any infinity or NaN would show in the sum
    per_view = np.isfinite(k).all(axis=-1) & (k[..., :2] > 0).all(axis=-1)
    per_view = per_view & np.isfinite(rot).all(axis=(-2, -1)) & np.isfinite(centre).all(axis=-1)
    s0, s1 = sigma[..., 0], sigma[..., 1]
    image = np.isfinite(uv[..., 0] + uv[..., 1]) & (s0 > 0) & (s1 > 0) & np.isfinite(s0 + s1)
    return np.asarray(image & per_view)


def _origin(mask: Bools, centre: Array) -> Array:
    """(n, 3) centre of each point's first used view."""
    first = np.argmax(mask, axis=1)
    chosen: Array = centre[first] if centre.ndim == 2 else centre[np.arange(len(first)), first]
    return chosen


def _ray_angle(views: Views, used: Bools) -> Array:
    """(n,) largest angle between two used rays, from the chord of the unit vectors; NaN with fewer than two."""
    d = directions(views)
    count = used.shape[1]
    largest = np.full(used.shape[0], -1.0)
    for i in range(count - 1):
        both = (used[:, i : i + 1] & used[:, i + 1 :]).T
        chord2 = (d[0][i] - d[0][i + 1 :]) ** 2 + (d[1][i] - d[1][i + 1 :]) ** 2 + (d[2][i] - d[2][i + 1 :]) ** 2
        largest = np.maximum(largest, np.where(both, chord2, -1.0).max(axis=0))
    return np.where(largest >= 0, 2.0 * np.arcsin(np.minimum(np.sqrt(np.abs(largest)) / 2.0, 1.0)), np.nan)


def _store(
    result: IntersectionResult, index: NDArray[np.int64], views: Views, solution: Solution, origin: Array, used: Bools
) -> NDArray[np.int8]:
    """Write the good points to the rows `index` of the result; returns the statuses of all."""
    x, upper = solution.x, solution.cov
    cx, cy, cz = camera_point(views, x)
    xn, yn = cx / cz, cy / cz
    real = np.isfinite(x[0] + x[1] + x[2])
    behind = np.any(used.T & ~(cz > 0), axis=0) & real
    good = solution.converged & real & np.isfinite(sum(upper))
    if views.lenses is not None:
        good &= (inside_field(views, xn, yn) | ~used.T).all(axis=0)
    outcome = np.where(good, IntersectionStatus.OK, IntersectionStatus.NOT_CONVERGED)
    outcome = np.where(behind, IntersectionStatus.BEHIND_CAMERA, outcome).astype(np.int8)
    result.iterations[index] = solution.iterations
    ok = outcome == IntersectionStatus.OK
    keep: slice | NDArray[np.int64] = index[ok]
    chosen: slice | Bools = ok
    if ok.all() and int(index[-1]) - int(index[0]) + 1 == index.size:  # the common case, without copies
        keep, chosen = slice(int(index[0]), int(index[-1]) + 1), slice(None)
    for axis in range(3):
        result.xyz_m[keep, axis] = x[axis][chosen] + origin[chosen, axis]
    for value, (i, j) in zip(upper, UPPER, strict=True):
        result.cov_m2[keep, i, j] = value[chosen]
        if i != j:
            result.cov_m2[keep, j, i] = value[chosen]
    bent_x, bent_y = image_point(views, xn, yn)
    found = ((views.u - bent_x) * views.fx, (views.v - bent_y) * views.fy, cz)
    if not used.all():
        found = (np.where(used.T, found[0], np.nan), np.where(used.T, found[1], np.nan), np.where(used.T, cz, np.nan))
    result.residuals_px[keep, :, 0] = found[0].T[chosen]
    result.residuals_px[keep, :, 1] = found[1].T[chosen]
    result.depth_m[keep] = found[2].T[chosen]
    return outcome
