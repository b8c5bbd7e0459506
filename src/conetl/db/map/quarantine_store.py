"""Refused records in PostGIS: kept with reason and payload, so that nothing disappears silently."""

from __future__ import annotations

from collections.abc import Sequence
from uuid import UUID

from conetl.db.connection import Connection, copy_columns
from conetl.db.map.columns import rejection_columns
from conetl.model.rejections import Rejection


def insert_rejections(conn: Connection, changeset_id: UUID, rejections: Sequence[Rejection]) -> None:
    """Keep refused records beside their changeset, inside the caller's transaction."""
    copy_columns(conn, "conetl.quarantine", rejection_columns(changeset_id, rejections))
