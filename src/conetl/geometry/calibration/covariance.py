"""Errors of a rig's calibration: their covariance, their effect on intersected points, and the part that several drives share.

The least-squares point moves by dX = -(A^T A)^-1 A^T B dp, A and B being the derivatives of the collinearity equations by point
and calibration (implicit function theorem on the normal equations; e.g. Mikhail & Ackermann 1976, ch. 4). These errors are common
to all images of a rig: the Jacobians of all sightings of a cone are averaged, never their covariances.

The error of a calibration is L z: z are independent errors of one sigma each, L L^T is the stated covariance. It moves a position
by A z with the shared-error Jacobian A = J L (metres), J from `calibration_jacobian`. Two positions with Jacobians A and B have
the cross-covariance A B^T, whichever drives they are from. L is the symmetric square root of the correlations times the sigmas,
which does not depend on the order of parameters. Stored as float32 (`SharedErrorJacobian`): 3 x K numbers for every version of a
cone.

Covariance from a board (`rig_covariance`): least squares assumes independent corner errors, but motion blur, light, a bent board
and the detector move all corners of an image together. Each pair is a cluster: the influence of its residuals is compared with
that of independent errors of the same variance, its leverage removed (cluster-robust "sandwich", Liang & Zeger 1986; correction
by Bell & McCaffrey 2002). The least-squares covariance is multiplied by the ratio of the two sums over all pairs and directions,
the design effect (Kish 1965), shrunk towards 1 by the amount that chance explains.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import NamedTuple
from uuid import UUID

import numpy as np
from numpy.typing import ArrayLike

from conetl.geometry import rig as rigs
from conetl.geometry.calibration.stereo_bundle import BundleError, Reduced
from conetl.geometry.camera import project_with_jacobian
from conetl.geometry.packing import as_rows
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.arrays import Floats
from conetl.model.base import SharedErrorJacobian
from conetl.model.rig import INTERIOR, RELATIVE, CalibrationCovariance, Rig, SharedErrors

_WIRE = ">f4"
#: Decimals of the relative pose in metres and of its rotation: it is worked out from two poses, which rounding may change.
_DECIMALS = 9


def known_covariance(rig: Rig) -> CalibrationCovariance | None:
    """Covariance of the calibration of the cameras that took the images (the raw rig, if there is one); None if unknown."""
    return (rig.rectified_from or rig).calibration_covariance


def calibration_jacobian(points_left_m: ArrayLike, rig: Rig) -> Floats:
    """Derivative (P, 3, K) of two-view points (P, 3) in the rig's left camera frame with respect to the calibration.

    K parameters in the order of `known_covariance(rig).names`; K = 0 without a covariance. Equal weights for all four
    image coordinates. Points behind a camera give NaN. Raises ValueError for an unknown name.
    """
    points = np.asarray(points_left_m, dtype=np.float64).reshape(-1, 3)
    covariance = known_covariance(rig)
    if covariance is None:
        return np.zeros((len(points), 3, 0))
    taken = rig.rectified_from or rig
    taken_R_own = rigs.body_SE3_camera(taken, "left")[:3, :3].T @ rigs.body_SE3_camera(rig, "left")[:3, :3]
    in_left = points @ taken_R_own.T  # rectification turns a camera about its own centre
    relative = rigs.left_SE3_right(taken)
    rotation, shift = relative[:3, :3], relative[:3, 3]
    in_right = (in_left - shift) @ rotation
    left = project_with_jacobian(taken.left, in_left)
    right = project_with_jacobian(taken.right, in_right)
    by_point = np.concatenate([left.by_point, right.by_point @ rotation.T], axis=1)
    # (R exp(r), t + dt): the point in the right camera changes by x_right x r - R^T dt
    by_relative = np.concatenate(
        [right.by_point @ cross_matrix(in_right), -(right.by_point @ rotation.T)], axis=2
    )  # fmt: skip
    columns = np.stack(
        [_column(name, left.by_interior, right.by_interior, by_relative) for name in covariance.names], 2
    )
    normal = np.swapaxes(by_point, 1, 2) @ by_point
    moved = -np.linalg.solve(normal, np.swapaxes(by_point, 1, 2) @ columns)
    return np.asarray(taken_R_own.T @ moved)


def calibration_cov(points_left_m: ArrayLike, rig: Rig) -> Floats:
    """Covariance (P, 3, 3) in m^2 of two-view points (P, 3) in the left camera's frame from the calibration alone.

    Zero for a calibration without a covariance, which counts as exact.
    """
    return shared_cov(calibration_jacobian(points_left_m, rig), rig)


def shared_cov(jacobians: ArrayLike, rig: Rig) -> Floats:
    """Covariance (..., 3, 3) of Jacobians (..., 3, K) of `calibration_jacobian`, summed with weights or turned as needed."""
    j = np.asarray(jacobians, dtype=np.float64)
    covariance = known_covariance(rig)
    if covariance is None:
        return np.zeros((*j.shape[:-1], 3))
    cov: Floats = j @ np.array(covariance.matrix) @ np.swapaxes(j, -1, -2)
    return (cov + np.swapaxes(cov, -1, -2)) / 2


def _column(name: str, left: Floats, right: Floats, relative: Floats) -> Floats:
    """(P, 4) derivative of u_left, v_left, u_right, v_right with respect to one named parameter."""
    column = np.zeros((len(left), 4))
    part, _, field = name.partition(".")
    if part == "relative" and field in RELATIVE:
        column[:, 2:] = relative[:, :, RELATIVE.index(field)]
        return column
    interior, rows = (left, slice(0, 2)) if part == "left" else (right, slice(2, 4))
    if part in ("left", "right") and field in INTERIOR:
        column[:, rows] = interior[:, :, INTERIOR.index(field)]
        return column
    number = field.removeprefix("lens.")
    if part in ("left", "right") and field != number and number.isdigit() and 4 + int(number) < interior.shape[2]:
        column[:, rows] = interior[:, :, 4 + int(number)]
        return column
    raise ValueError(f"'{name}' is not a parameter of this rig's calibration")


def calibration_id(rig: Rig) -> UUID:
    """Id of a calibration: equal for rigs with exactly the same cameras, relative pose and covariance. Names of rigs and their
    pose on the body do not count."""
    taken = rig.rectified_from or rig
    covariance = known_covariance(rig)
    content = [
        taken.left.model_dump(mode="json", exclude={"shutter"}),
        taken.right.model_dump(mode="json", exclude={"shutter"}),
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


def square_root(covariance: ArrayLike) -> Floats:
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


def jacobian_of(jacobian: Floats, rig: Rig, others: Sequence[tuple[UUID, Floats]] = ()) -> SharedErrorJacobian | None:
    """Shared-error Jacobian of a position from its derivative (3, N) with respect to the parameters of `known_covariance`, if
    any.

    others: ids and Jacobians (3, K) of errors that drives share besides the calibration.
    """
    shared, parts = shared_errors(rig), dict(others)
    if shared is not None:
        parts[shared.calibration] = jacobian @ np.array(shared.matrix)
    moved_m = np.zeros((1, len(parts), 3, max((part.shape[1] for part in parts.values()), default=0)))
    for k, key in enumerate(sorted(parts)):
        moved_m[0, k, :, : parts[key].shape[1]] = parts[key]
    [shared_jacobian] = pack_jacobians(tuple(sorted(parts)), moved_m)
    return shared_jacobian


def pack_jacobians(
    calibrations: tuple[UUID, ...], moved_m: Floats, *, most: int | None = None
) -> list[SharedErrorJacobian | None]:
    """(N, C, 3, K) metres -> N records, rounded for storage; None for empty ones.

    calibrations: C ids, ascending. most: keep at most this many, those with the largest effect.
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


def unpack_jacobians(
    calibrations: tuple[UUID, ...], shared_jacobian: Sequence[SharedErrorJacobian | None], width: int = 0
) -> Floats:
    """N records (all None, or all with the same calibrations) -> (N, C, 3, K) metres.

    calibrations: the C ids of the result, a superset of theirs; missing ones are 0. width: least K; missing errors are 0.
    """
    first = next((one for one in shared_jacobian if one is not None), None)
    if first is None:
        return np.zeros((len(shared_jacobian), len(calibrations), 3, width))
    moved_m = np.frombuffer(b"".join(one.moved_m for one in shared_jacobian if one is not None), _WIRE)
    moved_m = moved_m.reshape(len(shared_jacobian), len(first.calibrations), 3, -1)
    errors = moved_m.shape[3]
    result = np.zeros((len(shared_jacobian), len(calibrations), 3, max(errors, width)))
    result[:, [calibrations.index(one) for one in first.calibrations], :, :errors] = moved_m
    return result


def with_covariance(rig: Rig, covariance: CalibrationCovariance | None) -> Rig:
    """The rig with another covariance of the calibration that took the images (`known_covariance`); None: unknown."""
    if rig.rectified_from is None:
        return rig.model_copy(update={"calibration_covariance": covariance})
    taken = rig.rectified_from.model_copy(update={"calibration_covariance": covariance})
    return rig.model_copy(update={"rectified_from": taken})


class RigCovariance(NamedTuple):
    """matrix (k, k) of the rig's unknowns.

    design_effect: mean ratio of their variances to those of independent corner errors.
    """

    matrix: Floats
    design_effect: float


def rig_covariance(reduced: Reduced, rig_parameters: int, variance_factor: float) -> RigCovariance:
    """Covariance of the first `rig_parameters` unknowns, from the linearised system at the solution.

    variance_factor: a-posteriori variance of one image coordinate, px^2. Raises BundleError where the images do not determine
    the unknowns.
    """
    normal = reduced.normal
    diagonal = np.diag(normal)
    if not np.all(diagonal > 0):
        raise BundleError("the images do not determine the calibration: an unknown has no influence on any corner")
    scale = 1.0 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    if not values[0] > 1e-13 * values[-1]:
        raise BundleError("the images do not determine the calibration: singular normal equations")
    half = (scale[:, None] * vectors) / np.sqrt(values)  # half half^T = normal^-1
    back = half[:rig_parameters]
    least_squares = variance_factor * back @ back.T
    # The part of the prior is kept as it is; the design effect applies to the part of the pairs.
    known = variance_factor * back @ (half.T @ reduced.prior @ half) @ back.T
    sizes = np.sqrt(np.diag(least_squares))
    root = np.linalg.cholesky((least_squares - known) / sizes[:, None] / sizes)
    white = np.linalg.solve(
        root, back / sizes[:, None]
    )  # from whitened unknowns to those of the rig, themselves whitened
    found = expected = scatter = 0.0
    for share, gradient in zip(reduced.normals, reduced.gradients, strict=True):
        leverage = half.T @ share @ half
        pull = variance_factor * white @ (leverage - leverage @ leverage) @ white.T  # its covariance if independent
        found += float(((white @ (half.T @ gradient)) ** 2).sum())
        expected += float(np.trace(pull))
        scatter += 2.0 * float((pull**2).sum())  # variance of a sum of squares of normal variables
    if not expected > 0:
        raise BundleError("there are too few pairs to estimate their scatter")
    excess = found / expected - 1.0
    effect = 1.0 + excess * excess**2 / (excess**2 + scatter / expected**2)
    return RigCovariance(effect * (least_squares - known) + known, effect)


def change_over_pairs(reduced: Reduced, rig_parameters: int, variance_factor: float) -> float:
    """How far the first `rig_parameters` unknowns differ between earlier and later pairs: about 1 if they are constant.

    The pairs are divided after a quarter, half and three quarters of them. Each part has its own solution (one linear step) and
    covariance (`rig_covariance`); the result is the largest chi-square of a difference per degree of freedom, 0 if no division
    leaves two parts that determine the unknowns.
    """
    count, largest = len(reduced.normals), 0.0
    for first in (count // 4, count // 2, count - count // 4):
        try:
            before, after = (
                _solution_of(reduced, part, rig_parameters, variance_factor)
                for part in (slice(first), slice(first, count))
            )
        except BundleError:
            continue
        difference, cov = before[0] - after[0], before[1] + after[1]
        scale = 1.0 / np.sqrt(np.diag(cov))  # units differ by many powers of ten
        chi_square = scale * difference @ np.linalg.solve(cov * np.outer(scale, scale), scale * difference)
        largest = max(largest, float(chi_square) / rig_parameters)
    return largest


def _solution_of(reduced: Reduced, part: slice, rig_parameters: int, variance_factor: float) -> tuple[Floats, Floats]:
    """Step (k,) of the rig's unknowns to the solution of some pairs, and its covariance (k, k). Raises BundleError."""
    own = Reduced(reduced.normals[part], reduced.gradients[part], reduced.prior)
    try:
        step = np.linalg.solve(own.normal, own.gradients.sum(axis=0))
        solved = own._replace(gradients=own.gradients - own.normals @ step)
        return step[:rig_parameters], rig_covariance(solved, rig_parameters, variance_factor).matrix
    except np.linalg.LinAlgError as error:
        raise BundleError(f"the pairs do not determine the calibration: {error}") from error
