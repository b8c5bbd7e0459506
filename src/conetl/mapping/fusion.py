"""Fusion of two estimates of one position that share errors: a feature of the map and a track of a drive.

Best linear unbiased fusion (Bar-Shalom & Campo 1986, "The effect of the common process noise on the two-sensor fused-track
covariance"; Bar-Shalom, Willett & Tian 2011, "Tracking and Data Fusion", ch. 9): with covariances P1, P2 and cross-covariance C,
the gain of the second is G = (P1 - C) (P1 + P2 - C - C')^-1.

Drives share the errors of a calibration (`geometry/calibration/covariance.py`). With the shared-error Jacobian A of an estimate,
P = R + A A', R being independent, and C = A1 A2'. The fused Jacobian is (I - G) A1 + G A2, the fused independent part (I - G) R1
(I - G)' + G R2 G'; their sum is positive definite and never below the error that the calibration leaves. Drives from one side
have the same Jacobian, so that the calibration's error remains; from opposite sides the Jacobians cancel. A gain may be below 0
or above 1: of a near and a far estimate with one calibration, the far one shows the direction of the common error. Without
Jacobians A = 0.

Where drives contradict each other by more than they state, at least one of them has an error that its sigmas lack, and nothing
shows which. This excess is one more shared error, of the id `EXCESS`, of the feature and of all drives that are fused with it:
their position is the weighted mean, and the excess does not average out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, TypeVar
from uuid import NAMESPACE_OID, UUID, uuid5

import numpy as np

from conetl.geometry.calibration.covariance import pack_jacobians, unpack_jacobians
from conetl.geometry.packing import cov3, cov_matrices, cov_matrix
from conetl.model.arrays import Floats
from conetl.model.base import Cov3, SharedErrorJacobian
from conetl.model.drive import Track
from conetl.model.map_records import MapFeature

S = TypeVar("S")

#: Id of the excess among the shared errors.
EXCESS = uuid5(NAMESPACE_OID, "conetl:excess of contradicting drives")
#: A difference of this many sigmas of the excess is as large as those that it was estimated from.
_EXCESS_SIGMAS = 3.0
#: A feature keeps the shared-error Jacobians of at most this many calibrations, because each lengthens its versions. If there are
#: more, the smallest count as independent errors from then on.
MOST_CALIBRATIONS = 8
#: Least variance of the independent part, one micrometre squared: Jacobians are rounded, and two estimates with calibration
#: errors only get equal weights.
_LEAST_INDEPENDENT_M2 = 1e-12
#: Differences beyond this, in plan or in height, are not chance (0.7 and 0.16 % of honest ones).
_COVERED_CHI2 = 10.0


class Fused(NamedTuple):
    """N fused positions."""

    gain: Floats
    """(N, 3, 3) of the new estimates; those of the old ones are I less it."""
    cov_m2: Floats
    """(N, 3, 3), symmetric."""
    shared_jacobian: list[SharedErrorJacobian | None]
    difference_m2: Floats
    """(N, 3, 3): covariance of the differences of both estimates, to which shared errors contribute only if they differ."""


def fuse(
    old_cov: Sequence[Cov3],
    old_jacobian: Sequence[SharedErrorJacobian | None],
    new_cov: Sequence[Cov3],
    new_jacobian: Sequence[SharedErrorJacobian | None],
) -> Fused:
    """Fuse N pairs of estimates of one position each; covariances in m^2."""
    old, new = cov_matrices(old_cov), cov_matrices(new_cov)
    difference = old + new
    gain = old @ np.linalg.inv(difference)
    cov = (np.eye(3) - gain) @ old
    cov = (cov + np.swapaxes(cov, 1, 2)) / 2
    shared_jacobian: list[SharedErrorJacobian | None] = [None] * len(old)
    for rows, ids, a, b in _correlated(old_jacobian, new_jacobian):
        gain[rows], cov[rows], moved, difference[rows] = _fuse_correlated(old[rows], a, new[rows], b)
        for k, fused in zip(rows, pack_jacobians(ids, moved, most=MOST_CALIBRATIONS), strict=True):
            shared_jacobian[k] = fused
    return Fused(gain, cov, shared_jacobian, difference)


def difference_cov(
    old_cov: Sequence[Cov3],
    old_jacobian: Sequence[SharedErrorJacobian | None],
    new_cov: Sequence[Cov3],
    new_jacobian: Sequence[SharedErrorJacobian | None],
) -> Floats:
    """Covariances (N, 3, 3) m^2 of the differences of N pairs of estimates, P1 + P2 - C - C': what both share cancels.

    old: may have an excess, which counts so that a difference as large as those before is a few sigmas.
    """
    old, new = cov_matrices(old_cov) - _uncounted_excess(old_jacobian), cov_matrices(new_cov)
    old_jacobian = list(map(without_excess, old_jacobian))
    cov = old + new
    for rows, _, a, b in _correlated(old_jacobian, new_jacobian):
        flat_a, flat_b = _flat(a), _flat(b)
        own = _independent_part(old[rows], flat_a) + _independent_part(new[rows], flat_b)
        cov[rows] = own + _squared(flat_a - flat_b)  # positive definite for any pair
    return cov


def excess_of(shared_jacobian: SharedErrorJacobian | None) -> Floats | None:
    """(3, 3) m^2; None without an excess."""
    if shared_jacobian is None or EXCESS not in shared_jacobian.calibrations:
        return None
    ids = shared_jacobian.calibrations
    moved_m = unpack_jacobians(ids, [shared_jacobian])[0, ids.index(EXCESS)]
    return np.asarray(moved_m @ moved_m.T)


def without_excess(shared_jacobian: SharedErrorJacobian | None) -> SharedErrorJacobian | None:
    """The Jacobian of the other shared errors."""
    if shared_jacobian is None or EXCESS not in shared_jacobian.calibrations:
        return shared_jacobian
    ids = tuple(one for one in shared_jacobian.calibrations if one != EXCESS)
    moved_m = unpack_jacobians(shared_jacobian.calibrations, [shared_jacobian])
    kept = [k for k, one in enumerate(shared_jacobian.calibrations) if one != EXCESS]
    return pack_jacobians(ids, moved_m[:, kept])[0]


def with_excess(
    cov_m2: Cov3, shared_jacobian: SharedErrorJacobian | None, excess_m2: Floats
) -> tuple[Cov3, SharedErrorJacobian]:
    """Covariance and Jacobian with this excess (3, 3) in place of their own."""
    before, others = excess_of(shared_jacobian), without_excess(shared_jacobian)
    known = () if others is None else others.calibrations
    ids = tuple(sorted({EXCESS, *known}))
    moved_m = unpack_jacobians(ids, [others], 3)
    values, vectors = np.linalg.eigh(excess_m2)
    # The symmetric root: features that one drive contradicts have the same error.
    moved_m[0, ids.index(EXCESS), :, :3] = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    [packed] = pack_jacobians(ids, moved_m)
    stored_m2 = excess_of(packed)  # rounded
    assert packed is not None and stored_m2 is not None  # it has an id
    return cov3(cov_matrix(cov_m2) - (0.0 if before is None else before) + stored_m2), packed


def larger_excess(one_m2: Floats | None, other_m2: Floats | None) -> Floats | None:
    """An excess (3, 3) that contains both."""
    if one_m2 is None or other_m2 is None:
        return other_m2 if one_m2 is None else one_m2
    values, vectors = np.linalg.eigh(other_m2 - one_m2)
    return np.asarray(one_m2 + (vectors * np.maximum(values, 0.0)) @ vectors.T)


def _uncounted_excess(shared_jacobian: Sequence[SharedErrorJacobian | None]) -> Floats:
    """(N, 3, 3) m^2: the part of the excess that no difference is expected to show."""
    uncounted = np.zeros((len(shared_jacobian), 3, 3))
    for k, one in enumerate(shared_jacobian):
        if (excess_m2 := excess_of(one)) is not None:
            uncounted[k] = (1 - _EXCESS_SIGMAS**-2) * excess_m2
    return uncounted


def expected_covs(features: Sequence[MapFeature]) -> Floats:
    """(N, 3, 3) m^2: how far features may be from another drive's cones by the map's errors; see `difference_cov`."""
    return cov_matrices([f.cov_m2 for f in features]) - _uncounted_excess([f.shared_jacobian for f in features])


def birge_ratios(apart_m: Floats, cov_m2: Floats) -> Floats:
    """(N, 3) factors for the variances of east, north and up so that they cover the differences apart_m (N, 3) of two estimates
    with stated covariance cov_m2 (N, 3, 3); 1 where they already do.

    One of the two is wrong, and nothing shows which (Birge 1932, "The calculation of errors by the method of least squares").
    """
    ratios = np.ones_like(apart_m)
    for axes in (slice(2), slice(2, 3)):
        chi2 = np.einsum("ni,nij,nj->n", apart_m[:, axes], np.linalg.inv(cov_m2[:, axes, axes]), apart_m[:, axes])
        beyond = chi2 > _COVERED_CHI2
        ratios[beyond, axes] = chi2[beyond, None] / (axes.stop - (axes.start or 0))
    return ratios


def independent_parts(cov: Sequence[Cov3], shared_jacobian: Sequence[SharedErrorJacobian | None]) -> Floats:
    """Independent parts (N, 3, 3) of covariances, in m^2."""
    own = cov_matrices(cov)
    for (ids, _), rows in _rows_by_shape([_shape(one) for one in shared_jacobian]).items():
        if ids:
            own[rows] = _independent_part(own[rows], _flat(unpack_jacobians(ids, [shared_jacobian[k] for k in rows])))
    return own


def _correlated(
    old_jacobian: Sequence[SharedErrorJacobian | None], new_jacobian: Sequence[SharedErrorJacobian | None]
) -> Iterator[tuple[list[int], tuple[UUID, ...], Floats, Floats]]:
    """Rows of the pairs with shared errors, together where they have the same ones; ids and Jacobians (N, C, 3, K) of both."""
    shapes = [(_shape(one), _shape(other)) for one, other in zip(old_jacobian, new_jacobian, strict=True)]
    for ((old_ids, old_errors), (new_ids, new_errors)), rows in _rows_by_shape(shapes).items():
        if ids := tuple(sorted({*old_ids, *new_ids})):
            errors = max(old_errors, new_errors)
            a, b = (unpack_jacobians(ids, [side[k] for k in rows], errors) for side in (old_jacobian, new_jacobian))
            yield rows, ids, a, b


def _fuse_correlated(old: Floats, a: Floats, new: Floats, b: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Gain, covariance (N, 3, 3), shared-error Jacobian (N, C, 3, K) of pairs with Jacobians a, b of the same calibrations; the
    covariance of their differences."""
    flat_a, flat_b = _flat(a), _flat(b)
    own_old, own_new = _independent_part(old, flat_a), _independent_part(new, flat_b)
    difference = own_old + own_new + _squared(flat_a - flat_b)  # P1 + P2 - C - C'
    of_old = own_old + flat_a @ np.swapaxes(flat_a - flat_b, 1, 2)  # P1 - C
    gain = np.swapaxes(np.linalg.solve(difference, np.swapaxes(of_old, 1, 2)), 1, 2)
    rest = np.eye(3) - gain
    moved = (rest[:, None] @ a + gain[:, None] @ b).astype(np.float32).astype(np.float64)  # as stored
    own = rest @ own_old @ np.swapaxes(rest, 1, 2) + gain @ own_new @ np.swapaxes(gain, 1, 2)
    cov = own + _squared(_flat(moved))
    return gain, (cov + np.swapaxes(cov, 1, 2)) / 2, moved, difference


def _independent_part(cov: Floats, shared_jacobian: Floats) -> Floats:
    """Covariances (N, 3, 3) less those of shared-error Jacobians (N, 3, M)."""
    own = cov - _squared(shared_jacobian)
    values, vectors = np.linalg.eigh((own + np.swapaxes(own, 1, 2)) / 2)
    return np.asarray((vectors * np.maximum(values, _LEAST_INDEPENDENT_M2)[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def _rows_by_shape(shapes: Iterable[S]) -> dict[S, list[int]]:
    """Rows grouped by the shape of their Jacobians, to be computed together; usually one group per drive."""
    rows: dict[S, list[int]] = {}
    for k, shape in enumerate(shapes):
        rows.setdefault(shape, []).append(k)
    return rows


def _shape(shared_jacobian: SharedErrorJacobian | None) -> tuple[tuple[UUID, ...], int]:
    """Calibrations, and number of errors of each."""
    if shared_jacobian is None:
        return (), 0
    ids = shared_jacobian.calibrations
    return ids, len(shared_jacobian.moved_m) // (4 * 3 * len(ids))


def _flat(shared_jacobian: Floats) -> Floats:
    """(N, C, 3, K) -> (N, 3, C K)."""
    return np.swapaxes(shared_jacobian, 1, 2).reshape(len(shared_jacobian), 3, -1)


def _squared(shared_jacobian: Floats) -> Floats:
    """(N, 3, M) -> (N, 3, 3)."""
    return shared_jacobian @ np.swapaxes(shared_jacobian, 1, 2)


def tracks_in_map_frame(
    wanted: Iterable[int],
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    pairs: Mapping[int, int],
    weight: float,
) -> dict[int, Track]:
    """The wanted tracks by index, with their covariances and shared-error Jacobians in the map's frame.

    pairs: feature -> track index, from which the drive's offset was estimated. Correcting a track by the share `weight` of it
    leaves 1 - weight of the drive's common error, adds weight of the map's, and keeps the track's own errors (`relative_cov_m2`).
    Its Jacobian becomes A - weight mean(A_track - A_feature). Otherwise a cone that a drive without a GNSS fix adds to a
    well-known row would follow the next drive, away from the row. Without an offset the tracks are unchanged.
    """
    own = {i: tracks[i] for i in wanted}
    if weight == 0 or not pairs or not own:
        return own
    taken = offset_errors([features[j] for j in pairs], [tracks[i].shared_jacobian for i in pairs.values()], weight)
    some = own.values()
    covs, jacobians = in_map_frame(
        [t.cov_m2 for t in some], [t.relative_cov_m2 for t in some], [t.shared_jacobian for t in some], taken
    )
    return {
        i: track.model_copy(update={"cov_m2": cov_m2, "shared_jacobian": jacobian})
        for (i, track), cov_m2, jacobian in zip(own.items(), covs, jacobians, strict=True)
    }


class OffsetErrors(NamedTuple):
    """Errors of the share `weight` of a drive's offset, from the features that it was estimated from."""

    weight: float
    of_map: Floats
    """(3, 3) m^2: the map's part of its covariance."""
    jacobians: Mapping[UUID, Floats]
    """(3, K) by calibration."""


def offset_errors(
    observed: Sequence[MapFeature], shared_jacobian: Sequence[SharedErrorJacobian | None], weight: float
) -> OffsetErrors:
    """observed: the features that the drive observed, at least one; shared_jacobian: of what it observed of each."""
    of_map = weight**2 * independent_parts([f.cov_m2 for f in observed], [f.shared_jacobian for f in observed]).mean(
        axis=0
    )
    sides = shared_jacobian, [feature.shared_jacobian for feature in observed]
    errors = max(_shape(one)[1] for side in sides for one in side)
    drive, on_map = (_sums(side, errors) for side in sides)
    none = np.zeros((3, errors))
    summed = {key: drive.get(key, none) - on_map.get(key, none) for key in drive | on_map}
    return OffsetErrors(weight, of_map, {key: weight / len(observed) * moved_m for key, moved_m in summed.items()})


def in_map_frame(
    cov_m2: Sequence[Cov3],
    relative_cov_m2: Sequence[Cov3],
    shared_jacobian: Sequence[SharedErrorJacobian | None],
    offset: OffsetErrors,
) -> tuple[list[Cov3], list[SharedErrorJacobian | None]]:
    """Covariances and Jacobians of N positions of the drive after subtracting its offset."""
    relative = cov_matrices(relative_cov_m2)
    whole = independent_parts(cov_m2, shared_jacobian)
    # Without the calibration's part; all positions of the drive have the same error of GNSS/INS.
    own = relative + (1 - offset.weight) ** 2 * (whole - relative) + offset.of_map
    errors = max((moved_m.shape[1] for moved_m in offset.jacobians.values()), default=0)
    jacobians = list(shared_jacobian)
    for (known, _), rows in _rows_by_shape(map(_shape, shared_jacobian)).items():
        ids = tuple(sorted({*offset.jacobians, *known}))
        after = unpack_jacobians(ids, [shared_jacobian[k] for k in rows], errors)
        for calibration, moved_m in offset.jacobians.items():
            after[:, ids.index(calibration), :, : moved_m.shape[1]] -= moved_m
        after = after.astype(np.float32).astype(np.float64)  # as stored
        own[rows] += _squared(_flat(after))
        for k, packed in zip(rows, pack_jacobians(ids, after, most=MOST_CALIBRATIONS), strict=True):
            jacobians[k] = packed
    return list(map(cov3, (own + np.swapaxes(own, 1, 2)) / 2)), jacobians


def mean_jacobians(shared_jacobian: Sequence[SharedErrorJacobian | None]) -> dict[UUID, Floats]:
    """Mean (3, K) of the Jacobians of N positions, by calibration: by how much they are off together."""
    return {key: moved_m / len(shared_jacobian) for key, moved_m in _sums(shared_jacobian, 0).items()}


def _sums(shared_jacobian: Sequence[SharedErrorJacobian | None], errors: int) -> dict[UUID, Floats]:
    """Sum (3, K) of the Jacobians of each calibration; errors: least K."""
    sums: dict[UUID, Floats] = {}
    shapes = list(map(_shape, shared_jacobian))
    errors = max([errors, *(count for _, count in shapes)])  # a corrected calibration has more errors
    for (ids, _), rows in _rows_by_shape(shapes).items():
        if ids:
            summed_m = unpack_jacobians(ids, [shared_jacobian[k] for k in rows], errors).sum(axis=0)
            for calibration, moved_m in zip(ids, summed_m, strict=True):
                sums[calibration] = sums.get(calibration, 0.0) + moved_m
    return sums
