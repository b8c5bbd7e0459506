"""What the report of one drive tells, read from the database alone."""

from __future__ import annotations

from dataclasses import dataclass, fields
from datetime import datetime
from typing import Any
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from conetl.db.connection import Connection, database_errors, execute, stream
from conetl.db.map.drive_store import read_drive, read_frame_pairs
from conetl.db.map.map_store import list_changesets, read_features_as_of
from conetl.db.map.results import CommittedChangeset
from conetl.db.serve_store import read_changeset_changes
from conetl.db.statements import load_sql
from conetl.geometry.rig import map_SE3_left
from conetl.model.errors import InputError
from conetl.model.map_records import DeltaKind
from conetl.model.records import FramePair, Rig, Track

Floats = NDArray[np.float64]
#: Features so far from the path are drawn on the plan.
_AROUND_M = 30.0


@dataclass(frozen=True)
class Change:
    """What the drive did to one feature; metres of the map's CRS."""

    number: int
    """In table and plan, from 1."""
    feature_id: UUID
    kind: DeltaKind
    changed_at: datetime
    shift_m: float | None
    track_index: int | None
    """None where the drive did not see it."""
    frames_seen: int | None
    frames_empty: int | None
    old_xy_m: tuple[float, float] | None
    xyz_m: tuple[float, float, float]
    sigma_m: float
    cone_height_m: float
    existence_probability: float
    observation_count: int

    @property
    def is_confirmation(self) -> bool:
        return self.kind is DeltaKind.CONFIRMED


@dataclass(frozen=True)
class RejectionLine:
    """Refused records of one step and reason, and the first of them."""

    step: str
    reason: str
    count: int
    record: str
    detail: str


@dataclass(frozen=True)
class StepLine:
    """How long one step took, seconds by the clock."""

    step: str
    task_count: int
    busy_s: float
    started_s: float
    ended_s: float


@dataclass(frozen=True)
class DriveFacts:
    """Everything that the page of a drive shows, but the images."""

    map_name: str
    srid: int
    changeset: CommittedChangeset
    source_path: str
    rig: Rig
    expected_frame_count: int
    content_sha256: str
    pruned_at: datetime | None
    facts: dict[str, Any]
    """Empty where none were kept."""
    max_rejected_fraction: float | None
    """What the run's parameters allowed ..."""
    min_existence_probability: float | None
    """... and asked for."""
    steps: tuple[StepLine, ...]
    frame_pairs: list[FramePair]
    tracks: list[Track]
    changes: tuple[Change, ...]
    rejections: tuple[RejectionLine, ...]
    range_m: Floats
    """(N,) of every position; empty where they were pruned."""
    residual_px: Floats
    """(N,)"""
    path_m: Floats
    """(F, 2) of the left camera."""
    others_m: Floats
    """(M, 2): features around the path that the drive did not judge, as the map knew them then."""

    @property
    def lost_pairs(self) -> int:
        return self.expected_frame_count - len(self.frame_pairs)


def find_drive(conn: Connection, name: str, *, map_name: str) -> CommittedChangeset:
    """The changeset of a number or of a drive's id; of a drive that was analysed several times, the one that counts, or the last.

    Raises InputError where there is none.
    """
    found = list_changesets(conn, map_name=map_name)
    by_number = [c for c in found if name.isascii() and name.isdigit() and c.changeset_no == int(name)]
    by_id = [c for c in found if c.drive_id == name]
    chosen = next((c for c in by_id if c.counts), None) or next(iter(by_id or by_number), None)
    if chosen is None:
        raise InputError(f"the map {map_name} knows no drive and no changeset {name}: `conetl map log` lists them")
    return chosen


def read_drive_facts(conn: Connection, changeset: CommittedChangeset, *, map_name: str) -> DriveFacts:
    """Facts of one changeset. Raises InputError for an imported map, which is no drive; changes nothing."""
    parameters = {"changeset_id": changeset.changeset_id}
    with database_errors(f"Drive {changeset.drive_id} cannot be read"):
        header = execute(conn, load_sql("reports.changeset"), parameters)[0]
        if header["rig"] is None:
            raise InputError(f"changeset {changeset.changeset_no} is an imported map, not a drive: it has no report")
        rig = Rig.model_validate(header["rig"])
        rows = [_change(row) for row in read_changeset_changes(conn, map_name, changeset.changeset_no)]
        rejections = execute(conn, load_sql("reports.rejections"), parameters)
        residuals = np.array(list(stream(conn, load_sql("reports.residuals"), {"drive_uuid": changeset.drive_uuid})))
    frame_pairs = read_frame_pairs(conn, changeset.drive_uuid)
    path_m = np.array([map_SE3_left(pair.pose, rig)[:2, 3] for pair in frame_pairs])
    residuals = residuals.reshape(-1, 3).astype(np.float64)
    params = header["params"] or {}
    return DriveFacts(
        map_name=map_name, srid=header["srid"], changeset=changeset, source_path=header["source_path"], rig=rig,
        expected_frame_count=header["expected_frame_count"], content_sha256=header["content_sha256"],
        pruned_at=header["pruned_at"], facts=header["facts"] or {},
        max_rejected_fraction=params.get("max_rejected_fraction"),
        min_existence_probability=params.get("track", {}).get("min_existence_probability"),
        steps=tuple(StepLine(**step) for step in header["steps"] or ()),
        frame_pairs=frame_pairs, tracks=read_drive(conn, changeset.drive_uuid).tracks, changes=_numbered(rows),
        rejections=tuple(RejectionLine(**row) for row in rejections),
        range_m=residuals[:, 1], residual_px=residuals[:, 2], path_m=path_m,
        others_m=_others(conn, changeset, path_m, {row["feature_id"] for row in rows}, map_name),
    )  # fmt: skip


def _change(row: dict[str, Any]) -> dict[str, Any]:
    same = {field.name: row[field.name] for field in fields(Change) if field.name in row}
    return same | {
        "kind": DeltaKind(row["kind"]),
        "old_xy_m": None if row["old_easting_m"] is None else (row["old_easting_m"], row["old_northing_m"]),
        "xyz_m": (row["easting_m"], row["northing_m"], row["height_m"]),
        "sigma_m": float(np.sqrt((row["cov_xx"] + row["cov_yy"]) / 2)),
    }


#: What needs a person's eye comes first.
_ORDER = (
    DeltaKind.REMOVED, DeltaKind.MOVED, DeltaKind.ADDED, DeltaKind.SPLIT, DeltaKind.MERGED, DeltaKind.HEIGHT_CHANGED,
    DeltaKind.MISSED, DeltaKind.CONFIRMED,
)  # fmt: skip


def _numbered(rows: list[dict[str, Any]]) -> tuple[Change, ...]:
    """Changes by kind, the rarest kinds first, then along the road as the drive met them."""
    rows.sort(key=lambda row: (_ORDER.index(row["kind"]), row["changed_at"], str(row["feature_id"])))
    return tuple(Change(number=number, **row) for number, row in enumerate(rows, start=1))


def _others(
    conn: Connection, changeset: CommittedChangeset, path_m: Floats, judged: set[UUID], map_name: str
) -> Floats:
    west, south = path_m.min(axis=0) - _AROUND_M
    east, north = path_m.max(axis=0) + _AROUND_M
    standing = read_features_as_of(
        conn, known_at=changeset.committed_at, map_name=map_name,
        within=(float(west), float(south), float(east), float(north)),
    )  # fmt: skip
    return np.array([v.feature.xyz_m[:2] for v in standing if v.feature.feature_id not in judged]).reshape(-1, 2)
