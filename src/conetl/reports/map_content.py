"""Reads the content of a map picture from the database: drive paths, lane boundaries and LiDAR points."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np
import shapely
from numpy.typing import NDArray

from conetl.db.connection import Connection
from conetl.db.map.map_store import list_changesets
from conetl.db.serve_store import read_base_lines, read_base_tile, read_base_tiles
from conetl.db.zone_store import read_paths
from conetl.model.map_records import FeatureChange, MapFeature
from conetl.readers.base_layers.point_tiles import decode_points, tile_side_m
from conetl.reports.map_picture import Array, Bbox, PlanContent

_MAX_POINTS = 400_000
_MAX_TILES = 100_000
_MAX_LINES = 200_000


def read_plan_content(
    conn: Connection,
    map_name: str,
    srid: int,
    extent: Bbox,
    standing: Sequence[MapFeature],
    changes: Sequence[FeatureChange] | None,
    *,
    valid_at: datetime | None,
    known_at: datetime | None,
) -> PlanContent:
    """Cones of a map, and what the database holds around them; extent: west, south, east, north in the map's CRS."""
    west, south, east, north = extent
    margin = max(east - west, north - south)  # the paper has another shape than the extent
    around = (west - margin, south - margin, east + margin, north + margin)
    points_m, shades = _points(conn, map_name, around)
    return PlanContent(
        srid=srid, standing=standing, changes=changes, paths_m=drive_paths(conn, map_name, valid_at, known_at),
        lines_m=_lines(conn, map_name, around), points_m=points_m, shades=shades,
    )  # fmt: skip


def drive_paths(conn: Connection, map_name: str, valid_at: datetime | None, known_at: datetime | None) -> list[Array]:
    """(N, 2) drive paths until an instant, of the drives committed until an instant of the database."""
    paths = read_paths(conn, map_name=map_name, until=valid_at)
    if known_at is None:
        return [path.xy_m for path in paths]
    known = {c.drive_id for c in list_changesets(conn, map_name=map_name) if c.committed_at <= known_at}
    return [path.xy_m for path in paths if path.drive_id in known]


def _lines(conn: Connection, map_name: str, around: Bbox) -> list[Array]:
    rows = read_base_lines(conn, map_name, _MAX_LINES)
    shapes = shapely.from_wkb([bytes(row["geom"]) for row in rows])
    return [shapely.get_coordinates(shape) for shape in shapes if shapely.intersects(shape, shapely.box(*around))]


def _points(conn: Connection, map_name: str, around: Bbox) -> tuple[Array, NDArray[np.uint8]]:
    """(N, 2) points and (N,) intensities of the tiles around, coarse ones first, up to _MAX_POINTS."""
    west, south, east, north = around
    points, shades, count = [np.empty((0, 2))], [np.empty(0, np.uint8)], 0
    for row in read_base_tiles(conn, map_name, _MAX_TILES):
        x, y = row["origin_m"][:2]
        side = tile_side_m(row["level"])
        if x > east or y > north or x + side < west or y + side < south:
            continue
        count += row["points"]
        payload = read_base_tile(conn, map_name, row["sha256"]) if count <= _MAX_POINTS else None
        if payload is None:
            break
        steps, shade = decode_points(payload)
        points.append(steps[:, :2] * np.array(row["scale_m"][:2]) + (x, y))
        shades.append(shade)
    return np.concatenate(points), np.concatenate(shades)
