"""Errors of a calibration that several drives share, and how they move what the drives measured.

A calibration is wrong by L z: z are independent errors of one sigma each, drawn once when the rig was calibrated, L L^T is the
stated covariance. A place that was found with it is off by A z, A = J L being its shared_jacobian (metres), J from
`calibration_covariance.calibration_jacobian`. So two places with the shared_jacobian A and B have the covariance A B^T in
common, whatever drives they are from, as long as z means the same in both. Therefore L belongs to the calibration as it was
given, and is the symmetric square root of its correlations, times the sigmas: there is one only, in whatever order the
parameters stand.

SharedErrorJacobian are kept as float32 (`records.SharedErrorJacobian`): 3 x K of them go with every version of every cone.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from uuid import UUID

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conetl.geometry import rig as rigs
from conetl.geometry.calibration.covariance import known_covariance
from conetl.model.records import CalibrationCovariance, Rig, SharedErrorJacobian, SharedErrors

Array = NDArray[np.float64]

_WIRE = ">f4"
#: Decimals of the relative pose in metres and of its rotation: it is worked out from two poses, which rounding may change.
_DECIMALS = 9


def calibration_id(rig: Rig) -> UUID:
    """Which calibration this is: two rigs with the same cameras, relative pose and covariance, to all digits, have the same one.

    Names of rigs and where they sit on the body do not count: neither is among what the covariance is about.
    """
    taken = rig.rectified_from or rig
    covariance = known_covariance(rig)
    content = [
        taken.left.model_dump(mode="json"),
        taken.right.model_dump(mode="json"),
        # + 0: no negative zeros
        (np.round(rigs.left_SE3_right(taken), _DECIMALS) + 0.0).tolist(),
        None if covariance is None else [covariance.names, covariance.matrix],
    ]
    return UUID(bytes=hashlib.sha256(json.dumps(content).encode()).digest()[:16])


def shared_errors(rig: Rig) -> SharedErrors | None:
    """Which errors of the rig's calibration are common to the drives that were given it; None where no covariance is known."""
    covariance = known_covariance(rig)
    if covariance is None or covariance.shared is not None:
        return covariance.shared if covariance else None
    return SharedErrors(calibration=calibration_id(rig), matrix=as_rows(square_root(covariance.matrix)))


def square_root(covariance: ArrayLike) -> Array:
    """(K, K) -> (K, R): L with L L^T = covariance, a column for each parameter that is uncertain at all.

    Sigmas times the symmetric square root of the correlations: units differ by many powers of ten.
    """
    matrix = np.asarray(covariance, dtype=np.float64)
    sigmas = np.sqrt(np.diag(matrix))
    kept = sigmas > 0
    values, vectors = np.linalg.eigh(matrix[np.ix_(kept, kept)] / np.outer(sigmas[kept], sigmas[kept]))
    # What rounding, or a covariance that was written down with few digits, put below zero.
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    result = np.zeros((len(matrix), int(kept.sum())))
    result[kept] = sigmas[kept, None] * root
    return result


def as_rows(matrix: Array) -> tuple[tuple[float, ...], ...]:
    """(N, K) -> tuples."""
    return tuple(tuple(row) for row in matrix.tolist())


def jacobian_of(jacobian: Array, rig: Rig) -> SharedErrorJacobian | None:
    """SharedErrorJacobian of a place by its derivative (3, N) by the parameters of `known_covariance`; None where no covariance
    is known."""
    shared = shared_errors(rig)
    if shared is None:
        return None
    [shared_jacobian] = pack_all((shared.calibration,), (jacobian @ np.array(shared.matrix))[None, None])
    return shared_jacobian


def pack_all(
    calibrations: tuple[UUID, ...], moved_m: Array, *, most: int | None = None
) -> list[SharedErrorJacobian | None]:
    """(N, C, 3, K) metres -> N records, rounded to what is kept; None without any.

    calibrations: C, in rising order. most: so many at most, those that move a place most.
    """
    count, number = moved_m.shape[:2]
    if moved_m[:1].size == 0:
        return [None] * count
    wire = moved_m.astype(_WIRE)
    if most is None or number <= most:
        return [SharedErrorJacobian(calibrations, one.tobytes()) for one in wire]
    size = np.square(moved_m).sum(axis=(2, 3))
    kept = np.sort(np.argsort(-size, axis=1, kind="stable")[:, :most], axis=1)
    return [
        SharedErrorJacobian(tuple(calibrations[k] for k in own), one[own].tobytes())
        for own, one in zip(kept.tolist(), wire, strict=True)
    ]


def unpack_all(calibrations: tuple[UUID, ...], shared_jacobian: Sequence[SharedErrorJacobian | None]) -> Array:
    """N records, all without shared_jacobian or all with those of the same calibrations -> (N, C, 3, K) metres.

    calibrations: the C of the result, among which theirs are; 0 for the others.
    """
    first = next((one for one in shared_jacobian if one is not None), None)
    if first is None:
        return np.zeros((len(shared_jacobian), len(calibrations), 3, 0))
    moved_m = np.frombuffer(b"".join(one.moved_m for one in shared_jacobian if one is not None), _WIRE)
    moved_m = moved_m.reshape(len(shared_jacobian), len(first.calibrations), 3, -1)
    result = np.zeros((len(shared_jacobian), len(calibrations), 3, moved_m.shape[3]))
    result[:, [calibrations.index(one) for one in first.calibrations]] = moved_m
    return result


def with_shared(covariance: CalibrationCovariance, calibration: UUID, matrix: Array) -> CalibrationCovariance:
    """A covariance of which only a part, (N, K) `matrix` times its transpose, is common to drives with that calibration."""
    return covariance.model_copy(update={"shared": SharedErrors(calibration=calibration, matrix=as_rows(matrix))})


def with_covariance(rig: Rig, covariance: CalibrationCovariance) -> Rig:
    """The rig with another covariance of the calibration that took the images (`known_covariance`)."""
    if rig.rectified_from is None:
        return rig.model_copy(update={"calibration_covariance": covariance})
    taken = rig.rectified_from.model_copy(update={"calibration_covariance": covariance})
    return rig.model_copy(update={"rectified_from": taken})
