"""Two statements about one place into one: what the map knows of it, and what a drive says of it.

Best linear unbiased fusion of two estimates whose errors may have a part in common (Bar-Shalom & Campo 1986, "The effect of the
common process noise on the two-sensor fused-track covariance"; Bar-Shalom, Willett & Tian 2011, "Tracking and Data Fusion",
ch. 9): with P1, P2 their covariances and C what they have in common, the weight of the second is
G = (P1 - C) (P1 + P2 - C - C')^-1.

What drives have in common is the error of a calibration (`geometry/calibration/shared.py`). A statement has a place, its
covariance P and its shared_jacobian A, so that P = R + A A', R being nobody else's, and C = A1 A2'. The fused shared_jacobian are
(I - G) A1 + G A2, the fused own part is (I - G) R1 (I - G)' + G R2 G', and P is their sum again: what the formula of the
covariance gives, but positive definite by its form, and never below what the calibration leaves. Drives from one side have the
same shared_jacobian, and the calibration's error stays; from opposite sides shared_jacobian cancel. A weight may be below 0 or
above 1: of a near and a far look with one calibration, the far one tells which way both are off.

Where neither has shared_jacobian the plain formula holds, which is the same with A = 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, TypeVar
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.calibration.shared import pack_all, unpack_all
from conetl.geometry.packing import cov_matrices
from conetl.model.records import Cov3, SharedErrorJacobian

Floats = NDArray[np.float64]
S = TypeVar("S")

#: A feature keeps the shared_jacobian of at most so many calibrations: each makes its versions longer. Of more, those that move
#: it least count as errors of its own from then on.
MOST_CALIBRATIONS = 8
#: The own part of a covariance is at least this, one micrometre squared: shared_jacobian are rounded, and two statements that are
#: calibration error through and through have equal weights then instead of none.
_LEAST_OWN_M2 = 1e-12


class Fusion(NamedTuple):
    """How N pairs of statements become one each."""

    gain: Floats
    """(N, 3, 3) weight of the new place; the old one's is I less it."""
    cov_m2: Floats
    """(N, 3, 3), symmetric."""
    shared_jacobian: list[SharedErrorJacobian | None]


def fuse(
    old_cov: Sequence[Cov3],
    old_jacobian: Sequence[SharedErrorJacobian | None],
    new_cov: Sequence[Cov3],
    new_jacobian: Sequence[SharedErrorJacobian | None],
) -> Fusion:
    """Weights, covariances and shared_jacobian of N pairs of statements about one place each; covariances in m^2."""
    old, new = cov_matrices(old_cov), cov_matrices(new_cov)
    gain = old @ np.linalg.inv(old + new)
    cov = (np.eye(3) - gain) @ old
    cov = (cov + np.swapaxes(cov, 1, 2)) / 2
    shared_jacobian: list[SharedErrorJacobian | None] = [None] * len(old)
    shapes = [(_shape(one), _shape(other)) for one, other in zip(old_jacobian, new_jacobian, strict=True)]
    for ((old_ids, _), (new_ids, _)), rows in _alike(shapes).items():
        ids = tuple(sorted({*old_ids, *new_ids}))
        if not ids:
            continue
        a, b = _side_by_side(ids, [old_jacobian[k] for k in rows], [new_jacobian[k] for k in rows])
        gain[rows], cov[rows], moved = _fuse_correlated(old[rows], a, new[rows], b)
        for k, fused in zip(rows, pack_all(ids, moved, most=MOST_CALIBRATIONS), strict=True):
            shared_jacobian[k] = fused
    return Fusion(gain, cov, shared_jacobian)


def own_parts(cov: Sequence[Cov3], shared_jacobian: Sequence[SharedErrorJacobian | None]) -> Floats:
    """Covariances (N, 3, 3) in m^2 less what shared_jacobian say of them."""
    own = cov_matrices(cov)
    for (ids, _), rows in _alike([_shape(one) for one in shared_jacobian]).items():
        if ids:
            own[rows] = _own_part(own[rows], _flat(unpack_all(ids, [shared_jacobian[k] for k in rows])))
    return own


def with_jacobian(own: Floats, shared_jacobian: Floats) -> Floats:
    """Covariances (N, 3, 3) whose own parts are these, with shared_jacobian (N, C, 3, K)."""
    return own + _squared(_flat(shared_jacobian))


def _fuse_correlated(old: Floats, a: Floats, new: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
    """Gain, covariance (N, 3, 3) and shared_jacobian (N, C, 3, K) of pairs whose shared_jacobian, of the same calibrations, are
    a and b."""
    flat_a, flat_b = _flat(a), _flat(b)
    own_old, own_new = _own_part(old, flat_a), _own_part(new, flat_b)
    apart = flat_a - flat_b
    # P1 + P2 - C - C', and P1 - C, with the own parts: the former is positive definite however near the two statements are.
    difference = own_old + own_new + _squared(apart)
    of_old = own_old + flat_a @ np.swapaxes(apart, 1, 2)
    gain = np.swapaxes(np.linalg.solve(difference, np.swapaxes(of_old, 1, 2)), 1, 2)
    rest = np.eye(3) - gain
    moved = (rest[:, None] @ a + gain[:, None] @ b).astype(np.float32).astype(np.float64)  # as it is kept
    own = rest @ own_old @ np.swapaxes(rest, 1, 2) + gain @ own_new @ np.swapaxes(gain, 1, 2)
    cov = own + _squared(_flat(moved))
    return gain, (cov + np.swapaxes(cov, 1, 2)) / 2, moved


def _own_part(cov: Floats, shared_jacobian: Floats) -> Floats:
    """Covariances (N, 3, 3) less those of shared_jacobian (N, 3, M)."""
    own = cov - _squared(shared_jacobian)
    values, vectors = np.linalg.eigh((own + np.swapaxes(own, 1, 2)) / 2)
    return np.asarray((vectors * np.maximum(values, _LEAST_OWN_M2)[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def _side_by_side(
    ids: tuple[UUID, ...], old: Sequence[SharedErrorJacobian | None], new: Sequence[SharedErrorJacobian | None]
) -> tuple[Floats, Floats]:
    """SharedErrorJacobian of N pairs, (N, C, 3, K) each; 0 where one has none of a calibration, or fewer errors."""
    a, b = unpack_all(ids, old), unpack_all(ids, new)
    width = max(a.shape[3], b.shape[3])
    return tuple(np.pad(x, ((0, 0), (0, 0), (0, 0), (0, width - x.shape[3]))) for x in (a, b))  # type: ignore[return-value]


def _alike(shapes: Iterable[S]) -> dict[S, list[int]]:
    """Rows by the shapes of their shared_jacobian: those of one shape go through together, and as a rule that is all of a
    drive."""
    rows: dict[S, list[int]] = {}
    for k, shape in enumerate(shapes):
        rows.setdefault(shape, []).append(k)
    return rows


def _shape(shared_jacobian: SharedErrorJacobian | None) -> tuple[tuple[UUID, ...], int]:
    return ((), 0) if shared_jacobian is None else (shared_jacobian.calibrations, len(shared_jacobian.moved_m))


def _flat(shared_jacobian: Floats) -> Floats:
    """(N, C, 3, K) -> (N, 3, C K): errors of different calibrations are errors like others."""
    return np.swapaxes(shared_jacobian, 1, 2).reshape(len(shared_jacobian), 3, -1)


def _squared(shared_jacobian: Floats) -> Floats:
    """(N, 3, M) -> (N, 3, 3)."""
    return shared_jacobian @ np.swapaxes(shared_jacobian, 1, 2)
