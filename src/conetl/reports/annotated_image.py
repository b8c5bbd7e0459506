"""Images with the detector's boxes drawn in, for people to judge."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.model.errors import InputError

#: Blue, green, red.
_BOX, _FOOT, _TIP = (0, 230, 255), (60, 220, 60), (255, 140, 40)


def write_annotated_image(path: Path, image_bgr: NDArray[np.uint8], boxes: NDArray[np.float64]) -> None:
    """Write a JPEG of an image (H, W, 3) with boxes (N, 9) as `detect_image` gives them; makes the folder.

    Raises InputError where the file cannot be written.
    """
    _, data = cv2.imencode(".jpg", draw_boxes(image_bgr, boxes), [cv2.IMWRITE_JPEG_QUALITY, 92])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}): choose another folder.") from error


def pairs_jpeg(rows: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8], str]], *, width_px: int = 1400) -> bytes:
    """Left and right images (H, W, 3) side by side, a row a pair with its title above, as one JPEG of the given width."""
    strips = []
    for left, right, title in rows:
        pair = np.hstack([left, right[: left.shape[0]]]) if left.shape[0] == right.shape[0] else left
        height = round(pair.shape[0] * width_px / pair.shape[1])
        head = np.full((28, width_px, 3), 255, np.uint8)
        cv2.putText(head, title, (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        strips += [head, cv2.resize(pair, (width_px, height), interpolation=cv2.INTER_AREA)]
    _, data = cv2.imencode(".jpg", np.vstack(strips), [cv2.IMWRITE_JPEG_QUALITY, 80])
    return data.tobytes()


def draw_boxes(image_bgr: NDArray[np.uint8], boxes: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A copy of an image with boxes, scores, feet and tips; boxes as in `write_annotated_image`."""
    image = image_bgr.copy()
    width = max(1, round(max(image.shape[:2]) / 900))
    for x, y, w, h, score, *ends in boxes.tolist():
        corner, far = (round(x), round(y)), (round(x + w), round(y + h))
        cv2.rectangle(image, corner, far, _BOX, width)
        size = 0.4 * width
        (text_w, text_h), _ = cv2.getTextSize(f"{score:.2f}", cv2.FONT_HERSHEY_SIMPLEX, size, width)
        left = min(corner[0], max(image.shape[1] - text_w, 0))
        base = corner[1] - 2 * width if corner[1] > text_h + 2 * width else far[1] + text_h + 2 * width
        # A dark rim keeps the number readable on a bright sky.
        for colour, thickness in (((0, 0, 0), 3 * width), (_BOX, width)):
            cv2.putText(
                image, f"{score:.2f}", (left, base), cv2.FONT_HERSHEY_SIMPLEX, size, colour, thickness, cv2.LINE_AA
            )
        if np.isfinite(ends).all():
            for (u, v), colour in ((ends[:2], _FOOT), (ends[2:], _TIP)):
                cv2.circle(image, (round(u), round(v)), 2 * width, colour, -1, cv2.LINE_AA)
    return image
