"""Events of committed changesets, for automations: told once, whichever run gets to tell them.

A run may be killed between its commit and its events, or not be able to write its files. What it left untold is told by whoever
comes next: the run that takes the same drive again and finds it on the map, or the next backfill or look into the drop folder,
which need no drive for it. The ids of the events follow from the changeset: one that is told twice, by a run killed between event
and mark, is stored once.
"""

from __future__ import annotations

from datetime import timedelta
from uuid import UUID, uuid5

from prefect import task
from prefect.events import emit_event
from prefect.events.worker import EventsWorker
from prefect.logging import get_logger

from conetl.db.connection import Connection
from conetl.db.map.map_store import find_changeset, list_changesets
from conetl.db.notification_store import QUIET, is_published, mark_published, pending_changesets, removed_by_changeset
from conetl.exports.geojson import export_geojson
from conetl.model.ingest_report import IngestReport
from conetl.pipeline.settings import Settings
from conetl.reports.drive_page import write_drive_page
from flows.merge import open_map, report_of
from flows.retries import RETRY

_NAMESPACE = UUID("7d0b6f2e-54c3-4f0d-9a53-0d2f7c1be9aa")
_PATIENCE_S = 60.0


def tell_changes(report: IngestReport, settings: Settings) -> bool:
    """One event for the changeset, and one for each cone that vanished, which an automation can count; whether any was due."""
    with open_map(settings) as conn:
        if is_published(conn, report.changeset_id):
            return False
        vanished = removed_by_changeset(conn, report.changeset_id)
        map_resource = f"conetl.map.{report.map_name}"
        changeset_resource = f"{map_resource}.changeset.{report.changeset_id}"
        related = [{"prefect.resource.id": map_resource, "prefect.resource.role": "map"}]
        emit_event(
            "conetl.changeset.committed",
            resource={
                "prefect.resource.id": changeset_resource,
                "prefect.resource.name": report.drive_id,
                "conetl.map": report.map_name,
                **{f"conetl.{kind}": str(count) for kind, count in report.counts.items()},
            },
            related=related,
            payload=report.model_dump(mode="json", exclude={"changes"}),
            id=uuid5(_NAMESPACE, changeset_resource),
        )
        for cone in vanished:
            emit_event(
                "conetl.cone.vanished",
                resource={
                    "prefect.resource.id": f"{map_resource}.feature.{cone.feature_id}",
                    "conetl.map": report.map_name,
                    "conetl.changeset": str(report.changeset_id),
                    "conetl.drive": report.drive_id,
                },
                related=related,
                payload={"xyz_m": cone.xyz_m, "srid": report.map_srid, "cone_height_m": cone.cone_height_m},
                id=uuid5(_NAMESPACE, f"{changeset_resource}/{cone.feature_id}"),
            )
        # Events leave in a thread of their own: "told" is true only once they have left.
        EventsWorker.drain_all(timeout=_PATIENCE_S, at_exit=False)
        mark_published(conn, report.changeset_id)
    return True


@task(name="tell what was left untold", **RETRY)
def catch_up_task(report: IngestReport, settings: Settings) -> None:
    """Of a drive that is on the map already: what the run that committed it did not get to do."""
    catch_up(report, settings)


def catch_up(report: IngestReport, settings: Settings) -> None:
    """Write the map's file and the drive's report, then tell: "told" is true of all of it. Nothing where it was told."""
    with open_map(settings) as conn:
        if is_published(conn, report.changeset_id):
            return
        settings.exports_folder.mkdir(parents=True, exist_ok=True)
        export_geojson(conn, settings.exports_folder / f"{settings.map_name}.geojson", map_name=settings.map_name)
        for known in list_changesets(conn, map_name=settings.map_name):
            if known.changeset_id == report.changeset_id:
                page = settings.drive_report_path(known.drive_id, known.changeset_no)
                write_drive_page(conn, known, page, map_name=settings.map_name)
    tell_changes(report, settings)


def tell_untold(conn: Connection, settings: Settings, *, quiet: timedelta = QUIET) -> None:
    """Catch up on every drive of the map that was committed longer ago than `quiet` and not told.

    What does not work is logged and left to the next one: those who call this have drives to see to.
    """
    for found in pending_changesets(conn, map_name=settings.map_name, quiet=quiet):
        known = find_changeset(conn, found.idempotency_key, map_name=settings.map_name)
        conn.rollback()
        if known is None:
            continue
        report = report_of(
            known,
            map_name=settings.map_name,
            map_srid=found.map_srid,
            content_sha256=found.content_sha256,
            expected_frame_count=found.expected_frame_count,
        )
        try:
            catch_up(report, settings)
        except Exception as error:
            get_logger(__name__).warning("Changes by drive %s are on the map, but untold: %s", known.drive_id, error)
