"""What people judge changes by, one function per statement of sql/judging.sql; rows have the units of its comments."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from typing import Any
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from conetl.db.connection import Connection, database_errors, execute, stream
from conetl.db.statements import load_sql

Row = dict[str, Any]


def drives_past(
    conn: Connection,
    map_name: str,
    xy_m: tuple[float, float],
    *,
    drive_uuids: Collection[UUID] | None = None,
    max_rows: int,
) -> list[Row]:
    """The drives whose area contains a position (map CRS), the latest first; drive_uuids: only these."""
    only = None if drive_uuids is None else list(drive_uuids)
    position = {"easting_m": xy_m[0], "northing_m": xy_m[1]}
    return _rows(conn, "drives_past", map_name=map_name, drive_uuids=only, max_rows=max_rows, **position)


def observed_frames(conn: Connection, map_name: str, feature_id: UUID) -> dict[UUID, tuple[str, set[int]]]:
    """Kind of the change and frame indices of the observations of a feature, by drive."""
    found: dict[UUID, tuple[str, set[int]]] = {}
    for row in _rows(conn, "observed_frames", map_name=map_name, feature_id=feature_id):
        _, frames = found.setdefault(row["drive_uuid"], (row["kind"], set()))
        if row["frame_index"] is not None:
            frames.add(row["frame_index"])
    return found


def tracks_near(
    conn: Connection, drive_uuid: UUID, xy_m: tuple[float, float], radius_m: float, feature_id: UUID
) -> NDArray[np.float64]:
    """(M, 3) tracks of a drive around a position, in the drive's map frame, without the one of the feature."""
    parameters = {
        "drive_uuid": drive_uuid, "easting_m": xy_m[0], "northing_m": xy_m[1], "radius_m": radius_m, "feature_id": feature_id,
    }  # fmt: skip
    with database_errors("The tracks of a drive cannot be read"):
        rows = list(stream(conn, load_sql("judging.tracks_near"), parameters))
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def track_ranges(
    conn: Connection, tracks: Sequence[tuple[UUID, int]]
) -> dict[tuple[UUID, int], tuple[float, float, int]]:
    """Nearest and farthest distance (m), and number of frame pairs, of tracks (drive, index) whose positions are kept."""
    if not tracks:
        return {}
    parameters = {"drive_uuids": [drive for drive, _ in tracks], "track_indexes": [index for _, index in tracks]}
    return {
        (row["drive_uuid"], row["track_index"]): (row["near_m"], row["far_m"], row["frames"])
        for row in _rows(conn, "track_ranges", **parameters)
    }


def read_frame(conn: Connection, map_name: str, drive_uuid: UUID, frame_index: int) -> Row | None:
    """One frame pair with its rig; None if the map has none such."""
    rows = _rows(conn, "frame", map_name=map_name, drive_uuid=drive_uuid, frame_index=frame_index)
    return rows[0] if rows else None


def read_frame_boxes(conn: Connection, drive_uuid: UUID, frame_index: int) -> dict[str, list[Row]]:
    """The detections of a frame pair, by side."""
    found: dict[str, list[Row]] = defaultdict(list)
    for row in _rows(conn, "frame_boxes", drive_uuid=drive_uuid, frame_index=frame_index):
        found[row.pop("side")].append(row)
    return found


def review_page(
    conn: Connection, map_name: str, kind: str, *, first_row: int, max_rows: int, **bounds: float | str
) -> tuple[int, list[UUID]]:
    """Number of features of one kind (changes, doubtful) that wait for a person, and the ids of one page."""
    rows = _rows(conn, f"review_{kind}", map_name=map_name, first_row=first_row, max_rows=max_rows, **bounds)
    return int(rows[0]["total"]), [row["feature_id"] for row in rows if row["feature_id"] is not None]


def last_changes(conn: Connection, map_name: str, feature_ids: Sequence[UUID]) -> dict[UUID, Row]:
    """What the last drive that judged each of some features did to it."""
    rows = _rows(conn, "last_changes", map_name=map_name, feature_ids=list(feature_ids)) if feature_ids else []
    return {row["feature_id"]: row for row in rows}


def _rows(conn: Connection, statement: str, **parameters: Any) -> list[Row]:
    with database_errors("The map cannot be read"):
        return execute(conn, load_sql(f"judging.{statement}"), parameters)
