from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.evaluation.lidar_check import fit_scene_bias, scene_samples
from conetl.geometry import pose as se3
from conetl.model.rig import Camera, Rig
from conetl.readers.rigs.common import rig_of
from tests import records

SIZE = (200, 600)
CAMERA = Camera(width_px=SIZE[1], height_px=SIZE[0], fx_px=400.0, fy_px=400.0, cx_px=300.0, cy_px=100.0)
BASE_M = 0.5


def make_rig() -> Rig:
    return rig_of("test", CAMERA, CAMERA, se3.se3(np.eye(3), [BASE_M, 0.0, 0.0]))


class Wall(NamedTuple):
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    points: NDArray[np.float64]


def wall(z_m: float, seed: int, error_px: float, error_across_px: float, noise: float = 1.0) -> Wall:
    """Both images of a wall, with an error of calibration of a + b x/z, and LiDAR points on it."""
    rng = np.random.default_rng(seed)
    left = cv2.GaussianBlur(rng.uniform(0, 255, SIZE).astype(np.float32), (0, 0), 1.5)
    left = (left - left.min()) / np.ptp(left) * 220 + 15
    v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]].astype(np.float32)
    # pixel u of the left image is seen at u - d(u) in the right one; solved for the left column of a right pixel
    source = u.copy()
    for _ in range(5):
        source = u + 400.0 * BASE_M / z_m + error_px + error_across_px * (source - 300.0) / 400.0
    right = cv2.remap(left, source.astype(np.float32), v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    images = [
        np.repeat(np.clip(p + rng.normal(0, noise, SIZE), 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
        for p in (left, right)
    ]
    x, y = rng.uniform(-0.6, 0.6, 800), rng.uniform(-0.2, 0.2, 800)
    return Wall(images[0], images[1], np.stack([x * z_m, y * z_m, np.full(800, z_m)], axis=1))


def test_errors_of_calibration_and_range_are_separated() -> None:
    rig = make_rig()
    offset_m = 0.08  # the LiDAR ranges are too short by this
    samples = []
    for seed, z_m in enumerate((5.0, 6.0, 8.0, 11.0, 15.0, 20.0)):
        left, right, points = wall(z_m, seed, -0.4, -0.5)
        points[:, 2] -= offset_m
        points[:, :2] *= points[:, 2:] / z_m
        samples.append(scene_samples(points, left, right, rig, [], seed=seed))
    bias = fit_scene_bias(np.concatenate(samples), rig)
    assert bias is not None
    across = np.array([[x, 0.0] for x in (-0.4, 0.0, 0.4)])
    assert bias.disparity_error_px(across) == pytest.approx(-0.4 - 0.5 * across[:, 0], abs=0.06)
    assert bias.range_offset_m == pytest.approx(offset_m, abs=0.02)


def test_cones_are_left_out() -> None:
    left, right, points = wall(8.0, 0, 0, 0)
    box = records.box(0.0, 0.0, 400.0, 200.0)
    samples = scene_samples(points, left, right, make_rig(), [box])
    assert len(samples) > 0
    assert (samples[:, 0] > (400 - 300) / 400).all()


def test_too_few_samples_give_no_fit() -> None:
    left, right, points = wall(8.0, 0, 0, 0)
    assert fit_scene_bias(scene_samples(points[:50], left, right, make_rig(), []), make_rig()) is None
    assert scene_samples(np.zeros((0, 3)), left, right, make_rig(), []).shape == (0, 4)
