"""Errors of a calibration that several drives share, and how they move what the drives measured.

A calibration is wrong by L z: z are independent errors of one sigma each, L L^T is the stated covariance. A position that was
found with it is wrong by A z with the shared-error Jacobian A = J L (metres), J from `covariance.calibration_jacobian`; two
positions with Jacobians A and B have the covariance A B^T in common, of whatever drives. L is the symmetric square root of the
correlations times the sigmas, which does not depend on the order of parameters. Stored as float32 (`SharedErrorJacobian`): 3 x K
numbers for every version of every cone.
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
    """Id of a calibration: equal for rigs with the same cameras, relative pose and covariance, to all digits.

    Names of rigs and their pose on the body do not count.
    """
    taken = rig.rectified_from or rig
    covariance = known_covariance(rig)
    content = [
        taken.left.model_dump(mode="json"),
        taken.right.model_dump(mode="json"),
        # + 0 removes negative zeros
        (np.round(rigs.left_SE3_right(taken), _DECIMALS) + 0.0).tolist(),
        None if covariance is None else [covariance.names, covariance.matrix],
    ]
    return UUID(bytes=hashlib.sha256(json.dumps(content).encode()).digest()[:16])


def shared_errors(rig: Rig) -> SharedErrors | None:
    """Errors of the rig's calibration that its drives share; None without a covariance."""
    covariance = known_covariance(rig)
    if covariance is None or covariance.shared is not None:
        return covariance.shared if covariance else None
    return SharedErrors(calibration=calibration_id(rig), matrix=as_rows(square_root(covariance.matrix)))


def square_root(covariance: ArrayLike) -> Array:
    """(K, K) -> (K, R): L with L L^T = covariance, a column for each uncertain parameter.

    Sigmas times the symmetric square root of the correlations: units differ by many powers of ten.
    """
    matrix = np.asarray(covariance, dtype=np.float64)
    sigmas = np.sqrt(np.diag(matrix))
    kept = sigmas > 0
    values, vectors = np.linalg.eigh(matrix[np.ix_(kept, kept)] / np.outer(sigmas[kept], sigmas[kept]))
    # Rounding, or a covariance with few digits, may give negative eigenvalues.
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    result = np.zeros((len(matrix), int(kept.sum())))
    result[kept] = sigmas[kept, None] * root
    return result


def as_rows(matrix: Array) -> tuple[tuple[float, ...], ...]:
    """(N, K) -> tuples."""
    return tuple(tuple(row) for row in matrix.tolist())


def jacobian_of(jacobian: Array, rig: Rig) -> SharedErrorJacobian | None:
    """Shared-error Jacobian of a position from its derivative (3, N) by the parameters of `known_covariance`, if any."""
    shared = shared_errors(rig)
    if shared is None:
        return None
    [shared_jacobian] = pack_all((shared.calibration,), (jacobian @ np.array(shared.matrix))[None, None])
    return shared_jacobian


def pack_all(
    calibrations: tuple[UUID, ...], moved_m: Array, *, most: int | None = None
) -> list[SharedErrorJacobian | None]:
    """(N, C, 3, K) metres -> N records, rounded as stored; None for empty ones.

    calibrations: C, in ascending order. most: keep at most this many, those of the largest effect.
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
    """N records, all None or all of the same calibrations -> (N, C, 3, K) metres.

    calibrations: the C of the result, which include theirs; 0 for the others.
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
