"""The page of a night: all drives that were processed into a map within a period."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from conetl.db.connection import Connection, database_errors, query
from conetl.db.map.decision_store import held_drives, hold_events
from conetl.db.map.map_store import find_map, list_changesets, read_paths, require_map
from conetl.db.receipt_store import STRAYS
from conetl.model.arrays import Floats
from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.model.health import HeldDrive, HoldEvent, hold_remedy
from conetl.model.map_records import DeltaKind
from conetl.reports import figures
from conetl.reports.html import render, write_page
from conetl.reports.map_picture import PlanContent, draw_plan

#: Rows of a table; the rest is counted.
_MAX_ROWS = 400
_WORST = 8
Row = dict[str, Any]


@dataclass(frozen=True)
class NightFacts:
    """Changes of a map in [since, until), by the clock of the database."""

    map_name: str
    since: datetime
    until: datetime
    drives: list[Row]
    """Committed changesets, oldest first: fields of CommittedChangeset and columns of `reports.night_drives`, with lost_pairs and
    lost_share."""
    held: list[HeldDrive]
    """Drives that went on hold before the end of the period and are on hold now."""
    hold_events: list[HoldEvent]
    """Holds and releases in the period, in order."""
    failures: list[Row]
    """Of drives, and of what is no drive: last receipts, and entries of the drop folder that have none. The state is failed,
    crashed, started (not finished), needs init or not recognised."""
    waiting: list[Row]
    """What is still arriving in the drop folder now: drive_id, drive_path, reason."""
    changes: list[Row]
    """Of point objects, confirmations excluded; at most `_MAX_ROWS`, each with the `total` and how many are `gone`."""
    srid: int
    """0 before the first drive is on the map."""
    paths_m: list[Floats]
    """(N, 2) each: drive paths of the period."""
    rejections: list[Row]
    markings: list[Row]
    """Stretches of lane markings by kind of change: kind, count, length_m."""
    sizes: list[tuple[datetime, int]]
    """Number of point objects on the map after each change of it; the whole history."""

    @property
    def failed(self) -> list[Row]:
        """Failures that are not of a drive that may still be running."""
        return [row for row in self.failures if row["state"] != "started"]

    @property
    def entries(self) -> list[Row]:
        """Every drive and every other entry, a row each: drive_id, state and reason; those that wait for a person first."""
        known = {
            drive.changeset_no: f"{drive.reason} {hold_remedy(drive.changeset_no, self.map_name)}"
            for drive in self.held
        }
        held = [
            {"drive_id": drive.drive_id, "state": "held", "reason": known[drive.changeset_no]} for drive in self.held
        ]
        done = [
            {"drive_id": row["drive_id"], "state": "committed" if row["counts"] else "not in effect", "reason": ""}
            for row in self.drives
            if row["changeset_no"] not in known
        ]
        others = [
            {name: row[name] for name in ("drive_id", "drive_path", "state", "reason")}
            for row in (*self.failures, *self.waiting)
        ]
        return [*held, *others, *done]

    def size_at(self, instant: datetime) -> int:
        """Cones on the map just before an instant."""
        return next((count for at, count in reversed(self.sizes) if at < instant), 0)


def read_night(
    conn: Connection, *, map_name: str, since: datetime, until: datetime, drop_folder: Sequence[Row] = ()
) -> NightFacts:
    """Facts of a period; read-only. drop_folder: what is in it and no drive, as `entries.as_rows`.

    A map that does not exist yet has a report, too, if there is something to say of it: a first drive that failed, entries of the
    drop folder. Raises InputError for an unknown map or an empty period.
    """
    if until <= since:
        raise InputError(f"the report would end ({until:%Y-%m-%d %H:%M}) before it begins ({since:%Y-%m-%d %H:%M})")
    info = find_map(conn, map_name)
    period = {"map_name": map_name, "since": since, "until": until}
    with database_errors(f"The map {map_name} cannot be read"):
        drives = query(conn, "reports.night_drives", **period)
        changesets = {one.changeset_id: one for one in list_changesets(conn, map_name=map_name)}
        sizes = query(conn, "reports.map_size", map_name=map_name)
        failures = query(conn, "reports.night_failures", map_name=map_name, until=until)
        changes = query(conn, "reports.night_changes", **period | {"max_rows": _MAX_ROWS})
        rejections = query(conn, "reports.night_rejections", **period)
        markings = query(conn, "reports.night_markings", **period)
        held = [drive for drive in held_drives(conn, map_name=map_name) if drive.since < until]
        events = hold_events(conn, map_name=map_name, since=since, until=until)
        conn.rollback()
    # What failed earlier is listed until it is repaired, or its folder removed.
    failures = [row for row in failures if row["at"] >= since or os.path.lexists(row["drive_path"])]
    for row in failures:
        start = row["reason"].partition(":")[0]
        row["state"] = start if start in STRAYS else row["state"]
    reported = {(row["drive_path"], row["drive_id"]) for row in failures}
    unseen = {"frame_pairs": None, "attempts": 0, "at": None, "host": ""}
    new = [row for row in drop_folder if (row["drive_path"], row["drive_id"]) not in reported]
    waiting = [row for row in new if row["state"] == "arriving"]
    failures += [row | unseen for row in new if row["state"] != "arriving"]
    if info is None and not (failures or waiting):
        require_map(conn, map_name)
    for row in drives:
        row.update(vars(changeset := changesets[row["changeset_id"]]))
        row["captured_at"] = utc_from_ns(changeset.captured_from_ns)
        row["lost_pairs"] = changeset.lost_pairs
        row["lost_share"] = changeset.lost_pairs / max(changeset.expected_frame_count, 1)
    names = {row["drive_id"] for row in drives}
    paths_m = [path.xy_m for path in read_paths(conn, map_name=map_name) if path.drive_id in names]
    counts = [(row["at"], int(row["standing"])) for row in sizes]
    return NightFacts(
        map_name,
        since,
        until,
        drives,
        held,
        events,
        failures,
        waiting,
        changes,
        info.srid if info else 0,
        paths_m,
        rejections,
        markings,
        counts,
    )


def write_night_page(conn: Connection, path: Path, **asked: Any) -> NightFacts:
    """Write the page; asked: as for `read_night`. Returns its facts. Raises InputError, also where the file cannot be written."""
    facts = read_night(conn, **asked)
    write_page(path, night_page(facts))
    return facts


def night_page(facts: NightFacts) -> str:
    """The page as text."""
    sizes = [(at, count) for at, count in facts.sizes if at < facts.until]
    figure = None
    if sizes:
        times, counts = zip((min(sizes[0][0], facts.since), 0), *sizes, strict=True)  # empty before the first drive
        figure = figures.map_size(times, counts, facts.since, facts.until)
    return render(
        "night.html.j2",
        title=f"Map {facts.map_name}, {facts.since:%Y-%m-%d %H:%M} to {facts.until:%Y-%m-%d %H:%M} UTC",
        made_at=datetime.now(UTC),
        facts=facts,
        what_to_do=partial(hold_remedy, map_name=facts.map_name),
        totals=sum((row["change_counts"].points for row in facts.drives if row["counts"]), Counter[DeltaKind]()),
        size_before=facts.size_at(facts.since),
        size_after=facts.size_at(facts.until),
        size_figure=figure,
        max_rows=_MAX_ROWS,
        worst=_WORST,
        plan=_plan(facts) if facts.changes else None,
    )


def _plan(facts: NightFacts) -> bytes:
    """Where the changes are."""
    kinds = [(row, DeltaKind(row["kind"])) for row in facts.changes]
    marks = [figures.PlanMark(row["category"], kind, row["xyz_m"][:2], None, str(row["number"])) for row, kind in kinds]
    return figures.png(draw_plan(PlanContent(facts.srid, marks, (), facts.paths_m)))
