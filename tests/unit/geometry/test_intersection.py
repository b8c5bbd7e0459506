"""Equation 1: against the truth, against other people's code, against Monte Carlo, and where it must refuse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares

from conetl.geometry import pose as se3
from conetl.geometry.camera import add_pose_covariance
from conetl.geometry.intersection import IntersectionStatus, intersect

Array = NDArray[np.float64]
K = np.array([721.5, 720.0, 609.6, 172.9])
BASE = np.array([[0.0, 0.0, 0.0], [0.54, 0.0, 0.0]])
STEREO = {"k_px": np.stack([K, K]), "map_R_cam": np.stack([np.eye(3)] * 2), "centre_m": BASE}
ORIGIN = np.array([457_808.0, 5_428_849.0, 112.0])


def project(points: Array, rot: Array, centre: Array, k: Array = K) -> Array:
    """Image points (P, V, 2) of points (P, 3) in cameras (V, 3, 3), (V, 3); written apart from the code under test."""
    local = np.einsum("vij,pvi->pvj", rot, points[:, None] - centre[None])
    return k[:2] * local[..., :2] / local[..., 2:] + k[2:]


def ring_of_cameras(rng: np.random.Generator, views: int, spread_m: float = 3.0) -> tuple[Array, Array]:
    """Cameras near the origin that look roughly along +z."""
    rot = se3.rotation_from_rpy(*rng.uniform(-0.15, 0.15, (3, views)))
    centre = rng.uniform(-1, 1, (views, 3)) * [spread_m, 0.5, 1.0]
    return rot, centre


def points_ahead(rng: np.random.Generator, count: int) -> Array:
    return rng.uniform([-4, -1, 5], [4, 2, 25], (count, 3))


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 7), st.integers(1, 9))
def test_projection_then_intersection_returns_the_point(seed: int, views: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    rot, centre = ring_of_cameras(rng, views)
    truth = points_ahead(rng, count)
    result = intersect(project(truth, rot, centre), np.tile(K, (views, 1)), rot, centre, 0.5, min_ray_angle_rad=1e-3)
    angle_known = result.status != IntersectionStatus.RAY_ANGLE_TOO_SMALL
    assert result.ok[angle_known].all()
    np.testing.assert_allclose(result.xyz_m[angle_known], truth[angle_known], atol=1e-6)
    assert np.nanmax(np.abs(result.residuals_px), initial=0) < 1e-6


def test_map_coordinates_cost_no_digits() -> None:
    truth = points_ahead(np.random.default_rng(2), 50)
    uv = project(truth, STEREO["map_R_cam"], BASE)
    near = intersect(uv, **STEREO, sigma_uv_px=0.5)
    far = intersect(uv, STEREO["k_px"], STEREO["map_R_cam"], BASE + ORIGIN, 0.5)
    np.testing.assert_allclose(far.xyz_m - ORIGIN, near.xyz_m, atol=2e-7)
    np.testing.assert_allclose(far.cov_m2, near.cov_m2, rtol=1e-6)


def noisy_case(views: int) -> tuple[Array, Array, Array, Array, Array]:
    rng = np.random.default_rng(7)
    rot, centre = ring_of_cameras(rng, views)
    truth = points_ahead(rng, 30)
    sigma = rng.uniform(0.2, 2.0, (30, views, 2))
    return project(truth, rot, centre) + sigma * rng.normal(size=sigma.shape), sigma, rot, centre, truth


@pytest.mark.parametrize("views", [2, 5])
def test_it_finds_the_optimum_that_scipy_finds(views: int) -> None:
    uv, sigma, rot, centre, truth = noisy_case(views)
    result = intersect(uv, np.tile(K, (views, 1)), rot, centre, sigma)
    assert result.ok.all()
    # The inverse normal matrix is the covariance; errors drawn for positions of two cameras are in `test_positions.py`.
    for i, start in enumerate(truth):
        exact = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
        best = least_squares(
            lambda x, i=i: ((project(x[None], rot, centre)[0] - uv[i]) / sigma[i]).ravel(), start, **exact
        )
        np.testing.assert_allclose(result.xyz_m[i], best.x, atol=1e-4 * math.sqrt(np.trace(result.cov_m2[i])) + 1e-7)
        np.testing.assert_allclose(result.cov_m2[i], np.linalg.inv(best.jac.T @ best.jac), rtol=2e-3, atol=1e-9)
        np.testing.assert_allclose(result.residuals_px[i].ravel(), -(best.fun * sigma[i].ravel()), atol=1e-4)


def test_pose_covariance_is_added_to_that_of_the_image() -> None:
    image = np.diag([0.01, 0.04, 0.02])[None]
    total = add_pose_covariance(image, np.ones((1, 3)), np.eye(3), np.zeros(3), np.array([0.3, 0.3, 0.5]), np.zeros(3))
    np.testing.assert_allclose(total[0], image[0] + np.diag([0.09, 0.09, 0.25]))
    with pytest.raises(ValueError, match="straight up or down"):
        add_pose_covariance(
            image, np.ones((1, 3)), se3.rotation_from_rpy(0, math.pi / 2, 0), np.zeros(3), np.ones(3), np.ones(3)
        )


def test_cameras_per_point_give_what_shared_cameras_give() -> None:
    rng = np.random.default_rng(4)
    truth = points_ahead(rng, 9000)
    uv = project(truth, STEREO["map_R_cam"], BASE) + rng.normal(scale=0.3, size=(9000, 2, 2))
    shared = intersect(uv, **STEREO, sigma_uv_px=0.3)
    each = intersect(
        uv, np.broadcast_to(STEREO["k_px"], (9000, 2, 4)), np.broadcast_to(np.eye(3), (9000, 2, 3, 3)),
        np.broadcast_to(BASE, (9000, 2, 3)), np.full((9000, 2, 2), 0.3),
    )  # fmt: skip
    np.testing.assert_array_equal(shared.status, each.status)
    np.testing.assert_allclose(shared.xyz_m, each.xyz_m, atol=1e-9, equal_nan=True)
    np.testing.assert_allclose(shared.cov_m2, each.cov_m2, rtol=1e-9, equal_nan=True)


def test_a_result_does_not_depend_on_its_neighbours_in_the_batch() -> None:
    rng = np.random.default_rng(8)
    truth = points_ahead(rng, 500)
    uv = project(truth, STEREO["map_R_cam"], BASE) + rng.normal(scale=0.5, size=(500, 2, 2))
    together = intersect(uv, **STEREO, sigma_uv_px=0.5)
    assert len(set(together.iterations.tolist())) > 1
    for i in range(0, 500, 50):
        alone = intersect(uv[i : i + 1], **STEREO, sigma_uv_px=0.5)
        np.testing.assert_array_equal(together.xyz_m[i], alone.xyz_m[0])
        assert together.iterations[i] == alone.iterations[0]


AHEAD = project(np.array([[0.0, 1.0, 10.0]]), STEREO["map_R_cam"], BASE)[0]


INVALID, NARROW = IntersectionStatus.INVALID_INPUT, IntersectionStatus.RAY_ANGLE_TOO_SMALL


@pytest.mark.parametrize(
    ("uv", "changes", "status"),
    [
        ([[600.0, 200.0], [600.0, 200.0]], {}, NARROW),  # parallel
        ([[600.0, 200.0], [600.3, 200.0]], {"centre_m": np.zeros((2, 3))}, NARROW),  # one camera twice
        ([[600.0, 200.0], [650.0, 200.0]], {}, IntersectionStatus.BEHIND_CAMERA),  # diverging
        (AHEAD, {"sigma_uv_px": 0.0}, INVALID),
        (AHEAD, {"sigma_uv_px": np.nan}, INVALID),
        (AHEAD, {"centre_m": np.array([[0.0, 0.0, 0.0], [np.inf, 0.0, 0.0]])}, INVALID),
        (AHEAD, {"k_px": np.stack([K, K * [-1, 1, 1, 1]])}, INVALID),
    ],
)
def test_rays_without_a_point_are_refused(uv: Array, changes: dict[str, object], status: IntersectionStatus) -> None:
    result = intersect(np.array(uv)[None], **(STEREO | {"sigma_uv_px": 0.5} | changes))  # type: ignore[arg-type]
    assert (result.status[0], result.ok[0]) == (status, False)
    for rows in (result.xyz_m, result.cov_m2, result.residuals_px, result.depth_m):
        assert np.isnan(rows[0]).all(), "a refused point has no numbers"


def test_shapes_are_checked_at_the_border() -> None:
    with pytest.raises(ValueError, match="uv_px"):
        intersect(np.zeros((3, 2)), **STEREO, sigma_uv_px=1)
    with pytest.raises(ValueError, match="centre_m"):
        intersect(np.zeros((3, 2, 2)), STEREO["k_px"], STEREO["map_R_cam"], np.zeros((3, 3)), 1)
    assert intersect(np.zeros((0, 2, 2)), **STEREO, sigma_uv_px=1).xyz_m.shape == (0, 3)
