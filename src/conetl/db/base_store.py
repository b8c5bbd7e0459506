"""Base layers in PostGIS: one transaction per file, all or nothing."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal
from uuid import UUID, uuid4

import numpy as np
import shapely

from conetl.db import copy_rows as copy
from conetl.db.connection import Connection, copy_columns, query, read, stream_values, transaction
from conetl.db.copy_rows import Columns
from conetl.geometry.pose import se3
from conetl.model.arrays import Floats
from conetl.model.work_zone_records import LaneLine
from conetl.readers.base_layers.georeferencing import MapGround, ground_under
from conetl.readers.base_layers.lines import Line, bounds_lanes, full_kind
from conetl.readers.base_layers.point_tiles import Tile

Kind = Literal["points", "lines"]
#: Distance around the cones of a work zone for lane lines, more than the width of a road.
_LANE_REACH_M = 60.0
_MAX_POSES = 20_000
_MAX_FEET = 5_000
_TILES_AT_ONCE = 200
_LINES_AT_ONCE = 5_000


@dataclass(frozen=True)
class BaseFile:
    """Identity of an import: the same file is imported once into a layer with the same parameters."""

    map_name: str
    layer_name: str
    kind: Kind
    source_path: str
    content_sha256: str
    params: Mapping[str, Any]
    source_crs: str
    heights: Literal["file", "drives"]


@dataclass(frozen=True)
class BaseCounts:
    """How many points or lines a file has, how many are unusable, and their bounding box (map's CRS)."""

    read_count: int
    refused_count: int
    west_m: float
    south_m: float
    east_m: float
    north_m: float


def read_map_ground(conn: Connection, map_name: str, srid: int) -> MapGround:
    """Positions along a map's drives, and the height of the road there."""
    poses = _points(conn, "base_layers.poses", map_name, _MAX_POSES)
    feet = _points(conn, "base_layers.feet", map_name, _MAX_FEET)
    return MapGround(srid, ground_under(poses, feet))


def read_ingested_poses(conn: Connection, map_name: str, content_sha256: str) -> dict[int, Floats]:
    """Frame index -> (4, 4) map_SE3_body of the ingested drive with this content; {} if the map does not have it."""
    what = f"The poses of a drive of map {map_name} cannot be read"
    poses = {}
    for row in read(conn, what, "base_layers.ingested_poses", map_name=map_name, content_sha256=content_sha256):
        position_m = row["easting_m"], row["northing_m"], row["height_m"]
        poses[int(row["frame_index"])] = se3(np.reshape(row["map_r_body"], (3, 3)), position_m)
    return poses


def find_base_file(conn: Connection, file: BaseFile) -> int | None:
    """Number of points or lines kept by an earlier import of this file; None if there was none."""
    identity = asdict(file) | {"params": copy.json_text(file.params)}
    rows = read(conn, _unreadable(file.map_name), "base_layers.find_source", **identity)
    return int(rows[0]["kept_count"]) if rows else None


def write_points(conn: Connection, file: BaseFile, counts: BaseCounts, tiles: Iterable[Tile]) -> int | None:
    """Write a file's tiles. Returns the number of points kept, None if another import of the same file finished first."""
    source_id = uuid4()
    blocks = (
        (_tile_columns(source_id, batch), sum(t.points for t in batch)) for batch in _batches(tiles, _TILES_AT_ONCE)
    )
    return _write(conn, source_id, file, counts, "conetl.base_tile", blocks)


def write_lines(conn: Connection, file: BaseFile, counts: BaseCounts, lines: Iterable[Line], srid: int) -> int | None:
    """Write a file's lines, in the map's CRS. Returns their number, None if another import of the same file finished first."""
    source_id = uuid4()
    blocks = ((_line_columns(source_id, batch, srid), len(batch)) for batch in _batches(lines, _LINES_AT_ONCE))
    return _write(conn, source_id, file, counts, "conetl.base_line", blocks)


def list_base_sources(conn: Connection, map_name: str) -> list[dict[str, Any]]:
    """All imported files of a map, by layer: columns of `base_layers.sources`."""
    return read(conn, _unreadable(map_name), "base_layers.sources", map_name=map_name)


def drop_base_layer(conn: Connection, map_name: str, layer_name: str) -> list[int]:
    """Drop a layer. Returns the numbers of points or lines of its files, [] if there was no such layer."""
    with transaction(conn, f"The base layer {layer_name} of map {map_name} was not dropped"):
        rows = query(conn, "base_layers.drop_layer", map_name=map_name, layer_name=layer_name)
    return [int(row["kept_count"]) for row in rows]


def _write(
    conn: Connection,
    source_id: UUID,
    file: BaseFile,
    counts: BaseCounts,
    table: str,
    blocks: Iterable[tuple[Columns, int]],
) -> int | None:
    with transaction(conn, f"{file.source_path} was not imported, nothing was written"):
        kept = 0
        for columns, count in blocks:
            copy_columns(conn, table, columns)
            kept += count
        own = {"params": copy.json_text(file.params), "source_id": source_id, "kept_count": kept}
        parameters = asdict(file) | asdict(counts) | own
        if not query(conn, "base_layers.insert_source", **parameters):
            conn.rollback()
            return None
        query(conn, "base_layers.drop_older_source", **parameters)
        return kept


def _tile_columns(source_id: UUID, tiles: list[Tile]) -> Columns:
    return {
        "source_id": [source_id] * len(tiles),
        **{
            name: [getattr(tile, name) for tile in tiles]
            for name in ("level", "ix", "iy", "points", "high_m", "payload")
        },
        "origin_m": copy.arrays(t.origin_m for t in tiles),
        "scale_m": copy.arrays(t.scale_m for t in tiles),
        "sha256": [hashlib.sha256(t.payload).hexdigest() for t in tiles],
    }


def _line_columns(source_id: UUID, lines: list[Line], srid: int) -> Columns:
    shapes = [shapely.set_srid(shapely.LineString(line.xyz), srid) for line in lines]
    return {
        "source_id": [source_id] * len(lines),
        "kind": [line.kind for line in lines],
        "attributes": [line.attributes for line in lines],
        "geom": list(shapely.to_wkb(shapes, hex=True, include_srid=True, output_dimension=3)),
    }


def _unreadable(map_name: str) -> str:
    return f"The base layers of map {map_name} cannot be read"


def _points(conn: Connection, name: str, map_name: str, max_rows: int) -> Floats:
    rows = read(conn, f"The drives of map {map_name} cannot be read", name, map_name=map_name, max_rows=max_rows)
    return np.array([(r["easting_m"], r["northing_m"], r["height_m"]) for r in rows], np.float64).reshape(-1, 3)


def _batches(items: Iterable[Any], size: int) -> Iterator[list[Any]]:
    iterator = iter(items)
    while batch := list(itertools.islice(iterator, size)):
        yield batch


def read_lanes_near(
    conn: Connection, positions_m: Sequence[Floats], *, map_name: str
) -> tuple[list[list[LaneLine]], list[str]]:
    """Lane lines of the map's base layers near each set of positions, and the names of these layers.

    positions_m: (N, 2) each, in the map's CRS. Near: inside their box, widened by `_LANE_REACH_M`.
    """
    found: list[list[LaneLine]] = [[] for _ in positions_m]
    layers: set[str] = set()
    low = [positions.min(axis=0) - _LANE_REACH_M for positions in positions_m]
    high = [positions.max(axis=0) + _LANE_REACH_M for positions in positions_m]
    corners = np.hstack([low, high]).reshape(-1, 4).T.tolist()
    box = dict(zip(("west_m", "south_m", "east_m", "north_m"), corners, strict=True))
    rows = stream_values(conn, _unreadable(map_name), "base_layers.lines_near", map_name=map_name, **box)
    for zone, layer, kind, attributes, wkb in rows:
        if bounds_lanes(kind, attributes):
            line = shapely.get_coordinates(shapely.from_wkb(bytes(wkb)))
            found[zone].append(LaneLine(line, full_kind(kind, attributes)))
            layers.add(layer)
    return found, sorted(layers)
