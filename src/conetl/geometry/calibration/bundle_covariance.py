"""Covariance of a rig's calibration for corner errors that are correlated within one pair.

Least squares assumes independent corner errors, but motion blur, light, a bent board and the detector move the corners of one
image together. Each pair is a cluster: the influence of its residuals is compared with that of independent errors of the same
variance, its leverage removed (cluster-robust "sandwich", Liang & Zeger 1986; correction by Bell & McCaffrey 2002). The
least-squares covariance is multiplied by the ratio of the two sums over all pairs and directions, the design effect (Kish 1965),
drawn towards 1 where it differs by no more than chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from conetl.geometry.calibration.stereo_bundle import BundleError, Reduced
from conetl.model.arrays import Floats


@dataclass(frozen=True)
class RigCovariance:
    """matrix (k, k) of the rig's unknowns. least_squares (k, k): as if all corner errors were independent.

    design_effect: mean ratio of the two variances, 1 for independent errors.
    """

    matrix: Floats
    least_squares: Floats
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
    return RigCovariance(effect * (least_squares - known) + known, least_squares, effect)
