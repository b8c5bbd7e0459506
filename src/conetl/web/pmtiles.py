"""PMTiles version 3 (github.com/protomaps/PMTiles, spec/v3/spec.md): raster tiles of a file, read where they lie."""

from __future__ import annotations

import os
import struct
import zlib
from bisect import bisect_right
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from conetl.model.errors import InputError, StorageError

_HEADER_BYTES = 127
_MEDIA_TYPES = {2: "image/png", 3: "image/jpeg", 4: "image/webp", 5: "image/avif"}
_NONE, _GZIP = 1, 2
#: Larger directories and tiles are refused: a damaged file must not fill the memory.
_MAX_DIRECTORY_BYTES, _MAX_ENTRIES = 16_000_000, 100_000
_MAX_TILE_BYTES = 8_000_000
#: The specification allows three levels of leaves below the root in practice.
_MAX_DEPTH = 4


class Entry(NamedTuple):
    """A run of equal tiles, or (run 0) a leaf directory."""

    tile_id: int
    run: int
    length: int
    offset: int


class Archive:
    """An open file; reading is safe from several threads."""

    def __init__(self, path: Path, file: int, header: bytes) -> None:
        self._path, self._file = path, file
        numbers = struct.unpack_from("<11Q", header, 8)
        self._root, self._leaves, self._data = (numbers[0], numbers[1]), numbers[4], numbers[6]
        _, self._packed, tile_packed, tile_type, self.min_zoom, self.max_zoom = header[96:102]
        if tile_type not in _MEDIA_TYPES:
            raise InputError(f"{path} holds no raster tiles (type {tile_type}): expected PNG, JPEG, WebP or AVIF")
        if self._packed not in (_NONE, _GZIP) or tile_packed != _NONE or self.max_zoom > 30:
            raise InputError(f"{path} is packed in a way that is not supported: expected gzip or none for directories")
        self.media_type = _MEDIA_TYPES[tile_type]
        self._directory = lru_cache(maxsize=32)(self._read_directory)
        self._directory(*self._root)

    def tile(self, z: int, x: int, y: int) -> bytes | None:
        """The bytes of a tile; None without one. Raises StorageError if the file is damaged."""
        if not (self.min_zoom <= z <= self.max_zoom and x < 1 << z and y < 1 << z):
            return None
        wanted = tile_id(z, x, y)
        at, length = self._root
        for _ in range(_MAX_DEPTH):
            entries = self._directory(at, length)
            index = bisect_right(entries, wanted, key=lambda entry: entry.tile_id) - 1
            if index < 0:
                return None
            entry = entries[index]
            if entry.run == 0:
                at, length = self._leaves + entry.offset, entry.length
                continue
            if wanted >= entry.tile_id + entry.run:
                return None
            return self._read(self._data + entry.offset, entry.length, _MAX_TILE_BYTES)
        raise StorageError(f"{self._path} is damaged: its directories have no end")

    def _read(self, at: int, length: int, most: int) -> bytes:
        if length > most:
            raise StorageError(f"{self._path} is damaged: {length} bytes at {at}, expected at most {most}")
        try:
            data = os.pread(self._file, length, at)
        except (OSError, OverflowError) as error:
            raise StorageError(f"{self._path} cannot be read: {error}") from error
        if len(data) != length:
            raise StorageError(f"{self._path} is truncated: {length} bytes expected at {at}, found {len(data)}")
        return data

    def _read_directory(self, at: int, length: int) -> list[Entry]:
        data = self._read(at, length, _MAX_DIRECTORY_BYTES)
        try:
            if self._packed == _GZIP:
                data = zlib.decompressobj(31).decompress(data, _MAX_DIRECTORY_BYTES)
            return _entries(data)
        except (zlib.error, IndexError) as error:
            raise StorageError(f"{self._path} has a damaged directory at byte {at}") from error


def open_archive(path: Path) -> Archive:
    """A PMTiles file. Raises InputError unless it is one of raster tiles."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        header = os.pread(file, _HEADER_BYTES, 0)
    except OSError as error:
        raise InputError(
            f"--basemap {path}: {error.strerror}; expected a PMTiles file or a URL with {{z}}, {{x}}, {{y}}"
        ) from error
    if len(header) < _HEADER_BYTES or header[:8] != b"PMTiles\x03":
        os.close(file)
        raise InputError(f"--basemap {path} is no PMTiles file of version 3")
    try:
        return Archive(path, file, header)
    except StorageError as error:
        raise InputError(str(error)) from error


def tile_id(z: int, x: int, y: int) -> int:
    """Number of a tile: all of smaller zooms first, then along the Hilbert curve."""
    number, side = ((1 << 2 * z) - 1) // 3, 1 << z
    half = side >> 1
    while half:
        right, down = int(x & half > 0), int(y & half > 0)
        number += half * half * ((3 * right) ^ down)
        if not down:
            if right:
                x, y = side - 1 - x, side - 1 - y
            x, y = y, x
        half >>= 1
    return number


def _entries(data: bytes) -> list[Entry]:
    """The entries of a directory: their number, then one column after the other as varints. Raises IndexError."""
    at = 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80 or shift > 63:
                return value
            shift += 7

    count = varint()
    if count > min(len(data) // 4, _MAX_ENTRIES):  # each has four bytes or more
        raise IndexError(count)
    ids, last = [], 0
    for _ in range(count):
        last += varint()
        ids.append(last)
    runs, lengths = ([varint() for _ in range(count)] for _ in range(2))
    offsets: list[int] = []
    for i in range(count):
        value = varint()
        if value == 0 and i == 0:
            raise IndexError(value)
        offsets.append(offsets[i - 1] + lengths[i - 1] if value == 0 else value - 1)
    return [Entry(*values) for values in zip(ids, runs, lengths, offsets, strict=True)]
