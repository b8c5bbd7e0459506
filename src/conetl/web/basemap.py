"""The base map that the operator chose: tiles of another server, which the browser requests, or a local PMTiles file.

Raster tiles of a PMTiles file of version 3 are read in place.
"""

from __future__ import annotations

import os
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated
from urllib.parse import SplitResult, urlsplit

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi import Path as PathParameter
from pmtiles.reader import Reader
from pmtiles.tile import Compression, TileType

from conetl.model.errors import InputError, StorageError
from conetl.web.models import BaseMapItem

#: Most XYZ servers have no deeper level; a deeper zoom enlarges the tiles of this one.
DEFAULT_ZOOM = 19
#: Names of the same three numbers in WMTS templates.
_SYNONYMS = {"TileMatrix": "z", "TileCol": "x", "TileRow": "y"}
_HOST = re.compile(r"(?:[a-z0-9.-]+|\[[0-9a-f:]+\])(?::\d{1,5})?", re.IGNORECASE)
Zoom = Annotated[int, PathParameter(ge=0, le=30)]
Index = Annotated[int, PathParameter(ge=0, le=2**30)]
router = APIRouter(tags=["layers"])
_MEDIA_TYPES = {
    TileType.PNG: "image/png", TileType.JPEG: "image/jpeg", TileType.WEBP: "image/webp", TileType.AVIF: "image/avif",
}  # fmt: skip
#: Larger directories and tiles are refused: a damaged file must not exhaust the memory.
_MAX_BYTES = 8_000_000


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
    """Whether the port, if given, is valid."""
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


class Archive:
    """An open file; reading is safe from several threads."""

    def __init__(self, path: Path, file: int) -> None:
        self._path, self._file = path, file
        self._reader = Reader(self._read)  # type: ignore[no-untyped-call]
        try:
            named = self._reader.header()  # type: ignore[no-untyped-call]
        except ValueError as error:
            raise InputError(f"{path} is damaged: {error} in its header") from error
        if named["tile_type"] not in _MEDIA_TYPES:
            raise InputError(
                f"{path} holds no raster tiles ({named['tile_type'].name}): expected PNG, JPEG, WebP or AVIF"
            )
        packed = named["internal_compression"], named["tile_compression"]
        self.min_zoom, self.max_zoom = named["min_zoom"], named["max_zoom"]
        if packed != (Compression.GZIP, Compression.NONE) or self.max_zoom > 30:
            raise InputError(
                f"{path} uses a compression that is not supported: expected gzip for directories, none for tiles"
            )
        self.media_type = _MEDIA_TYPES[named["tile_type"]]
        self.tile(self.min_zoom, 0, 0)  # reads the root directory

    def tile(self, z: int, x: int, y: int) -> bytes | None:
        """The bytes of a tile; None if there is none. Raises StorageError if the file is damaged."""
        if not (self.min_zoom <= z <= self.max_zoom and x < 1 << z and y < 1 << z):
            return None
        try:
            data: bytes | None = self._reader.get(z, x, y)  # type: ignore[no-untyped-call]
        except (EOFError, OSError, zlib.error) as error:
            raise StorageError(f"{self._path} has a damaged directory") from error
        return data

    def _read(self, at: int, length: int) -> bytes:
        if length > _MAX_BYTES:
            raise StorageError(f"{self._path} is damaged: {length} bytes at {at}, expected at most {_MAX_BYTES}")
        try:
            data = os.pread(self._file, length, at)
        except (OSError, OverflowError) as error:
            raise StorageError(f"{self._path} cannot be read: {error}") from error
        if len(data) != length:
            raise StorageError(f"{self._path} is truncated: {length} bytes expected at {at}, found {len(data)}")
        return data


def open_archive(path: Path) -> Archive:
    """A PMTiles file. Raises InputError unless it is one of raster tiles."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        begin = os.pread(file, 8, 0)
    except OSError as error:
        raise InputError(
            f"--basemap {path}: {error.strerror}; expected a PMTiles file or a URL with {{z}}, {{x}}, {{y}}"
        ) from error
    if begin != b"PMTiles\x03":
        os.close(file)
        raise InputError(f"--basemap {path} is not a PMTiles file of version 3")
    try:
        return Archive(path, file)
    except StorageError as error:
        raise InputError(str(error)) from error
