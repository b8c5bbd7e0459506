"""Boxes of the network -> detection records."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from conetl.model.params import DetectionParams
from conetl.model.records import Detection, Side, Vec2
from conetl.model.rejections import Rejection, RejectionReason


def check_boxes(
    boxes: NDArray[np.float64], *, frame_index: int, side: Side, params: DetectionParams
) -> tuple[list[Detection], list[Rejection]]:
    """Turn one image's boxes into detections, by falling score.

    boxes: (N, 5) x, y, width, height in pixels of the original image (x, y top-left) and score, or (N, 9) with foot x, y and
    tip x, y in box edges besides; NaN there where the network does not tell. Boxes lower than the threshold or smaller than
    `min_height_px` are not detections at all; a box that is no box (NaN, negative size) is rejected.
    """
    detections: list[Detection] = []
    rejections: list[Rejection] = []
    for row in boxes[np.argsort(-boxes[:, 4], kind="stable")].tolist():
        x, y, width, height, score = row[:5]
        if score < params.score_threshold or height < params.min_height_px:
            continue
        try:
            detections.append(
                Detection(
                    frame_index=frame_index,
                    side=side,
                    detection_index=len(detections),
                    x_px=x,
                    y_px=y,
                    w_px=width,
                    h_px=height,
                    score=score,
                    foot_px=_point(row[5:7]),
                    tip_px=_point(row[7:9]),
                )
            )
        except ValidationError as error:
            rejections.append(
                Rejection(
                    step="detections",
                    reason=RejectionReason.DETECTION_INVALID,
                    record=f"a box in the {side} image of frame pair {frame_index}",
                    detail=f"expected a finite box with positive size and a score in 0..1: {error.errors()[0]['msg']}",
                    payload={"box": [repr(value) for value in (x, y, width, height, score)]},
                )
            )
    return detections, rejections


def _point(xy: list[float]) -> Vec2 | None:
    """An image point, None where there is none or it is not two finite numbers."""
    return (xy[0], xy[1]) if len(xy) == 2 and np.isfinite(xy).all() else None
