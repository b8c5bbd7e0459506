"""Conversions between arrays and the tuples of records."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from conetl.model.arrays import Floats
from conetl.model.base import Cov3, Vec3


def vec3(values: Floats) -> Vec3:
    """(3,) -> tuple."""
    x, y, z = values.tolist()
    return x, y, z


def as_rows(matrix: Floats) -> tuple[tuple[float, ...], ...]:
    """(N, K) -> tuples."""
    return tuple(map(tuple, matrix.tolist()))


def cov3(matrix: Floats) -> Cov3:
    """Symmetric (3, 3) -> upper triangle xx, xy, xz, yy, yz, zz."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = matrix.tolist()
    return xx, xy, xz, yy, yz, zz


def cov_matrix(cov: Cov3) -> Floats:
    """Symmetric (3, 3) matrix from its upper triangle xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = cov
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def horizontal_sigma_m(cov: Cov3) -> float:
    """Standard deviation of the horizontal position in its worst direction: the semi-major axis of the error ellipse."""
    return float(np.sqrt(np.linalg.eigvalsh(cov_matrix(cov)[:2, :2])[-1]))


def stack_rows(rows: Sequence[Sequence[float]], width: int) -> Floats:
    """N tuples of `width` numbers -> (N, width), in half the time of numpy.array."""
    return np.fromiter(chain.from_iterable(rows), np.float64, width * len(rows)).reshape(-1, width)


def cov_matrices(covariances: Sequence[Cov3]) -> Floats:
    """As `cov_matrix`, for N of them: (N, 3, 3)."""
    return stack_rows(covariances, 6)[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
