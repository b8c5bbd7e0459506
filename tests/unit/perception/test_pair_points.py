"""Points in both images of a pair, to a fraction of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from conetl.model.params import TrajectoryParams
from conetl.perception.pair_points import pair_points

PARAMS = TrajectoryParams()


def textured(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).uniform(0, 255, (360, 640)).astype(np.float32)
    blurred = cv2.GaussianBlur(noise, (0, 0), 3.0)
    return np.asarray(np.clip((blurred - 127) * 6 + 127, 0, 255), np.uint8)


@pytest.mark.parametrize("moved", [(0.0, 0.0), (-20.4, 0.0), (-7.75, 2.3)])
def test_points_are_found_to_a_fraction_of_a_pixel(moved: tuple[float, float]) -> None:
    left = textured()
    right = cv2.warpAffine(
        left, np.float64([[1, 0, moved[0]], [0, 1, moved[1]]]), left.shape[::-1], flags=cv2.INTER_CUBIC
    )
    points = pair_points(left, np.asarray(right, np.uint8), PARAMS)
    assert len(points) > 200
    off = points[:, 2:] - points[:, :2] - moved
    assert np.median(np.abs(off)) < 0.06  # that of the resampled image included


def test_images_without_common_points_give_none() -> None:
    blank = np.full((360, 640), 90, np.uint8)
    assert pair_points(blank, blank, PARAMS).shape == (0, 4)
    assert pair_points(textured(), blank, PARAMS).shape == (0, 4)
    assert len(pair_points(textured(0), textured(1), PARAMS)) < 10
