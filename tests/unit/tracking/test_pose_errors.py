"""Errors of poses over time: split into what stays and what changes, and how they move points together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.geometry.motion.chain_solver import cross_covariance
from conetl.model.params import TrajectoryParams
from conetl.tracking.pose_errors import constant_and_change, moved_cov, pose_cov
from conetl.tracking.trajectory import log_errors, refine_trajectory
from tests.synthetic.odometry import log_of, motions_of, true_poses
from tests.synthetic.world import make_path, make_rig

PARAMS = TrajectoryParams()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 8))
def test_the_two_parts_add_up_and_are_independent(seed: int, count: int) -> None:
    root = np.random.default_rng(seed).normal(size=(6 * count, 6 * count + 4))
    cov = root @ root.T
    constant, change = constant_and_change(cov)
    alike = np.tile(np.eye(6), (count, 1))
    assert np.allclose(alike @ constant @ alike.T + change, cov)
    assert np.linalg.eigvalsh(change).min() > -1e-6 * np.trace(cov)
    assert np.linalg.eigvalsh(constant).min() > 0
    # What the best estimate of a constant leaves over tells nothing of it.
    assert np.allclose(np.linalg.solve(cov, alike).T @ change, 0, atol=1e-6)


def test_an_error_that_stays_does_not_change() -> None:
    """All poses off by the same, but for a thousandth."""
    cov = np.tile(np.diag([4.0, 4.0, 9.0, 0.1, 0.1, 0.2]), (7, 7)) + 4e-6 * np.eye(42)
    constant, change = constant_and_change(cov)
    assert np.diag(constant) == pytest.approx([4.0, 4.0, 9.0, 0.1, 0.1, 0.2], rel=1e-4)
    assert np.diag(change) == pytest.approx(4e-6, rel=0.2)


def test_what_has_no_error_has_none_in_either_part() -> None:
    """As a log without errors of attitude states it."""
    cov = np.tile(np.diag([4e-4, 4e-4, 9e-4, 0.0, 0.0, 0.0]), (5, 5)) + np.kron(
        np.eye(5), np.diag([1e-4] * 3 + [0.0] * 3)
    )
    constant, change = constant_and_change(cov)
    assert np.diag(constant) == pytest.approx([4.2e-4, 4.2e-4, 9.2e-4, 0.0, 0.0, 0.0], rel=1e-6, abs=1e-15)
    assert np.abs(change.reshape(5, 6, 5, 6)[:, 3:]).max() < 1e-15


def test_of_a_refined_drive_it_is_that_of_the_adjustment() -> None:
    """Frame indices in, joint covariance out; its diagonal is what the poses state."""
    rng, rig = np.random.default_rng(3), make_rig()
    truth = true_poses(30)
    result = refine_trajectory(log_of(truth, rng, 0.4, 9e-4, PARAMS), rig, motions_of(truth, rig, rng, PARAMS), PARAMS)
    assert result.covariance is not None
    frames = [pair.frame_index for pair in result.frame_pairs]
    cov = pose_cov(result, PARAMS)([frames[2], frames[9], frames[20]])
    for at, k in enumerate((2, 9, 20)):
        pose = result.frame_pairs[k].pose
        stated = np.square([*pose.sigma_enu_m, *pose.sigma_rpy_rad])
        assert np.diag(cov)[6 * at : 6 * at + 6] == pytest.approx(stated, rel=1e-6)
    assert np.allclose(cov[:6, 12:], cross_covariance(result.covariance, 2, 20)[:6, :6])


def test_of_a_log_it_is_that_of_its_gauss_markov_processes() -> None:
    pairs = make_path(12, sigma_m=0.02)
    logged = refine_trajectory(pairs, make_rig(), [], PARAMS)
    frames = [pair.frame_index for pair in pairs]
    cov = pose_cov(logged, PARAMS)(frames)
    assert np.array_equal(cov, log_errors(pairs, PARAMS))
    blocks = cov.reshape(12, 6, 12, 6)
    apart_s = (pairs[11].captured_at_ns - pairs[0].captured_at_ns) * 1e-9
    kept = (1 - PARAMS.gnss_white_share**2) * np.exp(-apart_s / PARAMS.gnss_correlation_s)
    assert blocks[0, 0, 11, 0] == pytest.approx(kept * 0.02**2)
    assert blocks[4, 0, 4, 0] == pytest.approx(0.02**2)
    assert blocks[4, 5, 4, 5] == pytest.approx(pairs[4].pose.sigma_rpy_rad[2] ** 2)
    assert np.count_nonzero(blocks[0, 0, 11]) == 1


def test_points_of_one_frame_move_together() -> None:
    """By the covariance of their poses, whichever frame each is of."""
    rng = np.random.default_rng(8)
    jacobian, rank = rng.normal(size=(5, 3, 6)), np.array([1, 0, 2, 1, 1])
    root = rng.normal(size=(18, 18))
    cov = root @ root.T
    moved = moved_cov(jacobian, rank, cov).reshape(5, 3, 5, 3)
    for a in range(5):
        for b in range(5):
            block = cov[6 * rank[a] : 6 * rank[a] + 6, 6 * rank[b] : 6 * rank[b] + 6]
            assert np.allclose(moved[a, :, b], jacobian[a] @ block @ jacobian[b].T)
