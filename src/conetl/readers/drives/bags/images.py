"""Images in the messages of a bag, unpacked once into a folder under the hash of their bytes.

Compressed ones stay as they were recorded, byte for byte; raw ones, mosaics and frames of video become PNG, which loses nothing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.files.atomic import temporary_path
from conetl.files.documents import library_errors
from conetl.model.rejections import RejectionReason
from conetl.perception.images import check_image_bytes
from conetl.perception.video_frames import frame_pixels
from conetl.readers.drives.pairs import PairError

#: Channels, and the conversion to BGR. OpenCV names Bayer patterns from another pixel than ROS does (REP 118, cv_bridge).
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None), "8UC3": (3, None), "mono8": (1, None), "8UC1": (1, None), "rgb8": (3, cv2.COLOR_RGB2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR), "bgra8": (4, cv2.COLOR_BGRA2BGR), "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR), "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
}  # fmt: skip

#: Names of the codecs of a CompressedVideo.
_CODECS = {"h264": "h264", "h265": "hevc", "hevc": "hevc", "vp9": "vp9", "av1": "av1"}


def image_bytes(content: Any, name: str) -> bytes:
    """File bytes of a sensor_msgs CompressedImage (as they are) or Image (as PNG). Raises PairError."""
    data = np.asarray(content.data, dtype=np.uint8)
    if not hasattr(content, "encoding"):
        return _compressed(data.tobytes(), str(getattr(content, "format", "")), name)
    encoding = str(content.encoding)
    if encoding not in _ENCODINGS:
        raise _unknown(encoding, name)
    channels, code = _ENCODINGS[encoding]
    height, width, step = int(content.height), int(content.width), int(content.step)
    if height < 1 or step < width * channels or width < 1 or data.size < height * step:
        raise PairError(
            RejectionReason.IMAGE_TRUNCATED,
            f"{name}: {data.size} bytes are too few for {width} x {height} pixels of {encoding} in rows of {step} bytes",
        )
    rows = data[: height * step].reshape(height, step)[:, : width * channels]
    pixels: NDArray[np.uint8] = np.ascontiguousarray(rows.reshape(height, width, channels))
    return png_of(pixels if code is None else cv2.cvtColor(pixels, code), name)


def _compressed(data: bytes, described: str, name: str) -> bytes:
    """The file in a CompressedImage as it is; of a colour mosaic in one channel ("bayer_rggb8; jpeg compressed") the colours.

    Raises PairError, ImageFileError.
    """
    encoding = described.partition(";")[0].strip()
    if not encoding.startswith("bayer_"):
        return data
    check_image_bytes(data, name, None)
    mosaic = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    if mosaic is None or mosaic.ndim == 3:
        return data
    if encoding not in _ENCODINGS or mosaic.dtype != np.uint8:
        raise _unknown(encoding, name)
    return png_of(cv2.cvtColor(mosaic, int(_ENCODINGS[encoding][1] or 0)), name)


def _unknown(encoding: str, name: str) -> PairError:
    return PairError(
        RejectionReason.IMAGE_UNREADABLE,
        f"{name}: the encoding '{encoding}' is not supported; known: {', '.join(_ENCODINGS)}, and "
        "JPEG or PNG in a CompressedImage",
    )


def png_of(image: NDArray[Any], name: str) -> bytes:
    """The file of an image (height, width, 3) in blue, green, red order, or (height, width). Raises PairError."""
    done, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise PairError(RejectionReason.IMAGE_UNREADABLE, f"{name}: the image cannot be written as PNG")
    return bytes(encoded.tobytes())


def unpack(data: bytes, suffix: str, folder: Path) -> Path:
    """Path of the image in the folder, written unless it exists. Raises InputError where it cannot be written."""
    digest = hashlib.sha256(data).hexdigest()
    path = (folder / digest[:2] / f"{digest}{suffix}").absolute()
    free_space = "; free space or set CONETL_HOME to a folder with more"
    with library_errors(f"{path}: an image of the bag cannot be unpacked there", OSError, hint=free_space):
        if path.is_file() and path.read_bytes() == data:  # it may be damaged, for example by a power failure
            path.touch()  # in use: `old_images` checks its age
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = temporary_path(path)
        unfinished.write_bytes(data)
        unfinished.replace(path)
    return path


class VideoDecoder:
    """Decodes the frames of one topic, each in a message of its own, in the order of their recording."""

    def __init__(self) -> None:
        self._codec: Any = None
        self._name = ""

    def decode(self, number: int, content: Any) -> Iterator[tuple[int, bytes]]:
        """Numbers of messages and the files (PNG) of their images, some of earlier messages. Raises PairError."""
        kind = str(content.format).lower()
        if kind not in _CODECS:
            problem = f"the codec '{kind[:20]}' of a CompressedVideo is not supported; known: {', '.join(_CODECS)}"
            raise PairError(RejectionReason.IMAGE_UNREADABLE, problem)
        if self._codec is None or self._name != kind:
            self._codec, self._name = av.VideoCodecContext.create(_CODECS[kind], "r"), kind
            self._codec.thread_count = 1
        packet = av.Packet(bytes(content.data))
        packet.pts = packet.dts = number
        yield from self._frames(packet)

    def rest(self) -> Iterator[tuple[int, bytes]]:
        """The images that the decoder still holds, at the end."""
        if self._codec is not None:
            yield from self._frames(None)

    def _frames(self, packet: av.Packet[Any] | None) -> Iterator[tuple[int, bytes]]:
        try:
            for frame in self._codec.decode(packet):
                if frame.pts is not None:
                    yield frame.pts, png_of(frame_pixels(frame), "frame of a video")
        except av.FFmpegError as error:
            problem = f"the frame of the video cannot be decoded ({error.strerror})"
            raise PairError(RejectionReason.IMAGE_UNREADABLE, problem) from error
