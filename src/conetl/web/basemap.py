"""The base map of the operator's choice: tiles of another server, which the browser requests, or a local PMTiles file.

PMTiles version 3: github.com/protomaps/PMTiles, spec/v3/spec.md; raster tiles are read where they lie.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from bisect import bisect_right
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, NamedTuple
from urllib.parse import SplitResult, urlsplit

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi import Path as PathParameter

from conetl.model.errors import InputError, StorageError
from conetl.web.models import BaseMapItem

#: Most servers of XYZ tiles end there; a deeper zoom enlarges the tiles of this one.
DEFAULT_ZOOM = 19
#: Names of the same three numbers in templates of WMTS.
_SYNONYMS = {"TileMatrix": "z", "TileCol": "x", "TileRow": "y"}
_HOST = re.compile(r"(?:[a-z0-9.-]+|\[[0-9a-f:]+\])(?::\d{1,5})?", re.IGNORECASE)
Zoom = Annotated[int, PathParameter(ge=0, le=30)]
Index = Annotated[int, PathParameter(ge=0, le=2**30)]
router = APIRouter(tags=["layers"])
_HEADER_BYTES = 127
_MEDIA_TYPES = {2: "image/png", 3: "image/jpeg", 4: "image/webp", 5: "image/avif"}
_NONE, _GZIP = 1, 2
#: Larger directories and tiles are refused: a damaged file must not fill the memory.
_MAX_DIRECTORY_BYTES, _MAX_ENTRIES = 16_000_000, 100_000
_MAX_TILE_BYTES = 8_000_000
#: The specification allows three levels of leaves below the root in practice.
_MAX_DEPTH = 4


@dataclass(frozen=True)
class BaseMap:
    """Where the tiles come from, in the Web Mercator scheme of XYZ (z/x/y, from the north-west)."""

    item: BaseMapItem
    host: str | None
    """The other server as a source of the content security policy, such as https://tiles.example:8443; None for a file."""
    archive: Archive | None


def base_map(source: str, attribution: str | None = None, max_zoom: int | None = None) -> BaseMap:
    """The base map of a URL template or a PMTiles file. Raises InputError."""
    if "://" not in source:
        archive = open_archive(Path(source))
        deepest = min(archive.max_zoom, max_zoom) if max_zoom is not None else archive.max_zoom
        item = BaseMapItem(template="./api/basemap/{z}/{x}/{y}", attribution=attribution or "", max_zoom=deepest)
        return BaseMap(item, None, archive)
    template = re.sub(r"\{(\w+)\}", lambda m: "{" + _SYNONYMS.get(m[1], m[1]) + "}", source)
    parts = urlsplit(template)
    if parts.scheme not in ("http", "https") or not _HOST.fullmatch(parts.netloc) or not _has_port(parts):
        raise InputError(
            f"--basemap {source}: expected http://HOST/... or https://HOST/... without a login; {{s}} names several hosts"
        )
    names = sorted(re.findall(r"\{([^{}]*)\}", template))
    if names not in (["x", "y", "z"], ["-y", "x", "z"]):
        raise InputError(
            f"--basemap {source}: expected {{z}}, {{x}} and {{y}} (WMTS: {{TileMatrix}}, {{TileCol}}, {{TileRow}}) once each"
        )
    item = BaseMapItem(
        template=template, attribution=attribution or parts.netloc,
        max_zoom=DEFAULT_ZOOM if max_zoom is None else max_zoom,
    )  # fmt: skip
    return BaseMap(item, f"{parts.scheme}://{parts.netloc}", None)


def _has_port(parts: SplitResult) -> bool:
    """Whether the port, if there is one, is one."""
    try:
        return parts.port != 0
    except ValueError:
        return False


@router.get("/basemap/{z}/{x}/{y}", response_class=Response, responses={204: {"description": "No tile there."}})
def tile(z: Zoom, x: Index, y: Index, request: Request) -> Response:
    """One tile of the PMTiles file."""
    chosen: BaseMap | None = request.app.state.basemap
    if chosen is None or chosen.archive is None:
        raise HTTPException(
            404, "This server has no tiles of a base map: start it with `conetl view --basemap FILE.pmtiles`."
        )
    data = chosen.archive.tile(z, x, y)
    if data is None:
        return Response(status_code=204)
    return Response(data, media_type=chosen.archive.media_type, headers={"Cache-Control": "private, max-age=86400"})


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
