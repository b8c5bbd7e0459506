"""Raw images through their rig: resampled where they must be, sharp, in the right place, and untouched where they need not."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.rectification import rectify
from conetl.model.rig import Camera, Lens, Rig
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_rig_image
from conetl.readers.rigs.common import rig_of

BARREL = Lens(model="brown", coefficients=(-0.3, 0.1, 1e-3, -8e-4, -0.02))
RAW = Camera(width_px=640, height_px=400, fx_px=500, fy_px=498, cx_px=322, cy_px=196, lens=BARREL)


def raw_rig() -> Rig:
    turn = Rotation.from_rotvec([0.01, -0.03, 0.008]).as_matrix()
    return rig_of("raw", RAW, RAW, se3.se3(turn, [0.3, 0.004, -0.006]))


def world_image(rig: Rig, side: str) -> np.ndarray:
    """An image of a far wall (a smooth pattern over directions) as one raw camera takes it."""
    camera = rigs.camera_of(rig, side)  # type: ignore[arg-type]
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    d = cam.rays(camera, np.stack([u, v], axis=-1)) @ rigs.body_SE3_camera(rig, side)[:3, :3].T  # type: ignore[arg-type]
    return np.repeat(pattern(d)[..., None], 3, axis=-1)


def pattern(d: np.ndarray) -> np.ndarray:
    x, y = d[..., 0] / d[..., 2], d[..., 1] / d[..., 2]
    return np.round(128 + 50 * np.sin(60 * x) + 50 * np.cos(45 * y + 20 * x)).astype(np.uint8)


@pytest.mark.parametrize("side", ["left", "right"])
def test_every_pixel_shows_its_own_direction(side: str, tmp_path: Path) -> None:
    raw = raw_rig()
    flat = rectify(raw)
    path = tmp_path / "0.png"
    cv2.imwrite(str(path), world_image(raw, side))
    image = read_rig_image(path, flat, side)  # type: ignore[arg-type]
    camera = rigs.camera_of(flat, side)  # type: ignore[arg-type]
    assert image.shape == (camera.height_px, camera.width_px, 3)
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    turn = rigs.body_SE3_camera(flat, side)[:3, :3]  # type: ignore[arg-type]
    expected = pattern(cam.rays(camera, np.stack([u, v], axis=-1)) @ turn.T).astype(float)
    error = image[..., 0] - expected
    assert np.abs(error).max() <= 3 and error.std() < 0.7, "grey levels; 1 px off would be 10"


def test_the_size_asked_for_is_that_of_the_stored_image(tmp_path: Path) -> None:
    flat = rectify(raw_rig())
    path = tmp_path / "0.png"
    cv2.imwrite(str(path), np.zeros((flat.left.height_px, flat.left.width_px, 3), np.uint8))
    with pytest.raises(ImageFileError, match="640 x 400"):
        read_rig_image(path, flat, "left")
