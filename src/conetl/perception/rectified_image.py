"""Images of a rig as geometry wants them: read, and resampled where the rig that took them is not rectified."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.files.storage import NO_FILE_SHA256
from conetl.geometry.rectification import raw_from_rectified, stored_camera
from conetl.geometry.rig import camera_of
from conetl.model.errors import StorageError
from conetl.model.records import Rig, Side
from conetl.perception.images import ImageFileError, read_image

#: Bicubic: bilinear resampling blurs by how far a pixel falls between its neighbours, and area-based matching sees that as shift.
_INTERPOLATION = cv2.INTER_CUBIC
_BLOCK_ROWS = 64

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


def read_rig_image(path: Path, rig: Rig, side: Side, *, grey: bool = False) -> NDArray[np.uint8]:
    """Image of one side as (height, width, 3) uint8 in blue, green, red order, or (height, width) grey, in the size of the
    rig's own camera.

    Where `rig.rectified_from` is set, the file is one of that rig and is resampled; else it is read as it is, at no cost.
    Raises ImageFileError (see `read_image`).
    """
    stored = stored_camera(rig, side)
    image = read_image(path, (stored.width_px, stored.height_px), grey=grey)
    return image if rig.rectified_from is None else rectify_image(image, rig, side)


def read_hashed_rig_image(path: Path, sha256: str, rig: Rig, side: Side, *, grey: bool = False) -> NDArray[np.uint8]:
    """Like `read_rig_image`, for results that are kept under the image's hash: what is wrong with it has to be true of the
    bytes with that hash (`NO_FILE_SHA256`: of there being none).

    Raises ImageFileError where it is, and StorageError where storage failed or somebody wrote to the image meanwhile.
    """
    try:
        image = read_rig_image(path, rig, side, grey=grey)
    except ImageFileError as error:
        if error.sha256 == sha256:
            raise
        raise StorageError(
            f"{path}: the image changed while it was worked on ({error}). Run the same command again when nobody writes to the "
            "drive. Nothing was written."
        ) from error
    if sha256 == NO_FILE_SHA256:
        raise StorageError(
            f"{path}: the image changed while it was worked on: it was not there, and is now. Run the same command again when "
            "the drive is complete. Nothing was written."
        )
    return image


def read_rig_image_again(path: Path, rig: Rig, side: Side, *, grey: bool = False) -> NDArray[np.uint8]:
    """Like `read_rig_image`, of a image that an earlier step read: that it is not there any more is no property of the drive.

    Raises StorageError.
    """
    try:
        return read_rig_image(path, rig, side, grey=grey)
    except ImageFileError as error:
        raise StorageError(
            f"{path}: the image was read before, but now: {error}. Run the same command again when it is back. "
            "Nothing was written."
        ) from error


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
