"""Pictures with the detector's boxes drawn in, for people to judge."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.errors import InputError

#: Blue, green, red.
_BOX, _FOOT, _TIP = (0, 230, 255), (60, 220, 60), (255, 140, 40)


def write_annotated_image(path: Path, image_bgr: NDArray[np.uint8], boxes: NDArray[np.float64]) -> None:
    """Write a JPEG of an image (H, W, 3) with boxes (N, 9) as `detect_image` gives them; makes the folder.

    Raises InputError where the file cannot be written.
    """
    picture = image_bgr.copy()
    width = max(1, round(max(picture.shape[:2]) / 900))
    for x, y, w, h, score, *ends in boxes.tolist():
        corner, far = (round(x), round(y)), (round(x + w), round(y + h))
        cv2.rectangle(picture, corner, far, _BOX, width)
        size = 0.4 * width
        (text_w, text_h), _ = cv2.getTextSize(f"{score:.2f}", cv2.FONT_HERSHEY_SIMPLEX, size, width)
        left = min(corner[0], max(picture.shape[1] - text_w, 0))
        base = corner[1] - 2 * width if corner[1] > text_h + 2 * width else far[1] + text_h + 2 * width
        # A dark rim keeps the number readable on a bright sky.
        for colour, thickness in (((0, 0, 0), 3 * width), (_BOX, width)):
            cv2.putText(
                picture, f"{score:.2f}", (left, base), cv2.FONT_HERSHEY_SIMPLEX, size, colour, thickness, cv2.LINE_AA
            )
        if np.isfinite(ends).all():
            for (u, v), colour in ((ends[:2], _FOOT), (ends[2:], _TIP)):
                cv2.circle(picture, (round(u), round(v)), 2 * width, colour, -1, cv2.LINE_AA)
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 92])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}): choose another folder.") from error
