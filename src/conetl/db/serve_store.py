"""What the web view reads, one function per statement of sql/serving.sql; rows are dictionaries in the units of its comments."""

from __future__ import annotations

from datetime import datetime
from typing import Any, NamedTuple
from uuid import UUID

from conetl.db.connection import Connection, database_errors, execute
from conetl.db.statements import load_sql
from conetl.model.params import ReconcileParams
from conetl.model.records import Side

Row = dict[str, Any]


def read_maps(conn: Connection) -> list[Row]:
    """All maps, by name."""
    return _rows(conn, "archive.list_maps")


class Head(NamedTuple):
    """The latest state of a map; each part differs after a change of its kind."""

    changeset_no: int = 0
    decision_no: int = 0
    base: str = "none"


def read_heads(conn: Connection) -> dict[str, Head]:
    """The head of every map."""
    return {row.pop("map_name"): Head(**row) for row in _rows(conn, "serving.heads")}


def read_decisions(conn: Connection, map_name: str, max_rows: int) -> list[Row]:
    """The decisions that were not withdrawn, newest first."""
    return _rows(conn, "decisions.active_decisions", map_name=map_name)[::-1][:max_rows]


def read_origin(conn: Connection, map_name: str) -> tuple[float, float, float] | None:
    """Easting, northing, height from which the browser counts, in whole 100 m; None if the map is empty or missing."""
    rows = _rows(conn, "serving.origin", map_name=map_name)
    if not rows:
        return None
    easting, northing, height = (round(rows[0][name], -2) for name in ("easting_m", "northing_m", "height_m"))
    return easting, northing, height


def read_features(
    conn: Connection, map_name: str, valid_at: datetime | None, known_at: datetime | None, max_rows: int
) -> list[Row]:
    """Standing features at `valid_at` (None: latest) as known at `known_at` (None: now), by id."""
    instants = {"valid_at": _instant(valid_at), "known_at": _instant(known_at)}
    return _rows(conn, "serving.features", map_name=map_name, max_rows=max_rows, **instants)


def read_changeset_changes(conn: Connection, map_name: str, changeset_no: int) -> list[Row]:
    """What one changeset did, by feature id."""
    return _rows(conn, "history.changes_of_changeset", map_name=map_name, changeset_no=changeset_no)


def read_changes_between(
    conn: Connection,
    map_name: str,
    before: tuple[datetime | None, datetime | None],
    after: tuple[datetime | None, datetime | None],
    *,
    moved_from_m: float,
    max_rows: int,
) -> list[Row]:
    """How the map differs between two (valid, known) instants (None: latest); from `moved_from_m` on a feature was moved, a lane
    marking from the distance at which the fold takes it for another one."""
    instants = {
        "from_valid_at": _instant(before[0]),
        "from_known_at": _instant(before[1]),
        "to_valid_at": _instant(after[0]),
        "to_known_at": _instant(after[1]),
    }
    distances = {"moved_from_m": moved_from_m, "line_moved_from_m": ReconcileParams().marking_gate_m}
    return _rows(conn, "serving.changes_between", map_name=map_name, max_rows=max_rows, **distances, **instants)


def read_feature_history(
    conn: Connection, map_name: str, feature_id: UUID, known_at: datetime | None = None
) -> list[Row]:
    """Every delta of a feature with the state after it, as known at `known_at` (None: now), in the order of the drives.

    [] if the map has no such feature.
    """
    return _rows(conn, "serving.feature_history", map_name=map_name, feature_id=feature_id, known_at=_instant(known_at))


def read_sightings(conn: Connection, map_name: str, feature_id: UUID, max_rows: int) -> list[Row]:
    """The frame pairs in which a feature was seen, oldest first."""
    return _rows(conn, "serving.sightings", map_name=map_name, feature_id=feature_id, max_rows=max_rows)


def read_sighting_picture(
    conn: Connection, map_name: str, drive_uuid: UUID, frame_index: int, match_index: int, side: Side
) -> Row | None:
    """Path of the image of one side of a stereo match, and the box in it; None if there is no such match."""
    match = {"drive_uuid": drive_uuid, "frame_index": frame_index, "match_index": match_index, "side": side}
    rows = _rows(conn, "serving.sighting_image", map_name=map_name, **match)
    return rows[0] if rows else None


def read_trajectory(conn: Connection, map_name: str, drive_uuid: UUID, max_rows: int) -> list[Row]:
    """Poses of a drive in order of time; [] if the map has no such drive."""
    return _rows(conn, "serving.trajectory", map_name=map_name, drive_uuid=drive_uuid, max_rows=max_rows)


def read_rigs(conn: Connection, map_name: str, drive_uuids: set[UUID]) -> dict[UUID, Any]:
    """The rig (JSON) of each drive."""
    rows = _rows(conn, "serving.rigs", map_name=map_name, drive_uuids=list(drive_uuids))
    return {row["drive_uuid"]: row["rig"] for row in rows}


def read_base_tiles(conn: Connection, map_name: str, max_rows: int) -> list[Row]:
    """The point tiles of a map, coarse ones first."""
    return _rows(conn, "base_layers.tiles", map_name=map_name, max_rows=max_rows)


def read_base_tile(conn: Connection, map_name: str, sha256: str) -> bytes | None:
    """The bytes of one tile, in gzip; None if the map has no such tile."""
    rows = _rows(conn, "base_layers.tile", map_name=map_name, sha256=sha256)
    return bytes(rows[0]["payload"]) if rows else None


def read_base_lines(conn: Connection, map_name: str, max_rows: int) -> list[Row]:
    """Lines of a map's base layers; `geom` is well-known binary."""
    return _rows(conn, "base_layers.lines", map_name=map_name, max_rows=max_rows)


def _rows(conn: Connection, statement: str, **parameters: Any) -> list[Row]:
    with database_errors("The map cannot be read"):
        return execute(conn, load_sql(statement), parameters)


def _instant(time: datetime | None) -> str:
    return "infinity" if time is None else time.isoformat()
