"""Boxes of the network -> detection records; removal of the frame pairs whose images could not be decoded."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from conetl.model.base import Vec2
from conetl.model.drive import MIN_DETAIL, Detection, Drive, ImageDetail
from conetl.model.errors import DriveFolderError
from conetl.model.feature_classes import CONE, FEATURE_CLASSES
from conetl.model.params import DetectionParams
from conetl.model.rejections import INPUT_REASONS, Rejection, RejectionReason
from conetl.model.rig import Side


def to_detections(
    boxes: NDArray[np.float64],
    *,
    frame_index: int,
    side: Side,
    params: DetectionParams,
    categories: Sequence[str] = (CONE,),
) -> tuple[list[Detection], list[Rejection]]:
    """Detections of one image, by falling score.

    boxes: (N, 5) x, y, width, height in pixels of the original image (x, y top-left) and score, or (N, 10) with foot x, y and tip
    x, y in the same coordinates (NaN if the network does not give them) and the index in `categories`. Boxes below the threshold
    or smaller than `min_height_px` are dropped; invalid boxes (NaN, negative size) are rejected.
    """
    detections: list[Detection] = []
    rejections: list[Rejection] = []
    for row in boxes[np.argsort(-boxes[:, 4], kind="stable")].tolist():
        x, y, width, height, score = row[:5]
        if score < params.score_threshold or height < params.min_height_px:
            continue
        category = categories[int(row[9])] if len(row) > 9 else CONE
        # Plates of signs and boards do not stand on the ground: no network is trained to give their feet.
        has_foot = category not in FEATURE_CLASSES or FEATURE_CLASSES[category].on_road
        try:
            detections.append(
                Detection(
                    frame_index=frame_index,
                    side=side,
                    detection_index=len(detections),
                    category=category,
                    x_px=x,
                    y_px=y,
                    w_px=width,
                    h_px=height,
                    score=score,
                    foot_px=_finite_point(row[5:7]) if has_foot else None,
                    tip_px=_finite_point(row[7:9]) if has_foot else None,
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


def drop_unread_pairs(
    drive: Drive, detections: Sequence[Detection], rejections: Iterable[Rejection]
) -> tuple[Drive, list[Detection]]:
    """The drive and its detections without the frame pairs of which an image could not be decoded, or is torn.

    The reader of a drive checks only headers and ends of images, so such a pair is part of the drive until its images are
    decoded. It must be dropped: a cone that is not detected in an unreadable image is not a cone that is gone. rejections: those
    of the detection. Raises DriveFolderError if no pair is left.
    """
    undecoded = [r for r in rejections if r.reason in INPUT_REASONS]
    lost = {r.payload["frame_index"] for r in undecoded}
    if not lost:
        return drive, list(detections)
    kept = tuple(pair for pair in drive.frame_pairs if pair.frame_index not in lost)
    if not kept:
        raise DriveFolderError(
            f"{drive.source_path}: none of {len(drive.frame_pairs)} frame pairs has two images that can be decoded; "
            f"the first: {undecoded[0].record}: {undecoded[0].detail}"
        )
    return drive.model_copy(update={"frame_pairs": kept}), [d for d in detections if d.frame_index not in lost]


def add_image_detail(drive: Drive, details: Iterable[ImageDetail]) -> tuple[Drive, list[Rejection]]:
    """The drive with the detail of its images in its frame pairs; rejections of pairs that are no evidence of absence."""
    least: dict[int, ImageDetail] = {}
    for one in details:
        if one.frame_index not in least or one.detail < least[one.frame_index].detail:
            least[one.frame_index] = one
    pairs = tuple(
        pair.model_copy(update={"detail": least[pair.frame_index].detail}) if pair.frame_index in least else pair
        for pair in drive.frame_pairs
    )
    refused = [
        Rejection(
            step="detections",
            reason=RejectionReason.IMAGE_WITHOUT_DETAIL,
            record=f"frame pair {pair.frame_index}",
            detail=f"the {least[pair.frame_index].side} image shows fine structure of {pair.detail:.1f} grey levels, at least "
            f"{MIN_DETAIL:.0f} are needed to conclude that a cone is gone: check for a covered lens, darkness, fog, blur or "
            "strong compression",
            payload={"frame_index": pair.frame_index, "side": least[pair.frame_index].side, "detail": pair.detail},
        )
        for pair in pairs
        if not pair.shows_absence
    ]
    return drive.model_copy(update={"frame_pairs": pairs}), refused


def _finite_point(xy: list[float]) -> Vec2 | None:
    """An image point; None unless it has two finite coordinates."""
    return (xy[0], xy[1]) if len(xy) == 2 and np.isfinite(xy).all() else None
