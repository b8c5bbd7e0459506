"""Cut the surroundings of one detection out of its image, with the box drawn."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.model.errors import InputError
from conetl.model.records import Rig, Side
from conetl.perception.rectified_image import read_rig_image

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
#: Sky blue of Okabe & Ito, in OpenCV's order; seen on asphalt, orange cones and white stripes alike with its dark edge.
_BOX_BGR = (233, 180, 86)
_EDGE_BGR = (40, 30, 20)
_MAX_SIDE_PX = 1600
_MIN_HEIGHT_PX = 300
_MIN_CROP_PX = 64
_JPEG_QUALITY = 88

Box = tuple[float, float, float, float]
"""x, y (top-left corner), width, height in pixels of the rectified image, counted from its edge."""


class ImageMissingError(InputError):
    """The image of a sighting is not where the drive was ingested from."""


def picture_file(source_path: str, picture_path: str) -> Path:
    """The file of a image that the database names, which must lie in its drive's folder and be a image.

    Raises ImageMissingError where it is gone, leads out of the folder, or is no image.
    """
    folder = Path(source_path).resolve()
    path = (folder / picture_path).resolve()  # an absolute path stays what it is
    if path.suffix.lower() not in IMAGE_SUFFIXES or not path.is_relative_to(folder):
        raise ImageMissingError(f"{Path(picture_path).name} is no image inside the folder of its drive")
    if not path.is_file():
        name = path.relative_to(folder).as_posix()
        raise ImageMissingError(f"the image {name} is not there any more: put the drive back to {folder}")
    return path


def crop_jpeg(path: Path, rig: Rig, side: Side, box: Box, *, context: float) -> bytes:
    """JPEG of the box's surroundings, `context` times as tall and wide as the box (pushed inside at the border), box drawn.

    Small crops are enlarged to 300 pixels. Raises ImageFileError where the image cannot be decoded.
    """
    image = read_rig_image(path, rig, side)
    left, top, right, bottom = _window(box, (image.shape[1], image.shape[0]), context)
    crop = image[top:bottom, left:right]
    scale = max(1.0, _MIN_HEIGHT_PX / crop.shape[0])
    scale = min(scale, _MAX_SIDE_PX / max(crop.shape[:2]))
    shrinks = scale < 1.0
    shown = cv2.resize(
        crop, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    ).astype(np.uint8)
    _draw_box(shown, ((box[0] - left) * scale, (box[1] - top) * scale, box[2] * scale, box[3] * scale))
    done, data = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not done:
        raise ImageMissingError(f"{path.name}: the crop could not be encoded")
    return bytes(data.tobytes())


def _window(box: Box, size_px: tuple[int, int], context: float) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the part of a image of `size_px` (width, height) that is shown; never empty.

    A square around the box, pushed into the image where it stands over the border, cut where the image is too small.
    """
    x, y, w, h = box
    side = round(max(w * context, h * context, _MIN_CROP_PX))
    edges: list[tuple[int, int]] = []
    for centre, length in ((x + w / 2, size_px[0]), (y + h / 2, size_px[1])):
        start = int(np.clip(round(centre - side / 2), 0, max(length - side, 0)))
        edges.append((start, min(start + side, length)))
    (left, right), (top, bottom) = edges
    return left, top, right, bottom


def _draw_box(image: NDArray[np.uint8], box: Box) -> None:
    x, y, w, h = box
    first, last = (round(x), round(y)), (round(x + w) - 1, round(y + h) - 1)
    cv2.rectangle(image, first, last, _EDGE_BGR, 3, cv2.LINE_AA)
    cv2.rectangle(image, first, last, _BOX_BGR, 1, cv2.LINE_AA)
