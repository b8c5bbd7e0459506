"""The collinearity equations of many points at once: linearised, weighted, solved (used by `intersection.py`).

Component first: every quantity is an array (V, n) over views and points, or (V, 1) where all points share a view. What is exactly
zero for all views (most of the rotations of a rectified pair) is None and costs no time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.lens import distort, distort_jacobian, field_radius, undistort
from conetl.model.records import Lens

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
#: One number for every view and point, or None for zero.
Term = Array | None

_ONE = np.ones((1, 1))
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class Views(NamedTuple):
    """Views of n points; unused ones have weight 0."""

    u: Array
    """observed (u - cx) / fx, distorted"""
    v: Array
    ray: tuple[Array, Array]
    """the same without distortion: x/z, y/z of the observed ray"""
    fx: Array
    fy: Array
    weight_u: Array
    """fx / sigma_u, or 0 for a view that is not used: what x/z is multiplied with."""
    weight_v: Array
    rot: list[list[Term]]
    """rot[i][j]: component of cam_R_map."""
    centre: list[Array]
    """relative to the point's origin"""
    lenses: tuple[Lens, ...] | None
    """one per view; None where no view has one"""

    def take(self, keep: Bools) -> Views:
        """Only the points of a mask (n,)."""

        def part(a: Array) -> Array:
            return a if a.shape[1] == 1 else a[:, keep]

        return Views(
            u=part(self.u), v=part(self.v), ray=(part(self.ray[0]), part(self.ray[1])),
            fx=part(self.fx), fy=part(self.fy), weight_u=part(self.weight_u), weight_v=part(self.weight_v),
            rot=[[None if a is None else part(a) for a in row] for row in self.rot],
            centre=[part(a) for a in self.centre], lenses=self.lenses,
        )  # fmt: skip


def ideal_points(uv: Array, k: Array, lenses: tuple[Lens, ...] | None) -> Array | None:
    """x/z, y/z (n, V, 2) without distortion of image points (n, V, 2), NaN where a lens has none; None without lenses."""
    if lenses is None:
        return None
    observed = (uv - k[..., 2:]) / k[..., :2]
    return np.stack([undistort(lens, observed[:, i]) for i, lens in enumerate(lenses)], axis=1)


def make_views(
    uv: Array, ideal: Array | None, used: Bools, k: Array, rot: Array, centre: Array, sigma: Array, origin: Array,
    lenses: tuple[Lens, ...] | None,
) -> Views:  # fmt: skip
    """Component-first views of n points.

    uv (n, V, 2): image points; ideal: theirs by `ideal_points`. used (n, V). origin (n, 3). The cameras are
    (V, ...) where all points share them, else (n, V, ...): k (4,), rot (3, 3) map_R_cam, centre (3,), sigma (2,) px.
    """

    def comp(a: Array) -> Array:
        return np.ascontiguousarray(a.T) if a.ndim == 2 else a[:, None]

    mask = np.ascontiguousarray(used.T)
    all_used = bool(mask.all())

    def clean(a: Array, neutral: float) -> Array:
        return a if all_used else np.where(mask, a, neutral)

    def turn(i: int, j: int) -> Term:
        a = comp(rot[..., j, i])
        if not np.count_nonzero(a):
            return None
        return _ONE if a.shape[1] == 1 and (a == 1.0).all() else clean(a, float(i == j))

    fx, fy = clean(comp(k[..., 0]), 1.0), clean(comp(k[..., 1]), 1.0)
    u = clean((comp(uv[..., 0]) - comp(k[..., 2])) / fx, 0.0)
    v = clean((comp(uv[..., 1]) - comp(k[..., 3])) / fy, 0.0)
    ray = (u, v) if ideal is None else (clean(comp(ideal[..., 0]), 0.0), clean(comp(ideal[..., 1]), 0.0))
    return Views(
        u=u, v=v, ray=ray, fx=fx, fy=fy,
        weight_u=clean(fx * (1.0 / comp(sigma[..., 0])), 0.0), weight_v=clean(fy * (1.0 / comp(sigma[..., 1])), 0.0),
        rot=[[turn(i, j) for j in range(3)] for i in range(3)],
        centre=[clean(comp(centre[..., i]) - origin[:, i], 0.0) for i in range(3)], lenses=lenses,
    )  # fmt: skip


# --------------------------------------------------------------------------- sums that skip zeros


def _product(a: Term, b: Term) -> Term:
    if a is None or b is None:
        return None
    return b if a is _ONE else a if b is _ONE else a * b


def _plus(a: Term, b: Term) -> Term:
    return b if a is None else a if b is None else a + b


def _minus(a: Term, b: Term) -> Term:
    return a if b is None else -b if a is None else a - b


def _over_views(a: Term) -> Array | float:
    """(n,) sum of (V, n) over the views; adding two rows is faster than reducing them."""
    if a is None:
        return 0.0
    return a[0] + a[1] if a.shape[0] == 2 else np.asarray(a.sum(axis=0))


def _normal_matrix(a: Sequence[Term], b: Sequence[Term]) -> list[Array | float]:
    """Upper triangle (6 of (n,)) of the normal matrix of rows a, b."""
    return [_over_views(_plus(_product(a[i], a[j]), _product(b[i], b[j]))) for i, j in UPPER]


def _normal_side(a: Sequence[Term], b: Sequence[Term], ra: Term, rb: Term) -> list[Array | float]:
    """Right side (3 of (n,)) of the normal equations of rows a, b with residuals ra, rb."""
    return [_over_views(_plus(_product(a[i], ra), _product(b[i], rb))) for i in range(3)]


def _inverse(n: Sequence[Array | float]) -> list[Array]:
    """Upper triangle of the inverse of symmetric 3x3 matrices, in closed form; not finite where singular."""
    xx, xy, xz, yy, yz, zz = n
    if isinstance(xy, float):  # zero: a rectified pair
        c0, c1, c2 = yy * zz - yz * yz, xz * yz, -(xz * yy)
        scale = 1.0 / (xx * c0 + xz * c2)
        entries = [c0 * scale, c1 * scale, c2 * scale, (xx * zz - xz * xz) * scale, -(xx * yz) * scale, xx * yy * scale]
    else:
        c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        scale = 1.0 / (xx * c0 + xy * c1 + xz * c2)
        entries = [
            c0 * scale, c1 * scale, c2 * scale,
            (xx * zz - xz * xz) * scale, (xy * xz - xx * yz) * scale, (xx * yy - xy * xy) * scale,
        ]  # fmt: skip
    return [np.asarray(entry) for entry in entries]


def _times(inverse: Sequence[Array], g: Sequence[Array | float]) -> list[Array]:
    """3 of (n,): product of symmetric matrices with vectors."""
    xx, xy, xz, yy, yz, zz = inverse
    return [xx * g[0] + xy * g[1] + xz * g[2], xy * g[0] + yy * g[1] + yz * g[2], xz * g[0] + yz * g[1] + zz * g[2]]


# --------------------------------------------------------------------------- equations


def directions(views: Views) -> list[Array]:
    """3 of (V, n): unit vectors of the observed rays in the map frame."""
    u, v = views.ray
    scale = 1.0 / np.sqrt(u * u + v * v + 1.0)
    found = []
    for i in range(3):
        along = _plus(_plus(_product(views.rot[0][i], u), _product(views.rot[1][i], v)), views.rot[2][i])
        found.append(np.zeros_like(scale) if along is None else along * scale)
    return found


def camera_point(views: Views, x: Sequence[Array]) -> list[Array]:
    """x, y, z (V, n) of points (3 of (n,)) in every view's camera frame."""
    d = [x[i] - views.centre[i] for i in range(3)]
    found = [_plus(_plus(_product(r[0], d[0]), _product(r[1], d[1])), _product(r[2], d[2])) for r in views.rot]
    return [np.zeros_like(d[0]) if c is None else c for c in found]


def image_point(views: Views, x: Array, y: Array) -> tuple[Array, Array]:
    """Normalised image coordinates (V, n) with distortion of ideal ones."""
    if views.lenses is None:
        return x, y
    bent = [distort(lens, np.stack([x[i], y[i]], axis=-1)) for i, lens in enumerate(views.lenses)]
    return np.stack([b[:, 0] for b in bent]), np.stack([b[:, 1] for b in bent])


def inside_field(views: Views, x: Array, y: Array) -> Bools:
    """(V, n) False where ideal coordinates lie beyond what the view's lens maps one to one."""
    if views.lenses is None:
        return np.ones((1, 1), dtype=bool)
    limit2 = np.array([field_radius(lens) ** 2 for lens in views.lenses])[:, None]
    return np.asarray(x * x + y * y <= limit2)


def linearise(views: Views, x: Sequence[Array]) -> tuple[list[Term], list[Term], Array, Array]:
    """Weighted rows of the linearised collinearity equations (3 of (V, n) for u and for v) and weighted residuals (V, n)."""
    cx, cy, cz = camera_point(views, x)
    inverse = 1.0 / cz
    xn, yn = cx * inverse, cy * inverse
    if views.lenses is None:
        wu, wv = views.weight_u * inverse, views.weight_v * inverse
        a, b = _rows(views, wu, wu * xn, 0), _rows(views, wv, wv * yn, 1)
        return a, b, views.weight_u * (views.u - xn), views.weight_v * (views.v - yn)
    s, t = _rows(views, inverse, inverse * xn, 0), _rows(views, inverse, inverse * yn, 1)
    slopes = [distort_jacobian(lens, np.stack([xn[i], yn[i]], axis=-1))[0] for i, lens in enumerate(views.lenses)]
    ux, uy, vx, vy = (np.stack([slope[:, i, j] for slope in slopes]) for i in (0, 1) for j in (0, 1))
    ux, uy, vx, vy = views.weight_u * ux, views.weight_u * uy, views.weight_v * vx, views.weight_v * vy
    a = [_plus(_product(ux, s[j]), _product(uy, t[j])) for j in range(3)]
    b = [_plus(_product(vx, s[j]), _product(vy, t[j])) for j in range(3)]
    bent_x, bent_y = image_point(views, xn, yn)
    return a, b, views.weight_u * (views.u - bent_x), views.weight_v * (views.v - bent_y)


def _rows(views: Views, weight: Array, weighted: Array, axis: int) -> list[Term]:
    """weight * rot[axis] - weighted * rot[2]: derivative of one ideal coordinate times the weight."""
    return [_minus(_product(views.rot[axis][j], weight), _product(views.rot[2][j], weighted)) for j in range(3)]


def linear_start(views: Views) -> list[Array]:
    """3 of (n,): solution of the collinearity equations multiplied by the depth, which are linear in the point."""
    used: Array = np.where(views.weight_u > 0, 1.0, 0.0)
    u, v = views.ray
    a, b = _rows(views, used, u * used, 0), _rows(views, used, v * used, 1)
    c = views.centre
    ra, rb = (
        _plus(_plus(_product(row[0], c[0]), _product(row[1], c[1])), _product(row[2], c[2])) for row in (a, b)
    )  # fmt: skip
    return _times(_inverse(_normal_matrix(a, b)), _normal_side(a, b, ra, rb))


class Solution(NamedTuple):
    """Result of `gauss_newton` for n points."""

    x: list[Array]
    """3 of (n,), relative to the points' origins"""
    cov: list[Array]
    """6 of (n,): upper triangle of the inverse normal matrix at the last linearisation, within the last correction of x"""
    iterations: NDArray[np.int64]
    converged: Bools


def gauss_newton(views: Views, start: Sequence[Array], convergence_m2: float, max_iterations: int) -> Solution:
    """Iterate from a start (3 of (n,)); finished points leave the active set."""
    n = len(start[0])
    solution, cov = np.empty((3, n)), np.empty((6, n))
    iterations = np.zeros(n, dtype=np.int64)
    converged = np.zeros(n, dtype=bool)
    active: NDArray[np.intp] | slice = slice(None)
    x, work, going = list(start), views, np.ones(n, dtype=bool)
    upper: list[Array] = []
    all_going = True
    for _ in range(max_iterations):
        a, b, ra, rb = linearise(work, x)
        upper = _inverse(_normal_matrix(a, b))
        dx = _times(upper, _normal_side(a, b, ra, rb))
        if not all_going:  # finished points stay, so that no result depends on other points of the chunk
            dx = [np.where(going, d, 0.0) for d in dx]
        x = [c + d for c, d in zip(x, dx, strict=True)]
        square = dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2]
        iterations[active] += going
        small = square < convergence_m2
        converged[active] |= going & small
        going = going & (square >= convergence_m2)
        left = int(np.count_nonzero(going))
        if left == 0:
            break
        all_going = left == going.size
        if 2 * left < going.size:  # smaller arrays are worth the copy
            solution[:, active], cov[:, active] = x, upper
            active = np.arange(n)[active][going]
            x, work, going, all_going = [c[going] for c in x], work.take(going), going[going], True
    solution[:, active] = x
    if upper:
        cov[:, active] = upper
    return Solution(list(solution), list(cov), iterations, converged)
