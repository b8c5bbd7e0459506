"""The base map of the operator's choice: tiles of another server, which the browser requests, or a local PMTiles file."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated
from urllib.parse import SplitResult, urlsplit

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi import Path as PathParameter

from conetl.model.errors import InputError
from conetl.web.models import BaseMapItem
from conetl.web.pmtiles import Archive, open_archive

#: Most servers of XYZ tiles end there; a deeper zoom enlarges the tiles of this one.
DEFAULT_ZOOM = 19
#: Names of the same three numbers in templates of WMTS.
_SYNONYMS = {"TileMatrix": "z", "TileCol": "x", "TileRow": "y"}
_HOST = re.compile(r"(?:[a-z0-9.-]+|\[[0-9a-f:]+\])(?::\d{1,5})?", re.IGNORECASE)
Zoom = Annotated[int, PathParameter(ge=0, le=30)]
Index = Annotated[int, PathParameter(ge=0, le=2**30)]
router = APIRouter(tags=["layers"])


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
