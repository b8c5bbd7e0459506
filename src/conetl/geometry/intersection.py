"""Forward intersection of image rays: the collinearity equations for any number of views, by iterated least squares.

This is Equation 1 of Lagahit & Tseng ("A preliminary study on updating a detected traffic cone's coordinates obtained from
a stereo camera on a pseudo high definition map database"), written for V views and solved for P points at once:

    u = cx + fx * x/z,  v = cy + fy * y/z,  (x, y, z) = map_R_cam.T @ (X - C)

Each iteration linearises both equations of every view at the present X, weights them with the image sigmas and solves the
3x3 normal equations; it stops when the sum of squares of the correction falls below 1e-10 m^2 (the paper's criterion).
The start is the linear solution of the same equations multiplied by the depth. Coordinates are taken relative to a camera
of each point, so that map coordinates of millions of metres cost no digits. Degenerate points get a status, never a number.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: Points per chunk with two views: small enough for the working arrays to stay in the processor's cache.
CHUNK_POINTS = 4096
_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class IntersectionStatus(IntEnum):
    """What became of one point; anything but OK means that its rows in the result are NaN."""

    OK = 0
    INVALID_INPUT = 1
    """A used image point, sigma, camera or start is not finite, or a sigma is not positive."""
    TOO_FEW_VIEWS = 2
    RAY_ANGLE_TOO_SMALL = 3
    BEHIND_CAMERA = 4
    NOT_CONVERGED = 5


@dataclass(frozen=True)
class IntersectionResult:
    """P points from V views. Rows of points whose status is not OK are NaN, except `ray_angle_rad` and `iterations`."""

    status: NDArray[np.int8]
    """(P,) values of IntersectionStatus."""
    xyz_m: Array
    """(P, 3) in the frame of the camera poses."""
    cov_m2: Array
    """(P, 3, 3) from the image sigmas alone."""
    residuals_px: Array
    """(P, V, 2) observed minus computed; NaN for views that were not used."""
    depth_m: Array
    """(P, V) along the optical axis of each view; NaN for views that were not used."""
    ray_angle_rad: Array
    """(P,) largest angle between any two used rays; NaN where it cannot be told."""
    iterations: NDArray[np.int64]
    """(P,) solutions of the normal equations."""

    @property
    def ok(self) -> Bools:
        """(P,) True where the point is good."""
        return np.asarray(self.status == IntersectionStatus.OK)


class _Views(NamedTuple):
    """Views of the points at work, component first: every array is (V, n) or, where all points share a view, (V, 1)."""

    u: Array
    v: Array
    fx: Array
    fy: Array
    weight_u: Array
    """fx / sigma_u, or 0 for a view that is not used: what x/z is multiplied with."""
    weight_v: Array
    rot: list[list[Array]]
    """rot[i][j]: component of cam_R_map."""
    centre: list[Array]
    """relative to the point's origin"""

    def take(self, keep: Bools) -> _Views:
        """Only the points of a mask (n,)."""

        def part(a: Array) -> Array:
            return a if a.shape[1] == 1 else a[:, keep]

        return _Views(
            u=part(self.u), v=part(self.v), fx=part(self.fx), fy=part(self.fy),
            weight_u=part(self.weight_u), weight_v=part(self.weight_v),
            rot=[[part(a) for a in row] for row in self.rot], centre=[part(a) for a in self.centre],
        )  # fmt: skip


def intersect(
    uv_px: ArrayLike,
    valid: ArrayLike | None,
    k_px: ArrayLike,
    map_R_cam: ArrayLike,
    centre_m: ArrayLike,
    sigma_uv_px: ArrayLike,
    *,
    start_m: ArrayLike | None = None,
    convergence_m2: float = 1e-10,
    max_iterations: int = 20,
    min_ray_angle_rad: float = 0.008,
    chunk_points: int = CHUNK_POINTS,
) -> IntersectionResult:
    """Intersect the rays of P points in up to V views each.

    uv_px (P, V, 2): image points in pixels. valid (P, V) bool: which of them exist (None: all). k_px (V, 4) or (P, V, 4):
    fx, fy, cx, cy. map_R_cam (V, 3, 3) or (P, V, 3, 3) and centre_m (V, 3) or (P, V, 3): exterior orientation of the views
    in any common frame. sigma_uv_px: anything that broadcasts to (P, V, 2). start_m (P, 3): optional approximate points.
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
    start = None if start_m is None else np.asarray(start_m, dtype=np.float64)
    if start is not None and start.shape != (p, 3):
        raise ValueError(f"start_m must be ({p}, 3), found {start.shape}")
    result = _empty(p, v)
    step = max(1, min(chunk_points, chunk_points * 8 // (v * v))) if v > 2 else chunk_points
    for begin in range(0, p, step):
        part = slice(begin, min(begin + step, p))

        def cut(a: Array, shared_ndim: int, part: slice = part) -> Array:
            return a if a.ndim == shared_ndim else a[part]

        _intersect_chunk(
            result, part, uv[part], mask[part], cut(k, 2), cut(rot, 3), cut(centre, 2), cut(sigma, 2),
            None if start is None else start[part], convergence_m2, max_iterations, min_ray_angle_rad,
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
    sigma: Array, start: Array | None, convergence_m2: float, max_iterations: int, min_ray_angle_rad: float,
) -> None:  # fmt: skip
    """Fill the rows `part` of the result."""
    n = uv.shape[0]
    status = np.zeros(n, dtype=np.int8)
    sound = _sound(uv, k, rot, centre, sigma)
    status[np.any(mask & ~sound, axis=1)] = IntersectionStatus.INVALID_INPUT
    if start is not None:
        status[~np.isfinite(start).all(axis=1)] = IntersectionStatus.INVALID_INPUT
    status[(status == 0) & (mask.sum(axis=1) < 2)] = IntersectionStatus.TOO_FEW_VIEWS
    used = mask & sound
    origin = _origin(used, centre)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        views = _views(uv, used, k, rot, centre, sigma, origin)
        angle = _ray_angle(views, used)
        result.ray_angle_rad[part] = angle
        status[(status == 0) & ~(angle >= min_ray_angle_rad)] = IntersectionStatus.RAY_ANGLE_TOO_SMALL
        rows = np.flatnonzero(status == 0)
        if rows.size:
            if rows.size < n:
                views, origin, used = views.take(status == 0), origin[rows], used[rows]
            first = _linear_start(views) if start is None else np.ascontiguousarray((start[rows] - origin).T)
            x, iterations, converged = _iterate(views, first, convergence_m2, max_iterations)
            _store(result, part.start + rows, views, x, iterations, converged, origin, status, rows, used)
    result.status[part] = status


def _sound(uv: Array, k: Array, rot: Array, centre: Array, sigma: Array) -> Bools:
    """(n, V) True where image point, sigma and camera can be used."""
    if np.isfinite(sum(float(a.sum()) for a in (uv, k, rot, centre, sigma))) and min(sigma.min(), k[..., :2].min()) > 0:
        return np.ones(uv.shape[:2], dtype=bool)  # one infinity or NaN anywhere would show in the sum
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


def _ray_angle(views: _Views, used: Bools) -> Array:
    """(n,) largest angle between two used rays, from the chord of the unit vectors; NaN with fewer than two."""
    u, v, rot = views.u, views.v, views.rot
    scale = 1.0 / np.sqrt(u * u + v * v + 1.0)
    d = [(rot[0][i] * u + rot[1][i] * v + rot[2][i]) * scale for i in range(3)]
    count = used.shape[1]
    largest = np.full(used.shape[0], -1.0)
    for i in range(count - 1):
        both = (used[:, i : i + 1] & used[:, i + 1 :]).T
        chord2 = (d[0][i] - d[0][i + 1 :]) ** 2 + (d[1][i] - d[1][i + 1 :]) ** 2 + (d[2][i] - d[2][i + 1 :]) ** 2
        largest = np.maximum(largest, np.where(both, chord2, -1.0).max(axis=0))
    return np.where(largest >= 0, 2.0 * np.arcsin(np.minimum(np.sqrt(np.abs(largest)) / 2.0, 1.0)), np.nan)


def _views(uv: Array, mask: Bools, k: Array, rot: Array, centre: Array, sigma: Array, origin: Array) -> _Views:
    """Bring the inputs into component-first order; unused views get weight 0 and harmless numbers."""

    def comp(a: Array) -> Array:
        return np.ascontiguousarray(a.T) if a.ndim == 2 else a[:, None]

    used = np.ascontiguousarray(mask.T)
    all_used = bool(used.all())

    def clean(a: Array, neutral: float) -> Array:
        return a if all_used else np.where(used, a, neutral)

    fx, fy = clean(comp(k[..., 0]), 1.0), clean(comp(k[..., 1]), 1.0)
    inverse = (1.0 / comp(sigma[..., 0]), 1.0 / comp(sigma[..., 1]))
    local = [clean(comp(centre[..., i]) - origin[:, i], 0.0) for i in range(3)]
    cam_R_map = [[clean(comp(rot[..., j, i]), float(i == j)) for j in range(3)] for i in range(3)]
    return _Views(
        u=clean((comp(uv[..., 0]) - comp(k[..., 2])) / fx, 0.0), v=clean((comp(uv[..., 1]) - comp(k[..., 3])) / fy, 0.0),
        fx=fx, fy=fy, weight_u=clean(fx * inverse[0], 0.0), weight_v=clean(fy * inverse[1], 0.0),
        rot=cam_R_map, centre=local,
    )  # fmt: skip


def _over_views(a: Array) -> Array:
    """(n,) sum of (V, n) over the views; two rows are added faster than they are reduced."""
    return a[0] + a[1] if a.shape[0] == 2 else np.asarray(a.sum(axis=0))


def _normal_matrix(a: list[Array], b: list[Array]) -> list[Array]:
    """Upper triangle (6 arrays (n,)) of the normal matrix of rows a, b."""
    return [_over_views(a[i] * a[j] + b[i] * b[j]) for i, j in _UPPER]


def _normal_side(a: list[Array], b: list[Array], ra: Array, rb: Array) -> list[Array]:
    """Right side (3 arrays (n,)) of the normal equations of rows a, b with residuals ra, rb."""
    return [_over_views(a[i] * ra + b[i] * rb) for i in range(3)]


def _inverse(n: list[Array]) -> list[Array]:
    """Upper triangle of the inverse of symmetric 3x3 matrices, in closed form; not finite where singular."""
    xx, xy, xz, yy, yz, zz = n
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    scale = 1.0 / (xx * c0 + xy * c1 + xz * c2)
    return [
        c0 * scale, c1 * scale, c2 * scale,
        (xx * zz - xz * xz) * scale, (xy * xz - xx * yz) * scale, (xx * yy - xy * xy) * scale,
    ]  # fmt: skip


def _times(inverse: list[Array], g: list[Array]) -> Array:
    """(3, n) product of symmetric matrices with vectors."""
    xx, xy, xz, yy, yz, zz = inverse
    return np.stack(
        [xx * g[0] + xy * g[1] + xz * g[2], xy * g[0] + yy * g[1] + yz * g[2], xz * g[0] + yz * g[1] + zz * g[2]]
    )


def _linear_start(views: _Views) -> Array:
    """(3, n) solution of the collinearity equations multiplied by the depth, which are linear in the point."""
    used = (views.weight_u > 0) * 1.0
    a = [(views.rot[0][j] - views.u * views.rot[2][j]) * used for j in range(3)]
    b = [(views.rot[1][j] - views.v * views.rot[2][j]) * used for j in range(3)]
    c = views.centre
    ra, rb = (row[0] * c[0] + row[1] * c[1] + row[2] * c[2] for row in (a, b))
    return _times(_inverse(_normal_matrix(a, b)), _normal_side(a, b, ra, rb))


def _camera_point(views: _Views, x: Array) -> list[Array]:
    """x, y, z (V, n) of points (3, n) in every view's camera frame."""
    d = [x[i] - views.centre[i] for i in range(3)]
    return [r[0] * d[0] + r[1] * d[1] + r[2] * d[2] for r in views.rot]


def _linearise(views: _Views, x: Array) -> tuple[list[Array], list[Array], Array, Array]:
    """Weighted rows of the linearised collinearity equations and weighted residuals, each (V, n)."""
    cx, cy, cz = _camera_point(views, x)
    inverse = 1.0 / cz
    xn, yn = cx * inverse, cy * inverse
    wu, wv = views.weight_u * inverse, views.weight_v * inverse
    a = [wu * (views.rot[0][j] - xn * views.rot[2][j]) for j in range(3)]
    b = [wv * (views.rot[1][j] - yn * views.rot[2][j]) for j in range(3)]
    return a, b, views.weight_u * (views.u - xn), views.weight_v * (views.v - yn)


def _iterate(
    views: _Views, start: Array, convergence_m2: float, max_iterations: int
) -> tuple[Array, NDArray[np.int64], Bools]:
    """Gauss-Newton; points that are done leave the active set. Returns (3, n), (n,), (n,)."""
    n = start.shape[1]
    solution = start.copy()
    iterations = np.zeros(n, dtype=np.int64)
    converged = np.zeros(n, dtype=bool)
    active, x, work = np.arange(n), start, views
    going = np.ones(n, dtype=bool)
    for _ in range(max_iterations):
        a, b, ra, rb = _linearise(work, x)
        # Points that are done stand still, so that no result depends on which other points share the chunk.
        dx = _times(_inverse(_normal_matrix(a, b)), _normal_side(a, b, ra, rb)) * going
        x = x + dx
        square = dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2]
        iterations[active] += going
        converged[active] |= going & (square < convergence_m2)
        going = going & (square >= convergence_m2)
        left = int(np.count_nonzero(going))
        if left == 0:
            break
        if 2 * left < going.size:  # smaller arrays pay for their making
            solution[:, active] = x
            active, x, work, going = active[going], x[:, going], work.take(going), going[going]
    solution[:, active] = x
    return solution, iterations, converged


def _store(
    result: IntersectionResult, index: NDArray[np.int64], views: _Views, x: Array, iterations: NDArray[np.int64],
    converged: Bools, origin: Array, status: NDArray[np.int8], rows: NDArray[np.int64], used: Bools,
) -> None:  # fmt: skip
    """Covariance, residuals and depths at the solution; statuses of the points that have none."""
    a, b, _, _ = _linearise(views, x)
    upper = _inverse(_normal_matrix(a, b))
    cx, cy, cz = _camera_point(views, x)
    real = np.isfinite(x[0] + x[1] + x[2])
    behind = np.any(used & ~(cz.T > 0), axis=1) & real
    finite = real & np.isfinite(sum(upper))
    outcome = np.where(converged & finite, IntersectionStatus.OK, IntersectionStatus.NOT_CONVERGED)
    outcome = np.where(behind, IntersectionStatus.BEHIND_CAMERA, outcome)
    status[rows] = outcome
    result.iterations[index] = iterations
    ok = outcome == IntersectionStatus.OK
    keep: slice | NDArray[np.int64] = index[ok]
    chosen: slice | Bools = ok
    if ok.all() and int(index[-1]) - int(index[0]) + 1 == index.size:  # the common case, without copies
        keep, chosen = slice(int(index[0]), int(index[-1]) + 1), slice(None)
    for axis in range(3):
        result.xyz_m[keep, axis] = x[axis][chosen] + origin[chosen, axis]
    for value, (i, j) in zip(upper, _UPPER, strict=True):
        result.cov_m2[keep, i, j] = value[chosen]
        if i != j:
            result.cov_m2[keep, j, i] = value[chosen]
    result.residuals_px[keep, :, 0] = np.where(used, ((views.u - cx / cz) * views.fx).T, np.nan)[chosen]
    result.residuals_px[keep, :, 1] = np.where(used, ((views.v - cy / cz) * views.fy).T, np.nan)[chosen]
    result.depth_m[keep] = np.where(used, cz.T, np.nan)[chosen]
