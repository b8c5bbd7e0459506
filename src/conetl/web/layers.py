"""Routes of what is shown beside the map: base layers (points in tiles, lines) and provisional features of running drives."""

from __future__ import annotations

import gzip
import hashlib
from typing import Annotated, Any

import numpy as np
import shapely
from fastapi import APIRouter, Depends, HTTPException, Path, Request, Response

from conetl.db.base_store import list_base_sources
from conetl.db.live_store import read_provisional
from conetl.db.serve_store import read_base_tile, read_some
from conetl.web import layer_models as m
from conetl.web import rows as to
from conetl.web.parameters import MapName, Origin, Reader

router = APIRouter(tags=["layers"], prefix="/maps/{map_name}")
_MAX_TILES = 20_000
_MAX_LINES = 20_000
#: Decimals of the metres of lines.
_DECIMALS = 2
_UNCHANGED: dict[int | str, dict[str, Any]] = {304: {"description": "Not modified."}}
Sha256 = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$", description="SHA-256 of the tile's bytes.")]


def require_change(map_name: MapName, conn: Reader, origin: Origin, request: Request, response: Response) -> None:
    """Answer 304 if the browser has this state of the base layers; else the answer gets its ETag."""
    sources = "".join(f"{source['source_id']} " for source in list_base_sources(conn, map_name))
    # Weak: the compressing middleware may send other bytes of the same content.
    tag = f'W/"{hashlib.sha256(f"{origin} {sources}".encode()).hexdigest()}"'
    if request.headers.get("if-none-match") == tag:
        raise HTTPException(304, headers={"ETag": tag})
    response.headers["ETag"] = tag


@router.get("/base", responses=_UNCHANGED, dependencies=[Depends(require_change)])
def base_layers(map_name: MapName, conn: Reader, origin: Origin) -> m.BaseLayers:
    """The base layers of a map and their tiles of points, coarse ones first."""
    layers: dict[tuple[str, Any], list[int]] = {}
    for source in list_base_sources(conn, map_name):
        layers.setdefault((source["layer_name"], source["kind"]), []).append(source["kept_count"])
    rows, truncated = read_some(conn, "base_layers.tiles", _MAX_TILES, map_name=map_name)
    return m.BaseLayers(
        origin_m=origin,
        layers=[
            m.BaseLayer(layer_name=name, kind=kind, files=len(counts), count=sum(counts))
            for (name, kind), counts in layers.items()
        ],
        tiles=[
            m.BaseTile(**row | {"origin_m": to.offset(row["origin_m"], origin), "high_m": row["high_m"] - origin[2]})
            for row in rows
        ],
        truncated=truncated,
    )  # fmt: skip


@router.get("/base/lines", responses=_UNCHANGED, dependencies=[Depends(require_change)])
def base_lines(map_name: MapName, conn: Reader, origin: Origin) -> m.BaseLines:
    """The lines of all base layers."""
    rows, truncated = read_some(conn, "base_layers.lines", _MAX_LINES, map_name=map_name)
    shapes = shapely.from_wkb([bytes(row["geom"]) for row in rows])
    lines = [
        m.BaseLine(
            kind=row["kind"],
            subtype=row["subtype"],
            xyz_m=np.round(shapely.get_coordinates(shape, include_z=True) - origin, _DECIMALS).ravel().tolist(),
        )
        for row, shape in zip(rows, shapes, strict=True)
    ]
    return m.BaseLines(origin_m=origin, lines=lines, truncated=truncated)


@router.get(
    "/base/tiles/{sha256}.bin",
    response_class=Response,
    responses={200: {"content": {"application/octet-stream": {}}}, **_UNCHANGED},
)
def base_tile(map_name: MapName, sha256: Sha256, conn: Reader, request: Request) -> Response:
    """The points of one tile, 7 bytes per point (see readers/base_layers/point_tiles.py); the content of a URL never changes."""
    tag = f'"{sha256}"'
    headers = {"ETag": tag, "Cache-Control": "private, max-age=31536000, immutable", "Vary": "Accept-Encoding"}
    payload = read_base_tile(conn, map_name, sha256)
    if payload is None:
        raise HTTPException(404, f"The map {map_name} has no tile {sha256}.")
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    if "gzip" in request.headers.get("accept-encoding", ""):
        headers["Content-Encoding"] = "gzip"
    else:
        payload = gzip.decompress(payload)
    return Response(payload, media_type="application/octet-stream", headers=headers)


@router.get("/provisional")
def provisional(map_name: MapName, conn: Reader, origin: Origin) -> m.ProvisionalFeatures:
    """Cones of drives that are being recorded; the ingest of a drive replaces its own."""
    rows = read_provisional(conn, map_name=map_name)
    features = [to.answer(m.ProvisionalFeature, row, origin, is_watched=row["ended_at"] is None) for row in rows]
    return m.ProvisionalFeatures(origin_m=origin, features=features, truncated=False)
