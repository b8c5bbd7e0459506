"""What a JPEG or PNG file says of itself, without decoding it: size and whether it is all there.

A decoder cannot be asked: reading a truncated JPEG can yield pixels of the image decoded before it (opencv#26488), and
OpenCV takes images of up to 2^30 pixels. So the markers and the size are read first, from the bytes.
"""

from __future__ import annotations

import zlib
from typing import NamedTuple

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: Start-of-frame markers: all of C0..CF but DHT (C4), JPG (C8) and DAC (CC).
_SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_STANDALONE = frozenset({0x01, *range(0xD0, 0xD8)})


class ImageFormatError(ValueError):
    """The bytes are neither a JPEG nor a PNG that could be decoded."""


class ImageTruncatedError(ValueError):
    """The file starts like an image but ends too early."""


class ImageHeader(NamedTuple):
    """Format ("jpeg" or "png") and size in pixels."""

    format: str
    width_px: int
    height_px: int


def inspect_image(data: bytes) -> ImageHeader:
    """Header of a whole image file.

    Raises ImageFormatError for anything but JPEG and PNG, ImageTruncatedError where the end is missing.
    """
    if not data:
        raise ImageFormatError("the file is empty")
    if data.startswith(_PNG_SIGNATURE):
        return _inspect_png(data)
    if data.startswith(b"\xff\xd8"):
        return _inspect_jpeg(data)
    raise ImageFormatError(f"the file is neither a JPEG nor a PNG; it begins with {data[:4].hex(' ')}")


def _inspect_png(data: bytes) -> ImageHeader:
    """Walk the chunks up to IEND and check the checksum of each."""
    position = len(_PNG_SIGNATURE)
    size: tuple[int, int] | None = None
    view = memoryview(data)
    while True:
        if position + 12 > len(data):
            raise ImageTruncatedError("the PNG ends before its IEND chunk")
        length = int.from_bytes(data[position : position + 4], "big")
        kind = data[position + 4 : position + 8]
        end = position + 12 + length
        if end > len(data):
            raise ImageTruncatedError(f"the PNG ends inside its {kind.decode('latin-1')} chunk")
        if zlib.crc32(view[position + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            raise ImageFormatError(f"the PNG's {kind.decode('latin-1')} chunk is damaged (checksum)")
        if size is None:
            if kind != b"IHDR" or length != 13:
                raise ImageFormatError("the PNG does not begin with an IHDR chunk")
            size = (int.from_bytes(data[position + 8 : position + 12], "big"),
                    int.from_bytes(data[position + 12 : position + 16], "big"))  # fmt: skip
        if kind == b"IEND":
            break
        position = end
    return _header("png", *size)


def _inspect_jpeg(data: bytes) -> ImageHeader:
    """Walk the segments to the first scan, then look for the end marker.

    Inside scan data every FF byte is stuffed, so FF D9 there is the end marker and nothing else.
    """
    position, size, scanned = 2, None, False
    while not scanned:
        if position + 4 > len(data):
            raise ImageTruncatedError("the JPEG ends inside its header")
        if data[position] != 0xFF:
            raise ImageFormatError(f"the JPEG's header is damaged at byte {position}")
        marker = data[position + 1]
        if marker == 0xFF:
            position += 1
            continue
        if marker in _STANDALONE:
            position += 2
            continue
        if marker == 0xD9:
            raise ImageTruncatedError("the JPEG holds no image data")
        length = int.from_bytes(data[position + 2 : position + 4], "big")
        if length < 2:
            raise ImageFormatError(f"the JPEG's header is damaged at byte {position}")
        if position + 2 + length > len(data):
            raise ImageTruncatedError("the JPEG ends inside its header")
        if marker in _SOF:
            if length < 8:
                raise ImageFormatError(f"the JPEG's header is damaged at byte {position}")
            body = data[position + 4 : position + 2 + length]
            size = (int.from_bytes(body[3:5], "big"), int.from_bytes(body[1:3], "big"))
        scanned = marker == 0xDA
        position += 2 + length
    # Some cameras pad the file; the end marker must still be the last thing that means anything.
    if not data[position:].rstrip(b"\x00\r\n ").endswith(b"\xff\xd9"):
        raise ImageTruncatedError("the JPEG lacks its end marker (FF D9): the file was cut off")
    if size is None:
        raise ImageFormatError("the JPEG has no frame header")
    return _header("jpeg", *size)


def _header(kind: str, width: int, height: int) -> ImageHeader:
    if width < 1 or height < 1:
        raise ImageFormatError(f"the {kind.upper()} says it is {width} x {height} pixels")
    return ImageHeader(kind, width, height)
