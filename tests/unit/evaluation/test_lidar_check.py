from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from conetl.evaluation.lidar_check import LidarRange, LidarResidual, lidar_range, summarise
from conetl.model.rig import Camera
from conetl.readers.drives.velodyne import untwist
from conetl.tracking.matching.cone_outline import Outline

CAMERA = Camera(width_px=1242, height_px=375, fx_px=721.5, fy_px=721.5, cx_px=609.6, cy_px=172.9)
UP = np.array([0.0, -1.0, 0.0])
HEIGHT_M, FOOT_RADIUS_M, TIP_RADIUS_M, CAMERA_HEIGHT_M = 0.70, 0.14, 0.04, 1.65


def outline_of(x_m: float, z_m: float) -> Outline:
    """The outline in the left image of a cone at (x, z)."""
    scale = CAMERA.fx_px / z_m
    axis, foot = CAMERA.cx_px + scale * x_m, CAMERA.cy_px + scale * CAMERA_HEIGHT_M
    return Outline(
        tip_row=foot - scale * HEIGHT_M, foot_row=foot,
        left_top=axis - scale * TIP_RADIUS_M, right_top=axis + scale * TIP_RADIUS_M,
        left_foot=axis - scale * FOOT_RADIUS_M, right_foot=axis + scale * FOOT_RADIUS_M,
    )  # fmt: skip


def cone_points(x_m: float, z_m: float, rng: np.random.Generator, count: int = 30) -> NDArray[np.float64]:
    """Returns from the visible half of the cone, with 2 cm noise along the beam."""
    height = rng.uniform(0.03, 0.65, count)
    radius = FOOT_RADIUS_M + (TIP_RADIUS_M - FOOT_RADIUS_M) * height / HEIGHT_M
    angle = math.atan2(-x_m, -z_m) + np.arcsin(rng.uniform(-0.9, 0.9, count))
    points = np.stack([x_m + radius * np.sin(angle), CAMERA_HEIGHT_M - height, z_m + radius * np.cos(angle)], axis=1)
    beam = points / np.linalg.norm(points, axis=1, keepdims=True)
    return np.asarray(points + rng.normal(0, 0.02, (count, 1)) * beam)


def wall_points(z_m: float, rng: np.random.Generator, count: int = 3000) -> NDArray[np.float64]:
    return np.stack([rng.uniform(-6, 6, count), rng.uniform(-0.5, 1.6, count), np.full(count, z_m)], axis=1)


@settings(max_examples=40, deadline=None)
@given(x_m=st.floats(-4.0, 4.0), z_m=st.floats(5.0, 16.0), wall_m=st.floats(2.0, 10.0), seed=st.integers(0, 2**32 - 1))
def test_the_range_is_that_of_the_axis(x_m: float, z_m: float, wall_m: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    cone = cone_points(x_m, z_m, rng)
    # the cone hides the wall behind it
    far = wall_points(z_m + wall_m, rng)
    shadow = np.abs(far[:, 0] / far[:, 2] - x_m / z_m) < 0.16 / z_m
    found = lidar_range(np.vstack([cone, far[~shadow]]), outline_of(x_m, z_m), CAMERA, UP)
    assert found is not None
    assert abs(found.ground_range_m - math.hypot(x_m, z_m)) < 4 * found.sigma_m
    assert found.sigma_m < 0.04


def test_an_occluded_cone_has_no_range() -> None:
    rng = np.random.default_rng(1)
    post = np.stack([rng.uniform(0.0, 0.1, 20), rng.uniform(0.8, 1.4, 20), np.full(20, 7.0)], axis=1)
    assert lidar_range(np.vstack([cone_points(0.0, 10.0, rng), post]), outline_of(0.0, 10.0), CAMERA, UP) is None


def test_too_few_returns_give_no_range() -> None:
    rng = np.random.default_rng(1)
    assert lidar_range(cone_points(0.0, 10.0, rng, count=2), outline_of(0.0, 10.0), CAMERA, UP) is None
    assert lidar_range(np.zeros((0, 3)), outline_of(0.0, 10.0), CAMERA, UP) is None


@settings(max_examples=40, deadline=None)
@given(speed=st.floats(-10, 20), rate=st.floats(-0.5, 0.5), azimuth=st.floats(-1.2, 1.2), reach=st.floats(3, 30))
def test_untwisting_undoes_the_motion_during_a_turn(speed: float, rate: float, azimuth: float, reach: float) -> None:
    # a static point, relative to the scanner at the time of the beam
    later = azimuth / (2 * math.pi) * 0.1
    seen = np.array([[reach * math.cos(azimuth), reach * math.sin(azimuth), -1.0]])
    cos, sin = math.cos(rate * later), math.sin(rate * later)
    expected = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ seen[0] + [speed * later, 0.0, 0.0]
    assert untwist(seen, np.array([speed, 0.0, 0.0]), rate, 0.1)[0] == pytest.approx(expected)


def residual_of(range_m: float, residual_m: float) -> LidarResidual:
    lidar = LidarRange(range_m, 0.03, 20)
    return LidarResidual(0, 0, lidar.ground_range_m, lidar.sigma_m, range_m + residual_m, 0.04, 0.04, residual_m)


def test_the_summary_is_by_range_and_robust() -> None:
    residuals = [residual_of(9.0, 0.01 * k) for k in range(-5, 16)] + [residual_of(9.5, 40.0), residual_of(14.0, -0.2)]
    near, middle, far, _ = summarise(residuals)
    assert near.pairs == 0
    assert near.median_m is None
    assert middle.pairs == 22
    assert middle.median_m == pytest.approx(0.055)
    assert far.median_m == pytest.approx(-0.2)
    assert far.median_abs_m == pytest.approx(0.2)


def test_true_sigmas_give_a_ratio_of_one() -> None:
    rng = np.random.default_rng(0)
    _, band, *_ = summarise([residual_of(9.0, float(e)) for e in rng.normal(0, 0.05, 2000)])
    assert band.ratio_std == pytest.approx(1.0, abs=0.07)
    _, doubtful, *_ = summarise([residual_of(9.0, float(e)) for e in rng.normal(0, 0.10, 2000)])
    assert doubtful.ratio_std == pytest.approx(2.0, abs=0.14)
    assert band.within_2_sigmas == pytest.approx(0.954, abs=0.015)
    assert doubtful.within_2_sigmas == pytest.approx(0.683, abs=0.03)
    assert [band.pairs for band in summarise([])] == [0, 0, 0, 0]
