from __future__ import annotations

from typing import Any

import numpy as np

from conetl.model.params import DetectionParams
from conetl.model.rejections import RejectionReason
from conetl.perception.detections import to_detections

LEFT: dict[str, Any] = {"frame_index": 0, "side": "left", "params": DetectionParams()}


def test_boxes_become_detections_by_falling_score() -> None:
    boxes = np.array([[10.0, 10.0, 8.0, 20.0, 0.5], [30.0, 10.0, 8.0, 20.0, 0.9], [50.0, 10.0, 8.0, 20.0, 0.1]])
    found, rejections = to_detections(boxes, frame_index=7, side="right", params=DetectionParams())
    assert [(d.detection_index, d.score) for d in found] == [(0, 0.9), (1, 0.5)]
    assert {d.frame_index for d in found} == {7}
    assert not rejections


def test_no_box_is_no_error() -> None:
    assert to_detections(np.zeros((0, 5)), **LEFT) == ([], [])


def test_a_box_that_is_no_box_is_rejected_and_the_others_stay() -> None:
    boxes = np.array([[np.nan, 10.0, 8.0, 20.0, 0.9], [30.0, 10.0, -8.0, 20.0, 0.8], [1.0, 1.0, 8.0, 20.0, 0.7]])
    found, rejections = to_detections(boxes, **LEFT)
    assert len(found) == 1
    assert [r.reason for r in rejections] == [RejectionReason.DETECTION_INVALID] * 2


def test_foot_and_tip_are_kept_where_the_network_tells_them() -> None:
    nan = np.nan
    boxes = [
        [10.0, 10.0, 8.0, 20.0, 0.9, 14.0, 28.5, 14.1, 10.2],
        [30.0, 10.0, 8.0, 20.0, 0.8, nan, nan, 34.0, 10.0],
        [50.0, 10.0, 8.0, 20.0, 0.7, 54.0, np.inf, nan, 10.0],
    ]
    found, rejections = to_detections(np.array(boxes), **LEFT)
    assert [d.foot_px for d in found] == [(14.0, 28.5), None, None]
    assert [d.tip_px for d in found] == [(14.1, 10.2), (34.0, 10.0), None]
    assert not rejections


def test_boxes_alone_have_neither_foot_nor_tip() -> None:
    (found,), _ = to_detections(np.array([[1.0, 1.0, 8.0, 20.0, 0.7]]), **LEFT)
    assert (found.foot_px, found.tip_px) == (None, None)


def test_signs_and_boards_have_no_foot() -> None:
    boxes = np.array([[10.0 + 30 * k, 10.0, 8.0, 20.0, 0.9 - 0.1 * k, 14.0, 28.5, 14.1, 10.2, k] for k in range(3)])
    categories = ("drum", "work_zone_sign", "arrow_board")
    found, _ = to_detections(boxes, **LEFT, categories=categories)
    assert [(d.category, d.foot_px is None, d.tip_px is None) for d in found] == [
        ("drum", False, False), ("work_zone_sign", True, True), ("arrow_board", True, True)
    ]  # fmt: skip
