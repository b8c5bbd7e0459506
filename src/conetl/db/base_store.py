"""Base layers in PostGIS: one transaction a file, all of it or nothing."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Literal
from uuid import UUID, uuid4

import numpy as np
import shapely
from numpy.typing import NDArray

from conetl.db.connection import Connection, copy_columns, database_errors, execute, load_sql, transaction
from conetl.db.copy_binary import (
    Column,
    byteas,
    constant_uuid,
    double_arrays,
    doubles,
    fixed,
    integers,
    json_text,
    jsons,
    texts,
)
from conetl.readers.base_layers.georeferencing import MapGround, ground_under
from conetl.readers.base_layers.point_tiles import Tile

Kind = Literal["points", "lines"]
_MAX_POSES = 20_000
_MAX_FEET = 5_000
_TILES_AT_ONCE = 200
_LINES_AT_ONCE = 5_000


@dataclass(frozen=True)
class BaseFile:
    """What identifies an import: the same file into the same layer with the same parameters is imported once."""

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
    """How many points or lines a file had, how many of them could not be used, and where they lie (map's CRS)."""

    read_count: int
    refused_count: int
    low_m: tuple[float, float]
    high_m: tuple[float, float]


@dataclass(frozen=True)
class BaseSource:
    """One imported file."""

    source_id: UUID
    layer_name: str
    kind: Kind
    source_path: str
    content_sha256: str
    params: Mapping[str, Any]
    source_crs: str
    read_count: int
    kept_count: int
    refused_count: int
    heights: str
    imported_at: datetime
    west_m: float
    south_m: float
    east_m: float
    north_m: float
    bytes: int


@dataclass(frozen=True)
class PlacedLine:
    """A line on the map: xyz_m (N, 3) in the map's CRS."""

    kind: str
    xyz_m: NDArray[np.float64]
    attributes: Mapping[str, Any]


def read_map_ground(conn: Connection, map_name: str, srid: int) -> MapGround:
    """Where a map's drives were, and how high the road is there."""
    with database_errors(f"The drives of map {map_name} cannot be read"):
        poses = _places(conn, "map/base_poses", {"map_name": map_name, "max_rows": _MAX_POSES})
        feet = _places(conn, "map/base_feet", {"map_name": map_name, "max_rows": _MAX_FEET})
    return MapGround(srid, ground_under(poses, feet))


def read_ingested_poses(conn: Connection, map_name: str, content_sha256: str) -> dict[int, NDArray[np.float64]]:
    """Frame index -> (4, 4) map_SE3_body that the drive of this content was placed by; {} where the map does not have it."""
    parameters = {"map_name": map_name, "content_sha256": content_sha256}
    with database_errors(f"The poses of a drive of map {map_name} cannot be read"):
        rows = execute(conn, load_sql("map/ingested_poses"), parameters)
    poses = {}
    for row in rows:
        pose = np.eye(4)
        pose[:3, :3] = np.reshape(row["map_r_body"], (3, 3))
        pose[:3, 3] = row["easting_m"], row["northing_m"], row["height_m"]
        poses[int(row["frame_index"])] = pose
    return poses


def find_base_file(conn: Connection, file: BaseFile) -> int | None:
    """How many points or lines an earlier import of this very file keeps; None where there was none."""
    with database_errors(f"The base layers of map {file.map_name} cannot be read"):
        rows = execute(conn, load_sql("map/find_base_source"), asdict(file) | {"params": json_text(file.params)})
    return int(rows[0]["kept_count"]) if rows else None


def write_points(conn: Connection, file: BaseFile, counts: BaseCounts, tiles: Iterable[Tile]) -> int | None:
    """Write a file's tiles; the number of points kept, None where another import of the same file was faster."""
    source_id = uuid4()
    kept = 0
    with transaction(conn, f"{file.source_path} was not imported, nothing was written"):
        for batch in _batches(tiles, _TILES_AT_ONCE):
            copy_columns(conn, "conetl.base_tile", _tile_columns(source_id, batch))
            kept += sum(tile.points for tile in batch)
        return _finish(conn, source_id, file, counts, kept)


def write_lines(
    conn: Connection, file: BaseFile, counts: BaseCounts, lines: Iterable[PlacedLine], srid: int
) -> int | None:
    """Write a file's lines; their number, None where another import of the same file was faster."""
    source_id = uuid4()
    kept = 0
    with transaction(conn, f"{file.source_path} was not imported, nothing was written"):
        for batch in _batches(lines, _LINES_AT_ONCE):
            copy_columns(conn, "conetl.base_line", _line_columns(source_id, batch, srid))
            kept += len(batch)
        return _finish(conn, source_id, file, counts, kept)


def list_base_sources(conn: Connection, map_name: str) -> list[BaseSource]:
    """All imported files of a map, by layer."""
    with database_errors(f"The base layers of map {map_name} cannot be read"):
        return [BaseSource(**row) for row in execute(conn, load_sql("map/base_sources"), {"map_name": map_name})]


def drop_base_layer(conn: Connection, map_name: str, layer_name: str) -> list[int]:
    """Drop a layer; points or lines of each of its files, [] where there was no such layer."""
    with transaction(conn, f"The base layer {layer_name} of map {map_name} was not dropped"):
        rows = execute(conn, load_sql("write/drop_base_layer"), {"map_name": map_name, "layer_name": layer_name})
    return [int(row["kept_count"]) for row in rows]


def _finish(conn: Connection, source_id: UUID, file: BaseFile, counts: BaseCounts, kept: int) -> int | None:
    west_m, south_m = counts.low_m
    east_m, north_m = counts.high_m
    parameters = asdict(file) | {
        "params": json_text(file.params), "source_id": source_id, "read_count": counts.read_count, "kept_count": kept,
        "refused_count": counts.refused_count, "west_m": west_m, "south_m": south_m, "east_m": east_m, "north_m": north_m,
    }  # fmt: skip
    if not execute(conn, load_sql("write/insert_base_source"), parameters):
        conn.rollback()
        return None
    execute(conn, load_sql("write/drop_older_base_source"), parameters)
    return kept


def _tile_columns(source_id: UUID, tiles: list[Tile]) -> dict[str, Column]:
    return {
        "source_id": constant_uuid(source_id, len(tiles)),
        "level": fixed([t.level for t in tiles], ">i2"),
        "ix": integers([t.ix for t in tiles]),
        "iy": integers([t.iy for t in tiles]),
        "points": integers([t.points for t in tiles]),
        "origin_m": double_arrays([t.origin_m for t in tiles]),
        "scale_m": double_arrays([t.scale_m for t in tiles]),
        "high_m": doubles([t.high_m for t in tiles]),
        "sha256": texts([hashlib.sha256(t.payload).hexdigest() for t in tiles]),
        "payload": byteas([t.payload for t in tiles]),
    }


def _line_columns(source_id: UUID, lines: list[PlacedLine], srid: int) -> dict[str, Column]:
    shapes = [shapely.set_srid(shapely.LineString(line.xyz_m), srid) for line in lines]
    return {
        "source_id": constant_uuid(source_id, len(lines)),
        "kind": texts([line.kind for line in lines]),
        "attributes": jsons([line.attributes for line in lines]),
        "geom": byteas(list(shapely.to_wkb(shapes, include_srid=True, output_dimension=3))),
    }


def _places(conn: Connection, name: str, parameters: Mapping[str, Any]) -> NDArray[np.float64]:
    rows = execute(conn, load_sql(name), parameters)
    return np.array([(r["easting_m"], r["northing_m"], r["height_m"]) for r in rows], np.float64).reshape(-1, 3)


def _batches(items: Iterable[Any], size: int) -> Iterator[list[Any]]:
    iterator = iter(items)
    while batch := list(itertools.islice(iterator, size)):
        yield batch
