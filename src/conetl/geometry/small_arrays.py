"""Arithmetic of small arrays that adjustments repeat in every iteration: cross products, inverses, steps of poses.

A step (w, d), in radians and metres, gives R = exp([w]x) R_before, t = t_before + d.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from conetl.model.arrays import Floats, Ints


def nearest_index(known: Floats | Ints, wanted: Floats | Ints) -> Ints:
    """(N,) index of the value in ascending `known` (K,), K > 0, nearest to each `wanted` (N,); of two equally near, the lower."""
    after = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(wanted - known[before]) <= np.abs(known[after] - wanted), before, after)


def robust_std(values: Floats) -> float:
    """Standard deviation of (n,) numbers, n > 0, by the median of their distances from the median, for a normal distribution."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def upper_median(values: NDArray[np.floating]) -> float:
    """The median of (n,) numbers, n > 0; of an even number the upper of the middle two. `np.median` takes 9 us longer."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def cross_matrix(vectors: ArrayLike) -> Floats:
    """(..., 3, 3) cross product matrices [v]x of vectors (..., 3)."""
    v = np.asarray(vectors, dtype=np.float64)
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return matrix


def inverse_of_symmetric(matrices: Floats) -> Floats:
    """Inverses of N symmetric matrices (3, 3, N), by their cofactors."""
    entries = matrices.reshape(9, -1)
    cofactors = entries.take((4, 0, 0, 2, 1, 1), 0) * entries.take((8, 8, 4, 5, 5, 2), 0)
    cofactors -= entries.take((5, 2, 1, 1, 2, 0), 0) * entries.take((5, 2, 1, 8, 4, 5), 0)
    cofactors /= entries[0] * cofactors[0] + entries[1] * cofactors[3] + entries[2] * cofactors[4]
    return cofactors.take((0, 3, 4, 3, 1, 5, 4, 5, 2), 0).reshape(matrices.shape)


def apply_steps(poses: Floats, steps: Floats) -> Floats:
    """Apply steps (..., 6) of (w, d) to poses (..., 4, 4)."""
    result = poses.copy()
    result[..., :3, :3] = Rotation.from_rotvec(steps[..., :3]).as_matrix() @ poses[..., :3, :3]
    result[..., :3, 3] += steps[..., 3:]
    return result


def pose_distance(poses: Floats, expected: Floats) -> tuple[Floats, Floats]:
    """Angle (rad) and distance (m) between poses (H, 4, 4) and an expected one."""
    trace = np.einsum("hij,ij->h", poses[:, :3, :3], expected[:3, :3])
    turn = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    return turn, np.linalg.norm(poses[:, :3, 3] - expected[:3, 3], axis=1)
