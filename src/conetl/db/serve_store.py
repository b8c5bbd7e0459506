"""What the web view reads, and what people judge changes by; rows are dictionaries in the units of the comments in sql/."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from datetime import datetime
from typing import Any, NamedTuple
from uuid import UUID

from conetl.db.connection import Connection, database_errors, execute, or_infinity, read

Row = dict[str, Any]


def read_rows(conn: Connection, statement: str, **parameters: Any) -> list[Row]:
    """Rows of a statement of sql/, such as "serving.sightings". Raises DatabaseError."""
    return read(conn, "The map cannot be read", statement, **parameters)


def read_some(conn: Connection, statement: str, most: int, **parameters: Any) -> tuple[list[Row], bool]:
    """At most `most` rows of a statement that has the parameter max_rows, and whether there are more. Raises DatabaseError."""
    rows = read_rows(conn, statement, max_rows=most + 1, **parameters)
    return rows[:most], len(rows) > most


def read_listing(
    conn: Connection, sql: str, fields: Sequence[Sequence[str]], **parameters: Any
) -> tuple[str | None, str | None]:
    """Point objects and lane markings of a statement with a column `marking`, each with its fields as JSON objects between commas
    (None: there are none). Raises DatabaseError."""
    points, lines = (
        f"string_agg((select row_to_json(r) from (select {', '.join(names)}) r)::text, ',')" for names in fields
    )
    aggregated = f"""
        select {points} filter (where marking is null) as points, {lines} filter (where marking is not null) as lines
        from ({sql.rstrip(";")}) q"""
    with database_errors("The map cannot be read"):
        [row] = execute(conn, aggregated, parameters)
    return row["points"], row["lines"]


class Head(NamedTuple):
    """The latest state of a map; each part differs after a change of its kind."""

    changeset_no: int = 0
    decision_no: int = 0
    base: str = "none"


def read_heads(conn: Connection) -> dict[str, Head]:
    """The head of every map."""
    return {row.pop("map_name"): Head(**row) for row in read_rows(conn, "serving.heads")}


def read_origin(conn: Connection, map_name: str) -> tuple[float, float, float] | None:
    """Easting, northing, height from which the browser counts, in whole 100 m; None if the map is empty or missing."""
    rows = read_rows(conn, "serving.origin", map_name=map_name)
    if not rows:
        return None
    easting, northing, height = (
        round(rows[0][name], -2) for name in ("easting_m", "northing_m", "ellipsoidal_height_m")
    )
    return easting, northing, height


def read_feature_history(
    conn: Connection,
    map_name: str,
    feature_id: UUID,
    known_at: datetime | None = None,
    origin_m: Sequence[float] = (0.0, 0.0, 0.0),
) -> list[Row]:
    """Every delta of a feature with the state after it, as known at `known_at` (None: now), in the order of the drives.

    xyz_m and the vertices of `marking` count from `origin_m`. [] if the map has no such feature.
    """
    return read_rows(
        conn, "serving.feature_history", map_name=map_name, feature_id=feature_id, known_at=or_infinity(known_at),
        origin_m=list(origin_m),
    )  # fmt: skip


def read_base_tile(conn: Connection, map_name: str, sha256: str) -> bytes | None:
    """The bytes of one tile, in gzip; None if the map has no such tile."""
    rows = read_rows(conn, "base_layers.tile", map_name=map_name, sha256=sha256)
    return bytes(rows[0]["payload"]) if rows else None


def observed_frames(conn: Connection, map_name: str, feature_id: UUID) -> dict[UUID, tuple[str, dict[int, int]]]:
    """Kind of the change, and the frame indices of the observations of a feature with their stereo matches, by drive."""
    found: dict[UUID, tuple[str, dict[int, int]]] = {}
    for row in read_rows(conn, "judging.observed_frames", map_name=map_name, feature_id=feature_id):
        _, frames = found.setdefault(row["drive_uuid"], (row["kind"], {}))
        if row["frame_index"] is not None:
            frames[row["frame_index"]] = row["match_index"]
    return found


def track_ranges(
    conn: Connection, tracks: Sequence[tuple[UUID, int]]
) -> dict[tuple[UUID, int], tuple[float, float, int]]:
    """Nearest and farthest distance (m), and number of frame pairs, of tracks (drive, index) whose positions are kept."""
    if not tracks:
        return {}
    parameters = {"drive_uuids": [drive for drive, _ in tracks], "track_indexes": [index for _, index in tracks]}
    return {
        (row["drive_uuid"], row["track_index"]): (row["near_m"], row["far_m"], row["frames"])
        for row in read_rows(conn, "judging.track_ranges", **parameters)
    }


def read_frame_boxes(conn: Connection, drive_uuid: UUID, frame_index: int) -> dict[str, list[Row]]:
    """The detections of a frame pair, by side."""
    found: dict[str, list[Row]] = defaultdict(list)
    for row in read_rows(conn, "judging.frame_boxes", drive_uuid=drive_uuid, frame_index=frame_index):
        found[row.pop("side")].append(row)
    return found


def review_page(
    conn: Connection, map_name: str, kind: str, *, first_row: int, max_rows: int, **bounds: float | str
) -> tuple[int, list[UUID]]:
    """Number of features of one kind (changes, doubtful) that wait for a person, and the ids of one page."""
    rows = read_rows(
        conn, f"judging.review_{kind}", map_name=map_name, first_row=first_row, max_rows=max_rows, **bounds
    )
    return int(rows[0]["total"]), [row["feature_id"] for row in rows if row["feature_id"] is not None]


def last_changes(conn: Connection, map_name: str, feature_ids: Sequence[UUID]) -> dict[UUID, Row]:
    """What the last drive that judged each of some features did to it."""
    rows = (
        read_rows(conn, "judging.last_changes", map_name=map_name, feature_ids=list(feature_ids)) if feature_ids else []
    )
    return {row["feature_id"]: row for row in rows}
