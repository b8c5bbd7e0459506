"""After the commit: write the map and the drive's changes as files, and send notifications.

A run may be killed between its commit and its notifications, or be unable to write its files. What is left pending is completed
when the same drive is ingested again and found on the map, or by the next backfill or check of the drop folder.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple
from uuid import UUID

from conetl.db import receipt_store as receipts
from conetl.db.connection import Connection
from conetl.db.map.decision_store import hold_events
from conetl.db.map.map_store import list_changesets
from conetl.db.map.results import CommittedChangeset
from conetl.exports.text_files import export_geojson
from conetl.files.home import make_home
from conetl.model.errors import ConetlError
from conetl.model.ingest_report import CommitReport
from conetl.model.work_zone_params import WorkZoneParams
from conetl.pipeline.commit import CommittedDrive, report_of
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.executor import step
from conetl.pipeline.maps.decisions import DecisionOutcome
from conetl.pipeline.maps.notices import record_notices
from conetl.pipeline.settings import Settings, read_settings

_log = logging.getLogger(__name__)
#: Sends the report of a changeset and the cones that it removed (`removed_by_changeset`); returns when they are sent.
Notify = Callable[[CommitReport, Sequence[dict[str, Any]]], None]


class PublishedFiles(NamedTuple):
    """Files written for one drive."""

    geojson: Path
    """The whole map."""
    plan_view: Path
    page: Path
    """The QA report."""


@step("publish", "publish {committed.changeset.drive_id}")
def publish(
    committed: CommittedDrive,
    settings: Settings | None = None,
    database: MapDatabase | None = None,
    times: Sequence[receipts.StepTime] = (),
) -> PublishedFiles:
    """Write the map as GeoJSON, plan view (PNG) and QA report of a drive; on a small map store the versions of work zones.

    Does not send notifications (`notify` does).

    settings: folders, database and name of the map; default: CONETL_* of the environment. times: of the steps, for the report.
    """
    settings = settings or read_settings()
    changeset, plan_view = committed.changeset, settings.drive_image_path(committed.changeset.drive_id)
    with ExitStack() as stack:
        database = database or stack.enter_context(MapDatabase(settings))
        conn = stack.enter_context(database.connection())
        geojson = _write_map(conn, settings)
        record_notices(conn, map_name=settings.map_name, most_features=WorkZoneParams().most_at_merge)
        receipts.write_run_steps(conn, changeset.changeset_id, times)
        page = _write_page(conn, changeset, settings, plan_view)
        renew_pages(conn, [change.changeset_id for change in committed.report.hold_changes], settings)
    return PublishedFiles(geojson, plan_view, page)


def renew_pages(
    conn: Connection, changeset_ids: Collection[UUID], settings: Settings, *, missing: UUID | None = None
) -> None:
    """Rewrite existing QA reports of drives, for example after one went on hold or was released. missing: the changeset whose
    report is written in any case. Raises InputError if one cannot be written.
    """
    for one in list_changesets(conn, map_name=settings.map_name) if changeset_ids or missing else ():
        is_written = settings.drive_report_path(one.drive_id, one.changeset_no).is_file()
        if one.changeset_id == missing or (one.changeset_id in changeset_ids and is_written):
            _write_page(conn, one, settings)


def publish_decision(conn: Connection, decided: DecisionOutcome, settings: Settings) -> str | None:
    """Rewrite the map's file, if there is one, and the QA reports of drives whose state a decision changed; returns why that
    failed, else None.

    The decision is made in either case.
    """
    about = {change.changeset_id for change in decided.hold_changes}
    if decided.changeset_id is not None:
        about.add(decided.changeset_id)
    try:
        if _map_path(settings).is_file():
            _write_map(conn, settings)
        renew_pages(conn, about, settings)
    except ConetlError as error:
        return f"The decision was stored, but a file could not be written: {error} `conetl report drive` writes a report again."
    return None


def notify(report: CommitReport, database: MapDatabase, send: Notify) -> None:
    """Send the report of a changeset unless that was done before, and record it."""
    with database.connection() as conn:
        if receipts.is_published(conn, report.changeset_id):
            return
        send(report, receipts.removed_by_changeset(conn, report.changeset_id))
        receipts.mark_published(conn, report.changeset_id)


def catch_up(report: CommitReport, settings: Settings, database: MapDatabase, send: Notify) -> None:
    """Complete what the run that committed a drive left pending: write the map's file and the drive's report, then notify."""
    with database.connection() as conn:
        if receipts.is_published(conn, report.changeset_id):
            return
        _write_map(conn, settings)
        events = hold_events(conn, map_name=settings.map_name, since=report.committed_at)
        renew_pages(conn, [event.changeset_id for event in events], settings, missing=report.changeset_id)
    notify(report, database, send)


def catch_up_all(settings: Settings, database: MapDatabase, send: Notify, *, quiet: timedelta = receipts.QUIET) -> None:
    """Complete all pending drives of the map that were committed longer ago than `quiet`.

    Failures are logged and left to the next caller: this one has drives to ingest.
    """
    with database.connection() as conn:
        pending = receipts.pending_changesets(conn, map_name=settings.map_name, quiet=quiet)
        known = [one for one in list_changesets(conn, map_name=settings.map_name) if one.changeset_id in pending]
    for changeset in reversed(known):
        try:
            catch_up(report_of(changeset, settings.map_name), settings, database, send)
        except Exception as error:
            _log.warning("Changes by drive %s are on the map, but not published: %s", changeset.drive_id, error)


def _write_map(conn: Connection, settings: Settings) -> Path:
    make_home(settings.home)
    path = _map_path(settings)
    export_geojson(conn, path, map_name=settings.map_name)
    return path


def _map_path(settings: Settings) -> Path:
    return settings.exports_folder / f"{settings.map_name}.geojson"


def _write_page(
    conn: Connection, changeset: CommittedChangeset, settings: Settings, plan_path: Path | None = None
) -> Path:
    from conetl.reports.drive_page import write_drive_page  # matplotlib takes half a second to load

    path = settings.drive_report_path(changeset.drive_id, changeset.changeset_no).resolve()
    return write_drive_page(conn, changeset, path, map_name=settings.map_name, plan_path=plan_path)
