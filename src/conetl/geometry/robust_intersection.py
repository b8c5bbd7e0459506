"""Intersection that finds blunders: data snooping after Baarda, started where the rays themselves agree.

An image point of another object pulls a least-squares point away and hides in it. Points whose largest normalised residual
passes Baarda's test ("A testing procedure for use in geodetic networks", 1968) are left alone. For the others every pair of
views is intersected; the pair whose point suits the other views best, each counted up to a limit (Torr & Zisserman 2000,
MSAC), tells which views agree. From these, data snooping takes out what is still off, one view at a time, and lets in again
what fits. With two rays nobody knows which is wrong; nor where another, equally large set of rays agrees on another point:
such a point gets a status and no number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

from conetl.geometry.collinearity import ideal_points, linearise, make_views
from conetl.geometry.intersection import IntersectionResult, IntersectionStatus, intersect
from conetl.records import Lens

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
#: Pairs that are tried for a point: all of up to ten views; of more views, this many drawn evenly.
MAX_PAIRS = 45
#: Shift of a normalised residual that a test of 0.1 % finds with 80 % probability (Baarda 1968).
_POWER = float(norm.ppf(0.8))


@dataclass(frozen=True)
class Blunder:
    """One image point that contradicts the others of its point."""

    point: int
    view: int
    residual_px: tuple[float, float]
    """Observed minus what the point found without it gives: size and direction of the blunder."""
    normalised_residual: tuple[float, float]
    """The same over its standard deviation, that of the point included: N(0, 1) where there is no blunder."""
    test_value: float
    """What neither of the two may exceed; both lie below only where this view in its turn would make another one exceed it."""
    detectable_px: tuple[float, float]
    """Smallest blunder along the rows and across that would be found with 80 % probability (internal reliability)."""


@dataclass(frozen=True)
class RobustIntersection:
    """`result` holds the points from the views `used` (P, V) alone."""

    result: IntersectionResult
    used: Bools
    blunders: tuple[Blunder, ...]
    """By point, then view; none are named for points whose blunder could not be located."""


@dataclass(frozen=True)
class _Problem:
    """Arguments of `intersect` as arrays; cameras shared (V, ...) or per point (P, V, ...)."""

    uv: Array
    valid: Bools
    k: Array
    rot: Array
    centre: Array
    sigma: Array
    lenses: tuple[Lens, ...] | None
    min_ray_angle_rad: float

    def take(self, rows: NDArray[np.intp]) -> _Problem:
        def part(a: Array, shared_ndim: int) -> Array:
            return a if a.ndim == shared_ndim else a[rows]

        return replace(
            self, uv=self.uv[rows], valid=self.valid[rows], k=part(self.k, 2), rot=part(self.rot, 3),
            centre=part(self.centre, 2), sigma=self.sigma[rows],
        )  # fmt: skip

    def solve(self, used: Bools) -> IntersectionResult:
        return intersect(
            self.uv, used, self.k, self.rot, self.centre, self.sigma, lenses=self.lenses,
            min_ray_angle_rad=self.min_ray_angle_rad,
        )  # fmt: skip


def intersect_robust(
    uv_px: ArrayLike,
    valid: ArrayLike | None,
    k_px: ArrayLike,
    map_R_cam: ArrayLike,
    centre_m: ArrayLike,
    sigma_uv_px: ArrayLike,
    *,
    lenses: Sequence[Lens] | None = None,
    significance: float = 0.001,
    min_ray_angle_rad: float = 0.008,
) -> RobustIntersection:
    """Intersect P points in up to V views each, without the image points that contradict the others.

    Arguments as in `intersect`. significance: probability that one coordinate without blunder is taken for one; the sigmas must
    be right for it to hold. Points of two views whose rays miss each other, and points whose contradiction cannot be laid on
    single views, get the status BLUNDER_NOT_LOCATED.
    """
    if not 0 < significance < 1:
        raise ValueError(f"significance must lie between 0 and 1, found {significance}")
    uv = np.array(uv_px, dtype=np.float64)
    mask = np.ones(uv.shape[:2], dtype=bool) if valid is None else np.asarray(valid, dtype=bool)
    problem = _Problem(
        uv, mask, np.asarray(k_px, np.float64), np.asarray(map_R_cam, np.float64), np.asarray(centre_m, np.float64),
        np.broadcast_to(np.asarray(sigma_uv_px, np.float64), uv.shape), None if lenses is None else tuple(lenses),
        min_ray_angle_rad,
    )  # fmt: skip
    limit = float(norm.ppf(1 - significance / 2))
    result, used = problem.solve(mask), mask.copy()
    test, _ = _normalised(problem, result, used)
    off = np.nan_to_num(np.abs(test)).max(axis=(1, 2), initial=0.0) > limit
    failed = np.isin(result.status, (IntersectionStatus.BEHIND_CAMERA, IntersectionStatus.NOT_CONVERGED))
    views = mask.sum(axis=1)
    _refuse(result, (off & (views == 2)).nonzero()[0])
    rows = ((off | failed) & (views > 2)).nonzero()[0]
    if not rows.size:
        return RobustIntersection(result, used, ())
    part = problem.take(rows)
    kept, rivals = _consensus(part, limit)
    kept = _readmit(part, _snoop(part, kept, limit), limit)
    solved = part.solve(kept)
    unsure = _contradicted(part, rivals, kept, solved, limit) | (
        (kept.sum(axis=1) == 2) & _still_off(part, solved, kept, limit)
    )
    _refuse(solved, unsure.nonzero()[0])
    for name in ("status", "xyz_m", "cov_m2", "residuals_px", "depth_m", "ray_angle_rad", "iterations"):
        getattr(result, name)[rows] = getattr(solved, name)
    used[rows] = np.where(unsure[:, None], part.valid, kept)
    return RobustIntersection(result, used, _report(part, solved, kept & ~unsure[:, None], rows, limit))


def _normalised(problem: _Problem, result: IntersectionResult, used: Bools) -> tuple[Array, Array]:
    """Normalised residuals (n, V, 2) and the standard deviations in px that they were divided by.

    Of a used view that of the residual itself, sigma^2 - A C A^T; of an unused one that of the difference between image point
    and prediction, sigma^2 + A C A^T. The two are the same number for a view that is put in or left out. NaN for points
    without a result and views without an image point; 0 where a used view is not controlled by the others at all.
    """
    xyz = np.where(result.ok[:, None], result.xyz_m, 0.0)
    with np.errstate(all="ignore"):  # points without a result and views without an image point give NaN
        ideal = ideal_points(problem.uv, problem.k, problem.lenses)
        views = make_views(
            problem.uv, ideal, problem.valid, problem.k, problem.rot, problem.centre, problem.sigma, xyz, problem.lenses
        )
        rows_u, rows_v, *residuals = linearise(views, [np.zeros(len(xyz))] * 3)
    good = result.ok[:, None] & problem.valid
    sign = np.where(used, -1.0, 1.0)
    found, spread = np.full((*used.shape, 2), np.nan), np.full((*used.shape, 2), np.nan)
    for axis, (rows, residual) in enumerate(zip((rows_u, rows_v), residuals, strict=True)):
        design = np.stack([np.zeros(used.T.shape) if a is None else np.broadcast_to(a, used.T.shape) for a in rows])
        variance = 1.0 + sign * np.einsum("ivn,nij,jvn->nv", design, result.cov_m2, design)
        deviation = np.sqrt(variance, where=good & (variance > 1e-6), out=np.full(used.shape, np.inf))
        found[good, axis] = residual.T[good] / deviation[good]
        spread[good, axis] = problem.sigma[good, axis] * deviation[good]
    return found, spread


def _pairs(count: int) -> list[tuple[int, int]]:
    pairs = list(combinations(range(count), 2))
    if len(pairs) <= MAX_PAIRS:
        return pairs
    return [pairs[i] for i in np.linspace(0, len(pairs) - 1, MAX_PAIRS).astype(int)]


def _consensus(problem: _Problem, limit: float) -> tuple[Bools, Bools]:
    """The views (n, V) that agree with the best pair, and those (pairs, n, V) that agree with any pair."""
    n = len(problem.uv)
    count = problem.valid.sum(axis=1)
    order = np.argsort(~problem.valid, axis=1, kind="stable")  # each point's image points first
    best = np.full(n, np.inf)
    agreed = problem.valid.copy()
    every = np.zeros((MAX_PAIRS, *problem.valid.shape), dtype=bool)
    pairs = {c: _pairs(c) for c in np.unique(count).tolist()}
    for number in range(max(len(p) for p in pairs.values())):
        only = np.zeros_like(problem.valid)
        for c, chosen in pairs.items():
            if number < len(chosen):
                rows = np.flatnonzero(count == c)
                only[rows[:, None], order[rows][:, chosen[number]]] = True
        result = problem.solve(only)
        test, spread = _normalised(problem, result, np.zeros_like(only))
        # over the image point's own sigma alone: no pair is good by being vague
        with np.errstate(invalid="ignore"):  # a residual of 0 over an infinite deviation
            plain = np.abs(test) * (spread / problem.sigma)
        every[number] = (plain <= limit).all(axis=2)
        cost = np.where(result.ok, np.nansum(np.minimum(plain, limit) ** 2, axis=(1, 2)), np.inf)
        better = cost < best
        best = np.where(better, cost, best)
        agreed[better] = ((np.abs(test) <= limit).all(axis=2) | only)[better]
    return agreed, every


def _snoop(problem: _Problem, used: Bools, limit: float) -> Bools:
    """Take out the view with the largest normalised residual until none exceeds the limit or two views are left."""
    used = used.copy()
    rows: NDArray[np.intp] = np.flatnonzero(used.sum(axis=1) > 2)
    while rows.size:
        part = problem.take(rows)
        test, _ = _normalised(part, part.solve(used[rows]), used[rows])
        worst = np.where(used[rows], np.nan_to_num(np.abs(test)).max(axis=2), 0.0)
        over = worst.max(axis=1) > limit
        rows = rows[over]
        used[rows, worst[over].argmax(axis=1)] = False
        rows = rows[used[rows].sum(axis=1) > 2]
    return used


def _readmit(problem: _Problem, used: Bools, limit: float) -> Bools:
    """Let views in again that fit, the best first, as long as none exceeds the limit by it."""
    used = used.copy()
    open_ = problem.valid & ~used
    rows: NDArray[np.intp] = np.flatnonzero(open_.any(axis=1))
    while rows.size:
        part = problem.take(rows)
        test, _ = _normalised(part, part.solve(used[rows]), used[rows])
        worst = np.where(open_[rows], np.abs(test).max(axis=2), np.nan)
        fits = np.nan_to_num(worst, nan=np.inf).min(axis=1) <= limit
        rows = rows[fits]
        best = np.nan_to_num(worst[fits], nan=np.inf).argmin(axis=1)
        trial = used[rows]
        trial[np.arange(len(rows)), best] = True
        open_[rows, best] = False
        part = problem.take(rows)
        solved = part.solve(trial)
        better = solved.ok & ~_still_off(part, solved, trial, limit)
        used[rows[better]] = trial[better]
        rows = rows[open_[rows].any(axis=1)]
    return used


def _still_off(problem: _Problem, result: IntersectionResult, used: Bools, limit: float) -> Bools:
    test, _ = _normalised(problem, result, used)
    return np.asarray((np.nan_to_num(np.abs(test)).max(axis=2) * used).max(axis=1) > limit)


def _contradicted(problem: _Problem, rivals: Bools, kept: Bools, solved: IntersectionResult, limit: float) -> Bools:
    """(n,) True where as many views as are kept agree on a point that is significantly another one."""
    unsure = np.zeros(len(kept), dtype=bool)
    for rival in rivals:
        other = (rival.sum(axis=1) >= kept.sum(axis=1)) & (rival & ~kept).any(axis=1)
        rows = np.flatnonzero(other & ~unsure & solved.ok)
        if not rows.size:
            continue
        part = problem.take(rows)
        found = part.solve(rival[rows])
        difference = np.nan_to_num(found.xyz_m - solved.xyz_m[rows])
        spread = np.where(found.ok[:, None, None], found.cov_m2 + solved.cov_m2[rows], np.eye(3))
        far = np.einsum("ni,ni->n", difference, np.linalg.solve(spread, difference[..., None])[..., 0]) > 3 * limit**2
        unsure[rows] = found.ok & far & ~_still_off(part, found, rival[rows], limit)
    return unsure


def _refuse(result: IntersectionResult, rows: NDArray[np.intp]) -> None:
    rows = rows[result.ok[rows]]
    result.status[rows] = IntersectionStatus.BLUNDER_NOT_LOCATED
    for values in (result.xyz_m, result.cov_m2, result.residuals_px, result.depth_m):
        values[rows] = np.nan


def _report(
    problem: _Problem, result: IntersectionResult, kept: Bools, rows: NDArray[np.intp], limit: float
) -> tuple[Blunder, ...]:
    """Blunders of the points with a result: the views that were not kept."""
    test, spread = _normalised(problem, result, kept)
    found = []
    for i, view in zip(*np.nonzero(problem.valid & ~kept & result.ok[:, None]), strict=True):
        u, v = test[i, view].tolist()
        su, sv = spread[i, view].tolist()
        detectable_px = ((limit + _POWER) * su, (limit + _POWER) * sv)
        found.append(Blunder(int(rows[i]), int(view), (u * su, v * sv), (u, v), limit, detectable_px))
    return tuple(found)
