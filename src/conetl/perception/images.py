"""Image files -> arrays. A faulty file raises `ImageFileError`, which callers turn into a rejection.

Faults of the storage are not properties of the image and must not be stored as rejections: they raise `StorageError`, and tasks
try again. Size and end of a file are read from its bytes before it is decoded (`image_headers.py`): reading a truncated JPEG can
yield pixels of the image decoded before it (opencv#26488), and OpenCV takes images of up to 2^30 pixels.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from conetl.files.storage import NOT_A_FILE, is_present, is_remote, object_bytes, recall, remember
from conetl.model.arrays import Image
from conetl.model.errors import StorageError
from conetl.model.rejections import RejectionReason
from conetl.model.rig import MAX_IMAGE_PIXELS
from conetl.perception.image_headers import (
    PNG_SIGNATURE,
    ImageFormatError,
    ImageHeader,
    ImageTruncatedError,
    inspect_image,
)

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"})
#: Larger files are not read at all.
MAX_FILE_BYTES = 256 * 2**20
#: A larger image has a byte for this many pixels: one with less shows nothing, and fills the memory.
SMALL_PIXELS, MAX_PIXELS_PER_BYTE = 2**24, 200
_HEAD_BYTES, _TAIL_BYTES = 2**16, 2**12
_PNG_END = b"\0\0\0\0IEND\xaeB`\x82"


class ImageFileError(Exception):
    """One image cannot be used; `reason` is the kind of rejection."""

    def __init__(self, reason: RejectionReason, message: str) -> None:
        super().__init__(message)
        self.reason = reason

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.reason, str(self))  # from a process of its own


def check_image_bytes(
    data: bytes, name: str, expected_size: tuple[int, int] | None, file_bytes: int | None = None
) -> ImageHeader:
    """Check header, size and end marker of an image's bytes. Raises ImageFileError naming `name`.

    file_bytes: size of the file, where `data` is only a part of it.
    """
    try:
        header = inspect_image(data, file_bytes)
    except ImageTruncatedError as error:
        raise ImageFileError(RejectionReason.IMAGE_TRUNCATED, f"{name}: {error}; copy it again") from error
    except ImageFormatError as error:
        raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, f"{name}: {error}; copy it again") from error
    found = (header.width_px, header.height_px)
    if expected_size is not None and found != tuple(expected_size):
        raise ImageFileError(
            RejectionReason.IMAGE_WRONG_SIZE,
            f"{name}: {found[0]} x {found[1]} pixels, but the calibration is for {expected_size[0]} x {expected_size[1]}; "
            "use the calibration of these images",
        )
    pixels, size_bytes = found[0] * found[1], file_bytes or len(data)
    if pixels > MAX_IMAGE_PIXELS:
        raise ImageFileError(RejectionReason.IMAGE_WRONG_SIZE, f"{name}: {found[0]} x {found[1]} pixels are too many")
    if pixels > max(SMALL_PIXELS, MAX_PIXELS_PER_BYTE * size_bytes):
        raise ImageFileError(
            RejectionReason.IMAGE_UNREADABLE,
            f"{name}: the header states {found[0]} x {found[1]} pixels, too many for {size_bytes:,} bytes; copy it again",
        )
    return header


def check_image_ends(path: Path, name: str, expected_size: tuple[int, int]) -> ImageHeader:
    """Like `check_image_bytes`, but reads only the ends of the file and misses damage in between. Raises ImageFileError."""
    data, file_bytes = b"", None
    with _file_errors(path, name):
        if (
            not is_remote(path) and is_present(path)
            and (file_bytes := path.stat().st_size) > _HEAD_BYTES + _TAIL_BYTES
        ):  # fmt: skip
            with path.open("rb") as file:
                data = file.read(_HEAD_BYTES)
                file.seek(-_TAIL_BYTES, 2)
                data += file.read()
    if data.startswith(PNG_SIGNATURE):  # the chunks cannot be walked: the header's own, and the end's
        data = data[:33] + _PNG_END if data.rstrip(b"\0").endswith(_PNG_END) else data[:33]
    if data:
        try:
            return check_image_bytes(data, name, expected_size, file_bytes)
        except ImageFileError:
            pass  # a long header, or really broken: the whole file shows which
    return check_image_bytes(read_bytes(path, name), name, expected_size)


def read_image(path: Path, expected_size: tuple[int, int] | None = None, *, grey: bool = False) -> Image:
    """Image as (height, width, 3) uint8 in blue, green, red order; grey and 16-bit images are converted.

    grey: as (height, width) of brightness; of a JPEG its own, which spares the decoder a third of its work.

    expected_size: (width, height) in pixels that the calibration is for. Header and end marker are checked before the decoder
    sees the file, so that a truncated file never yields pixels. Orientation tags (EXIF) are not applied: calibrations are for
    the pixels as stored. Raises ImageFileError.
    """
    return decode_image(read_bytes(path), path.name, expected_size, grey=grey)


def decode_image(data: bytes, name: str, expected_size: tuple[int, int] | None = None, *, grey: bool = False) -> Image:
    """Like `read_image`, of a file's bytes; `name` is for ImageFileError."""
    if check_image_bytes(data, name, expected_size).format == "jpeg":
        image = _decoded_jpeg(data, name, grey)
    else:
        image = _decoded(
            data, name, (cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
        )
    if expected_size is not None and image.shape[:2] != (expected_size[1], expected_size[0]):
        raise ImageFileError(
            RejectionReason.IMAGE_UNREADABLE, f"{name}: header and decoded image differ in size; copy it again"
        )
    return np.asarray(image, dtype=np.uint8)


def _decoded_jpeg(data: bytes, name: str, grey: bool) -> NDArray[Any]:
    """Pixels of a JPEG, equal to those of OpenCV, which takes almost twice as long and accepts damaged data.

    Raises ImageFileError.
    """
    try:
        return np.asarray(simplejpeg.decode_jpeg(data, "GRAY")[..., 0] if grey else simplejpeg.decode_jpeg(data, "BGR"))
    except ValueError as error:
        raise ImageFileError(
            RejectionReason.IMAGE_UNREADABLE, f"{name}: the image cannot be decoded ({error}); copy it again"
        ) from error


def _decoded(data: bytes, name: str, flags: int) -> NDArray[Any]:
    """An image as OpenCV decodes it. Raises ImageFileError."""
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error as error:
        raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, f"{name}: the decoder failed: {error}") from error
    if image is None:
        raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, f"{name}: the image cannot be decoded; copy it again")
    return np.asarray(image)


def read_upright_image(path: Path) -> Image:
    """Any single image as a person sees it: (height, width, 3) uint8 in blue, green, red order.

    Orientation tags (EXIF) are applied; grey and CMYK become colour; transparent parts become grey; 16-bit images are
    stretched to their own darkest and brightest permille, as many cameras fill only 10 or 12 of the 16 bits. For images
    without a calibration; drives are read by `read_image`. Raises ImageFileError.
    """
    data = read_bytes(path)
    kind = check_image_bytes(data, path.name, None).format
    colour = _decoded(data, path.name, cv2.IMREAD_COLOR)
    stored = _decoded(data, path.name, cv2.IMREAD_UNCHANGED) if kind in ("png", "tiff") else None
    # What IMREAD_COLOR lost: the depth of 16-bit images and transparency. Both decodings have the same orientation or they
    # cannot be put together (an orientation tag in such a PNG); then the plain one stays.
    if stored is None or stored.shape[:2] != colour.shape[:2]:
        return np.asarray(colour, dtype=np.uint8)
    opaque = 65535.0 if stored.dtype == np.uint16 else 255.0
    has_alpha = stored.ndim == 3 and stored.shape[2] == 4
    if stored.dtype != np.uint16 and not has_alpha:
        return np.asarray(colour, dtype=np.uint8)
    image: NDArray[np.float64] = colour.astype(np.float64)
    if stored.dtype == np.uint16:
        deep = stored[..., :3] if stored.ndim == 3 else np.repeat(stored[..., None], 3, axis=2)
        low, high = np.percentile(deep, (0.1, 99.9))
        image = (deep.astype(np.float64) - low) / max(float(high - low), 1.0) * 255.0
    if has_alpha:
        alpha = stored[..., 3:].astype(np.float64) / opaque
        image = image * alpha + 128.0 * (1.0 - alpha)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def read_bytes(path: Path, name: str = "") -> bytes:
    """All bytes of an image file, unchecked. Raises ImageFileError (missing or unreadable) or StorageError (temporary faults).

    name: for ImageFileError; default: the file's.
    """
    name = name or path.name
    with _file_errors(path, name):
        if is_remote(path):
            return object_bytes(path)
        if not is_present(path):
            raise _missing(path, name)
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise ImageFileError(
                RejectionReason.IMAGE_UNREADABLE, f"{name}: {size} bytes are more than {MAX_FILE_BYTES} and not read"
            )
        return path.read_bytes()


def read_hashed_bytes(path: Path, sha256: str) -> bytes:
    """The bytes of an image as they were when its drive was read: from memory, or read again if they are no longer there.

    Raises StorageError if they cannot be read again, or have changed: neither is a property of the drive. Without a hash
    (only headers were read) they are whatever the file holds, and ImageFileError is raised where it cannot be read.
    """
    if not sha256:
        return read_bytes(path)
    data = recall(sha256)
    if data is None:
        try:
            data = read_bytes(path)
        except ImageFileError as error:
            raise _changed(path, error) from error
        if hashlib.sha256(data).hexdigest() != sha256:
            raise _changed(path, "its content differs")
        remember(path, sha256, data)
    return data


def _changed(path: Path, why: object) -> StorageError:
    return StorageError(
        f"{path}: the image changed while conetl read it ({why}). Run the same command again when nothing writes to the drive. "
        "Nothing was written."
    )


@contextmanager
def _file_errors(path: Path, name: str) -> Iterator[None]:
    """Turn errors of the system into ImageFileError (the image) or StorageError (the storage)."""
    try:
        yield
    except FileNotFoundError as error:  # an object; or a file that vanished this moment
        raise _missing(path, name) from error
    except OSError as error:
        reason = error.strerror or error
        if isinstance(error, PermissionError) and _denied_by_mode(path):
            raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, f"{name}: {reason}; make it readable") from error
        raise StorageError(
            f"{path}: this image cannot be read from the storage ({reason}). Check the disk, the network file system and "
            "its tickets, and run the same command again. Nothing was written."
        ) from error


def _missing(path: Path, name: str) -> ImageFileError:
    other = not is_remote(path) and os.path.lexists(path)
    found = NOT_A_FILE if other else "there is no such file"
    return ImageFileError(RejectionReason.IMAGE_MISSING, f"{name}: {found}")


def _denied_by_mode(path: Path) -> bool:
    """Whether the file's mode denies this user reading, which is permanent. Network file systems also deny access temporarily,
    for example with an expired ticket."""
    try:
        found = path.stat()
    except OSError:
        return False
    if found.st_uid == os.geteuid():
        return not found.st_mode & stat.S_IRUSR
    ours = found.st_gid in {os.getegid(), *os.getgroups()}
    return not found.st_mode & (stat.S_IRGRP if ours else stat.S_IROTH)
