"""Deletion of raw records of old drives.

The detections, stereo matches and positions of a drive are deleted. Its path, tracks, changeset and deltas stay, so the history
of the map and every audit remain valid. Lost are its single sightings, and the possibility to compare it with the map again. A
drive or a decision that requires that is rejected (`require_comparable`) instead of using half of the evidence, so the map does
not depend on the order of the drives that were accepted.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from uuid import UUID

from conetl.db.connection import Connection, database_errors, execute
from conetl.db.map.map_store import map_transaction
from conetl.db.statements import load_sql
from conetl.model.errors import InputError


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
    with database_errors("The drives cannot be read"):
        found = [
            PrunableDrive(**row) for row in execute(conn, load_sql("retention.prunable_drives"), {"before": before})
        ]
        conn.rollback()
    return found


def prune_drives(conn: Connection, drives: Sequence[PrunableDrive], *, now: datetime | None = None) -> int:
    """Delete the raw records of drives, map by map, each under its lock and in one transaction; the number of rows deleted."""
    deleted = 0
    for map_name in sorted({drive.map_name for drive in drives}):
        own = [drive.drive_uuid for drive in drives if drive.map_name == map_name]
        parameters = {"drive_uuids": own, "pruned_at": now or datetime.now(UTC)}
        with map_transaction(conn, map_name):
            deleted += execute(conn, load_sql("retention.prune_drives"), parameters)[0]["deleted"]
    return deleted


def require_comparable(conn: Connection, drive_uuids: Sequence[UUID]) -> None:
    """Raise InputError if one of the drives must be compared with the map again, but was pruned."""
    pruned = execute(conn, load_sql("retention.pruned_drives"), {"drive_uuids": list(drive_uuids)})
    if pruned:
        first = pruned[0]
        more = f" and {len(pruned) - 1} more" if len(pruned) > 1 else ""
        raise InputError(
            f"drive {first['drive_id']}, recorded {first['captured_to']:%Y-%m-%d}{more}, would have to be compared with the map "
            f"again, but its raw records were pruned on {first['pruned_at']:%Y-%m-%d}: the map before that time is closed. "
            "Nothing was written."
        )


def parse_age(text: str) -> float:
    """Seconds of an age like 90d, 12w, 36h. Raises InputError."""
    units = {"h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}
    number, unit = text[:-1], text[-1:]
    if not number.isdigit() or unit not in units or not 0 < int(number) * units[unit] < time.time():
        raise InputError(f"{text!r} is not an age: write it like 90d, 12w or 36h")
    return int(number) * units[unit]
