from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.steps.area_matching import match_area, silhouette_mask

BOX = (60.0, 30.0, 30.0, 52.0)


def textured_pair(disparity_px: float, seed: int, noise: float = 2.0) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """A smooth random picture and the same shifted left by a part of a pixel, each with its own noise."""
    rng = np.random.default_rng(seed)
    fine = cv2.GaussianBlur(rng.uniform(0, 255, (120 * 4, 200 * 4)), (0, 0), 9)
    fine = (fine - fine.min()) / np.ptp(fine) * 200 + 25

    def view(shift_px: float) -> NDArray[np.uint8]:
        move = np.array([[1.0, 0.0, -4 * shift_px], [0.0, 1.0, 0.0]])
        moved = cv2.warpAffine(fine, move, (800, 480), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        small = cv2.resize(moved, (200, 120), interpolation=cv2.INTER_AREA)
        return np.clip(small + rng.normal(0, noise, small.shape), 0, 255).astype(np.uint8)

    return view(0.0), view(disparity_px)


@pytest.mark.parametrize("disparity_px", [12.0, 12.3, 12.5, 12.81])
def test_sub_pixel_disparity_is_found_from_a_rough_start(disparity_px: float) -> None:
    errors = []
    for seed in range(8):
        left, right = textured_pair(disparity_px, seed)
        match = match_area(left, right, BOX, disparity_px=10.0, search_px=4.0)
        assert match is not None
        errors.append(match.disparity_px - disparity_px)
    assert abs(np.mean(errors)) < 0.06
    assert np.std(errors) < 0.08


def test_brightness_and_contrast_do_not_matter() -> None:
    left, right = textured_pair(9.4, 3)
    darker = np.clip(right * 0.7 + 15, 0, 255).astype(np.uint8)
    plain = match_area(left, right, BOX, 9.0, 4.0)
    other = match_area(left, darker, BOX, 9.0, 4.0)
    assert plain is not None
    assert other is not None
    assert other.disparity_px == pytest.approx(plain.disparity_px, abs=0.05)


def test_what_stands_behind_the_cone_does_not_pull_it() -> None:
    near_left, near_right = textured_pair(20.0, 5)
    far_left, far_right = textured_pair(6.0, 6)
    x, y, w, h = (int(value) for value in BOX)
    mask = silhouette_mask(h, w)
    far_left[y : y + h, x : x + w][mask] = near_left[y : y + h, x : x + w][mask]
    far_right[y : y + h, x - 20 : x - 20 + w][mask] = near_right[y : y + h, x - 20 : x - 20 + w][mask]
    match = match_area(far_left, far_right, BOX, 18.5, 4.0)
    assert match is not None
    assert match.disparity_px == pytest.approx(20.0, abs=0.15)


def test_no_texture_gives_no_match() -> None:
    flat = np.full((120, 200, 3), 90, np.uint8)
    assert match_area(flat, flat, BOX, 10.0, 4.0) is None


def test_another_picture_gives_no_match() -> None:
    left, _ = textured_pair(10.0, 1)
    _, right = textured_pair(10.0, 2)
    match = match_area(left, right, (60.0, 20.0, 50.0, 80.0), 10.0, 4.0)
    assert match is None or match.correlation < 0.8


def test_a_search_beyond_the_picture_gives_no_match() -> None:
    left, right = textured_pair(10.0, 1)
    assert match_area(left, right, (2.0, 30.0, 30.0, 50.0), 10.0, 4.0) is None
