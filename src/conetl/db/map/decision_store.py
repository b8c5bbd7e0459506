"""Decisions of people about a map. Append-only: a decision is withdrawn by another one."""

from __future__ import annotations

from datetime import datetime
from uuid import UUID, uuid4

from conetl.db.connection import Connection, database_errors, execute
from conetl.db.copy_binary import clean_text
from conetl.db.map.results import Decidable, MapInfo, StoredDecision
from conetl.db.statements import load_sql
from conetl.model.map_records import Classification, Decisions, Location


def list_decisions(conn: Connection, *, map_name: str = "default") -> list[StoredDecision]:
    """The decisions that were not withdrawn, and the drives on hold, oldest first."""
    with database_errors(f"The decisions about map {map_name} cannot be read"):
        rows = execute(conn, load_sql("decisions.active_decisions"), {"map_name": map_name})
    return [StoredDecision(**{name: row[name] for name in row if name != "drive_id"}) for row in rows]


def read_decisions(conn: Connection, *, map_name: str = "default") -> Decisions:
    """The decisions in the form for the comparison of drives."""
    found = list_decisions(conn, map_name=map_name)
    placed = [(decision.kind, decision.place) for decision in found if decision.place is not None]
    return Decisions(
        suppressed=tuple(place for kind, place in placed if kind == "suppress"),
        pinned=tuple(place for kind, place in placed if kind == "pin"),
        classified=tuple(place for _, place in placed if isinstance(place, Classification)),
        accepted=frozenset(d.changeset_id for d in found if d.kind == "accept" and d.changeset_id is not None),
    )


def find_decisions(conn: Connection, beginning: str, *, map_name: str = "default") -> list[Decidable]:
    """Changesets and decisions whose id begins with a text, or the changeset of that number; at most two."""
    parameters = {"map_name": map_name, "beginning": clean_text(beginning).lower()}
    with database_errors(f"The map {map_name} cannot be read"):
        return [Decidable(**row) for row in execute(conn, load_sql("decisions.find_decisions"), parameters)]


def insert_decision(
    conn: Connection,
    info: MapInfo,
    kind: str,
    *,
    decided_at: datetime,
    note: str,
    decided_by: str | None = None,
    place: Location | None = None,
    feature_id: UUID | None = None,
    changeset_id: UUID | None = None,
    withdraws: UUID | None = None,
) -> UUID:
    """Write a decision inside the caller's `map_transaction`; its id.

    kind: suppress, pin, classify (with a `Classification`), revert, accept or withdraw.
    """
    decision_id = uuid4()
    easting_m, northing_m = place.xy_m if place else (None, None)
    parameters = {
        "decision_id": decision_id,
        "map_id": info.map_id,
        "srid": info.srid,
        "kind": kind,
        "easting_m": easting_m,
        "northing_m": northing_m,
        "radius_m": place.radius_m if place else None,
        "category": getattr(place, "category", None),
        "found_as": getattr(place, "found_as", None),
        "feature_id": feature_id,
        "changeset_id": changeset_id,
        "withdraws": withdraws,
        "note": clean_text(note),
        "decided_by": clean_text(decided_by) if decided_by else None,
        "decided_at": decided_at,
        "of_line": place is not None and place.of_line,
    }
    execute(conn, load_sql("decisions.insert_decision"), parameters)
    return decision_id
