"""Outputs of the YOLO family of networks -> boxes.

A model's sidecar names one of these heads under the key `head`, so that a network trained elsewhere is used as it was exported.
Pixels are those of `decoding.py`: an image W wide spans x = 0 .. W. A box has its most probable class, whose probability is
its score. Overlaps are suppressed by the caller (`decoding.suppress_overlaps`), except for the end-to-end head, whose network
has done so.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, PositiveInt, model_validator

from conetl.model.arrays import Floats
from conetl.model.base import Record
from conetl.model.errors import ModelFileError

Output = NDArray[Any]
"""One output of a network, of any floating type."""
Shape = Sequence[int | str | None]
"""Shape of an output; a dimension that is not fixed is None or a name."""

AnchorSide = Annotated[FiniteFloat, Field(gt=0)]

#: A network of 16 bit floats or 8 bit integers may overshoot 0 .. 1 by this much.
PROBABILITY_SLACK = 0.01


class _Head(Record):
    class_count: PositiveInt
    """Number of classes of the network; they are the sidecar's `class_names`, in the network's order."""

    @model_validator(mode="before")
    @classmethod
    def _classes_have_names(cls, values: Any) -> Any:
        if isinstance(values, dict) and "cone_class" in values:
            raise ValueError(
                "cone_class is no longer a key: name every class of the network in class_names, in its order, "
                "the cone as traffic_cone, and give their number as class_count"
            )
        return values


class YoloV3Head(_Head):
    """Raw maps of YOLOv3, one output per stride: per anchor t_x, t_y, t_w, t_h, objectness, classes (Redmon & Farhadi 2018)."""

    kind: Literal["yolov3"] = "yolov3"
    strides_px: tuple[PositiveInt, ...] = Field(default=(32, 16, 8), min_length=1)
    """In the order of the outputs."""
    anchors_px: tuple[tuple[tuple[AnchorSide, AnchorSide], ...], ...]
    """Per stride the (width, height) of each anchor in pixels of the network's input."""
    layout: Literal["NCHW", "NHWC"] = "NCHW"

    @model_validator(mode="after")
    def _anchors_fit_strides(self) -> Self:
        if len(self.anchors_px) != len(self.strides_px):
            raise ValueError(f"anchors_px has {len(self.anchors_px)} scales, strides_px has {len(self.strides_px)}")
        if not all(self.anchors_px):
            raise ValueError("anchors_px has a scale without an anchor")
        return self


class YoloV5Head(_Head):
    """YOLOv5 and YOLOv7 exports: one output (batch, boxes, 5 + classes) with cx, cy, w, h in pixels, objectness, classes."""

    kind: Literal["yolov5"] = "yolov5"


class YoloV8Head(_Head):
    """YOLOv8, v9 and v11 exports: one output (batch, 4 + classes, boxes) with cx, cy, w, h in pixels, class probabilities."""

    kind: Literal["yolov8"] = "yolov8"


class YoloXHead(_Head):
    """YOLOX exports without decoding: one output (batch, cells, 5 + classes), the cells of all strides one after another.

    Objectness and classes are probabilities; x, y are offsets from the cell's corner in strides, w, h logarithms of strides
    (Ge et al. 2021).
    """

    kind: Literal["yolox"] = "yolox"
    strides_px: tuple[PositiveInt, ...] = Field(default=(8, 16, 32), min_length=1)


class EndToEndHead(_Head):
    """Networks with suppression inside (as YOLOv10): one output (batch, boxes, 6) with x0, y0, x1, y1 in pixels, score, class."""

    kind: Literal["end-to-end"] = "end-to-end"


class SideDistributionHead(_Head):
    """Head of the shipped network: values and indices of the best cells of each stride; see `decoding.decode_cells`."""

    kind: Literal["side-distributions"] = "side-distributions"
    side_bins: int = Field(ge=2)
    strides_px: tuple[PositiveInt, ...] = Field(min_length=1)
    """In the order of the outputs."""
    foot_and_tip: bool = False
    """Whether the head gives the object's foot and tip besides its box."""
    class_count: PositiveInt = 1
    """Each class has a score of its own."""

    @property
    def channels(self) -> int:
        return 4 * self.side_bins + (4 if self.foot_and_tip else 0) + self.class_count


YoloHead = YoloV3Head | YoloV5Head | YoloV8Head | YoloXHead | EndToEndHead
Head = SideDistributionHead | YoloHead


def expected_shapes(head: Head) -> list[tuple[int | str, ...]]:
    """Shapes of the outputs that the head reads, in their order; a dimension of any size is a name."""
    match head:
        case YoloV3Head():
            channels = [len(anchors) * (5 + head.class_count) for anchors in head.anchors_px]
            if head.layout == "NCHW":
                return [("batch", count, "rows", "columns") for count in channels]
            return [("batch", "rows", "columns", count) for count in channels]
        case YoloV5Head() | YoloXHead():
            return [("batch", "boxes", 5 + head.class_count)]
        case YoloV8Head():
            return [("batch", 4 + head.class_count, "boxes")]
        case EndToEndHead():
            return [("batch", "boxes", 6)]
        case SideDistributionHead():
            return [("cells", head.channels), ("cells",)] * len(head.strides_px)


def check_outputs(head: Head, shapes: Sequence[Shape]) -> None:
    """Check that a network's outputs have the shapes that the head reads.

    shapes: of the outputs in their order, as onnxruntime reports them; None or a name where a dimension is not fixed.
    Raises ModelFileError where the number of outputs, a rank or a fixed channel count disagrees.
    """
    expected = expected_shapes(head)
    fits = len(expected) == len(shapes) and all(
        len(wanted) == len(found)
        and all(w == f for w, f in zip(wanted, found, strict=True) if isinstance(w, int) and isinstance(f, int))
        for wanted, found in zip(expected, shapes, strict=True)
    )
    if not fits:
        raise ModelFileError(
            f"the head '{head.kind}' expects {_shapes_text(expected)}, the network gives {_shapes_text(shapes)}; "
            "set the sidecar's head to the network's kind and classes, or export the network as that head expects"
        )


def decode_head(
    head: YoloHead, outputs: Sequence[Output], input_height_px: int, input_width_px: int, score_threshold: float
) -> Floats:
    """Outputs of one run -> candidates (N, 6) [x0, y0, x1, y1, score, class] of the first image, in pixels of its input.

    Only boxes whose score reaches the threshold are given, in the network's order. Boxes that are not finite or have no area
    are dropped; boxes may reach beyond the image. Raises ModelFileError where the outputs are not what the head reads: other
    shapes, a grid that does not fit the input, or scores that are not probabilities.
    """
    check_outputs(head, [output.shape for output in outputs])
    first = [output[0] for output in outputs]
    # A wild logarithm of a size overflows to infinity; such boxes are dropped below.
    with np.errstate(over="ignore", invalid="ignore"):
        match head:
            case YoloV3Head():
                candidates = _decode_yolov3(head, first, input_height_px, input_width_px, score_threshold)
            case YoloV5Head():
                candidates = _decode_yolov5(head, first[0], score_threshold)
            case YoloV8Head():
                candidates = _decode_yolov8(head, first[0], score_threshold)
            case YoloXHead():
                candidates = _decode_yolox(head, first[0], input_height_px, input_width_px, score_threshold)
            case EndToEndHead():
                candidates = _decode_end_to_end(head, first[0], score_threshold)
        real = np.isfinite(candidates).all(axis=1) & (candidates[:, 2:4] > candidates[:, :2]).all(axis=1)
    return candidates[real]


def _decode_yolov3(
    head: YoloV3Head, maps: Sequence[Output], input_height_px: int, input_width_px: int, score_threshold: float
) -> Floats:
    """b_xy = (sigmoid(t_xy) + cell) * stride, b_wh = anchor * exp(t_wh), score = sigmoid(objectness) * sigmoid(class)."""
    parts = []
    for raw, stride_px, anchors_px in zip(maps, head.strides_px, head.anchors_px, strict=True):
        grid = raw if head.layout == "NHWC" else np.moveaxis(raw, 0, -1)
        rows, columns = grid.shape[:2]
        if (rows * stride_px, columns * stride_px) != (input_height_px, input_width_px):
            raise ModelFileError(
                f"the head 'yolov3' expects a map of {input_height_px / stride_px:g} x {input_width_px / stride_px:g} cells "
                f"(rows x columns) at stride {stride_px} of an input of {input_height_px} x {input_width_px} px, the network "
                f"gives {rows} x {columns}; set strides_px and anchors_px in the order of the outputs, layout to the network's "
                "own, and pad_multiple_px to a multiple of the largest stride"
            )
        cells = grid.reshape(rows, columns, len(anchors_px), 5 + head.class_count)
        best, classes = _best(_sigmoid(cells[..., 5:]))
        scores = _sigmoid(cells[..., 4]) * best
        row, column, anchor = np.nonzero(scores >= score_threshold)
        chosen = cells[row, column, anchor, :4].astype(np.float64)
        centre = (_sigmoid(chosen[:, :2]) + np.stack((column, row), axis=1)) * stride_px
        size = np.exp(chosen[:, 2:]) * np.asarray(anchors_px, np.float64)[anchor]
        parts.append(_candidates(centre, size, scores[row, column, anchor], classes[row, column, anchor]))
    return np.concatenate(parts)


def _decode_yolov5(head: YoloV5Head, boxes: Output, score_threshold: float) -> Floats:
    """boxes: (A, 5 + classes). With a single class the class is not trained (its loss is off), so objectness is the score."""
    scores, (best, classes) = _probabilities(head, boxes[:, 4]), _best(_probabilities(head, boxes[:, 5:]))
    if head.class_count > 1:
        scores = scores * best
    chosen = scores >= score_threshold
    size = boxes[chosen, :4].astype(np.float64)
    return _candidates(size[:, :2], size[:, 2:], scores[chosen], classes[chosen])


def _decode_yolov8(head: YoloV8Head, channels: Output, score_threshold: float) -> Floats:
    """channels: (4 + classes, A)."""
    scores, classes = _best(_probabilities(head, channels[4:].T))
    chosen = scores >= score_threshold
    box = channels[:4, chosen].T.astype(np.float64)
    return _candidates(box[:, :2], box[:, 2:], scores[chosen], classes[chosen])


def _decode_yolox(
    head: YoloXHead, cells: Output, input_height_px: int, input_width_px: int, score_threshold: float
) -> Floats:
    """cells: (A, 5 + classes). b_xy = (t_xy + cell) * stride, b_wh = exp(t_wh) * stride, score = objectness * class."""
    corners, strides = [], []
    for stride_px in head.strides_px:
        rows, columns = np.mgrid[: input_height_px // stride_px, : input_width_px // stride_px]
        corners.append(np.stack((columns.ravel(), rows.ravel()), axis=1))
        strides.append(np.full(rows.size, float(stride_px)))
    corner, stride = np.concatenate(corners), np.concatenate(strides)
    if len(corner) != len(cells):
        raise ModelFileError(
            f"the head 'yolox' expects {len(corner)} cells at strides {head.strides_px} of an input of {input_height_px} x "
            f"{input_width_px} px, the network gives {len(cells)}; set strides_px to the network's own and pad_multiple_px to a "
            "multiple of the largest stride"
        )
    best, classes = _best(_probabilities(head, cells[:, 5:]))
    scores = _probabilities(head, cells[:, 4]) * best
    chosen = scores >= score_threshold
    box = cells[chosen, :4].astype(np.float64)
    steps = stride[chosen, None]
    return _candidates(
        (box[:, :2] + corner[chosen]) * steps, np.exp(box[:, 2:]) * steps, scores[chosen], classes[chosen]
    )


def _decode_end_to_end(head: EndToEndHead, boxes: Output, score_threshold: float) -> Floats:
    """boxes: (N, 6). Rows that the network did not fill have no area and are dropped by the caller."""
    scores = _probabilities(head, boxes[:, 4])
    chosen = (scores >= score_threshold) & (boxes[:, 5] > -0.5)  # some exports fill up with class -1
    classes = boxes[chosen, 5:].astype(np.float64).round()  # whole numbers, which a 16 bit network may round
    if (classes >= head.class_count).any():
        raise ModelFileError(
            f"the network gives class {classes.max():g}, the sidecar's head has class_count {head.class_count}: "
            "name all classes of the network in class_names and give their number as class_count"
        )
    return np.concatenate((boxes[chosen, :4].astype(np.float64), scores[chosen, None], classes), axis=1)


def _best(probabilities: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """The highest probability of classes (..., C) and its class."""
    classes = probabilities.argmax(axis=-1)
    return np.take_along_axis(probabilities, classes[..., None], axis=-1)[..., 0], classes


def _candidates(centre: Floats, size: Floats, scores: Floats, classes: NDArray[np.intp]) -> Floats:
    """(N, 6) [x0, y0, x1, y1, score, class] of centres (N, 2) and sizes (N, 2) in pixels; a negative size has no area."""
    return np.column_stack((centre - size / 2, centre + size / 2, scores, classes))


def _sigmoid(values: Output) -> Floats:
    # The half tangent does not overflow where exp would.
    result: Floats = 0.5 * (1.0 + np.tanh(0.5 * values.astype(np.float64)))
    return result


def _probabilities(head: YoloHead, values: Output) -> Floats:
    """The values as probabilities; NaN and infinity are kept. Raises ModelFileError if they are clearly outside 0 .. 1."""
    wide: Floats = values.astype(np.float64)
    finite = wide[np.isfinite(wide)]
    if finite.size and (finite.min() < -PROBABILITY_SLACK or finite.max() > 1.0 + PROBABILITY_SLACK):
        raise ModelFileError(
            f"the head '{head.kind}' expects scores from 0 to 1, the network gives {finite.min():.4g} to {finite.max():.4g}; "
            "export it with its sigmoid, or set the sidecar's head to the network's kind and classes"
        )
    return np.where(np.isfinite(wide), np.clip(wide, 0.0, 1.0), wide)


def _shapes_text(shapes: Sequence[Shape]) -> str:
    texts = ["(" + ", ".join("?" if size is None else str(size) for size in shape) + ")" for shape in shapes]
    return f"{len(shapes)} output{'s' if len(shapes) != 1 else ''} {', '.join(texts)}".rstrip()
