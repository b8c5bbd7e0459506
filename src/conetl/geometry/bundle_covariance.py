"""Covariance of a rig's calibration that stays honest where the corner errors of one pair belong together.

Least squares takes all corner errors as independent. They are not: motion blur, light, a bent board and the detector move the
corners of one picture together, and the covariance scaled by the variance factor alone comes out too small. Here each pair
is one cluster: its influence on the result is compared with what independent errors would have done (cluster-robust
"sandwich" covariance, Liang & Zeger 1986, with the leverage correction CR2 of Bell & McCaffrey 2002). A few dozen pairs
determine a matrix of 20 and more unknowns only roughly; it is therefore shrunk towards the least-squares covariance by the
share that its own scatter calls for (Ledoit & Wolf 2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.stereo_bundle import BundleError, Reduced

Array = NDArray[np.float64]

_LARGEST_LEVERAGE = 1.0 - 1e-6


@dataclass(frozen=True)
class RigCovariance:
    """matrix (k, k) of the rig's unknowns. least_squares (k, k): as if all corner errors were independent.

    design_effect: mean ratio of the two variances, 1 for independent errors. shrinkage: share of the least-squares shape in
    `matrix`, from 0 to 1.
    """

    matrix: Array
    least_squares: Array
    design_effect: float
    shrinkage: float


def rig_covariance(reduced: Reduced, rig_parameters: int, variance_factor: float) -> RigCovariance:
    """Covariance of the first `rig_parameters` unknowns, from the linearised system at the solution.

    variance_factor: a-posteriori variance of one image coordinate, px^2. Raises BundleError where the pictures do not determine
    the unknowns.
    """
    normal = reduced.normal
    diagonal = np.diag(normal)
    if not np.all(diagonal > 0):
        raise BundleError("the pictures do not determine the calibration: an unknown has no influence on any corner")
    scale = 1.0 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale)
    if not values[0] > 1e-13 * values[-1]:
        raise BundleError("the pictures do not determine the calibration: singular normal equations")
    half = (scale[:, None] * vectors) / np.sqrt(values)  # half half^T = normal^-1
    back = half[:rig_parameters]
    least_squares = variance_factor * back @ back.T
    # What is known of the board beforehand has its part in the covariance as it is; the pairs' part is what they tell about.
    known = variance_factor * back @ (half.T @ reduced.prior @ half) @ back.T
    sizes = np.sqrt(np.diag(least_squares))
    root = np.linalg.cholesky((least_squares - known) / sizes[:, None] / sizes)
    influences = []
    for share, gradient in zip(reduced.normals, reduced.gradients, strict=True):
        leverage, axes = np.linalg.eigh(half.T @ share @ half)
        corrected = axes @ ((axes.T @ (half.T @ gradient)) / np.sqrt(1.0 - np.clip(leverage, 0.0, _LARGEST_LEVERAGE)))
        influences.append(back @ corrected)
    # (p, k): the outer products sum to the identity where errors are independent
    whitened = np.asarray(np.linalg.solve(root, (np.array(influences) / sizes).T).T, dtype=np.float64)
    shape, effect, shrinkage = _shrunk(whitened)
    spread = sizes[:, None] * root
    full = spread @ shape @ spread.T + known
    return RigCovariance((full + full.T) / 2, least_squares, effect, shrinkage)


def _shrunk(samples: Array) -> tuple[Array, float, float]:
    """Ledoit & Wolf's estimate of the sum of outer products of (p, k) samples: matrix, its mean variance, share of the target."""
    count, size = samples.shape
    x = samples * np.sqrt(count)
    c = x.T @ x / count
    mean = float(np.trace(c)) / size
    distance = float(((c - mean * np.eye(size)) ** 2).sum()) / size
    scatter = float(np.mean([((np.outer(row, row) - c) ** 2).sum() for row in x])) / size / count
    share = 1.0 if distance <= 0 else min(1.0, scatter / distance)
    return share * mean * np.eye(size) + (1.0 - share) * c, mean, share
