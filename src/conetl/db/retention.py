"""Deletion of raw records of old drives, or their move to Parquet files.

The detections, stereo matches and positions of a drive are deleted. Its path, tracks, changeset and deltas stay, so the history
of the map and every audit remain valid. Lost are its single sightings, and the possibility to compare it with the map again. A
drive or a decision that requires that is rejected (`require_comparable`) instead of using half of the evidence, so the map does
not depend on the order of the drives that were accepted.

Archived records are not lost: a comparison that needs them brings them back, and other programs read the files, one folder per
drive with a file per table (columns: `records_of_...` in `sql/retention.sql`).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from uuid import UUID

import numpy as np
import pyarrow as pa
import shapely

from conetl.db import connection as db
from conetl.db.arrow_rows import batches_of, schema_of
from conetl.db.connection import Connection
from conetl.db.copy_rows import encode
from conetl.db.map.map_store import map_transaction
from conetl.files.atomic import atomic_files
from conetl.files.parquet_store import read_table, write_table
from conetl.model.errors import InputError, MapMismatchError

_RAW_TABLES = ("detection", "stereo_match", "position")
#: Geometries of a position, and their coordinates in its file.
_POINTS = {
    "geom": ("easting_m", "northing_m", "height_m"),
    "centre_geom": ("centre_easting_m", "centre_northing_m", "centre_height_m"),
}


@dataclass(frozen=True)
class PrunableDrive:
    """A drive whose raw records may be deleted, and their numbers."""

    map_name: str
    drive_uuid: UUID
    drive_id: str
    captured_to: datetime
    detection_count: int
    match_count: int
    position_count: int


def prunable_drives(conn: Connection, before: datetime) -> list[PrunableDrive]:
    """Drives of all maps that were recorded and committed before an instant and still have their raw records."""
    rows = db.read(conn, "The drives cannot be read", "retention.prunable_drives", before=before)
    return [PrunableDrive(**row) for row in rows]


def prune_drives(conn: Connection, drives: Sequence[PrunableDrive]) -> int:
    """Delete the raw records of drives, map by map, each under its lock and in one transaction. Returns the number of rows."""
    deleted = 0
    for map_name in sorted({drive.map_name for drive in drives}):
        own = [drive.drive_uuid for drive in drives if drive.map_name == map_name]
        with map_transaction(conn, map_name):
            deleted += db.query(conn, "retention.prune_drives", drive_uuids=own)[0]["deleted"]
    return deleted


def require_comparable(conn: Connection, drive_uuids: Sequence[UUID]) -> None:
    """Bring back archived raw records of drives that must be compared with the map again. Raises InputError if one was pruned."""
    gone = db.query(conn, "retention.pruned_drives", drive_uuids=list(drive_uuids))
    pruned = [drive for drive in gone if drive["archive_path"] is None]
    if pruned:
        first = pruned[0]
        more = f" and {len(pruned) - 1} more" if len(pruned) > 1 else ""
        raise InputError(
            f"drive {first['drive_id']}, recorded {first['captured_to']:%Y-%m-%d}{more}, would have to be compared with the map "
            f"again, but its raw records were pruned on {first['pruned_at']:%Y-%m-%d}: the map before that time is closed. "
            "Nothing was written."
        )
    for drive in gone:
        _restore(conn, drive["drive_uuid"], Path(drive["archive_path"]), drive["rows"])


def archive_drive(conn: Connection, drive: PrunableDrive, folder: Path) -> int:
    """Move the raw records of a drive to Parquet files in a folder of its own, under the map's lock. Returns their size in bytes.

    The files are complete on the disk before the rows are deleted. 0 where another process was faster, whose files stay. Raises
    InputError, StorageError where they cannot be written, MapMismatchError where the drive has not the records that it should.
    """
    path = folder.resolve() / str(drive.drive_uuid)
    parameters = {"drive_uuid": drive.drive_uuid}
    finals = [path / f"{table}.parquet" for table in _RAW_TABLES]
    counts = (drive.detection_count, drive.match_count, drive.position_count)
    with map_transaction(conn, drive.map_name):
        if db.query(conn, "retention.pruned_drives", drive_uuids=[drive.drive_uuid]):
            return 0
        with atomic_files(*finals) as files:
            for table, count, file in zip(_RAW_TABLES, counts, files, strict=True):
                archived = db.load_sql(f"retention.records_of_{table}").rstrip(";")
                schema = schema_of(conn, archived, parameters)
                records = pa.Table.from_batches(batches_of(conn, archived, parameters, schema), schema)
                if len(records) != count:
                    raise MapMismatchError(
                        f"drive {drive.drive_id}: table {table} has {len(records)} rows of it, expected {count} by its "
                        "changeset; nothing was archived. See `conetl db audit`"
                    )
                write_table(records, file)
        deleted = db.query(conn, "retention.prune_drives", drive_uuids=[drive.drive_uuid])[0]["deleted"]
        if deleted != sum(counts):
            raise MapMismatchError(
                f"drive {drive.drive_id}: {deleted} rows, but {sum(counts)} in its files; nothing was archived"
            )
        db.query(conn, "retention.mark_archived", **parameters | {"archive_path": str(path)})
    return sum(final.stat().st_size for final in finals)


def restore_drives(conn: Connection, map_name: str, drive_id: str | None = None) -> list[str]:
    """Bring the archived raw records of drives of a map back into the tables, of one or of all. Returns the ids of the drives."""
    with map_transaction(conn, map_name):
        found = db.query(conn, "retention.archived_drives", map_name=map_name, drive_id=drive_id)
        require_comparable(conn, [drive["drive_uuid"] for drive in found])
    return [drive["drive_id"] for drive in found]


def _restore(conn: Connection, drive_uuid: UUID, path: Path, rows: Mapping[str, int]) -> None:
    """Inside the caller's transaction. rows: how many each file must have, by table.

    Raises InputError where a file is missing, damaged, shorter, without a column, or that of another drive.
    """
    for table in _RAW_TABLES:
        archived = db.load_sql(f"retention.records_of_{table}").rstrip(";")
        try:
            records = read_table(path / f"{table}.parquet")
            if "cone_height_m" in records.column_names:  # of files before 0.3
                records = records.rename_columns({"cone_height_m": "object_height_m"})
        except (OSError, pa.ArrowException) as error:
            raise InputError(
                f"{path / table}.parquet: the archived records of the drive are required, but cannot be read ({error}). Nothing "
                "was written; put the file back where it was."
            ) from error
        expected = [name for name, _ in db.query_columns(conn, archived, {"drive_uuid": drive_uuid})]
        if missing := sorted(set(expected) - set(records.column_names)):
            raise InputError(
                f"{path / table}.parquet: it has no column {', '.join(missing)}. Nothing was written; put the file back that "
                "`conetl db archive` wrote."
            )
        others = set(records["drive_uuid"].unique().to_pylist()) - {str(drive_uuid)}
        if others or len(records) != rows[table]:
            of_others = f" of drive {min(others)}" if others else ""
            raise InputError(
                f"{path / table}.parquet: it has {len(records)} records{of_others}, expected {rows[table]} of drive "
                f"{drive_uuid}. Nothing was written; put the file back that `conetl db archive` wrote."
            )
        if table == "position":
            for name, axes in _POINTS.items():
                points = shapely.points(np.stack([records[axis].to_numpy() for axis in axes], axis=1))
                wkb = shapely.to_wkb(shapely.set_srid(points, records["srid"].to_numpy()), hex=True, include_srid=True)
                records = records.append_column(name, pa.array(wkb))
        columns = [name for name, _ in db.query_columns(conn, f"select * from conetl.{table}", {})]
        target, values = f"conetl.{table} ({', '.join(columns)})", {name: records[name] for name in columns}
        db.copy_in(conn, target, encode(values), str(path / table), options="(format csv)")
    db.query(conn, "retention.mark_restored", drive_uuid=drive_uuid)


def parse_age(text: str) -> float:
    """Seconds of an age like 90d, 12w, 36h. Raises InputError."""
    units = {"h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}
    number, unit = text[:-1], text[-1:]
    if not number.isdigit() or unit not in units or not 0 < int(number) * units[unit] < time.time():
        raise InputError(f"{text!r} is not an age: write it like 90d, 12w or 36h")
    return int(number) * units[unit]
