"""Boxes of the network -> detection records."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from conetl.params import DetectionParams
from conetl.records import Detection, Side
from conetl.rejections import Rejection, RejectionReason


def check_boxes(
    boxes: NDArray[np.float64], *, frame_index: int, side: Side, params: DetectionParams
) -> tuple[list[Detection], list[Rejection]]:
    """Turn one image's boxes into detections, by falling score.

    boxes: (N, 5 or more) x, y, width, height in pixels of the original image (x, y top-left) and score. Boxes lower than the
    threshold or smaller than `min_height_px` are not detections at all; a box that is no box (NaN, negative size) is rejected.
    """
    detections: list[Detection] = []
    rejections: list[Rejection] = []
    for x, y, width, height, score in boxes[np.argsort(-boxes[:, 4], kind="stable"), :5].tolist():
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
