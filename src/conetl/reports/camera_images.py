"""Camera images for people: crops around one detection, and whole images with the detector's boxes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.files.documents import library_errors
from conetl.model.arrays import Image
from conetl.model.errors import InputError
from conetl.model.rig import Rig, Side
from conetl.perception.images import IMAGE_SUFFIXES
from conetl.perception.rectified_image import read_rig_image
from conetl.perception.video import frame_of

Box = tuple[float, float, float, float]
"""x, y (top-left corner), width, height in pixels of the rectified image, counted from its edge."""
#: Width and height of what is shown of an object, in those of its box.
SURROUNDINGS = 3.0
#: Blue, green, red. Sky blue with a dark edge is visible on asphalt, orange cones and white stripes.
_CROP_BOX, _CROP_EDGE = (233, 180, 86), (40, 30, 20)
_BOX, _FOOT, _TIP = (0, 230, 255), (60, 220, 60), (255, 140, 40)
_MAX_SIDE_PX = 1600
_MIN_HEIGHT_PX = 300
_MIN_CROP_PX = 64


class ImageMissingError(InputError):
    """The image of a sighting is no longer in the folder from which its drive was ingested."""


def image_file(source_path: str, image_path: str) -> Path:
    """The image file, or the frame of a video, that the database names.

    Raises ImageMissingError for a missing file, or none inside the drive's folder.
    """
    folder, frame = Path(source_path).resolve(), frame_of(image_path)
    path = (folder / (frame.path if frame else image_path)).resolve()  # an absolute path stays absolute
    if (frame is None and path.suffix.lower() not in IMAGE_SUFFIXES) or not path.is_relative_to(folder):
        raise ImageMissingError(f"{Path(image_path).name} is not an image inside the folder of its drive")
    if not path.is_file():
        name = path.relative_to(folder).as_posix()
        raise ImageMissingError(f"the image {name} is missing: restore the drive to {folder}")
    return path if frame is None else Path(str(frame._replace(path=path)))


def crop_jpeg(path: Path, rig: Rig, side: Side, box: Box, *, context: float, whole: bool = False) -> bytes:
    """JPEG of the box and its surroundings, `context` times as tall and wide as the box, with the box drawn.

    What is farther away than `SURROUNDINGS` is pixelated unless `whole`. Small crops are enlarged to 300 pixels. Raises
    ImageFileError where the image cannot be decoded.
    """
    image = read_rig_image(path, rig, side)
    if context > SURROUNDINGS and not whole:
        image = pixelated(image, [box])
    x, y, w, h = box
    rows, columns = _surroundings(image, box, context)
    top, left = rows.start, columns.start
    crop = image[rows, columns]
    scale = min(max(1.0, _MIN_HEIGHT_PX / crop.shape[0]), _MAX_SIDE_PX / max(crop.shape[:2]))
    interpolation = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_CUBIC
    shown = cv2.resize(crop, None, fx=scale, fy=scale, interpolation=interpolation).astype(np.uint8)
    x, y, w, h = (x - left) * scale, (y - top) * scale, w * scale, h * scale
    first, last = (round(x), round(y)), (round(x + w) - 1, round(y + h) - 1)
    for colour, thickness in ((_CROP_EDGE, 3), (_CROP_BOX, 1)):
        cv2.rectangle(shown, first, last, colour, thickness, cv2.LINE_AA)
    return jpeg(shown, 88)


def frame_jpeg(path: Path, rig: Rig, side: Side, boxes: Iterable[Box], *, whole: bool = False) -> bytes:
    """JPEG of a whole rectified image in its own size. What is farther from the boxes than `SURROUNDINGS` is pixelated unless
    `whole`. Raises ImageFileError where the image cannot be decoded.
    """
    image = read_rig_image(path, rig, side)
    return jpeg(image if whole else pixelated(image, boxes), 92)


def pixelated(image: Image, boxes: Iterable[Box]) -> Image:
    """A copy of an image (H, W, 3) in which only the boxes and their surroundings can be recognised.

    The rest is averaged over squares of a 64th of the longer side: faces and number plates beside a road are smaller or hardly
    larger.
    """
    height, width = image.shape[:2]
    square = max(16, round(max(height, width) / 64))
    coarse = cv2.resize(image, (-(-width // square), -(-height // square)), interpolation=cv2.INTER_AREA)
    shown = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST).astype(np.uint8)
    for box in boxes:
        region = _surroundings(image, box, SURROUNDINGS)
        shown[region] = image[region]
    return shown


def _surroundings(image: Image, box: Box, context: float) -> tuple[slice, slice]:
    """Rows and columns of a square around a box, `context` times its longer side, inside the image."""
    x, y, w, h = box
    size = round(max(w * context, h * context, _MIN_CROP_PX))
    return slice(*_interval(y + h / 2, size, image.shape[0])), slice(*_interval(x + w / 2, size, image.shape[1]))


def _interval(centre: float, size: int, length: int) -> tuple[int, int]:
    """Pixels of a crop along one axis: pushed inside at the border, cut where the image is too small; never empty."""
    start = int(np.clip(round(centre - size / 2), 0, max(length - size, 0)))
    return start, min(start + size, length)


def write_annotated_image(
    path: Path, image_bgr: Image, boxes: NDArray[np.float64], categories: Sequence[str] = ("traffic_cone",)
) -> None:
    """Write a JPEG of an image (H, W, 3) with boxes (N, 10) of `detect_image` and the names of their classes; makes the folder.

    Raises InputError where the file cannot be written.
    """
    with library_errors(f"{path} cannot be written", OSError, hint=": choose another folder."):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(jpeg(draw_boxes(image_bgr, boxes, categories), 92))


def pairs_jpeg(rows: Sequence[tuple[Image, Image, str]]) -> bytes:
    """JPEG of left and right images (H, W, 3) side by side, one row per pair below its title."""
    strips, width_px = [], 1400
    for left, right, title in rows:
        pair = np.hstack([left, right[: left.shape[0]]]) if left.shape[0] == right.shape[0] else left
        height = round(pair.shape[0] * width_px / pair.shape[1])
        head = np.full((28, width_px, 3), 255, np.uint8)
        cv2.putText(head, title, (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        strips += [head, cv2.resize(pair, (width_px, height), interpolation=cv2.INTER_AREA)]
    return jpeg(np.vstack(strips), 80)


def draw_boxes(image_bgr: Image, boxes: NDArray[np.float64], categories: Sequence[str] = ("traffic_cone",)) -> Image:
    """A copy of an image with boxes, scores, feet and tips, and the class of what is not a cone; arguments as in
    `write_annotated_image`.
    """
    image = image_bgr.copy()
    width = max(1, round(max(image.shape[:2]) / 900))
    font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.4 * width
    for x, y, w, h, score, *ends, category in boxes.tolist():
        name = categories[int(category)]
        corner, far = (round(x), round(y)), (round(x + w), round(y + h))
        cv2.rectangle(image, corner, far, _BOX, width)
        text = f"{score:.2f}" if name == "traffic_cone" else f"{name.replace('_', ' ')} {score:.2f}"
        (text_w, text_h), _ = cv2.getTextSize(text, font, size, width)
        left = min(corner[0], max(image.shape[1] - text_w, 0))
        base = corner[1] - 2 * width if corner[1] > text_h + 2 * width else far[1] + text_h + 2 * width
        # A dark rim keeps the number readable on a bright sky.
        for colour, thickness in (((0, 0, 0), 3 * width), (_BOX, width)):
            cv2.putText(image, text, (left, base), font, size, colour, thickness, cv2.LINE_AA)
        if np.isfinite(ends).all():
            for (u, v), colour in ((ends[:2], _FOOT), (ends[2:], _TIP)):
                cv2.circle(image, (round(u), round(v)), 2 * width, colour, -1, cv2.LINE_AA)
    return image


def jpeg(image: Image, quality: int) -> bytes:
    """JPEG of an image (H, W, 3) in blue, green, red order."""
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
