"""Blunders in image points: found, named and taken out; never laid on the wrong view; no more false alarms than promised."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry.intersection import IntersectionStatus, intersect
from conetl.geometry.lens import distort
from conetl.geometry.robust_intersection import intersect_robust
from conetl.records import Lens

Array = NDArray[np.float64]
K = np.array([721.5, 720.0, 609.6, 172.9])
SIGMA_PX = 0.4


def scene(views: int, count: int, seed: int = 3, lens: Lens | None = None) -> tuple[dict[str, Array], Array, Array]:
    """Cameras all round (arguments of `intersect`), points (P, 3) and noisy image points (P, V, 2)."""
    rng = np.random.default_rng(seed)
    rot = se3.rotation_from_rpy(*rng.uniform(-0.15, 0.15, (3, views)))
    centre = rng.uniform(-1, 1, (views, 3)) * [3.0, 1.5, 1.0]
    truth = rng.uniform([-3, -1, 7], [3, 2, 16], (count, 3))
    local = np.einsum("vij,pvi->pvj", rot, truth[:, None] - centre[None])
    xy = local[..., :2] / local[..., 2:]
    uv = K[:2] * (xy if lens is None else distort(lens, xy)) + K[2:]
    cameras = {"k_px": np.tile(K, (views, 1)), "map_R_cam": rot, "centre_m": centre}
    return cameras, truth, uv + rng.normal(scale=SIGMA_PX, size=uv.shape)


def nees(found: Array, truth: Array, cov: Array) -> Array:
    off = found - truth
    return np.asarray(np.einsum("pi,pi->p", off, np.linalg.solve(cov, off[..., None])[..., 0]))


@pytest.mark.parametrize("lens", [None, Lens(model="brown", coefficients=(-0.2, 0.05, 1e-3, -5e-4, 0.0))])
@pytest.mark.parametrize(("views", "wrong"), [(5, 1), (8, 3)])
def test_blunders_are_named_and_the_rest_is_as_if_they_had_not_been(views: int, wrong: int, lens: Lens | None) -> None:
    cameras, truth, uv = scene(views, 60, lens=lens)
    lenses = None if lens is None else [lens] * views
    rng = np.random.default_rng(1)
    planted = np.zeros(uv.shape[:2], dtype=bool)
    shift = np.zeros_like(uv)
    for point in range(0, 60, 2):
        chosen = rng.choice(views, wrong, replace=False)
        planted[point, chosen] = True
        angle = rng.uniform(0, 2 * np.pi, wrong)
        shift[point, chosen] = rng.uniform(30, 300, (wrong, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    robust = intersect_robust(uv + shift, None, **cameras, sigma_uv_px=SIGMA_PX, lenses=lenses)
    assert robust.result.ok.sum() >= 58
    good = robust.result.ok
    assert not (robust.used & planted)[good].any()
    assert np.count_nonzero(~robust.used & ~planted) <= 4
    clean = intersect(uv, robust.used, **cameras, sigma_uv_px=SIGMA_PX, lenses=lenses)
    np.testing.assert_allclose(robust.result.xyz_m[good], clean.xyz_m[good], atol=1e-8)
    assert 2.3 < nees(robust.result.xyz_m, truth, robust.result.cov_m2)[good].mean() < 3.8
    for blunder in robust.blunders:
        if planted[blunder.point, blunder.view]:
            assert max(map(abs, blunder.normalised_residual)) > blunder.test_value
            np.testing.assert_allclose(blunder.residual_px, shift[blunder.point, blunder.view], atol=12)


def test_without_blunders_the_false_alarms_are_those_of_the_significance() -> None:
    cameras, _, uv = scene(4, 4000)
    robust = intersect_robust(uv, None, **cameras, sigma_uv_px=SIGMA_PX, significance=0.001)
    plain = intersect(uv, None, **cameras, sigma_uv_px=SIGMA_PX)
    alarms = np.count_nonzero((robust.used != plain.ok[:, None]).any(axis=1) | (robust.result.status != plain.status))
    assert (
        4000 * 8 * 0.001 * 0.5 < alarms < 4000 * 8 * 0.001 * 1.3
    )  # correlated tests: a little less than eight a point
    same = robust.used.all(axis=1) & plain.ok
    np.testing.assert_array_equal(robust.result.xyz_m[same], plain.xyz_m[same])


def test_the_normalised_residual_is_the_one_of_least_squares_with_the_view_left_out() -> None:
    """Residual and spread of the report against an intersection without the view, written out."""
    cameras, _, uv = scene(6, 1)
    uv[0, 2] += [40.0, -25.0]
    (blunder,) = intersect_robust(uv, None, **cameras, sigma_uv_px=SIGMA_PX).blunders
    assert blunder.view == 2
    valid = np.ones((1, 6), dtype=bool)
    valid[0, 2] = False
    alone = intersect(uv, valid, **cameras, sigma_uv_px=SIGMA_PX)

    def image(x: Array) -> Array:
        local = (x - cameras["centre_m"][2]) @ cameras["map_R_cam"][2]
        return np.asarray(K[:2] * local[:2] / local[2] + K[2:])

    x = alone.xyz_m[0]
    jacobian = np.stack([(image(x + d) - image(x - d)) / 2e-5 for d in 1e-5 * np.eye(3)], axis=1)
    spread = np.sqrt(SIGMA_PX**2 + np.diag(jacobian @ alone.cov_m2[0] @ jacobian.T))
    np.testing.assert_allclose(blunder.residual_px, uv[0, 2] - image(x), rtol=1e-6)
    np.testing.assert_allclose(blunder.normalised_residual, (uv[0, 2] - image(x)) / spread, rtol=1e-5)
    np.testing.assert_allclose(blunder.detectable_px, 4.13 * spread, rtol=2e-3)  # Baarda's delta_0


def test_two_rays_that_miss_each_other_are_refused() -> None:
    cameras, _, uv = scene(2, 20)
    plain = intersect(uv, None, **cameras, sigma_uv_px=SIGMA_PX)
    uv[3, 1, 1] += 60.0
    robust = intersect_robust(uv, None, **cameras, sigma_uv_px=SIGMA_PX)
    assert robust.result.status[3] == IntersectionStatus.BLUNDER_NOT_LOCATED
    assert np.isnan(robust.result.xyz_m[3]).all()
    assert np.isnan(robust.result.cov_m2[3]).all()
    assert not robust.blunders
    others = np.delete(np.arange(20), 3)
    np.testing.assert_array_equal(robust.result.status[others], plain.status[others])


def test_three_cameras_in_a_row_cannot_tell_which_column_is_wrong() -> None:
    """Along the baseline any two of three agree on a point; across it the blunder shows."""
    cameras = {
        "k_px": np.tile(K, (3, 1)), "map_R_cam": np.tile(np.eye(3), (3, 1, 1)),
        "centre_m": np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    }  # fmt: skip
    point = np.array([0.4, 1.0, 9.0])
    uv = K[:2] * (point - cameras["centre_m"])[:, :2] / 9.0 + K[2:]
    along, across = uv.copy(), uv.copy()
    along[1, 0] += 15.0
    across[1] += [15.0, 15.0]
    robust = intersect_robust(np.stack([uv, along, across]), None, **cameras, sigma_uv_px=SIGMA_PX)
    assert robust.result.status.tolist() == [0, IntersectionStatus.BLUNDER_NOT_LOCATED, 0]
    assert [(b.point, b.view) for b in robust.blunders] == [(2, 1)]
    np.testing.assert_allclose(robust.result.xyz_m[2], point, atol=1e-6)


def test_points_with_different_views_and_many_of_them() -> None:
    """More pairs than are tried, and points that only a few of the cameras saw."""
    cameras, truth, uv = scene(14, 40)
    rng = np.random.default_rng(6)
    valid = rng.random((40, 14)) < 0.5
    valid[:, :4] = True
    planted = np.zeros_like(valid)
    planted[:, 1] = True
    uv[:, 1] += [-80.0, 45.0]
    uv[~valid] = np.nan
    robust = intersect_robust(uv, valid, **cameras, sigma_uv_px=SIGMA_PX)
    assert robust.result.ok.mean() > 0.95
    assert not (robust.used & (planted | ~valid))[robust.result.ok].any()
    assert nees(robust.result.xyz_m, truth, robust.result.cov_m2)[robust.result.ok].mean() < 4.0
    assert {b.view for b in robust.blunders} >= {1}


def test_two_camps_of_equal_size_are_no_answer() -> None:
    cameras, truth, uv = scene(6, 1)
    local = np.einsum("vij,vi->vj", cameras["map_R_cam"], truth[0] + [1.0, 0.5, 2.0] - cameras["centre_m"])
    other = K[:2] * local[:, :2] / local[:, 2:] + K[2:]
    uv[0, 3:] = other[3:]
    robust = intersect_robust(uv, None, **cameras, sigma_uv_px=SIGMA_PX)
    assert robust.result.status[0] == IntersectionStatus.BLUNDER_NOT_LOCATED
    assert not robust.blunders
    with pytest.raises(ValueError, match="significance"):
        intersect_robust(uv, None, **cameras, sigma_uv_px=SIGMA_PX, significance=0.0)
