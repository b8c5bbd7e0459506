"""Refused records in PostGIS: kept with reason and payload, so that nothing disappears silently."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from uuid import UUID

from conetl.db.connection import Connection, copy_columns, database_errors, execute, load_sql
from conetl.db.map.columns import rejection_columns
from conetl.model.rejections import Rejection, RejectionReason


@dataclass(frozen=True)
class RejectionCount:
    """How many records one step refused for one reason."""

    step: str
    reason: RejectionReason
    count: int


def insert_rejections(conn: Connection, changeset_id: UUID, rejections: Sequence[Rejection]) -> None:
    """Keep refused records beside their changeset, inside the caller's transaction."""
    copy_columns(conn, "conetl.quarantine", rejection_columns(changeset_id, rejections))


def read_rejections(conn: Connection, changeset_id: UUID, *, limit: int | None = None) -> list[Rejection]:
    """The refused records of a changeset, in the order in which they were written."""
    with database_errors("The quarantine cannot be read"):
        rows = execute(conn, load_sql("map/rejections"), {"changeset_id": changeset_id, "max_rows": limit})
    return [Rejection(**row | {"reason": RejectionReason(row["reason"])}) for row in rows]


def count_rejections(conn: Connection, changeset_id: UUID) -> list[RejectionCount]:
    """Refused records of a changeset by step and reason."""
    with database_errors("The quarantine cannot be read"):
        rows = execute(conn, load_sql("map/rejection_counts"), {"changeset_id": changeset_id})
    return [RejectionCount(row["step"], RejectionReason(row["reason"]), row["count"]) for row in rows]
