"""Events of committed changesets, for automations: told once, whichever run gets to tell them.

A run may be killed between its commit and its events. What it left untold is told by the run that takes the same drive again and
finds it on the map, which recovery and backfills see to (`flows/recovery.py`). The ids of the events follow from the changeset:
one that is told twice, by a run killed between event and mark, is stored once.
"""

from __future__ import annotations

from uuid import UUID, uuid5

from prefect import task
from prefect.events import emit_event
from prefect.events.worker import EventsWorker

from conetl.io.exports.geojson import export_geojson
from conetl.io.stores.told_store import mark_told, vanished_by_changeset, was_told
from conetl.reports import IngestReport
from conetl.settings import Settings
from flows.merge import open_map
from flows.retries import RETRY

_NAMESPACE = UUID("7d0b6f2e-54c3-4f0d-9a53-0d2f7c1be9aa")
_PATIENCE_S = 60.0


def tell_changes(report: IngestReport, settings: Settings) -> bool:
    """One event for the changeset, and one for each cone that vanished, which an automation can count; whether any was due."""
    with open_map(settings) as conn:
        if was_told(conn, report.changeset_id):
            return False
        vanished = vanished_by_changeset(conn, report.changeset_id)
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
        mark_told(conn, report.changeset_id)
    return True


@task(name="tell what was left untold", **RETRY)
def catch_up_task(report: IngestReport, settings: Settings) -> None:
    """Of a drive that is on the map already: what a run that was killed after its commit did not get to do."""
    if tell_changes(report, settings):
        settings.exports_folder.mkdir(parents=True, exist_ok=True)
        with open_map(settings) as conn:
            export_geojson(conn, settings.exports_folder / f"{settings.map_name}.geojson", map_name=settings.map_name)
