"""Which changesets were told to the outside, and what is told of one: read back, so that another run can tell it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import timedelta
from uuid import UUID

from conetl.db.connection import Connection, execute, transaction
from conetl.db.statements import load_sql
from conetl.model.records import Vec3

#: Within this a run that has just committed tells its changes itself.
QUIET = timedelta(minutes=2)


@dataclass(frozen=True)
class VanishedCone:
    """A feature that a changeset took off the map; place and height as last known, in metres of the map's CRS."""

    feature_id: UUID
    xyz_m: Vec3
    cone_height_m: float


@dataclass(frozen=True)
class UntoldChangeset:
    """A changeset that is on the map, and was not told."""

    idempotency_key: str
    map_srid: int
    content_sha256: str
    expected_frame_count: int


def was_told(conn: Connection, changeset_id: UUID) -> bool:
    """Whether somebody handed on the events of this changeset."""
    return bool(execute(conn, load_sql("commit.is_published"), {"changeset_id": changeset_id})[0]["was_told"])


def untold_changesets(conn: Connection, *, map_name: str, quiet: timedelta) -> list[UntoldChangeset]:
    """Changesets of drives whose events nobody handed on, oldest first, but for those that were committed within `quiet`."""
    with transaction(conn, "The changesets that are still to be told cannot be read"):
        rows = execute(
            conn, load_sql("commit.pending_changesets"), {"map_name": map_name, "quiet_s": quiet.total_seconds()}
        )
    return [UntoldChangeset(**row) for row in rows]


def mark_told(conn: Connection, changeset_id: UUID) -> None:
    """Remember that its events were handed on."""
    with transaction(conn, "remember a told changeset"):
        execute(conn, load_sql("commit.mark_published"), {"changeset_id": changeset_id})


def vanished_by_changeset(conn: Connection, changeset_id: UUID) -> list[VanishedCone]:
    """The cones that a changeset removed, as it was committed."""
    rows = execute(conn, load_sql("commit.removed_features"), {"changeset_id": changeset_id})
    return [
        VanishedCone(r["feature_id"], (r["easting_m"], r["northing_m"], r["height_m"]), r["cone_height_m"])
        for r in rows
    ]
