"""Notices of work zones and of differences from plans, and who has been notified, in PostGIS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any
from uuid import UUID

from conetl.db.connection import Connection, copy_columns, or_infinity, query, read, transaction
from conetl.db.map.rows import Row
from conetl.model.notices import Notice, Subject


def round_due(conn: Connection, map_id: int, *, most_s: float) -> Row:
    """The only row of `notices.round_due`."""
    [row] = read(conn, "The state of the map cannot be read", "notices.round_due", map_id=map_id, most_s=most_s)
    return row


def last_states(conn: Connection, map_id: int) -> dict[Subject, tuple[str, Mapping[str, Any]]]:
    """Event and state of the last notice of every subject."""
    rows = read(conn, "The notices of the map cannot be read", "notices.last_notices", map_id=map_id)
    return {Subject(row["topic"], UUID(row["subject_id"])): (row["event"], row["state"]) for row in rows}


def write_notices(
    conn: Connection, map_id: int, notices: Sequence[tuple[Subject, str, Mapping[str, Any]]], newest: Any
) -> None:
    """Add notices, all or none, and that they are recorded up to `newest`, in the caller's transaction."""
    copy_columns(conn, "conetl.notice", {
        "map_id": [map_id] * len(notices),
        "topic": [subject.topic for subject, _, _ in notices],
        "subject_id": [str(subject.subject_id) for subject, _, _ in notices],
        "event": [event for _, event, _ in notices],
        "state": [dict(state) for _, _, state in notices],
    })  # fmt: skip
    query(conn, "notices.write_round", map_id=map_id, newest=newest)


def read_zone_aliases(conn: Connection, *, map_name: str) -> dict[UUID, UUID]:
    """By the id that is computed from a work zone's devices, the one that it keeps."""
    rows = read(conn, "The work zones of the map cannot be read", "notices.zone_aliases", map_name=map_name)
    return {row["computed_id"]: row["zone_id"] for row in rows}


def write_zone_aliases(conn: Connection, map_id: int, aliases: Mapping[UUID, UUID]) -> None:
    """Add such ids, in the caller's transaction."""
    copy_columns(conn, "conetl.zone_alias", {
        "map_id": [map_id] * len(aliases),
        "computed_id": [str(computed_id) for computed_id in aliases],
        "zone_id": [str(zone_id) for zone_id in aliases.values()],
    })  # fmt: skip


def read_zone_versions(
    conn: Connection, *, map_name: str, beginning: str = "", known_at: datetime | None = None
) -> Sequence[Row]:
    """Columns of `notices.zone_versions`, of the zones whose id begins so."""
    what, known = "The work zones of the map cannot be read", or_infinity(known_at)
    return read(conn, what, "notices.zone_versions", map_name=map_name, beginning=beginning, known_at=known)


def add_receiver(conn: Connection, map_id: int, receiver: str) -> None:
    """Notify a receiver of a map from now on; nothing if it is known."""
    with transaction(conn, f"The receiver {receiver} cannot be added"):
        query(conn, "notices.add_receiver", map_id=map_id, receiver=receiver)


def due_notices(conn: Connection, map_id: int, receiver: str, *, most: int) -> list[Notice]:
    """The next notice of each subject, oldest first, if it is due."""
    rows = read(
        conn,
        "The notices of the map cannot be read",
        "notices.due_notices",
        map_id=map_id,
        receiver=receiver,
        most=most,
    )
    return [
        Notice(row["notice_no"], Subject(row["topic"], UUID(row["subject_id"])), row["event"], row["recorded_at"],
               row["state"], row["attempts"])
        for row in rows
    ]  # fmt: skip


def write_delivery(
    conn: Connection, receiver: str, notice: Notice, problem: str | None, *, wait_s: float, patience_s: float
) -> None:
    """How an attempt ended; problem: None if the receiver has it. Others: as of `notices.write_delivery`."""
    with transaction(conn, "The delivery of a notice cannot be recorded"):
        query(
            conn, "notices.write_delivery", receiver=receiver, notice_no=notice.notice_no, delivered=problem is None,
            problem=problem, wait_s=wait_s, patience_s=patience_s,
        )  # fmt: skip


def undelivered(conn: Connection, map_name: str | None = None) -> Sequence[Row]:
    """Columns of `notices.undelivered`."""
    return read(conn, "The notices cannot be read", "notices.undelivered", map_name=map_name)


def try_again(conn: Connection, map_id: int) -> int:
    """Make notices due that were given up; returns their number."""
    with transaction(conn, "The notices cannot be tried again"):
        return len(query(conn, "notices.try_again", map_id=map_id))
