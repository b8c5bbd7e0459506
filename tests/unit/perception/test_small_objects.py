"""Small-object pass: parts, combination of both passes, results of the shipped network."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from conetl.perception.decoding import NetworkBoxes
from conetl.perception.detector import Detector, detect_image, load_detector
from conetl.perception.model_card import ModelCard, SmallObjectPass, read_model_card
from conetl.perception.second_passes import (
    CELL_PX,
    MIN_SCORE,
    detect_small_objects,
    enlargement,
    parts_around,
    pooled_score,
)
from tests.folders import ROOT
from tests.unit.perception.test_rescoring import candidate

SETTINGS = SmallObjectPass(below_px=40, from_score=0.25, around_px=24, scale=2.0, share=0.65)
Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

IMAGE = np.zeros((200, 400, 3), np.uint8)

boxes_in_an_image = st.lists(
    st.tuples(st.floats(0, 380), st.floats(0, 180), st.floats(2, 30), st.floats(2, 40)), min_size=0, max_size=12
).map(lambda boxes: np.array([(x, y, x + w, y + h) for x, y, w, h in boxes]).reshape(-1, 4))


def blind(shown: list[tuple[int, ...]], omitted: float = 0.0) -> Callable[[Image], NetworkBoxes]:
    """A network that finds nothing; `shown` gets the shapes of what it was shown."""

    def run(part: Image) -> NetworkBoxes:
        shown.append(part.shape)
        return np.zeros((0, 10)), omitted

    return run


def showing(boxes: list[Floats], row: Floats) -> Callable[[Image], NetworkBoxes]:
    """A network that finds these boxes (10,), in pixels of the image, in the part around a candidate (10,) at SETTINGS' scale."""
    x0, y0, *_ = parts_around(row[None], SETTINGS.around_px, 400, 200)[0]

    def run(part: Image) -> NetworkBoxes:
        seen = np.stack(boxes)
        seen[:, [0, 2, 5, 7]] -= x0
        seen[:, [1, 3, 6, 8]] -= y0
        seen[:, [0, 1, 2, 3, 5, 6, 7, 8]] *= SETTINGS.scale
        return seen, 0.0

    return run


@given(boxes_in_an_image)
def test_each_box_lies_in_one_part_with_its_surroundings_and_parts_do_not_touch(boxes: Floats) -> None:
    parts = parts_around(boxes, 24.0, 403, 211)
    size = np.array([403, 211, 403, 211])
    for surroundings in np.clip(boxes + np.array((-24, -24, 24, 24)), 0, size):
        corners = np.array(parts)
        inside = (corners[:, :2] <= surroundings[:2]) & (corners[:, 2:] >= surroundings[2:])
        assert inside.all(axis=1).sum() == 1
    for k, one in enumerate(parts):
        assert 0 <= one[0] < one[2] <= 403 and 0 <= one[1] < one[3] <= 211
        for other in parts[k + 1 :]:
            beside = max(one[0], other[0]) - min(one[2], other[2])
            below = max(one[1], other[1]) - min(one[3], other[3])
            assert max(beside, below) >= CELL_PX


@given(boxes_in_an_image, st.floats(1.1, 4.0))
def test_all_parts_enlarged_are_no_larger_than_the_image(boxes: Floats, wanted: float) -> None:
    parts = parts_around(boxes, 24.0, 400, 200)
    scale = enlargement(parts, wanted, 400 * 200)
    assert scale <= wanted
    assert sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in parts) * scale**2 <= 400 * 200 * (1 + 1e-9)


def test_what_is_tall_or_faint_calls_for_nothing() -> None:
    shown: list[tuple[int, ...]] = []
    tall_and_faint = np.stack([candidate(100, 50, 140, 110, 0.9), candidate(200, 50, 215, 70, 0.2)])
    for rows in (tall_and_faint, np.zeros((0, 10))):
        np.testing.assert_array_equal(detect_small_objects(blind(shown), IMAGE, rows, SETTINGS, 1.0), rows)
    assert shown == [], "nothing was to be looked at"


def test_the_part_is_shown_enlarged_and_boxes_come_back_in_pixels_of_the_image() -> None:
    ramp = np.tile(np.linspace(0, 250, 400, dtype=np.float32)[None, :, None], (200, 1, 3)).astype(np.uint8)
    row = candidate(104, 80, 120, 104, 0.6)
    x0, y0, x1, y1 = parts_around(row[None], 24.0, 400, 200)[0]
    shown: list[Image] = []

    def run(part: Image) -> NetworkBoxes:
        shown.append(part)
        return showing([candidate(105, 80, 121, 106, 0.8)], row)(part)

    (found,) = detect_small_objects(run, ramp, row[None], SETTINGS, 1.0)
    assert [part.shape for part in shown] == [(2 * (y1 - y0), 2 * (x1 - x0), 3)]
    assert shown[0][0, 0, 0] == pytest.approx(250 * x0 / 399, abs=1.5)
    np.testing.assert_allclose(found[:4], 0.35 * row[:4] + 0.65 * np.array([105, 80, 121, 106]))
    assert found[4] == pytest.approx(pooled_score(0.6, 0.8, 0.65))
    np.testing.assert_allclose(found[5:9], 0.35 * row[5:9] + 0.65 * np.array([113, 106, 113, 80]))


def test_in_a_image_that_is_scaled_down_the_part_keeps_more_of_its_own_pixels() -> None:
    row = candidate(1000, 600, 1040, 660, 0.6)  # 30 px of the network's input
    x0, y0, x1, y1 = parts_around(row[None], 48.0, 3200, 1200)[0]
    shown: list[tuple[int, ...]] = []
    detect_small_objects(blind(shown), np.zeros((1200, 3200, 3), np.uint8), row[None], SETTINGS, 2.0)
    assert shown == [(y1 - y0, x1 - x0, 3)]


def test_what_only_the_enlarged_look_sees_is_a_candidate_unless_it_is_cut_tall_or_part_of_a_cone() -> None:
    rows = np.stack([candidate(100, 80, 116, 104, 0.6), candidate(125, 60, 165, 125, 0.9)])  # the second is tall
    x0, y0, *_ = parts_around(rows[:1], 24.0, 400, 200)[0]
    far, band = candidate(84, 80, 91, 90, 0.9), candidate(127, 90, 139, 100, 0.5)
    cut, tall = candidate(x0 + 1, 80, 90, 100, 0.9), candidate(80, y0 + 4, 92, y0 + 60, 0.9)

    found = detect_small_objects(showing([far, band, cut, tall], rows[0]), IMAGE, rows, SETTINGS, 1.0)
    assert len(found) == 3
    assert found[0, 4] == pytest.approx(pooled_score(0.6, 0.0, 0.65)) and found[0, 4] < 0.2  # not seen again
    np.testing.assert_array_equal(found[1], rows[1])  # tall: not judged
    np.testing.assert_allclose(np.delete(found[2], 4), np.delete(far, 4))
    assert found[2, 4] == pytest.approx(pooled_score(MIN_SCORE, 0.9, 0.65))


def test_two_candidates_do_not_share_one_box_of_the_enlarged_look() -> None:
    rows = np.stack([candidate(100, 80, 116, 104, 0.5), candidate(103, 80, 119, 104, 0.6)])
    found = detect_small_objects(showing([candidate(102, 80, 118, 104, 0.9)], rows[0]), IMAGE, rows, SETTINGS, 1.0)
    assert found[1, 4] == pytest.approx(pooled_score(0.6, 0.9, 0.65))  # the surer one has it
    assert found[0, 4] == pytest.approx(pooled_score(0.5, 0.0, 0.65))


@pytest.mark.parametrize(("omitted", "counts_as"), [(0.0, 0.0), (0.04, 0.0), (0.5, 0.5), (0.8, 0.6)])
def test_what_a_crowd_may_keep_from_being_told_is_not_taken_for_unseen(omitted: float, counts_as: float) -> None:
    row = candidate(100, 80, 116, 104, 0.6)
    (found,) = detect_small_objects(blind([], omitted), IMAGE, row[None], SETTINGS, 1.0)
    assert found[4] == pytest.approx(pooled_score(0.6, counts_as, 0.65))


def test_a_cone_just_too_tall_to_be_judged_takes_what_is_seen_of_it() -> None:
    rows = np.stack([candidate(100, 80, 130, 124, 0.9), candidate(140, 80, 156, 104, 0.6)])
    x0, *_ = parts_around(rows[1:], 24.0, 400, 200)[0]
    counterpart = candidate(max(102, x0 + 4), 88, 130, 120, 0.95)
    found = detect_small_objects(showing([counterpart], rows[1]), IMAGE, rows, SETTINGS, 1.0)
    assert len(found) == 2
    np.testing.assert_array_equal(found[0], rows[0])


def test_only_wanted_candidates_call_and_boxes_beyond_all_bounds_harm_nothing() -> None:
    sides = ((100, 80, 116, 104), (300, 80, 316, 104), (-1e30, 5, 1e30, 9))
    rows = np.stack([candidate(*four, 0.6) for four in sides])
    shown: list[tuple[int, ...]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = detect_small_objects(blind(shown), IMAGE, rows, SETTINGS, 1.0, np.array([True, False, False]))
        assert len(shown) == 1
        np.testing.assert_array_equal(found[1:], rows[1:])
        detect_small_objects(blind(shown), IMAGE, rows, SETTINGS, 1.0)


@pytest.mark.parametrize(
    ("look", "change", "words"),
    [
        ("enlarged_look", {"scale": 1.0}, "greater than 1"),
        ("enlarged_look", {"share": 1.0}, "less than 1"),
        ("enlarged_look", {"below_px": 0}, "greater than 0"),
        ("enlarged_look", {"parts": 3}, "Extra inputs"),
        ("closer_look", {"cone_px": 96}, "cone_px must be below window_px"),
        ("closer_look", {"scores": [0.7, 0.3]}, "first of the scores below the second"),
        ("closer_look", {"share": 1.0}, "less than 1"),
        ("closer_look", {"window_px": 100}, "multiple of pad_multiple_px"),
        ("closer_look", {"windows": 3}, "Extra inputs"),
    ],
)
def test_a_sidecar_that_asks_for_the_impossible_is_refused(look: str, change: dict[str, object], words: str) -> None:
    values = read_model_card(None).model_dump(exclude_none=True)
    with pytest.raises(ValidationError, match=words):
        type(read_model_card(None)).model_validate({**values, look: {**values[look], **change}})


def test_another_look_is_another_detector_and_other_evidence_is_not() -> None:
    card = read_model_card(None)
    assert card.enlarged_look is not None
    plain = card.model_copy(update={"enlarged_look": None})
    assert plain.detections_sha256 != card.detections_sha256
    assert card.model_copy(update={"closer_look": None}).detections_sha256 != card.detections_sha256
    assert card.model_copy(update={"evidence": None, "licence": "?"}).detections_sha256 == card.detections_sha256
    renamed = (*card.class_names[1:], card.class_names[0])
    assert card.model_copy(update={"class_names": renamed}).detections_sha256 != card.detections_sha256


@pytest.mark.parametrize("change", [{"pad_multiple_px": 16}, {"head": {"strides_px": (8, 16, 32, 64)}}])
def test_images_are_padded_to_whole_cells_of_the_largest_stride(change: dict[str, Any]) -> None:
    values = read_model_card(None).model_dump(exclude_none=True, exclude={"closer_look"})
    head = {**values["head"], **change.get("head", {})}
    with pytest.raises(ValidationError, match=r"multiple of the largest of head\.strides_px"):
        ModelCard.model_validate({**values, **change, "head": head})


def far_street() -> Image:
    """An image of a sample drive at a third of its size, as from three times as far, in the lower middle of a grey one."""
    images = sorted((ROOT / "data" / "drives").glob("*/image_02/data/*"))
    image = cv2.imread(str(images[len(images) // 8]))
    assert image is not None
    return np.asarray(cv2.resize(image, None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA), np.uint8)


def without_enlarging(detector: Detector) -> Detector:
    return replace(detector, card=detector.card.model_copy(update={"enlarged_look": None}))


def test_more_small_cones_are_found_with_it() -> None:
    detector, image = load_detector(), far_street()
    plain = detect_image(without_enlarging(detector), image, score_threshold=0.3)
    found = detect_image(detector, image, score_threshold=0.3)
    assert len(found) > len(plain) >= 1


def test_no_cone_of_a_crowd_is_lost_to_it() -> None:
    detector, image = load_detector(), far_street()
    best = detect_image(detector, image, score_threshold=0.3)[0]
    x, y, w, h = best[:4].round().astype(int)
    cone = cv2.resize(image[y - 2 : y + h + 2, x - 2 : x + w + 2], (28, 36), interpolation=cv2.INTER_CUBIC)
    crowd = np.full((760, 1000, 3), np.median(image[y + h : y + h + 4, x : x + w], axis=(0, 1)).astype(np.uint8))
    places = [(left, top) for top in range(40, 700, 62) for left in range(40, 940, 70)]
    for left, top in places:
        crowd[top : top + 36, left : left + 28] = cone
    plain = detect_image(without_enlarging(detector), crowd, score_threshold=0.3)
    found = detect_image(detector, crowd, score_threshold=0.3)
    assert len(plain) >= 0.9 * len(places)  # as the network sees them at their own size
    assert len(found) >= len(plain)


def test_without_a_closer_look_nothing_below_the_threshold_comes_out() -> None:
    detector = load_detector()
    detector = replace(detector, card=detector.card.model_copy(update={"closer_look": None}))
    found = detect_image(detector, far_street(), score_threshold=0.3)
    assert len(found) and (found[:, 4] >= 0.3).all()


@pytest.mark.parametrize("thresholds", [(0.06, 0.3), (0.1, 0.5), (0.3, 0.5)])
def test_a_higher_threshold_is_a_shorter_list_of_the_same_small_boxes(thresholds: tuple[float, float]) -> None:
    detector, image = load_detector(), far_street()
    low, high = (detect_image(detector, image, score_threshold=score) for score in thresholds)
    assert len(low) > len(high) > 0
    np.testing.assert_array_equal(low[low[:, 4] >= thresholds[1]], high)


def test_rows_above_the_road_stay_out_and_so_does_what_lies_beside_the_wanted_part() -> None:
    detector, image = load_detector(), far_street()
    whole = detect_image(detector, image, score_threshold=0.3)
    middles = whole[:, 0] + whole[:, 2] / 2
    split = float(np.sort(middles)[len(middles) // 2]) - 1.0
    within = (split, 0.0, float(image.shape[1]), float(image.shape[0]))
    right = detect_image(detector, image, score_threshold=0.3, within=within, reach_px=40.0)
    assert 0 < len(right) < len(whole)
    assert (right[:, 0] + right[:, 2] / 2 >= split - 0.5).all()
    first_row = int(whole[:, 1].min()) // 2
    below = detect_image(detector, image, score_threshold=0.3, first_row=first_row)
    assert (below[:, 1] >= first_row).all() and len(below)
