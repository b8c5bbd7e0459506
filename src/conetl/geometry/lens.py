"""Lens distortion of normalised image coordinates x/z, y/z, in OpenCV's conventions, with its inverse and derivatives.

radial, brown, rational (Brown 1971; OpenCV's `calib3d` documentation), with s = x^2 + y^2:
    g = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3)
    x' = x g + 2 p1 x y + p2 (s + 2 x^2)
    y' = y g + p1 (s + 2 y^2) + 2 p2 x y
fisheye (equidistant; Kannala & Brandt 2006, as `cv2.fisheye`), with r = sqrt(s) and theta = atan(r):
    (x', y') = (x, y) theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) / r

Beyond `field_radius` a polynomial folds back, so that two directions share one image point; `undistort` gives NaN there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from conetl.model.arrays import Floats
from conetl.model.rig import Lens

_MAX_ITERATIONS = 40
_MAX_HALVINGS = 10
_TOLERANCE = 1e-13


def distort(lens: Lens, xy: ArrayLike) -> Floats:
    """Distorted normalised coordinates (..., 2) of ideal ones (..., 2)."""
    p = np.asarray(xy, dtype=np.float64)
    x, y = p[..., 0], p[..., 1]
    if lens.model == "none":
        return p.copy()
    if lens.model == "fisheye":
        return p * _fisheye_scale(lens, np.hypot(x, y))[0][..., None]
    k1, k2, p1, p2, k3, k4, k5, k6 = _padded(lens)
    s = x * x + y * y
    g = 1.0 + s * (k1 + s * (k2 + s * k3))
    if lens.model == "rational":
        with np.errstate(divide="ignore"):  # infinite at a pole of the model
            g = g / (1.0 + s * (k4 + s * (k5 + s * k6)))
    if lens.model == "radial":
        return p * g[..., None]
    xy2 = 2.0 * x * y
    return np.stack([x * g + p1 * xy2 + p2 * (s + 2.0 * x * x), y * g + p1 * (s + 2.0 * y * y) + p2 * xy2], axis=-1)


def distort_jacobian(lens: Lens, xy: ArrayLike) -> tuple[Floats, Floats]:
    """Derivatives of `distort` at ideal coordinates (..., 2).

    Returns (..., 2, 2) with respect to x, y and (..., 2, n) with respect to the lens's n coefficients in their order.
    """
    p = np.asarray(xy, dtype=np.float64)
    if lens.model == "none":
        return np.broadcast_to(np.eye(2), (*p.shape[:-1], 2, 2)).copy(), np.zeros((*p.shape[:-1], 2, 0))
    return _fisheye_jacobian(lens, p) if lens.model == "fisheye" else _polynomial_jacobian(lens, p)


def field_radius(lens: Lens) -> float:
    """Radius in ideal normalised coordinates up to which the radial part of a lens grows; inf where it always does.

    Beyond it the model is invalid. For a fisheye inf means 90 degrees off the axis.
    """
    if lens.model == "none":
        return float("inf")
    if lens.model == "fisheye":
        theta2 = _first_positive_root([1.0, *((2 * i + 3) * k for i, k in enumerate(lens.coefficients))])
        theta = np.sqrt(theta2)
        return float("inf") if theta >= np.pi / 2 else float(np.tan(theta))
    k1, k2, _, _, k3, k4, k5, k6 = _padded(lens)
    # d(r N/D)/dr = (N D + 2 s (N' D - N D')) / D^2, polynomials in s = r^2
    n, d = np.polynomial.Polynomial([1.0, k1, k2, k3]), np.polynomial.Polynomial([1.0, k4, k5, k6])
    s = np.polynomial.Polynomial([0.0, 1.0])
    slope = n * d + 2.0 * s * (n.deriv() * d - n * d.deriv())
    return float(np.sqrt(min(_first_positive_root(slope.coef.tolist()), _first_positive_root(d.coef.tolist()))))


def undistort(lens: Lens, xy: ArrayLike) -> Floats:
    """Ideal normalised coordinates (..., 2) of distorted ones (..., 2), by damped Newton iterations.

    Both coordinates of a point are NaN where the lens has no such image point: where the iteration does not come closer than
    `_TOLERANCE` (relative to 1 + the point's radius), where the answer lies beyond `field_radius`, or where the mapping is
    folded (its Jacobian's determinant is not positive).
    """
    wanted = np.asarray(xy, dtype=np.float64)
    if lens.model == "none":
        return wanted.copy()
    flat = wanted.reshape(-1, 2)
    found = _undistort_fisheye(lens, flat) if lens.model == "fisheye" else _undistort_polynomial(lens, flat)
    return found.reshape(wanted.shape)


# --------------------------------------------------------------------------- radial, brown, rational


def _padded(lens: Lens) -> tuple[float, ...]:
    """k1, k2, p1, p2, k3, k4, k5, k6: the shorter models are the beginnings of the longer ones."""
    return (*lens.coefficients, *(0.0,) * (8 - len(lens.coefficients)))


def _polynomial_jacobian(lens: Lens, p: Floats) -> tuple[Floats, Floats]:
    k1, k2, p1, p2, k3, k4, k5, k6 = _padded(lens)
    x, y = p[..., 0], p[..., 1]
    s = x * x + y * y
    n = 1.0 + s * (k1 + s * (k2 + s * k3))
    d = 1.0 + s * (k4 + s * (k5 + s * k6))
    g = n / d
    # derivative of g with respect to s
    g_s = (k1 + s * (2.0 * k2 + s * 3.0 * k3) - g * (k4 + s * (2.0 * k5 + s * 3.0 * k6))) / d
    by_xy = np.empty((*p.shape[:-1], 2, 2))
    by_xy[..., 0, 0] = g + 2.0 * x * x * g_s + 2.0 * p1 * y + 6.0 * p2 * x
    by_xy[..., 1, 1] = g + 2.0 * y * y * g_s + 6.0 * p1 * y + 2.0 * p2 * x
    by_xy[..., 0, 1] = by_xy[..., 1, 0] = 2.0 * x * y * g_s + 2.0 * p1 * x + 2.0 * p2 * y
    by_k = np.empty((*p.shape[:-1], 2, 8))
    for column, weight in (
        (0, s / d), (1, s**2 / d), (4, s**3 / d), (5, -g * s / d), (6, -g * s**2 / d), (7, -g * s**3 / d)
    ):  # fmt: skip
        by_k[..., column] = p * weight[..., None]
    by_k[..., 0, 2] = by_k[..., 1, 3] = 2.0 * x * y
    by_k[..., 1, 2] = s + 2.0 * y * y
    by_k[..., 0, 3] = s + 2.0 * x * x
    return by_xy, by_k[..., : len(lens.coefficients)].copy()


def _undistort_polynomial(lens: Lens, wanted: Floats) -> Floats:
    """(n, 2) ideal coordinates of (n, 2) distorted ones, NaN where there are none."""
    limit = field_radius(lens)
    found = np.full(wanted.shape, np.nan)
    index = np.flatnonzero(np.isfinite(wanted).all(axis=1))
    target = wanted[index]
    at = _inside(target, 0.95 * limit)
    accept = _TOLERANCE * (1.0 + np.hypot(target[:, 0], target[:, 1]))
    error = distort(lens, at) - target
    for _ in range(_MAX_ITERATIONS):
        size = np.hypot(error[:, 0], error[:, 1])
        done = size <= accept
        if done.any():
            found[index[done]] = at[done]
            keep = ~done
            index, accept, size = index[keep], accept[keep], size[keep]
            target, at, error = target[keep], at[keep], error[keep]
        if not len(index):
            break
        by_xy, _ = _polynomial_jacobian(lens, at)
        step = _solve2(by_xy, error)
        shrink = np.ones(len(at))
        trial = _inside(at - step, limit)
        trial_error = distort(lens, trial) - target
        for _ in range(_MAX_HALVINGS):
            worse = ~(np.hypot(trial_error[:, 0], trial_error[:, 1]) < size)
            if not worse.any():
                break
            shrink[worse] *= 0.5
            trial[worse] = _inside(at[worse] - shrink[worse, None] * step[worse], limit)
            trial_error[worse] = distort(lens, trial[worse]) - target[worse]
        # No step helps: within rounding the point is found, else there is none.
        stuck = ~(np.hypot(trial_error[:, 0], trial_error[:, 1]) < size)
        close = stuck & (size <= 100.0 * accept)
        found[index[close]] = at[close]
        index, accept, target = index[~stuck], accept[~stuck], target[~stuck]
        at, error = trial[~stuck], trial_error[~stuck]
    by_xy, _ = _polynomial_jacobian(lens, found)
    determinant = by_xy[:, 0, 0] * by_xy[:, 1, 1] - by_xy[:, 0, 1] * by_xy[:, 1, 0]
    found[~((np.hypot(found[:, 0], found[:, 1]) <= limit) & (determinant > 0.0))] = np.nan
    return found


def _inside(p: Floats, limit: float) -> Floats:
    """Points (n, 2) drawn in to a radius of `limit` at most."""
    if not np.isfinite(limit):
        return p.copy()
    r = np.hypot(p[:, 0], p[:, 1])
    with np.errstate(invalid="ignore"):  # infinite points have no direction: NaN, which no step accepts
        return np.asarray(p * (limit / np.maximum(r, limit))[:, None])


def _solve2(a: Floats, b: Floats) -> Floats:
    """Solutions (n, 2) of n systems (n, 2, 2); NaN where singular."""
    determinant = a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * a[:, 1, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (a[:, 1, 1] * b[:, 0] - a[:, 0, 1] * b[:, 1]) / determinant
        y = (a[:, 0, 0] * b[:, 1] - a[:, 1, 0] * b[:, 0]) / determinant
    return np.stack([x, y], axis=1)


# --------------------------------------------------------------------------- fisheye


def _fisheye_factor(lens: Lens, theta: Floats) -> tuple[Floats, Floats]:
    """theta_d / theta and d(theta_d) / d(theta)."""
    t2 = theta * theta
    k1, k2, k3, k4 = lens.coefficients
    factor = 1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))
    return factor, 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))


def _fisheye_scale(lens: Lens, r: Floats) -> tuple[Floats, Floats, Floats]:
    """theta_d / r, d(theta_d) / d(theta) and theta of radii r."""
    theta = np.arctan(r)
    factor, slope = _fisheye_factor(lens, theta)
    small = r < 1e-6
    theta_by_r = np.where(small, 1.0, theta / np.where(small, 1.0, r))
    return factor * theta_by_r, slope, theta


def _fisheye_jacobian(lens: Lens, p: Floats) -> tuple[Floats, Floats]:
    x, y = p[..., 0], p[..., 1]
    s = x * x + y * y
    r = np.sqrt(s)
    scale, slope, theta = _fisheye_scale(lens, r)
    # d(scale)/dr / r; what cancels near the axis is multiplied by x^2 below
    bend = (slope / (1.0 + s) - scale) / np.maximum(s, 1e-12)
    by_xy = np.empty((*p.shape[:-1], 2, 2))
    by_xy[..., 0, 0] = scale + x * x * bend
    by_xy[..., 1, 1] = scale + y * y * bend
    by_xy[..., 0, 1] = by_xy[..., 1, 0] = x * y * bend
    theta_by_r = np.where(r < 1e-6, 1.0, theta / np.maximum(r, 1e-6))
    powers = np.stack([theta ** (2 * i + 2) for i in range(4)], axis=-1)
    by_k = p[..., :, None] * (theta_by_r[..., None] * powers)[..., None, :]
    return by_xy, by_k


def _undistort_fisheye(lens: Lens, wanted: Floats) -> Floats:
    """(n, 2) ideal coordinates: Newton on theta alone, kept in a bracket by bisection."""
    top = float(np.arctan(field_radius(lens)))  # 90 degrees where the field is not limited
    target = np.hypot(wanted[:, 0], wanted[:, 1])
    low, high = np.zeros_like(target), np.full_like(target, top)
    theta = np.minimum(target, 0.95 * top)
    for _ in range(_MAX_ITERATIONS):
        factor, slope = _fisheye_factor(lens, theta)
        value = theta * factor - target
        low, high = np.where(value <= 0.0, theta, low), np.where(value > 0.0, theta, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = theta - value / slope
        moved = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        if np.all(np.abs(moved - theta) <= 1e-16 + 2e-16 * theta):
            break
        theta = moved
    error = np.abs(theta * _fisheye_factor(lens, theta)[0] - target)
    good = (error <= 1e-12 * (1.0 + target)) & (theta < top)
    small = target < 1e-9
    scale = np.where(small, 1.0, np.tan(theta) / np.where(small, 1.0, target))
    return np.where(good[:, None], wanted * scale[:, None], np.nan)


# --------------------------------------------------------------------------- helpers


def _first_positive_root(ascending: list[float]) -> float:
    """Smallest positive real root of a polynomial with coefficients in ascending order; inf where there is none."""
    values = np.asarray(ascending)
    # smaller ones have no effect within 80 degrees off the axis, but would spoil the eigenvalue problem
    coefficients = np.trim_zeros(np.where(np.abs(values) < 1e-12, 0.0, values), "b")
    if len(coefficients) < 2:
        return float("inf")
    roots = np.polynomial.polynomial.polyroots(coefficients)
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
    return float(real.min()) if len(real) else float("inf")
