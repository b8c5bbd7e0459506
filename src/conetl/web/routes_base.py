"""What the map lies on: which tiles of points and which lines there are, and the bytes of a tile."""

from __future__ import annotations

import gzip
import hashlib
from typing import Annotated

import numpy as np
import shapely
from fastapi import APIRouter, HTTPException, Path, Request, Response

from conetl.db.connection import Connection
from conetl.db.serve_store import read_base_lines, read_base_sources, read_base_tile, read_base_tiles
from conetl.web.models import BaseLayer, BaseLayers, BaseLine, BaseLines, BaseTile
from conetl.web.parameters import MAX_BASE_LINES, MAX_BASE_TILES, MapName, Reader, origin_of

router = APIRouter(tags=["base layers"], prefix="/maps/{map_name}/base")
_FOR_EVER = "private, max-age=31536000, immutable"
#: Sent to the centimetre.
_DECIMALS = 2
Sha256 = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$", description="SHA-256 of the tile's bytes.")]


@router.get("", responses={304: {"description": "Nothing changed."}}, response_model=BaseLayers)
def base_layers(map_name: MapName, conn: Reader, request: Request, response: Response) -> BaseLayers | Response:
    """The base layers of a map, and which tiles of points there are, coarse ones first."""
    if unchanged := _unchanged(conn, map_name, request, response):
        return unchanged
    origin = origin_of(conn, map_name)
    layers: dict[tuple[str, str], list[int]] = {}
    for row in read_base_sources(conn, map_name):
        layers.setdefault((row["layer_name"], row["kind"]), []).append(row["kept_count"])
    rows = read_base_tiles(conn, map_name, MAX_BASE_TILES + 1)
    tiles = [
        BaseTile(
            level=row["level"],
            points=row["points"],
            origin_m=_offset(row["origin_m"], origin),
            scale_m=tuple(row["scale_m"]),
            high_m=row["high_m"] - origin[2],
            sha256=row["sha256"],
        )
        for row in rows[:MAX_BASE_TILES]
    ]
    return BaseLayers(
        origin_m=origin,
        layers=[
            BaseLayer(layer_name=name, kind=kind, files=len(counts), count=sum(counts))
            for (name, kind), counts in layers.items()
        ],
        tiles=tiles,
        truncated=len(rows) > MAX_BASE_TILES,
    )


@router.get("/lines", responses={304: {"description": "Nothing changed."}}, response_model=BaseLines)
def base_lines(map_name: MapName, conn: Reader, request: Request, response: Response) -> BaseLines | Response:
    """The lines of all base layers."""
    if unchanged := _unchanged(conn, map_name, request, response):
        return unchanged
    origin = origin_of(conn, map_name)
    rows = read_base_lines(conn, map_name, MAX_BASE_LINES + 1)
    shown = rows[:MAX_BASE_LINES]
    shapes = shapely.from_wkb([bytes(row["geom"]) for row in shown])
    lines = [
        BaseLine(
            kind=row["kind"],
            subtype=row["subtype"],
            xyz_m=np.round(shapely.get_coordinates(shape, include_z=True) - origin, _DECIMALS).ravel().tolist(),
        )
        for row, shape in zip(shown, shapes, strict=True)
    ]
    return BaseLines(origin_m=origin, lines=lines, truncated=len(rows) > MAX_BASE_LINES)


@router.get(
    "/tiles/{sha256}.bin",
    response_class=Response,
    responses={200: {"content": {"application/octet-stream": {}}}, 304: {"description": "The browser has it."}},
)
def base_tile(map_name: MapName, sha256: Sha256, conn: Reader, request: Request) -> Response:
    """The points of one tile, 7 bytes a point (see readers/base_layers/point_tiles.py). The address tells the content: it never
    changes."""
    headers = {"ETag": f'"{sha256}"', "Cache-Control": _FOR_EVER, "Vary": "Accept-Encoding"}
    payload = read_base_tile(conn, map_name, sha256)
    if payload is None:
        raise HTTPException(404, f"The map {map_name} has no tile {sha256}.")
    if request.headers.get("if-none-match") == headers["ETag"]:
        return Response(status_code=304, headers=headers)
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(payload, media_type="application/octet-stream", headers={**headers, "Content-Encoding": "gzip"})
    return Response(gzip.decompress(payload), media_type="application/octet-stream", headers=headers)


def _unchanged(conn: Connection, map_name: str, request: Request, response: Response) -> Response | None:
    """304 where the browser has this state of the base layers; else None, and the answer gets its ETag."""
    sources = "".join(f"{row['source_id']} " for row in read_base_sources(conn, map_name))
    # Weak: the compressing middleware may send other bytes of the same content.
    tag = f'W/"{hashlib.sha256(f"{origin_of(conn, map_name)} {sources}".encode()).hexdigest()}"'
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers={"ETag": tag})
    response.headers["ETag"] = tag
    return None


def _offset(place: list[float], origin: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = (round(a - b, 4) for a, b in zip(place, origin, strict=True))
    return x, y, z
