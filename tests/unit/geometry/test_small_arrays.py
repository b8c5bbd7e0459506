"""Closed forms for small arrays against numpy's and SciPy's general ones."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from conetl.geometry.small_arrays import apply_steps, cross_matrix, inverse_of_symmetric, pose_distance


def test_inverses_are_those_of_linear_algebra() -> None:
    rng = np.random.default_rng(3)
    factors = rng.normal(size=(50, 3, 3))
    matrices = factors @ np.swapaxes(factors, 1, 2) + 0.1 * np.eye(3)
    found = inverse_of_symmetric(np.ascontiguousarray(matrices.transpose(1, 2, 0))).transpose(2, 0, 1)
    np.testing.assert_allclose(found, np.linalg.inv(matrices), rtol=1e-9, atol=1e-12)


def test_steps_turn_before_the_pose_and_move_its_place() -> None:
    rng = np.random.default_rng(4)
    steps = rng.normal(size=(40, 6)) * np.logspace(-12, 0.4, 40)[:, None]
    steps[0] = 0.0
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, :3, :3] = Rotation.random(40, random_state=5).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(40, 3))
    for pose, step, found in zip(poses, steps, apply_steps(poses, steps), strict=True):
        np.testing.assert_allclose(found[:3, :3], expm(cross_matrix(step[:3])) @ pose[:3, :3], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(found[:3, 3], pose[:3, 3] + step[3:])
        np.testing.assert_allclose(apply_steps(pose, step), found, rtol=0, atol=2e-14)


def test_how_far_poses_are_apart() -> None:
    step = np.array([0.0, 0.3, 0.0, 3.0, 0.0, 4.0])
    turn_rad, distance_m = pose_distance(apply_steps(np.eye(4)[None], step[None]), np.eye(4))
    np.testing.assert_allclose([turn_rad[0], distance_m[0]], [0.3, 5.0])
