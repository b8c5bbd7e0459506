"""The content of one drive's report, read from the database alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from conetl.checks.verdict import AGREES
from conetl.db.connection import Connection, read, stream_values
from conetl.db.map.decision_store import hold_events, map_checks
from conetl.db.map.drive_store import read_frame_pairs, read_tracks
from conetl.db.map.map_store import list_changesets, read_features_as_of
from conetl.db.map.results import CommittedChangeset
from conetl.db.serve_store import read_rows
from conetl.geometry.rig import map_SE3_left
from conetl.model.arrays import Floats
from conetl.model.drive import FramePair, Track
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE
from conetl.model.health import HealthCheck, HoldEvent, hold_checks
from conetl.model.map_records import DeltaKind, MapFeature
from conetl.model.rig import Rig
from conetl.reports.drive_passes import reasons_of
from conetl.reports.figures import MarkingChange, change_of_row, changes_of

Row = dict[str, Any]
#: Features within this distance of the path are drawn on the plan.
_AROUND_M = 30.0
#: Changes with a sentence and images on one page; the table lists all.
MAX_ILLUSTRATED = 120
#: Kinds that a person should review come first.
_ORDER = (
    DeltaKind.REMOVED, DeltaKind.MOVED, DeltaKind.ADDED, DeltaKind.SPLIT, DeltaKind.MERGED, DeltaKind.HEIGHT_CHANGED,
    DeltaKind.MISSED, DeltaKind.CONFIRMED,
)  # fmt: skip


@dataclass(frozen=True)
class DriveFacts:
    """The content of the page of a drive, except the images."""

    map_name: str
    changeset: CommittedChangeset
    header: Row
    """The row of `reports.changeset`. facts: trajectory, calibration, versions; steps: step, task_count, busy_s, started_s,
    ended_s of each step of the run."""
    rig: Rig
    frame_pairs: list[FramePair]
    tracks: list[Track]
    changes: tuple[Row, ...]
    """Of point objects: the rows of `history.changes_of_changeset`, kind as DeltaKind; number, in table and plan,
    from 1; why, one sentence with numbers, empty of confirmations and of what is beyond `MAX_ILLUSTRATED`."""
    checks: tuple[HealthCheck, ...]
    """Of the recording as it was ingested, and of the drive against the map as it is now; () where none were stored."""
    hold_events: tuple[HoldEvent, ...]
    """Holds and releases of this drive, in order."""
    rejections: list[Row]
    """step, reason, count, and record and detail of the first one."""
    range_m: Floats
    """(N,) of every position; empty where they were pruned."""
    residual_px: Floats
    """(N,)"""
    path_m: Floats
    """(F, 2) of the left camera."""
    others: tuple[MapFeature, ...]
    """Point objects around the path without a change, in the database state after the commit."""
    markings: tuple[MarkingChange, ...]
    """Lane markings that the drive evaluated, and those around the path that it did not."""

    @property
    def noun(self) -> str:
        """`cone`, or `object` where the drive evaluated other classes, too."""
        return "object" if {one["category"] for one in self.changes} - {CONE} else "cone"


def find_drive(conn: Connection, name: str, *, map_name: str) -> CommittedChangeset:
    """The changeset with a number or a drive's id; of several analyses of a drive the valid one, or the latest.

    Raises InputError for an unknown one.
    """
    found = list_changesets(conn, map_name=map_name)
    by_number = [c for c in found if name.isascii() and name.isdigit() and c.changeset_no == int(name)]
    by_id = [c for c in found if c.drive_id == name]
    chosen = next((c for c in by_id if c.counts), None) or next(iter(by_id or by_number), None)
    if chosen is None:
        raise InputError(f"the map {map_name} has no drive and no changeset {name}: see `conetl map log`")
    return chosen


def read_drive_facts(conn: Connection, changeset: CommittedChangeset, *, map_name: str) -> DriveFacts:
    """Facts of one changeset; read-only. Raises InputError for an imported map."""
    what = f"Drive {changeset.drive_id} cannot be read"
    header = read(conn, what, "reports.changeset", changeset_id=changeset.changeset_id)[0]
    if header["rig"] is None:
        raise InputError(f"changeset {changeset.changeset_no} is an imported map, not a drive: it has no report")
    number = {"map_name": map_name, "changeset_no": changeset.changeset_no}
    evaluated = read_rows(conn, "history.changes_of_changeset", origin_m=[0.0, 0.0, 0.0], **number)
    rejections = read(conn, what, "reports.rejections", changeset_id=changeset.changeset_id)
    residuals = np.array(list(stream_values(conn, what, "reports.residuals", drive_uuid=changeset.drive_uuid)))
    events = [e for e in hold_events(conn, map_name=map_name) if e.changeset_id == changeset.changeset_id]
    against_map = map_checks(conn, changeset.changeset_id)
    checks = tuple(HealthCheck(**check) for check in header["facts"].get("health", ()))
    accepted = [event.what for event in events if "accept" in event.what][-1:] == ["accepted"]
    if checks and not against_map and not accepted and not hold_checks(checks):
        against_map = (AGREES,)
    rig = Rig.model_validate(header["rig"])
    rows = [row for row in evaluated if row["marking"] is None]
    rows.sort(key=lambda row: (_ORDER.index(DeltaKind(row["kind"])), row["changed_at"], str(row["feature_id"])))
    drive = {"drive_id": changeset.drive_id, "drive_uuid": changeset.drive_uuid, "drive_kind": "drive"}
    explained = [row | drive for row in rows if row["kind"] != DeltaKind.CONFIRMED][:MAX_ILLUSTRATED]
    reasons = {row["feature_id"]: why for row, why in zip(explained, reasons_of(conn, explained), strict=True)}
    frame_pairs = read_frame_pairs(conn, changeset.drive_uuid)
    path_m = np.array([map_SE3_left(pair.pose, rig)[:2, 3] for pair in frame_pairs])
    (west, south), (east, north) = path_m.min(axis=0) - _AROUND_M, path_m.max(axis=0) + _AROUND_M
    box = (float(west), float(south), float(east), float(north))
    changed = {row["feature_id"] for row in evaluated}
    others = [
        found.feature
        for found in read_features_as_of(conn, known_at=changeset.effective_at, map_name=map_name, within=box)
        if found.feature.feature_id not in changed
    ]
    markings = [change_of_row(row) for row in evaluated if row["marking"] is not None]
    residuals = residuals.reshape(-1, 3).astype(np.float64)
    return DriveFacts(
        map_name=map_name,
        changeset=changeset,
        header=header,
        rig=rig,
        frame_pairs=frame_pairs,
        tracks=read_tracks(conn, changeset.drive_uuid),
        changes=tuple(
            row | {"number": number, "kind": DeltaKind(row["kind"]), "why": reasons.get(row["feature_id"], "")}
            for number, row in enumerate(rows, start=1)
        ),
        checks=(*checks, *against_map),
        hold_events=tuple(events),
        rejections=rejections,
        range_m=residuals[:, 1],
        residual_px=residuals[:, 2],
        path_m=path_m,
        others=tuple(one for one in others if one.marking is None),
        markings=(*markings, *changes_of((), others)),
    )
