"""Do errors fit their stated covariances? NEES, chi-square bands, CE90 and LE90.

The normalised estimation error squared (NEES, e.g. Bar-Shalom, Li & Kirubarajan 2001, ch. 5.4) of N points is chi-square with 3N
degrees of freedom only for independent errors. GNSS/INS and calibration errors are common to the points of one drive, so
`consistency` splits the squared error exactly into a relative and a common part with separate degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from scipy.special import chdtri

from conetl.model.arrays import Floats

#: A common error below this share of the points' own sigmas is invisible and has no degree of freedom.
_INVISIBLE = 1e-6


@dataclass(frozen=True)
class Nees:
    """A NEES and its degrees of freedom: chi-square distributed if the covariance is right."""

    value: float
    dof: int

    @property
    def per_dof(self) -> float:
        """1 on average if the covariance is correct; 4 if the sigmas are half the correct ones, 1/4 if double."""
        if self.dof == 0:
            raise ValueError("a NEES requires degrees of freedom")
        return self.value / self.dof

    def band(self, probability: float = 0.95) -> tuple[float, float]:
        """Two-sided interval that contains a chi-square variable with these degrees of freedom with this probability."""
        tail = (1.0 - probability) / 2.0
        return float(chdtri(self.dof, 1.0 - tail)), float(chdtri(self.dof, tail))  # chdtri takes the upper tail

    def holds(self, probability: float = 0.95) -> bool:
        """Whether `value` lies in its band."""
        low, high = self.band(probability)
        return low <= self.value <= high

    def __add__(self, other: Nees) -> Nees:
        return Nees(self.value + other.value, self.dof + other.dof)


@dataclass(frozen=True)
class Consistency:
    """NEES of the points of one drive; `absolute` is the sum of the other two."""

    absolute: Nees
    """Against the whole covariance, common errors as correlations between the points."""
    relative: Nees
    """What is left when the best fitting common errors are taken out: relevant for distances between points."""
    common: Nees
    """The common errors themselves, one degree of freedom each."""

    def __add__(self, other: Consistency) -> Consistency:
        """Of two drives together: sums against the sum of their degrees of freedom.

        As in the Monte Carlo test of Bar-Shalom, Li & Kirubarajan (2001, ch. 5.4): chi-square for independent drives.
        The error of a calibration that they share makes the band of `common` somewhat too narrow.
        """
        return Consistency(self.absolute + other.absolute, self.relative + other.relative, self.common + other.common)


def pooled(results: Iterable[Consistency | None]) -> Consistency | None:
    """The sum of all results that are not None; None without any."""
    known = [one for one in results if one is not None]
    return sum(known[1:], known[0]) if known else None


def point_nees(difference_m: ArrayLike, cov_m2: ArrayLike) -> Floats:
    """(N,) squared Mahalanobis length of each difference (N, 3) under its own covariance (N, 3, 3)."""
    difference = np.asarray(difference_m, dtype=np.float64)
    solved = np.linalg.solve(np.asarray(cov_m2, dtype=np.float64), difference[..., None])[..., 0]
    return np.asarray(np.einsum("...i,...i->...", difference, solved))


def leave_one_out_nees(difference_m: Floats, cov_m2: Floats) -> Floats:
    """(N,) NEES of each of N points (N, 3) given all others, chi-square with 3 degrees of freedom; cov_m2 (3N, 3N) of all.

    The prediction error of each point from all others, by the inverse of the joint covariance (e.g. Rasmussen & Williams 2006,
    5.4.2).
    """
    count, inverse = len(difference_m), np.linalg.inv(cov_m2)
    blocks = inverse.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
    return point_nees((inverse @ difference_m.ravel()).reshape(count, 3), blocks)


def consistency(
    difference_m: ArrayLike, own_cov_m2: ArrayLike, common_jacobian: ArrayLike, common_cov: ArrayLike
) -> Consistency:
    """Split the NEES of N points with D components (3, or fewer) into relative and common part.

    difference_m (N, D): estimate minus truth. own_cov_m2 (DN, DN): of the points' own errors, correlated where poses drift within
    a drive.
    common_jacobian (N, D, K), common_cov (K, K): how K common errors move each point, and their covariance (positive
    semi-definite). With e = G x + n whitened by the points' own covariance and G L = U S V' (L L' the common covariance), the
    whitened error has covariance I + U S^2 U': inside the columns of U is the common part, outside it the relative one.
    """
    e = np.asarray(difference_m, dtype=np.float64)
    g = np.asarray(common_jacobian, dtype=np.float64)
    if e.ndim != 2 or g.ndim != 3 or g.shape[:2] != e.shape:
        raise ValueError(f"expected differences (N, D) and a Jacobian (N, D, K), found {e.shape} and {g.shape}")
    lower = np.linalg.cholesky(np.asarray(own_cov_m2, dtype=np.float64))
    white = solve_triangular(lower, np.concatenate([e[..., None], g], axis=2).reshape(e.size, -1), lower=True)
    white_e, white_g = white[:, 0], white[:, 1:]
    values, vectors = np.linalg.eigh(np.asarray(common_cov, dtype=np.float64))
    if values.min(initial=0.0) < -1e-9 * max(values.max(initial=0.0), 1e-30):
        raise ValueError("consistency: the common covariance is not positive semi-definite")
    u, s, _ = np.linalg.svd(white_g @ (vectors * np.sqrt(np.maximum(values, 0.0))), full_matrices=False)
    seen = s > _INVISIBLE
    inside = u[:, seen].T @ white_e
    common = Nees(float(np.sum(inside**2 / (1.0 + s[seen] ** 2))), int(seen.sum()))
    relative = Nees(max(float(white_e @ white_e - inside @ inside), 0.0), e.size - int(seen.sum()))
    return Consistency(common + relative, relative, common)


def ce90_m(difference_m: ArrayLike) -> float:
    """Circular error: 90 % of the horizontal errors of (N, 3) differences are not larger."""
    e = np.asarray(difference_m, dtype=np.float64)
    return float(np.quantile(np.hypot(e[:, 0], e[:, 1]), 0.9))


def le90_m(difference_m: ArrayLike) -> float:
    """Linear error: 90 % of the vertical errors of (N, 3) differences are not larger."""
    return float(np.quantile(np.abs(np.asarray(difference_m, dtype=np.float64)[:, 2]), 0.9))
