"""Decisions of people about a map (append-only; one is withdrawn by another one), and drives on hold until a person decides."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from uuid import UUID, uuid4

from conetl.db.connection import Connection, query, read
from conetl.db.copy_rows import clean_text, json_text
from conetl.db.map.results import CommittedChangeset, DecisionTarget, MapInfo, StoredDecision
from conetl.model.health import HealthCheck, HeldDrive, HoldChange, HoldEvent, hold_reason
from conetl.model.map_records import Classification, Decisions, Location


def list_decisions(conn: Connection, *, map_name: str = "default") -> list[StoredDecision]:
    """The decisions in force and the drives on hold, oldest first."""
    what = f"The decisions about map {map_name} cannot be read"
    rows = read(conn, what, "decisions.active_decisions", map_name=map_name)
    return [StoredDecision(**{name: row[name] for name in row if name != "drive_id"}) for row in rows]


def read_decisions(conn: Connection, *, map_name: str = "default") -> Decisions:
    """The decisions as the comparison of drives takes them."""
    found = list_decisions(conn, map_name=map_name)
    located = [(decision.kind, decision.location) for decision in found if decision.location is not None]
    return Decisions(
        suppressed=tuple(location for kind, location in located if kind == "suppress"),
        pinned=tuple(location for kind, location in located if kind == "pin"),
        classified=tuple(location for _, location in located if isinstance(location, Classification)),
        accepted=frozenset(d.changeset_id for d in found if d.kind == "accept" and d.changeset_id is not None),
    )


def find_decisions(conn: Connection, beginning: str, *, map_name: str = "default") -> list[DecisionTarget]:
    """Changesets and decisions whose id begins with `beginning`, or the changeset with that number; at most two."""
    wanted = {"map_name": map_name, "beginning": clean_text(beginning).lower()}
    rows = read(conn, f"The map {map_name} cannot be read", "decisions.find_decisions", **wanted)
    return [DecisionTarget(**row) for row in rows]


def insert_decision(
    conn: Connection,
    info: MapInfo,
    kind: str,
    *,
    decided_at: datetime,
    note: str,
    decided_by: str | None = None,
    location: Location | None = None,
    feature_id: UUID | None = None,
    changeset_id: UUID | None = None,
    withdraws: UUID | None = None,
    approves: UUID | None = None,
) -> UUID:
    """Write a decision inside the caller's `map_transaction`. Returns its id.

    kind: suppress, pin, classify (with a `Classification`), approve, revert, accept or withdraw.
    """
    decision_id = uuid4()
    easting_m, northing_m = location.xy_m if location else (None, None)
    query(
        conn,
        "decisions.insert_decision",
        decision_id=decision_id,
        map_id=info.map_id,
        srid=info.srid,
        kind=kind,
        easting_m=easting_m,
        northing_m=northing_m,
        radius_m=location.radius_m if location else None,
        category=getattr(location, "category", None),
        found_as=getattr(location, "found_as", None),
        feature_id=feature_id,
        changeset_id=changeset_id,
        withdraws=withdraws,
        approves=approves,
        note=clean_text(note),
        decided_by=clean_text(decided_by) if decided_by else None,
        decided_at=decided_at,
        of_line=location is not None and location.of_line,
    )
    return decision_id


def write_holds(
    conn: Connection, checks: Mapping[UUID, Sequence[HealthCheck]], committed_at: datetime, *, by_map: bool
) -> None:
    """Begin and end holds of drives; does not commit.

    checks: by changeset, the checks that hold it (none: it counts); by_map: whether the comparison with the map made them, and
    not the recording alone.
    """
    if checks:
        reasons = [hold_reason(found) for found in checks.values()]
        parameters = {
            "changeset_ids": list(checks),
            "reasons": [reason and clean_text(reason) for reason in reasons],
            "committed_at": committed_at,
        }
        written = [json_text([check.model_dump(mode="json") for check in found]) for found in checks.values()]
        query(conn, "holds.end_holds", **parameters)
        query(conn, "holds.begin_holds", **parameters | {"by_map": by_map, "checks": written})


def _unreadable(map_name: str) -> str:
    return f"The drives on hold on map {map_name} cannot be read"


def held_drives(conn: Connection, *, map_name: str) -> list[HeldDrive]:
    """The drives of a map that are on hold, the longest-waiting first."""
    rows = read(conn, _unreadable(map_name), "holds.held_drives", map_name=map_name)
    return [HeldDrive(**row) for row in rows]


def hold_changes(
    conn: Connection,
    before: Sequence[HeldDrive],
    *,
    map_name: str,
    by: UUID | None = None,
    among: Collection[UUID] = (),
) -> tuple[HoldChange, ...]:
    """Which drives went on hold, or were released, since `before` was read.

    by: the changeset of the drive that caused it, to leave out others that were merged meanwhile; among: changesets that it
    affects.
    """
    held = {drive.changeset_id: drive for drive in held_drives(conn, map_name=map_name)}
    was = {drive.changeset_id: drive for drive in before}
    changed_ids = was.keys() ^ held.keys()
    if not changed_ids:
        return ()
    if by is not None:
        replaced = read(conn, _unreadable(map_name), "holds.earlier_deliveries", changeset_id=by)
        changed_ids &= {*among, *(row["changeset_id"] for row in replaced)}
    states = dict.fromkeys(changed_ids & held.keys(), "on hold")
    gone = read(conn, _unreadable(map_name), "holds.unheld_states", changeset_ids=list(changed_ids & was.keys()))
    states |= {row["changeset_id"]: row["state"] for row in gone}
    changed = [(was | held)[drive] for drive in states]
    return tuple(
        HoldChange(
            **drive.model_dump(include={"drive_id", "changeset_no", "changeset_id"}),
            state=states[drive.changeset_id],
            reason=drive.reason,
        )
        for drive in sorted(changed, key=lambda drive: drive.changeset_no)
    )


def hold_events(
    conn: Connection, *, map_name: str, since: datetime | None = None, until: datetime | None = None
) -> list[HoldEvent]:
    """Events in [since, until) of drives that are or were on hold, in order."""
    rows = read(conn, _unreadable(map_name), "holds.hold_events", map_name=map_name, since=since, until=until)
    return [HoldEvent(**row) for row in rows]


def replaced_by_delivery(conn: Connection, changeset_id: UUID) -> int | None:
    """Number of the later delivery of the recording that replaced a changeset; None if there is none."""
    rows = read(conn, "The deliveries of the drive cannot be read", "holds.replaced_by", changeset_id=changeset_id)
    return rows[0]["changeset_no"] if rows else None


def why_not_counted(conn: Connection, known: CommittedChangeset, map_name: str) -> str:
    """Why a changeset that is not on hold is not in effect, and what to do."""
    later = replaced_by_delivery(conn, known.changeset_id)
    if later is None:
        return (
            f"its changeset {known.changeset_no} was reverted. `conetl map decisions` shows by whom and why; to put it in effect "
            "again, revert that decision with `conetl map revert ID`"
        )
    return (
        f"a later analysis or delivery of the same recording (changeset {later}) replaced it. To use this one instead, run "
        f"`conetl map revert {later} --map {map_name}`"
    )


def map_checks(conn: Connection, changeset_id: UUID) -> tuple[HealthCheck, ...]:
    """The checks by which the map holds a drive, even if it is reverted or replaced; empty if it agrees."""
    rows = read(conn, "The drives on hold cannot be read", "holds.map_checks", changeset_id=changeset_id)
    return tuple(HealthCheck(**check) for row in rows for check in row["checks"])
