"""Steps of poses against scipy's rotations."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry.pose_steps import all_stepped, apart, stepped


def test_steps_turn_before_the_pose_and_move_its_place() -> None:
    rng = np.random.default_rng(4)
    steps = rng.normal(size=(40, 6)) * np.logspace(-12, 0.4, 40)[:, None]
    steps[0] = 0.0
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, :3, :3] = Rotation.random(40, random_state=5).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(40, 3))
    expected = poses.copy()
    expected[:, :3, :3] = Rotation.from_rotvec(steps[:, :3]).as_matrix() @ poses[:, :3, :3]
    expected[:, :3, 3] += steps[:, 3:]
    np.testing.assert_allclose(all_stepped(poses, steps), expected, rtol=0, atol=2e-14)
    for pose, step, wanted in zip(poses, steps, expected, strict=True):
        np.testing.assert_allclose(stepped(pose, step), wanted, rtol=0, atol=2e-14)


def test_how_far_poses_are_apart() -> None:
    step = np.array([0.0, 0.3, 0.0, 3.0, 0.0, 4.0])
    turn_rad, distance_m = apart(all_stepped(np.eye(4)[None], step[None]), np.eye(4))
    np.testing.assert_allclose([turn_rad[0], distance_m[0]], [0.3, 5.0])
