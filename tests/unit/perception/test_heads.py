"""The heads of the YOLO family: outputs of networks whose boxes were computed by hand, and networks that must be refused."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from conetl.model.errors import ModelFileError
from conetl.perception.heads import (
    EndToEndHead,
    YoloHead,
    YoloV3Head,
    YoloV5Head,
    YoloV8Head,
    YoloXHead,
    check_outputs,
    decode_head,
)

#: Not square, so that rows taken for columns are noticed.
HEIGHT_PX, WIDTH_PX = 64, 96
ANCHORS_PX = (
    ((116, 90), (156, 198), (373, 326)),
    ((30, 61), (62, 45), (59, 119)),
    ((10, 13), (16, 30), (33, 23)),
)

Arrays = list[np.ndarray]


def decode(head: YoloHead, outputs: Sequence[np.ndarray], score_threshold: float = 0.5) -> np.ndarray:
    check_outputs(head, [output.shape for output in outputs])
    return decode_head(head, outputs, HEIGHT_PX, WIDTH_PX, score_threshold)


def logit(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))


def yolov3_maps(class_count: int) -> Arrays:
    """Raw maps (1, 3 * (5 + classes), rows, columns) in which no cell has seen anything."""
    maps = [np.zeros((1, 3 * (5 + class_count), HEIGHT_PX // s, WIDTH_PX // s), np.float32) for s in (32, 16, 8)]
    for raw in maps:
        raw.reshape(3, 5 + class_count, -1)[:, 4:] = -20.0
    return maps


@pytest.mark.parametrize("layout", ["NCHW", "NHWC"])
def test_yolov3_gives_the_known_boxes(layout: Any) -> None:
    head = YoloV3Head(anchors_px=ANCHORS_PX, class_count=2, layout=layout)
    maps = yolov3_maps(2)
    # Stride 16, second anchor (62 x 45), row 2, column 3: a cone.
    maps[1][0, 7:14, 2, 3] = (0.0, logit(0.75), np.log(2), np.log(0.2), logit(0.9), -20.0, logit(0.8))
    # Stride 8, third anchor (33 x 23), row 7, column 11: rather the other class, in the last cell.
    maps[2][0, 14:21, 7, 11] = (logit(0.25), 0.0, 0.0, 0.0, logit(0.95), logit(0.8), logit(0.7))
    # Stride 32, first anchor: certainly the other class.
    maps[0][0, :7, 1, 0] = (0.0, 0.0, 0.0, 0.0, 20.0, 20.0, -20.0)
    if layout == "NHWC":
        maps = [np.ascontiguousarray(raw.transpose(0, 2, 3, 1)) for raw in maps]
    # Centre (3.5 * 16, 2.75 * 16) = (56, 44), size 124 x 9; centre (11.25 * 8, 7.5 * 8) = (90, 60), size 33 x 23.
    # Centre (0.5 * 32, 1.5 * 32) = (16, 48), size 116 x 90.
    expected = [[-42, 3, 74, 93, 1, 0], [-6.0, 39.5, 118.0, 48.5, 0.72, 1], [73.5, 48.5, 106.5, 71.5, 0.76, 0]]
    np.testing.assert_allclose(decode(head, maps), expected, atol=1e-4)
    np.testing.assert_allclose(decode(head, maps, 0.73), expected[::2], atol=1e-4)
    assert decode(head, maps, 1.0).shape == (0, 6)


CELLS = 8 * 12 + 4 * 6 + 2 * 3


Rows = list[tuple[tuple[int | slice, ...], tuple[float, ...]]]
#: Head, shape of its output, what is in its rows, the boxes, and which of them are above thresholds.
KNOWN: dict[str, tuple[YoloHead, tuple[int, ...], Rows, list[list[float]], dict[float, list[int]]]] = {
    "yolov5": (
        YoloV5Head(class_count=3), (1, 6, 8),
        [
            ((0, 0), (40, 30, 10, 24, 0.9, 0.1, 0.0, 0.8)),
            ((0, 1), (50, 30, 10, 24, 0.9, 0.8, 0.0, 0.1)),  # another class
            ((0, 2), (60, 30, 10, 24, 0.4, 0.0, 0.0, 0.9)),  # hardly an object
            ((0, 3), (70, 30, 10, -24, 0.9, 0.0, 0.0, 0.9)),  # no area
            ((0, 5), (80.5, 50, 9, 12, 1.0, 0.0, 0.9, 0.6)),
        ],
        [[35, 18, 45, 42, 0.72, 2], [45, 18, 55, 42, 0.72, 0], [55, 18, 65, 42, 0.36, 2], [76, 44, 85, 56, 0.9, 1]],
        {0.3: [0, 1, 2, 3], 0.5: [0, 1, 3], 0.8: [3]},
    ),
    "yolov5 with one class, by objectness": (
        YoloV5Head(class_count=1), (1, 1, 6), [((0, 0), (40, 30, 10, 24, 0.8, 0.5))], [[35, 18, 45, 42, 0.8, 0]], {0.5: [0]},
    ),
    "yolov8": (
        YoloV8Head(class_count=2), (1, 6, 9),
        [
            ((0, slice(None), 4), (40, 30, 10, 24, 0.7, 0.2)),
            ((0, slice(None), 5), (41, 30, 10, 24, 0.2, 0.7)),  # another class
            ((0, slice(None), 8), (94, 3, 8, 10, 0.55, 0.0)),  # reaches beyond the image
        ],
        [[35, 18, 45, 42, 0.7, 0], [36, 18, 46, 42, 0.7, 1], [90, -2, 98, 8, 0.55, 0]],
        {0.5: [0, 1, 2], 0.6: [0, 1]},
    ),
    "yolox": (
        YoloXHead(class_count=2), (1, CELLS, 7),
        [  # centre (76, 38), size 16 x 24; centre (80, 48), size 16 x 8
            ((0, 5 * 12 + 9), (0.5, -0.25, np.log(2), np.log(3), 0.9, 0.0, 0.8)),  # stride 8, row 5, column 9
            ((0, 8 * 12 + 2 * 6 + 5), (0.0, 1.0, 0.0, np.log(0.5), 0.8, 0.0, 0.75)),  # stride 16, row 2, column 5
            ((0, 8 * 12 + 4 * 6 + 1 * 3 + 2), (0.5, 0.5, 0.0, 0.0, 1.0, 1.0, 0.0)),  # stride 32, another class
        ],
        [[68, 26, 84, 50, 0.72, 1], [72, 44, 88, 52, 0.6, 1], [64, 32, 96, 64, 1.0, 0]],
        {0.5: [0, 1, 2], 0.7: [0, 2]},
    ),
    "end to end": (
        EndToEndHead(class_count=3), (1, 5, 6),  # the last row stays unfilled
        [
            ((0, 0), (35, 18, 45, 42, 0.7, 2)),
            ((0, 1), (36, 18, 46, 42, 0.9, 0.999)),  # rounded by the network
            ((0, 2), (60, 20, 70, 44, 0.4, 2)),
            ((0, 3), (60, 20, 70, 44, 0.9, -1)),  # filled up
        ],
        [[35, 18, 45, 42, 0.7, 2], [36, 18, 46, 42, 0.9, 1], [60, 20, 70, 44, 0.4, 2]],
        {0.0: [0, 1, 2], 0.5: [0, 1]},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", KNOWN)
def test_a_network_gives_the_known_boxes(name: str) -> None:
    head, shape, rows, boxes, seen = KNOWN[name]
    raw = np.zeros(shape, np.float32)
    for place, values in rows:
        raw[place] = values
    for threshold, shown in seen.items():
        np.testing.assert_allclose(decode(head, [raw], threshold), np.array(boxes)[shown], atol=1e-5)


@pytest.mark.parametrize(
    ("head", "outputs", "message"),
    [
        (
            YoloV3Head(strides_px=(8, 16, 32), anchors_px=ANCHORS_PX, class_count=1), yolov3_maps(1),
            r"8 x 12 cells \(rows x columns\) at stride 8 .* gives 2 x 3",
        ),
        (
            YoloXHead(strides_px=(8, 16), class_count=1), [np.zeros((1, CELLS, 6), np.float32)],
            r"expects 120 cells at strides \(8, 16\) .* gives 126",
        ),
        (
            EndToEndHead(class_count=2), [np.array([[[35, 18, 45, 42, 0.7, 2]]], np.float32)],
            "gives class 2, the sidecar's head has class_count 2",
        ),
    ],
)  # fmt: skip
def test_cells_and_classes_that_do_not_fit_are_named(head: YoloHead, outputs: Arrays, message: str) -> None:
    with pytest.raises(ModelFileError, match=message):
        decode(head, outputs)


def test_only_the_first_image_of_a_batch_is_decoded() -> None:
    raw = np.zeros((2, 5, 3), np.float32)
    raw[0, :, 0] = (40, 30, 10, 24, 0.7)
    raw[1, :, 1] = (20, 30, 10, 24, 0.9)
    found = decode_head(YoloV8Head(class_count=1), [raw], HEIGHT_PX, WIDTH_PX, 0.5)
    np.testing.assert_allclose(found, [[35, 18, 45, 42, 0.7, 0]], atol=1e-6)


def test_boxes_that_are_not_finite_are_dropped() -> None:
    good = (40, 30, 10, 24, 0.75, 1.0)
    rows = [good, *(tuple(bad if at == place else value for at, value in enumerate(good))
                    for bad in (np.nan, np.inf, -np.inf) for place in range(5))]  # fmt: skip
    found = decode(YoloV5Head(class_count=1), [np.array([rows], np.float32)])
    np.testing.assert_allclose(found, [[35, 18, 45, 42, 0.75, 0]])
    maps = yolov3_maps(1)
    maps[0][0, :6, 0, 0] = (0.0, 0.0, 5000.0, 0.0, 20.0, 20.0)  # exp overflows
    head = YoloV3Head(anchors_px=ANCHORS_PX, class_count=1)
    assert decode(head, maps).shape == (0, 6)
    assert decode(head, [raw.astype(np.float16) for raw in maps]).shape == (0, 6)


@pytest.mark.parametrize(
    ("head", "shape", "place"),
    [
        (YoloV5Head(class_count=1), (1, 3, 6), (0, 1, 4)),
        (YoloV8Head(class_count=1), (1, 5, 3), (0, 4, 1)),
        (YoloXHead(class_count=1), (1, CELLS, 6), (0, 1, 5)),
        (EndToEndHead(class_count=3), (1, 3, 6), (0, 1, 4)),
    ],
)
def test_scores_that_are_no_probabilities_are_refused(
    head: YoloHead, shape: tuple[int, ...], place: tuple[int, ...]
) -> None:
    raw = np.zeros(shape, np.float32)
    assert decode(head, [raw]).shape == (0, 6)
    raw[place] = -7.5
    with pytest.raises(
        ModelFileError, match=rf"'{head.kind}' expects scores from 0 to 1, the network gives -7\.5 to 0"
    ):
        decode(head, [raw])


def test_rounding_beyond_one_is_cut() -> None:
    raw = np.array([[[35, 18, 45, 42, 1.0005, 0]]], np.float32)
    np.testing.assert_array_equal(decode(EndToEndHead(class_count=3), [raw]), [[35, 18, 45, 42, 1.0, 0]])


WRONG = [
    (YoloV8Head(class_count=2), [(1, 9, 6)], r"1 output \(batch, 6, boxes\), .* gives 1 output \(1, 9, 6\)"),
    (YoloV5Head(class_count=2), [(1, 9, 85)], r"\(batch, boxes, 7\), .* \(1, 9, 85\)"),
    (YoloV5Head(class_count=1), [(1, 9, 6), (1, 3, 4, 4, 6)], r"gives 2 outputs \(1, 9, 6\), \(1, 3, 4, 4, 6\)"),
    (YoloXHead(class_count=1), [(126, 6)], r"\(batch, boxes, 6\), .* \(126, 6\)"),
    (EndToEndHead(class_count=3), [(1, 5, 7)], r"\(batch, boxes, 6\), .* \(1, 5, 7\)"),
    (
        YoloV3Head(anchors_px=ANCHORS_PX, class_count=1),
        [(1, 2, 3, 18), (1, 4, 6, 18), (1, 8, 12, 18)],
        r"3 outputs \(batch, 18, rows, columns\).* \(1, 2, 3, 18\)",
    ),
    (
        YoloV3Head(anchors_px=ANCHORS_PX, class_count=1, layout="NHWC"),
        [(1, 2, 3, 18), (1, 4, 6, 18)],
        r"3 outputs .* gives 2 outputs",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("head", "shapes", "message"), WRONG, ids=[str(index) for index in range(len(WRONG))])
def test_a_network_of_another_shape_is_refused(head: YoloHead, shapes: list[tuple[int, ...]], message: str) -> None:
    with pytest.raises(ModelFileError, match=message):
        check_outputs(head, shapes)
    with pytest.raises(ModelFileError, match=message):
        decode_head(head, [np.zeros(shape, np.float32) for shape in shapes], HEIGHT_PX, WIDTH_PX, 0.5)


def test_sizes_that_are_not_fixed_are_left_to_the_run() -> None:
    head = YoloV8Head(class_count=2)
    check_outputs(head, [["batch", None, "anchors"]])
    with pytest.raises(ModelFileError, match=r"gives 1 output \(batch, 7, \?\)"):
        check_outputs(head, [["batch", 7, None]])
    with pytest.raises(ModelFileError, match="gives 1 output"):
        check_outputs(head, [["batch", None]])
    with pytest.raises(ModelFileError, match="gives 0 outputs"):
        check_outputs(head, [])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"kind": "yolov8", "class_count": 3, "cone_class": 2}', "name every class of the network in class_names"),
        ('{"kind": "yolov8", "class_count": 0}', "greater than 0"),
        ('{"kind": "yolov8"}', "class_count"),
        ('{"kind": "yolov8", "class_count": 3, "anchors_px": []}', "Extra inputs"),
        ('{"kind": "yolov99", "class_count": 1}', "yolov99"),
        ('{"kind": "yolov3", "class_count": 3}', "anchors_px"),
        (
            '{"kind": "yolov3", "class_count": 3, "anchors_px": [[[1, 2]]]}',
            "1 scales, strides_px has 3",
        ),
        (
            '{"kind": "yolov3", "class_count": 3, "anchors_px": [[[1, 2]], [], []]}',
            "without an anchor",
        ),
        ('{"kind": "yolox", "class_count": 3, "strides_px": []}', "at least 1 item"),
    ],
)
def test_a_sidecar_that_contradicts_itself_is_refused(text: str, message: str) -> None:
    sidecar: TypeAdapter[YoloHead] = TypeAdapter(YoloHead)
    with pytest.raises(ValidationError, match=message):
        sidecar.validate_json(text)
