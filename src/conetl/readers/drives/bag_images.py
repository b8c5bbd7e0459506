"""Images of a bag, each unpacked once into a folder under the hash of its bytes.

Compressed images are stored as they were recorded, byte for byte; raw ones as PNG, which loses nothing.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.model.errors import DriveFolderError
from conetl.model.rejections import RejectionReason
from conetl.perception.images import ImageFileError, check_image_bytes
from conetl.readers.drives.pairs import PairError

#: OpenCV names Bayer patterns from another pixel than ROS does (REP 118, cv_bridge).
_TO_BGR: dict[str, int | None] = {
    "bgr8": None, "8UC3": None, "mono8": None, "8UC1": None, "rgb8": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR, "bayer_rggb8": cv2.COLOR_BayerBG2BGR, "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR, "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
}  # fmt: skip
_CHANNELS = {"bgr8": 3, "8UC3": 3, "rgb8": 3, "rgba8": 4, "bgra8": 4}


def image_bytes(content: Any, name: str) -> bytes:
    """File bytes of a sensor_msgs CompressedImage (as they are) or Image (as PNG). Raises PairError."""
    data = np.asarray(content.data, dtype=np.uint8)
    if not hasattr(content, "encoding"):
        return data.tobytes()
    encoding = str(content.encoding)
    if encoding not in _TO_BGR:
        raise PairError(
            RejectionReason.IMAGE_UNREADABLE,
            f"{name}: the encoding '{encoding}' is not supported; known: {', '.join(_TO_BGR)}, and "
            "JPEG or PNG in a CompressedImage",
        )
    channels = _CHANNELS.get(encoding, 1)
    height, width, step = int(content.height), int(content.width), int(content.step)
    if height < 1 or step < width * channels or width < 1 or data.size < height * step:
        raise PairError(
            RejectionReason.IMAGE_TRUNCATED,
            f"{name}: {data.size} bytes are too few for {width} x {height} pixels of {encoding} in rows of {step} bytes",
        )
    rows = data[: height * step].reshape(height, step)[:, : width * channels]
    pixels: NDArray[np.uint8] = np.ascontiguousarray(rows.reshape(height, width, channels))
    code = _TO_BGR[encoding]
    image = pixels if code is None else cv2.cvtColor(pixels, code)
    done, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise PairError(RejectionReason.IMAGE_UNREADABLE, f"{name}: the image cannot be written as PNG")
    return bytes(encoded.tobytes())


def check_image(data: bytes, name: str, size: tuple[int, int]) -> str:
    """Suffix of a complete image of this width and height. Raises PairError."""
    try:
        header = check_image_bytes(data, name, size)
    except ImageFileError as error:
        raise PairError(error.reason, str(error), path=name) from error
    return ".jpg" if header.format == "jpeg" else ".png"


def unpack(data: bytes, suffix: str, folder: Path) -> Path:
    """Path of the image in the folder, written unless it exists. Raises DriveFolderError where it cannot be written."""
    digest = hashlib.sha256(data).hexdigest()
    path = (folder / digest[:2] / f"{digest}{suffix}").absolute()
    try:
        if path.is_file() and path.stat().st_size == len(data):
            path.touch()  # in use: `expiry.old_images` checks its age
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{digest}.", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except OSError as error:
        raise DriveFolderError(
            f"{path}: an image of the bag cannot be unpacked there: {error.strerror or error}; free space or set CONETL_HOME to "
            "a folder with more"
        ) from error
    return path
