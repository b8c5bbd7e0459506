"""Tracks of one drive into the map, as one atomic changeset under the locks of its neighbourhood."""

from __future__ import annotations

import hashlib
import platform
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from uuid import UUID, uuid4, uuid5

from conetl.checks.verdict import AGREES, judge_all
from conetl.db.connection import Connection, sql_directory, transaction
from conetl.db.live_store import drop_watched_recording
from conetl.db.map.decision_store import held_drives, why_not_counted
from conetl.db.map.map_store import drive_transaction, find_changeset
from conetl.db.map.results import CommittedChangeset, RunInfo
from conetl.geometry.packing import horizontal_sigma_m
from conetl.model.base import utc_from_ns
from conetl.model.drive import Drive
from conetl.model.health import hold_checks
from conetl.model.ingest_report import ChangeLine, CommitReport
from conetl.model.map_records import Changeset, Delta, DeltaKind
from conetl.model.params import IngestParams
from conetl.perception.model_card import read_model_card
from conetl.pipeline.analysis import AnalysedDrive
from conetl.pipeline.chunks import analysis_of
from conetl.pipeline.compared.positions import check_positions_on_map
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.executor import step
from conetl.pipeline.replay import merge_drive
from conetl.pipeline.settings import Settings, read_settings

_NAMESPACE = UUID("0b9b3a5e-9c1f-4d0e-8b55-2f7d9a1c6e42")
#: Libraries that numbers come from.
_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "onnxruntime", "pyproj", "prefect")


@dataclass(frozen=True)
class CommittedDrive:
    """Changes of the map by one drive."""

    changeset: CommittedChangeset
    analysed: AnalysedDrive
    deltas: tuple[Delta, ...]
    report: CommitReport


def changeset_of(drive: Drive, params: IngestParams, settings: Settings) -> Changeset:
    """The changeset of a drive, still without deltas. Its key is derived from content, analysis and CRS."""
    analysis = analysis_of(params, settings)
    key = analysis.changeset_key(drive.content_sha256, drive.map_srid)
    return Changeset(
        changeset_id=uuid5(_NAMESPACE, f"{settings.map_name}/{key}"),
        drive_id=drive.drive_id,
        idempotency_key=key,
        params_sha256=analysis.params_sha256,
        model_sha256=analysis.model_sha256,
        code_version=version("conetl"),
        deltas=(),
    )


def already_committed(
    drive: Drive, changeset: Changeset, settings: Settings, database: MapDatabase
) -> CommitReport | None:
    """The report "no changes" where this very drive is already on the map. changeset: of the drive, without deltas."""
    with database.connection() as conn:
        known = find_changeset(conn, changeset.idempotency_key, map_name=settings.map_name)
        return None if known is None else _report_of_known(conn, known, drive, settings.map_name)


def _report_of_known(conn: Connection, known: CommittedChangeset, drive: Drive, map_name: str) -> CommitReport:
    with transaction(conn, "Provisional features cannot be removed"):  # it may have been watched again since
        drop_watched_recording(conn, drive, map_name=map_name)
    held = held_drives(conn, map_name=map_name) if known.hold else []
    return report_of(
        known,
        map_name,
        health=next((one.checks for one in held if one.changeset_id == known.changeset_id), ()),
        not_counted=None if known.counts or known.hold else why_not_counted(conn, known, map_name),
    )


@step("merge", "merge {analysed.drive.drive_id}")
def commit(
    analysed: AnalysedDrive,
    settings: Settings | None = None,
    database: MapDatabase | None = None,
    run: RunInfo | None = None,
    map_id: int | None = None,
) -> CommittedDrive:
    """Compare the tracks of a drive with the map and commit all differences, or none.

    settings: database and name of the map; default: CONETL_* of the environment. database: one that is already open. run: stored
    with the changeset. map_id: of the map when the work began; one that was renamed or deleted since is missed. If the drive is
    on the map, the status is "no changes". Raises MapMismatchError, DatabaseError.
    """
    settings = settings or read_settings()
    drive, records, params = analysed.drive, analysed.records, analysed.params
    run = run or run_info(analysed)
    with ExitStack() as stack:
        database = database or stack.enter_context(MapDatabase(settings))
        conn = stack.enter_context(database.connection())
        with drive_transaction(conn, settings.map_name):
            found = check_positions_on_map(conn, records, params, settings.map_name)
            health = (*analysed.health, *judge_all(found, params.check))
            merged = merge_drive(
                conn,
                records,
                changeset_of(drive, params, settings),
                params,
                map_name=settings.map_name,
                evidence=read_model_card(settings.model_path).evidence,
                run=run,
                hold=hold_checks(health),
                map_id=map_id,
            )
        if isinstance(merged, CommittedChangeset):
            return CommittedDrive(merged, analysed, (), _report_of_known(conn, merged, drive, settings.map_name))
    deltas = merged.changeset.deltas
    if not hold_checks(health):  # a recording that contradicts itself is not compared with the map
        health = (*health, merged.extension.hold or merged.extension.widened or AGREES)
    report = report_of(
        merged.committed,
        settings.map_name,
        is_new=True,
        changes=tuple(_line(delta) for delta in deltas if not delta.is_line),
        rejections=dict(sorted(Counter(rejection.reason for rejection in records.rejections).items())),
        trajectory=analysed.trajectory.detail,
        calibration=analysed.calibration.detail,
        frame_pairs_alike=analysed.alike,
        categories=params.detection.categories,
        health=health,
        replayed_drives=merged.replayed,
        hold_changes=merged.hold_changes,
    )
    return CommittedDrive(merged.committed, analysed, deltas, report)


def run_info(analysed: AnalysedDrive, flow_run_id: str | None = None) -> RunInfo:
    """What is stored about the run that commits an analysed drive."""
    facts = {
        "trajectory": analysed.trajectory.detail,
        "calibration": analysed.calibration.detail,
        "trajectory_outcome": analysed.trajectory.outcome.value,
        "calibration_outcome": analysed.calibration.outcome.value,
        "frame_pairs_alike": analysed.alike,
        "health": [check.model_dump(mode="json") for check in analysed.health],
        **code_facts(),
    }
    return RunInfo(uuid4(), datetime.now(UTC), analysed.params.model_dump(mode="json"), flow_run_id, facts)


def _line(delta: Delta) -> ChangeLine:
    feature = delta.state_after
    return ChangeLine(
        kind=delta.kind,
        feature_id=delta.feature_id,
        category=feature.category,
        xyz_m=feature.xyz_m,
        object_height_m=feature.object_height_m,
        sigma_horizontal_m=horizontal_sigma_m(feature.cov_m2),
        sigma_height_m=feature.cov_m2[5] ** 0.5,
        existence_probability=delta.evidence.existence_probability if delta.evidence else feature.existence_probability,
        observation_count=feature.observation_count,
        shift_m=delta.shift_m,
    )


def report_of(known: CommittedChangeset, map_name: str, *, is_new: bool = False, **facts: Any) -> CommitReport:
    """The report of a drive on the map. is_new: it was committed now; facts: fields of the report that the changeset lacks."""
    points, lines = known.change_counts.points, known.change_counts.lines
    return CommitReport(
        drive_id=known.drive_id,
        status="held" if known.hold is not None else "committed" if is_new else "no changes",
        changeset_id=known.changeset_id,
        captured_from=utc_from_ns(known.captured_from_ns),
        captured_to=utc_from_ns(known.captured_to_ns),
        map_name=map_name,
        map_srid=known.map_srid,
        frame_pairs=known.frame_pair_count,
        frame_pairs_rejected=known.lost_pairs,
        detections=known.detection_count,
        matches=known.match_count,
        positions=known.position_count,
        tracks=known.track_count,
        counts={kind: points[kind] for kind in DeltaKind},
        line_counts={kind: lines[kind] for kind in DeltaKind if kind in lines},
        markings=known.marking_count,
        params_sha256=known.params_sha256,
        model_sha256=known.model_sha256,
        content_sha256=known.content_sha256,
        committed_at=None if is_new else known.committed_at,
        counts_on_map=known.counts,
        on_hold=known.hold,
        **facts,
    )


def code_facts() -> dict[str, Any]:
    """Version and hash of the code, Python and the libraries that affect results, as JSON values."""
    return {
        "code_version": version("conetl"),
        "code_sha256": code_sha256(),
        "python": platform.python_version(),
        "libraries": {name: found for name in _LIBRARIES if (found := _version(name)) is not None},
    }


@cache
def code_sha256() -> str:
    """SHA-256 over names and bytes of conetl's modules, flows and .sql files; equal in a clone and an installed wheel."""
    flows = find_spec("flows")
    folders = {"conetl": Path(__file__).resolve().parents[1], "sql": sql_directory()}
    if flows is not None and flows.submodule_search_locations:
        folders["flows"] = Path(flows.submodule_search_locations[0])
    total = hashlib.sha256()
    for label, folder in sorted(folders.items()):
        suffix = ".sql" if label == "sql" else ".py"
        for path in sorted(folder.rglob(f"*{suffix}")):
            name = f"{label}/{path.relative_to(folder).as_posix()}"
            total.update(name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
