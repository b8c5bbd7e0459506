"""Re-scoring pass: windows, combined scores, results of the shipped network."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from conetl.perception.model_card import ReScoringPass
from conetl.perception.second_passes import pooled_score, rescore, window_around

SETTINGS = ReScoringPass(cone_px=48, window_px=96, scores=(0.25, 0.75), share=0.35)


def candidate(x0: float, y0: float, x1: float, y1: float, score: float) -> NDArray[np.float64]:
    return np.array([x0, y0, x1, y1, score, (x0 + x1) / 2, y1, (x0 + x1) / 2, y0, 0.0])


@given(st.floats(0.0, 150.0), st.floats(0.0, 100.0), st.floats(6.0, 30.0), st.floats(8.0, 45.0))
def test_a_box_lies_whole_in_its_window_and_the_window_in_the_image(x0: float, y0: float, w: float, h: float) -> None:
    image = np.zeros((160, 200, 3), np.uint8)
    box = np.array([x0, y0, x0 + w, y0 + h])
    window, left, top, scale = window_around(image, box, SETTINGS)
    assert window.shape == (96, 96, 3)
    assert scale * h == pytest.approx(48.0, abs=48.0 / (2 * h))  # the cut is of whole pixels
    side = 96 / scale
    assert left >= 0 and top >= 0 and left + side <= 200.0 + 1e-9 and top + side <= 160.0 + 1e-9
    assert top <= y0 + 1.0 and y0 + h <= top + side + 1.0
    if w <= h:
        assert left <= x0 + 1.0 and x0 + w <= left + side + 1.0


@pytest.mark.parametrize("height_px", [12.0, 48.0, 110.0])
def test_the_window_shows_what_lies_there(height_px: float) -> None:
    ramp = np.tile(np.linspace(0, 255, 512, dtype=np.float32)[None, :, None], (512, 1, 3)).astype(np.uint8)
    box = np.array([200.0, 300.0 - height_px, 220.0, 300.0])
    window, left, _, scale = window_around(ramp, box, SETTINGS)
    middle = left + 48 / scale  # image x in the middle of the window
    assert window[48, 47:49].mean() == pytest.approx(255 * (middle - 0.5) / 511, abs=1.5)


def test_a_cone_larger_than_half_the_image_gets_the_edge_repeated() -> None:
    image = np.full((60, 80, 3), 77, np.uint8)
    window, _, _, scale = window_around(image, np.array([10.0, 5.0, 40.0, 58.0]), SETTINGS)
    assert window.shape == (96, 96, 3) and scale < 1.0
    assert (window == 77).all()


@given(st.floats(0.02, 0.98), st.floats(0.02, 0.98), st.floats(0.05, 0.95))
def test_the_joined_score_lies_between_both(first: float, closer: float, share: float) -> None:
    assert min(first, closer) - 1e-9 <= pooled_score(first, closer, share) <= max(first, closer) + 1e-9
    assert pooled_score(first, closer, share) == pytest.approx(pooled_score(closer, first, 1.0 - share))
    assert pooled_score(first, first, share) == pytest.approx(first)


def test_only_middling_scores_are_looked_at_and_the_others_stay() -> None:
    image = np.zeros((200, 300, 3), np.uint8)
    rows = np.stack(
        [candidate(10, 10, 30, 50, 0.9), candidate(100, 60, 124, 108, 0.5), candidate(200, 100, 220, 140, 0.2)]
    )
    windows: list[tuple[int, ...]] = []

    def nothing(given: list[NDArray[np.uint8]], least: float) -> list[NDArray[np.float64]]:
        windows.extend(window.shape for window in given)
        return [np.zeros((0, 10)) for _ in given]

    result = rescore(nothing, image, rows, SETTINGS)
    assert windows == [(96, 96, 3)]
    np.testing.assert_array_equal(result[[0, 2]], rows[[0, 2]])
    np.testing.assert_array_equal(np.delete(result[1], 4), np.delete(rows[1], 4))
    assert result[1, 4] == pytest.approx(pooled_score(0.5, 0.0, 0.35)) and result[1, 4] < 0.2


def test_of_two_cones_in_the_window_the_candidates_own_counts() -> None:
    image = np.zeros((200, 300, 3), np.uint8)
    row = candidate(100, 60, 124, 108, 0.5)  # 48 px tall: the window is the image at its own scale
    _, left, top, scale = window_around(image, row[:4], SETTINGS)
    assert scale == 1.0

    def two(windows: list[NDArray[np.uint8]], least: float) -> list[NDArray[np.float64]]:
        own, other = candidate(100, 62, 124, 108, 0.7), candidate(110, 60, 134, 108, 0.9)
        seen = np.stack([other, own])
        seen[:, [0, 2, 5, 7]] -= left
        seen[:, [1, 3, 6, 8]] -= top
        return [seen for _ in windows]

    (found,) = rescore(two, image, row[None], SETTINGS)
    np.testing.assert_allclose(found[:4], 0.65 * row[:4] + 0.35 * np.array([100, 62, 124, 108]))
    np.testing.assert_allclose(found[5:9], 0.65 * row[5:9] + 0.35 * np.array([112, 108, 112, 62]))
    assert found[4] == pytest.approx(pooled_score(0.5, 0.7, 0.35))


def test_what_the_second_look_takes_for_another_class_is_not_found_again() -> None:
    image = np.zeros((160, 200, 3), np.uint8)
    row = candidate(100, 60, 124, 108, 0.5)
    _, left, top, _ = window_around(image, row[:4], SETTINGS)
    drum = candidate(100 - left, 60 - top, 124 - left, 108 - top, 0.9)
    drum[9] = 2.0
    (found,) = rescore(lambda windows, least: [drum[None] for _ in windows], image, row[None], SETTINGS)
    assert found[4] == pytest.approx(pooled_score(0.5, 0.0, 0.35))
    np.testing.assert_array_equal(found[[0, 1, 2, 3, 9]], row[[0, 1, 2, 3, 9]])
