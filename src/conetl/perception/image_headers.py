"""Headers of image files: format, size and whether the file is whole, from its bytes and without a decoder."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import NamedTuple

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: Start-of-frame markers: all of C0..CF but DHT (C4), JPG (C8) and DAC (CC).
_SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_STANDALONE = frozenset({0x01, *range(0xD0, 0xD8)})
#: Width, height, offsets and sizes of strips and of tiles.
_TIFF_TAGS = frozenset({256, 257, 273, 279, 324, 325})
_MOST_TAGS, _MOST_STRIPS = 1000, 100_000


class ImageFormatError(ValueError):
    """The bytes are not an image that could be decoded."""


class ImageTruncatedError(ValueError):
    """The file starts like an image but ends too early."""


class ImageHeader(NamedTuple):
    """Format ("jpeg", "png", "tiff", "bmp" or "webp") and size in pixels."""

    format: str
    width_px: int
    height_px: int


def inspect_image(data: bytes, file_bytes: int | None = None) -> ImageHeader:
    """Header of a whole image file; file_bytes: its size, where `data` is only its beginning and end.

    Raises ImageFormatError for anything but JPEG, PNG, TIFF, BMP and WebP, ImageTruncatedError where the end is missing.
    """
    if not data:
        raise ImageFormatError("the file is empty")
    for signature, inspect in _FORMATS.items():
        if data.startswith(signature):
            return inspect(data)
    try:
        if data.startswith(b"BM"):
            return _inspect_bmp(data, file_bytes or len(data))
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _inspect_webp(data, file_bytes or len(data))
        if data[:4] in (b"II*\0", b"MM\0*"):
            return _inspect_tiff(data)
    except (struct.error, IndexError) as error:
        raise ImageTruncatedError("the image ends inside its header") from error
    raise ImageFormatError(f"the file is no JPEG, PNG, TIFF, BMP or WebP; it begins with {data[:4].hex(' ')}")


def _inspect_bmp(data: bytes, file_bytes: int) -> ImageHeader:
    """The headers of BITMAPFILEHEADER and BITMAPINFOHEADER (or later ones); uncompressed pixels must be there."""
    begin, header = struct.unpack_from("<II", data, 10)
    if header < 40:
        raise ImageFormatError("the BMP has a header of OS/2")
    width, height, _, bits, compression = struct.unpack_from("<iiHHI", data, 18)
    found = _header("bmp", width, abs(height))
    row = (width * bits + 31) // 32 * 4
    if bits not in (8, 24, 32) or compression not in (0, 3):
        raise ImageFormatError(
            f"the BMP has {bits} bits a pixel in compression {compression}; known are 8, 24 and 32 without it"
        )
    if begin + row * found.height_px > file_bytes:
        raise ImageTruncatedError("the BMP ends before its last row")
    return found


def _inspect_webp(data: bytes, file_bytes: int) -> ImageHeader:
    """The first chunk: VP8 (lossy), VP8L (lossless) or VP8X (extended), see RFC 9649."""
    (size,), kind = struct.unpack_from("<I", data, 4), data[12:16]
    if size + 8 > file_bytes:
        raise ImageTruncatedError("the WebP ends before its last chunk")
    if kind == b"VP8 ":
        if data[23:26] != b"\x9d\x01\x2a":
            raise ImageFormatError("the WebP does not begin with a key frame")
        width, height = struct.unpack_from("<HH", data, 26)
        return _header("webp", width & 0x3FFF, height & 0x3FFF)
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return _header("webp", (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1)
    if kind == b"VP8X" and not data[20] & 2:
        low = struct.unpack_from("<HBHB", data, 24)
        return _header("webp", (low[1] << 16 | low[0]) + 1, (low[3] << 16 | low[2]) + 1)
    raise ImageFormatError("the WebP is an animation, or has no known first chunk")


def _inspect_tiff(data: bytes) -> ImageHeader:
    """The first image: its size, and that its strips or tiles are in the file (TIFF 6.0)."""
    order = "<" if data.startswith(b"II") else ">"
    (position,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, position)
    found: dict[int, list[int]] = {}
    for n in range(min(count, _MOST_TAGS)):
        tag, kind, values = struct.unpack_from(f"{order}HHI", data, position + 2 + 12 * n)
        letter = {3: "H", 4: "I"}.get(kind)
        if letter is None or tag not in _TIFF_TAGS or values > _MOST_STRIPS:
            continue
        at = position + 10 + 12 * n
        if values * struct.calcsize(letter) > 4:
            (at,) = struct.unpack_from(f"{order}I", data, at)
        found[tag] = list(struct.unpack_from(f"{order}{values}{letter}", data, at))
    offsets, counts = found.get(273, []) + found.get(324, []), found.get(279, []) + found.get(325, [])
    if not offsets or len(offsets) != len(counts) or not found.get(256) or not found.get(257):
        raise ImageFormatError("the TIFF states no size, or not where its pixels are")
    if max(a + b for a, b in zip(offsets, counts, strict=True)) > len(data):
        raise ImageTruncatedError("the TIFF ends before its last strip")
    return _header("tiff", found[256][0], found[257][0])


def _inspect_png(data: bytes) -> ImageHeader:
    """Walk the chunks up to IEND and check the checksum of each."""
    position = len(PNG_SIGNATURE)
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
        if marker == 0xFF or marker in _STANDALONE:
            position += 1 if marker == 0xFF else 2
            continue
        if marker == 0xD9:
            raise ImageTruncatedError("the JPEG holds no image data")
        length = int.from_bytes(data[position + 2 : position + 4], "big")
        if length < (8 if marker in _SOF else 2):
            raise ImageFormatError(f"the JPEG's header is damaged at byte {position}")
        if position + 2 + length > len(data):
            raise ImageTruncatedError("the JPEG ends inside its header")
        if marker in _SOF:
            body = data[position + 4 : position + 2 + length]
            size = (int.from_bytes(body[3:5], "big"), int.from_bytes(body[1:3], "big"))
        scanned = marker == 0xDA
        position += 2 + length
    # Some cameras pad the file; only padding may follow the end marker.
    if not data[position:].rstrip(b"\x00\r\n ").endswith(b"\xff\xd9"):
        raise ImageTruncatedError("the JPEG lacks its end marker (FF D9): the file is truncated")
    if size is None:
        raise ImageFormatError("the JPEG has no frame header")
    return _header("jpeg", *size)


def _header(kind: str, width: int, height: int) -> ImageHeader:
    if width < 1 or height < 1:
        raise ImageFormatError(f"the {kind.upper()} says it is {width} x {height} pixels")
    return ImageHeader(kind, width, height)


_FORMATS: dict[bytes, Callable[[bytes], ImageHeader]] = {PNG_SIGNATURE: _inspect_png, b"\xff\xd8": _inspect_jpeg}
