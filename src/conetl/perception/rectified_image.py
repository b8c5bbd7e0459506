"""Images of a rig for geometry: read, and resampled if the cameras that took them are not rectified."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.files.storage import as_path, fetch, recall
from conetl.geometry.rectification import raw_from_rectified, stored_camera
from conetl.geometry.rig import camera_of
from conetl.model.drive import FramePair
from conetl.model.rejections import RejectionReason
from conetl.model.rig import Camera, Rig, Side
from conetl.perception.images import ImageFileError, decode_image, read_hashed_bytes, read_image
from conetl.perception.video import frame_of
from conetl.perception.video_frames import read_frame

#: Bicubic: the blur of bilinear resampling depends on the sub-pixel phase, which area-based matching would measure as a shift.
_INTERPOLATION = cv2.INTER_CUBIC
_BLOCK_ROWS = 64

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


def read_rig_image(path: Path, rig: Rig, side: Side) -> NDArray[np.uint8]:
    """Image of one side as (height, width, 3) uint8 in blue, green, red order, in the size of the rig's own camera.

    Where `rig.rectified_from` is set, the file is one of that rig and is resampled; else it is read as it is, at no cost.
    Raises ImageFileError (see `read_image`).
    """
    stored = stored_camera(rig, side)
    frame = frame_of(path)
    size = stored.width_px, stored.height_px
    image = read_image(path, size) if frame is None else _sized(read_frame(frame), path, stored)
    return image if rig.rectified_from is None else rectify_image(image, rig, side)


def read_pair_image(pair: FramePair, side: Side, rig: Rig, *, grey: bool = False) -> NDArray[np.uint8]:
    """Like `read_rig_image`, of the image of a frame pair as it was when its drive was read; from memory where its bytes are.

    grey: as (height, width). Raises ImageFileError where these bytes are not an image of the rig, StorageError where they can
    no longer be read.
    """
    path, sha256 = pair.image(side)
    stored = stored_camera(rig, side)
    if (frame := frame_of(path)) is not None:
        image = _sized(read_frame(frame, sha256, grey=grey), path, stored)
    else:
        data = read_hashed_bytes(as_path(path), sha256)
        image = decode_image(data, Path(path).name, (stored.width_px, stored.height_px), grey=grey)
    return image if rig.rectified_from is None else rectify_image(image, rig, side)


def _sized(image: NDArray[np.uint8], path: str | Path, stored: Camera) -> NDArray[np.uint8]:
    """The image of a frame. Raises ImageFileError if its size differs from that of its camera: a video may change it."""
    if image.shape[:2] == (stored.height_px, stored.width_px):
        return image
    raise ImageFileError(
        RejectionReason.IMAGE_WRONG_SIZE,
        f"{path}: {image.shape[1]} x {image.shape[0]} pixels, but the calibration is for {stored.width_px} x {stored.height_px}",
    )


def fetch_pairs(pairs: Sequence[FramePair]) -> None:
    """Prefetch the images of some frame pairs together, if they are in object storage and not in memory."""
    images = [pair.image(side) for pair in pairs for side in ("left", "right")]
    fetch([as_path(path) for path, sha256 in images if frame_of(path) is None and recall(sha256) is None])


def rectify_image(image: NDArray[np.uint8], rig: Rig, side: Side) -> NDArray[np.uint8]:
    """A stored image of `rig.rectified_from` resampled to the rig's own camera (8 bits, any number of channels)."""
    map_u, map_v = _maps(rig, side)
    return np.asarray(cv2.remap(image, map_u, map_v, _INTERPOLATION, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


@lru_cache(maxsize=4)
def _maps(rig: Rig, side: Side) -> Maps:
    """Column and row in the stored image of every pixel of the rectified one, (height, width) each. Kept for two rigs."""
    camera = camera_of(rig, side)
    u, v = (np.empty((camera.height_px, camera.width_px), dtype=np.float32) for _ in range(2))
    columns = np.arange(camera.width_px, dtype=np.float64)
    for start in range(0, camera.height_px, _BLOCK_ROWS):  # in blocks: doubles of a 24-megapixel image take gigabytes
        rows = np.arange(start, min(start + _BLOCK_ROWS, camera.height_px), dtype=np.float64)
        source = raw_from_rectified(rig, side, np.stack(np.meshgrid(columns, rows), axis=-1))
        u[start : start + len(rows)], v[start : start + len(rows)] = source[..., 0], source[..., 1]
    # `rectify` leaves no pixel without a source; a rig from elsewhere may: those pixels take the border's colour.
    np.nan_to_num(u, copy=False, nan=-1.0)
    np.nan_to_num(v, copy=False, nan=-1.0)
    return u, v
