"""Output of the shipped network -> boxes.

Pixel convention: a box is [x, y, w, h] with x, y its top-left corner; the centre of the top-left pixel is (0.5, 0.5) in
these box coordinates, that is, an image W wide spans x = 0 .. W. See `docs/reference/coordinates.md` for observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.model.arrays import Floats

#: x0, y0, x1, y1, score, foot x, foot y, tip x, tip y, class
COLUMNS = 10
#: Candidates (N, 10), and the score below which the network may have omitted some.
NetworkBoxes = tuple[Floats, float]


def decode_cells(
    outputs: Sequence[NDArray[Any]],
    images_and_size: tuple[int, int, int],
    strides_px: Sequence[int],
    bins: int,
    score_threshold: float,
    *,
    foot_and_tip: bool = False,
    class_count: int = 1,
) -> tuple[Floats, NDArray[np.int64], float]:
    """Cells of all strides -> candidates (N, 10) in pixels of the network's input, the image (N,) of each, and the highest score
    that cells may have which the network omitted: it returns its best cells of each stride only (0 where it returns all).

    Columns: x0, y0, x1, y1, score, foot x, foot y, tip x, tip y, class. outputs: in turn values (K, 4*bins + class_count), or
    (K, 4*bins + 4 + class_count) with `foot_and_tip`, of a stride's cells, and their indices (K,) in the row-major maps of the
    images, one after the other, each of the input's height and width over the stride; without `foot_and_tip` its four columns
    are NaN. images_and_size: number of images, height and width in pixels. Each side (left, top, right, bottom) is a
    distribution over `bins` distances in strides from the cell's centre; its expectation is the distance (distribution focal
    loss, Li et al. 2020). Foot and tip are offsets in shares of the box from the middle of its lower and upper side; the last
    values are the logits of the classes, of which a cell has the best. Cells below the threshold are left out.
    Raises ValueError on arrays of another head.
    """
    channels = 4 * bins + (4 if foot_and_tip else 0) + class_count
    for values, cells in zip(outputs[::2], outputs[1::2], strict=True):
        if values.ndim != 2 or values.shape[1] != channels or cells.shape != values.shape[:1]:
            raise ValueError(f"cells have shapes {values.shape} and {cells.shape}, expected (K, {channels}) and (K,)")
    counts = [len(cells) for cells in outputs[1::2]]
    numbers, cells_at = np.concatenate(outputs[::2]), np.concatenate(outputs[1::2])
    # Along rows of a few numbers numpy takes six times as long.
    best = np.ascontiguousarray(numbers[:, -class_count:].T).max(axis=0)
    scores = 1.0 / (1.0 + np.exp(-best.astype(np.float64)))
    number, height_px, width_px = images_and_size
    omitted, first = 0.0, 0
    for count, stride_px in zip(counts, strides_px, strict=True):
        if 0 < count < number * (height_px // stride_px) * (width_px // stride_px):
            omitted = max(omitted, float(scores[first : first + count].min()))
        first += count
    kept = np.flatnonzero(scores >= score_threshold)
    scores, cells_at, strides = scores[kept], cells_at[kept], np.repeat(strides_px, counts)[kept]
    numbers = numbers[kept].astype(np.float64).T
    classes = numbers[-class_count:].argmax(axis=0)
    in_row, in_column = width_px // strides, height_px // strides
    images, cells_at = np.divmod(cells_at, in_row * in_column)
    rows, columns = np.divmod(cells_at, in_row)
    logits = numbers[: 4 * bins].reshape(4, bins, -1)
    weights = np.exp(logits - logits.max(axis=1, keepdims=True))
    left, top, right, bottom = (weights * np.arange(bins)[None, :, None]).sum(1) / weights.sum(1) * strides
    x_px, y_px = (columns + 0.5) * strides, (rows + 0.5) * strides
    x0, y0, x1, y1 = x_px - left, y_px - top, x_px + right, y_px + bottom
    ends = np.full((4, len(scores)), np.nan)
    if foot_and_tip:
        shares, middle = numbers[4 * bins : 4 * bins + 4], (x0 + x1) / 2
        ends[0], ends[1] = middle + shares[0] * (x1 - x0), y1 - shares[1] * (y1 - y0)
        ends[2], ends[3] = middle + shares[2] * (x1 - x0), y0 + shares[3] * (y1 - y0)
    return np.stack((x0, y0, x1, y1, scores, *ends, classes), axis=1), images, omitted


def intersection_over_union(box: Floats, boxes: Floats) -> Floats:
    """IoU of one box (4,) with boxes (N, 4), all [x0, y0, x1, y1]; boxes without area have IoU 0."""
    low = np.maximum(box[:2], boxes[:, :2])
    high = np.minimum(box[2:], boxes[:, 2:])
    shared = np.prod(np.clip(high - low, 0.0, None), axis=1)
    area = np.prod(np.clip(boxes[:, 2:] - boxes[:, :2], 0.0, None), axis=1)
    union = area + np.prod(np.clip(box[2:] - box[:2], 0.0, None)) - shared
    iou: Floats = np.divide(shared, union, out=np.zeros_like(shared), where=union > 0.0)
    return iou


def suppress_overlaps(candidates: Floats, nms_iou: float) -> Floats:
    """Greedy non-maximum suppression of candidates (N, 5 or more) [x0, y0, x1, y1, score, ...]; survivors by falling score.

    No two survivors overlap by more than `nms_iou`, in single precision; equal scores keep their order (the sort is stable).
    """
    if len(candidates) < 2:
        return candidates
    ordered = candidates[np.argsort(-candidates[:, 4], kind="stable")]
    corners_and_sizes = np.concatenate((ordered[:, :2], ordered[:, 2:4] - ordered[:, :2]), axis=1)
    # Ranks instead of scores: OpenCV takes scores in single precision, of which more are equal.
    ranks = np.arange(len(ordered), 0.0, -1.0)
    kept = cv2.dnn.NMSBoxes(corners_and_sizes, ranks, 0.0, nms_iou)  # type: ignore[arg-type]
    return ordered[np.asarray(kept, np.intp)]


def suppress_parts(candidates: Floats, larger: Floats) -> Floats:
    """Candidates (N, 5) without those that are only a part of a better box of `larger` (M, 5).

    A part has four fifths of its area inside a box that is at least twice as large and scores at least as high, such as the
    reflective band of a cone that fills the image.
    """
    area = np.prod(candidates[:, 2:4] - candidates[:, :2], axis=1)
    part = np.zeros(len(candidates), dtype=bool)
    for box in larger:
        low, high = np.maximum(box[:2], candidates[:, :2]), np.minimum(box[2:4], candidates[:, 2:4])
        shared = np.prod(np.clip(high - low, 0.0, None), axis=1)
        better = (box[4] >= candidates[:, 4]) & (np.prod(box[2:4] - box[:2]) >= 2.0 * area)
        part |= better & (shared >= 0.8 * area)
    return candidates[~part]


def boxes_in_image(boxes: Floats, width_px: int, height_px: int) -> Floats:
    """Candidates (N, 5 or more) [x0, y0, x1, y1, score, ...] in pixels of the image -> [x, y, w, h, score, ...].

    Boxes are clipped to the image; those in the padding are dropped. Further columns stay as they are.
    """
    corners = np.clip(boxes[:, :4], 0.0, (width_px, height_px, width_px, height_px))
    size = corners[:, 2:] - corners[:, :2]
    inside = (size > 0.0).all(axis=1)
    return np.concatenate((corners[:, :2], size, boxes[:, 4:]), axis=1)[inside]
