"""Intersection with lenses: the optimum in distorted pixels, as scipy finds it, and image points that no lens could have made."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from conetl.geometry import pose as se3
from conetl.geometry.camera import project as project_one
from conetl.geometry.intersection import IntersectionStatus, intersect
from conetl.model.records import Camera, Lens

Array = NDArray[np.float64]
LENSES = {
    "brown": Lens(model="brown", coefficients=(-0.28, 0.07, 1e-3, -8e-4, 0.0)),
    "radial": Lens(model="radial", coefficients=(-0.3, 0.09)),
    "rational": Lens(model="rational", coefficients=(0.5, 0.1, 1e-4, -2e-4, 0.01, 0.8, 0.2, 0.02)),
    "fisheye": Lens(model="fisheye", coefficients=(-0.02, 0.004, -0.001, 0.0)),
    "none": Lens(),
}


def camera(lens: Lens, fx_px: float = 700.0) -> Camera:
    return Camera(width_px=1280, height_px=960, fx_px=fx_px, fy_px=fx_px * 0.99, cx_px=641.0, cy_px=478.0, lens=lens)


def see(cameras: list[Camera], rot: Array, centre: Array, point: Array) -> Array:
    """Image points (V, 2), by the camera model alone."""
    return np.stack([project_one(c, (point - o) @ r) for c, r, o in zip(cameras, rot, centre, strict=True)])


def scene(models: list[str], count: int = 25) -> tuple[list[Camera], Array, Array, Array, Array, Array]:
    """Cameras, their rotations and centres, points, noisy image points (P, V, 2) and sigmas."""
    rng = np.random.default_rng(len(models))
    views = len(models)
    cameras = [camera(LENSES[m], 680.0 + 15.0 * i) for i, m in enumerate(models)]
    rot = se3.rotation_from_rpy(*rng.uniform(-0.08, 0.08, (3, views)))
    centre = np.column_stack([np.linspace(0, 0.6, views), rng.uniform(-0.05, 0.05, (views, 2))])
    points = rng.uniform([-2, -1, 4], [2, 1.5, 12], (count, 3))
    sigma = rng.uniform(0.2, 1.0, (count, views, 2))
    uv = np.stack([see(cameras, rot, centre, p) for p in points])
    return cameras, rot, centre, points, uv + sigma * rng.normal(size=uv.shape), sigma


def constants(cameras: list[Camera]) -> Array:
    return np.array([(c.fx_px, c.fy_px, c.cx_px, c.cy_px) for c in cameras])


@pytest.mark.parametrize(
    "models", [["brown", "brown"], ["radial", "none"], ["fisheye", "fisheye"], ["rational", "brown", "fisheye", "none"]]
)
def test_it_finds_the_optimum_in_distorted_pixels(models: list[str]) -> None:
    cameras, rot, centre, points, uv, sigma = scene(models)
    lenses = [c.lens for c in cameras]
    result = intersect(
        uv, None, constants(cameras), rot, centre, sigma, lenses=lenses, convergence_m2=1e-16, min_ray_angle_rad=1e-3
    )
    assert result.ok.all()
    exact = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    for i, start in enumerate(points):
        best = least_squares(lambda x, i=i: ((see(cameras, rot, centre, x) - uv[i]) / sigma[i]).ravel(), start, **exact)
        scale = math.sqrt(np.trace(result.cov_m2[i]))
        np.testing.assert_allclose(result.xyz_m[i], best.x, atol=1e-4 * scale + 1e-7)
        np.testing.assert_allclose(result.cov_m2[i], np.linalg.inv(best.jac.T @ best.jac), rtol=5e-3, atol=1e-9)
        np.testing.assert_allclose(result.residuals_px[i].ravel(), -best.fun * sigma[i].ravel(), atol=1e-4)


def test_views_of_one_point_may_be_missing() -> None:
    cameras, rot, centre, points, uv, sigma = scene(["brown", "fisheye", "none"])
    valid = np.ones(uv.shape[:2], dtype=bool)
    valid[::2, 1] = False
    uv[::2, 1] = np.nan
    lenses = [c.lens for c in cameras]
    together = intersect(uv, valid, constants(cameras), rot, centre, sigma, lenses=lenses)
    keep = [0, 2]
    alone = intersect(
        uv[::2][:, keep], None, constants(cameras)[keep], rot[keep], centre[keep], sigma[::2][:, keep],
        lenses=[lenses[0], lenses[2]],
    )  # fmt: skip
    assert together.ok.all()
    np.testing.assert_allclose(together.xyz_m[::2], alone.xyz_m, atol=1e-8)
    off = together.xyz_m - points
    assert np.einsum("pi,pi->p", off, np.linalg.solve(together.cov_m2, off[..., None])[..., 0]).max() < 20


def test_an_image_point_that_the_lens_cannot_make_is_invalid() -> None:
    cameras = [camera(Lens(model="radial", coefficients=(-0.3, 0.0)))] * 2
    rot, centre = np.stack([np.eye(3)] * 2), np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    good = see(cameras, rot, centre, np.array([0.3, 0.2, 6.0]))
    beyond = good.copy()
    beyond[0] = [641.0 + 700.0 * 0.9, 478.0]  # the lens folds back at 0.70 of the focal length
    result = intersect(
        np.stack([good, beyond]), None, constants(cameras), rot, centre, 0.3, lenses=[c.lens for c in cameras]
    )
    assert result.status.tolist() == [IntersectionStatus.OK, IntersectionStatus.INVALID_INPUT]
    assert np.isnan(result.xyz_m[1]).all()


def test_lenses_that_are_none_change_nothing_and_a_wrong_number_is_refused() -> None:
    cameras, rot, centre, _, uv, sigma = scene(["none", "none"])
    k = constants(cameras)
    plain = intersect(uv, None, k, rot, centre, sigma)
    np.testing.assert_array_equal(plain.xyz_m, intersect(uv, None, k, rot, centre, sigma, lenses=[Lens()] * 2).xyz_m)
    with pytest.raises(ValueError, match="one for each of the 2 views"):
        intersect(uv, None, k, rot, centre, sigma, lenses=[Lens()])
