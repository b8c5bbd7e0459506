"""NEES of points with common errors: its distribution, its parts, and that it notices wrong sigmas."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.geometry.camera import add_pose_covariance, pose_jacobian
from conetl.geometry.consistency import Nees, ce90_m, consistency, le90_m, point_nees


def random_drive(seed: int, points: int = 9, common: int = 4) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    root = rng.normal(0, 0.05, (points, 3, 3))
    own = root @ np.swapaxes(root, 1, 2) + 1e-4 * np.eye(3)
    jacobian = rng.normal(0, 1, (points, 3, common))
    spread = rng.normal(0, 0.1, (common, common))
    return rng, own, jacobian, spread @ spread.T


def draw(rng: np.random.Generator, own: np.ndarray, jacobian: np.ndarray, cov: np.ndarray) -> np.ndarray:
    noise = np.linalg.cholesky(own) @ rng.normal(size=(len(own), 3, 1))
    return noise[..., 0] + jacobian @ rng.multivariate_normal(np.zeros(len(cov)), cov)


def whole(own: np.ndarray) -> np.ndarray:
    """(3N, 3N) of (N, 3, 3)."""
    full = np.zeros((3 * len(own), 3 * len(own)))
    for i, block in enumerate(own):
        full[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    return full


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_own_errors_may_hang_together(seed: int) -> None:
    """The sum is that of the full matrix."""
    rng, own, jacobian, cov = random_drive(seed)
    error = draw(rng, own, jacobian, cov)
    slide = rng.normal(0, 0.05, (error.size, 5))
    correlated = whole(own) + slide @ slide.T
    g = jacobian.reshape(error.size, -1)
    full = correlated + g @ cov @ g.T
    result = consistency(error, correlated, jacobian, cov)
    assert result.absolute.value == pytest.approx(error.ravel() @ np.linalg.solve(full, error.ravel()), rel=1e-6)
    assert (result.absolute.dof, result.relative.dof, result.common.dof) == (27, 23, 4)


def test_no_common_error_leaves_every_degree_of_freedom_to_the_points() -> None:
    rng, own, jacobian, _ = random_drive(5)
    error = draw(rng, own, jacobian, np.zeros((4, 4)))
    result = consistency(error, whole(own), jacobian, np.zeros((4, 4)))
    assert result.common.dof == 0
    assert result.relative.value == pytest.approx(point_nees(error, own).sum())
    with pytest.raises(ValueError, match="degrees of freedom"):
        _ = result.common.per_dof


def test_the_pose_jacobian_gives_the_pose_covariance() -> None:
    rng = np.random.default_rng(1)
    xyz, place = rng.normal(0, 10, (5, 3)), rng.normal(0, 1, (5, 3))
    rotation = np.linalg.qr(rng.normal(size=(5, 3, 3)))[0]
    rotation *= np.linalg.det(rotation)[:, None, None]
    sigma = np.array([0.02, 0.03, 0.05, 0.001, 0.002, 0.003])
    jacobian = pose_jacobian(xyz, rotation, place)
    cov = jacobian @ np.diag(sigma**2) @ np.swapaxes(jacobian, 1, 2)
    expected = add_pose_covariance(np.zeros((5, 3, 3)), xyz, rotation, place, sigma[:3], sigma[3:])
    np.testing.assert_allclose(cov, expected, atol=1e-12)


def test_ce90_and_le90_of_normal_errors() -> None:
    error = np.random.default_rng(0).normal(0, 0.1, (200_000, 3))
    assert ce90_m(error) == pytest.approx(0.1 * np.sqrt(2 * np.log(10)), rel=0.01)
    assert le90_m(error) == pytest.approx(0.1 * 1.6449, rel=0.01)


def test_the_band_is_the_chi_square_interval() -> None:
    low, high = Nees(0.0, 3).band()
    assert (low, high) == (pytest.approx(0.2158, abs=1e-4), pytest.approx(9.3484, abs=1e-4))
    with pytest.raises(ValueError, match="Jacobian"):
        consistency(np.zeros((2, 3)), np.eye(6), np.zeros((1, 3, 2)), np.eye(2))
