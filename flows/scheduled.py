"""The flows of schedules: new drives from the folder where they arrive; the map as files, and against its own rules.

A drive is complete when its folder holds a file named COMPLETE, or when nothing in it has changed for `drop_quiet_minutes`
(CONETL_DROP_QUIET_MINUTES, default 10), by the time of the inode change, which copying tools cannot set back. Each complete one
is ingested once; everything else in the folder has a row with the reason.
"""

from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

from prefect import State, flow
from prefect.artifacts import create_link_artifact, create_table_artifact
from prefect.states import Completed
from pydantic import Field

from conetl.db.map.map_store import find_map
from conetl.db.schema import run_audits
from conetl.exports import FORMATS
from conetl.files.names import as_markdown, printable
from conetl.model.params import IngestParams
from conetl.pipeline.backfill_plan import attention_text, drop_folder_rows, plan_drives
from conetl.pipeline.entries import find_entries
from conetl.pipeline.maps.planned_zones import read_difference_table
from conetl.pipeline.publish import catch_up_all
from conetl.pipeline.settings import read_settings
from flows import dispatch
from flows.artifacts import send_events, show_differences, show_entries
from flows.backfill import refuse
from flows.notices import notify_map_receivers
from flows.runs import MapName, MapSrid, alive, needs_attention, recover_runs, rename_run


@flow(name="publish-map", flow_run_name="publish map")
def publish_map(
    map_name: MapName = None,
    formats: list[str] | None = None,
    folder: Path | None = None,
    as_of: datetime | None = None,
) -> State[Any]:
    """Write the map in several formats to a new folder, and point `latest` at it.

    All files show the same state of the map; `report.html` covers the last 24 hours. Where there are plans of work zones, the
    differences from them are a table. Fails for an unknown format or a folder that cannot be written; the last publication stays
    then.

    Args:
        map_name: Name of the map; default: CONETL_MAP_NAME of the worker.
        formats: Names of formats of `map export`; default: all but those of work zones.
        folder: Folder for the publication; default: `exports` in CONETL_HOME.
        as_of: State of the road at this time; default: latest.
    """
    from conetl.pipeline.nightly_publication import REPORT, write_publication  # matplotlib takes half a second to load

    settings = read_settings(map_name)
    with alive(settings) as database, database.connection() as conn:
        notify_map_receivers(settings, database)
        info = find_map(conn, settings.map_name)
        if info is None:
            return Completed(name="NothingToPublish", message=f"the map {settings.map_name} is empty")
        wanted = list(FORMATS) if formats is None else formats
        published, manifests, night = write_publication(
            conn, info, wanted, folder or settings.exports_folder, as_of, drop_folder_rows(settings)
        )
        view = (settings.view_url or "").rstrip("/")
        differences = read_difference_table(conn, map_name=settings.map_name, as_of=as_of, view=view)
    create_table_artifact(
        [{name: manifest[name] for name in ("file", "rows", "bytes", "sha256")} for manifest in manifests],
        key="publication",
        description=f"Map {settings.map_name} -> {as_markdown(published)}",
    )
    if differences is not None:
        show_differences(differences, settings.map_name)
    page = published / REPORT
    create_link_artifact(
        page.resolve().as_uri(),
        key="qa-report-night",
        link_text="Report of the last 24 hours",
        description=f"File: {as_markdown(page)}",
    )
    message = f"{len(manifests)} files in {published}"
    if night.failed:
        first = night.failed[0]
        said = f"failed drives: {len(night.failed)}; {message}. {first['drive_id']}: {first['reason']}"
        return needs_attention("DrivesFailed", said)
    if night.held:
        said = f"drives on hold: {len(night.held)}; {message}. {night.held[0].drive_id}: {night.held[0].reason}"
        return needs_attention("DrivesOnHold", said)
    return Completed(message=message)


@flow(name="audit", flow_run_name="audit")
def audit() -> State[Any]:
    """Run all audits over all maps of the database; failed where one of them finds a row."""
    with alive(read_settings()) as database, database.connection() as conn:
        results = run_audits(conn)
    rows = [
        {"audit": r.name, "result": "passed" if r.passed else f"{r.row_count} rows", "what": r.purpose} for r in results
    ]
    create_table_artifact(rows, key="audit", description="Consistency of the maps")
    failed = [result for result in results if not result.passed]
    if failed:
        found = [
            {"audit": r.name, **{k: as_markdown(str(v)) for k, v in row.items()}} for r in failed for row in r.rows[:20]
        ]
        create_table_artifact(found, key="audit-rows", description="Inconsistent rows, the first 20 of each audit")
        names = ", ".join(result.name for result in failed)
        return needs_attention("Inconsistent", f"{names}: inconsistent rows; see `conetl db audit`")
    return Completed(message=f"{len(results)} audits passed")


@flow(name="recover", flow_run_name="recover")
def recover() -> State[Any]:
    """Start runs again whose process died, on whatever machine."""
    with alive(read_settings()) as database:
        dead = recover_runs(database)
    return Completed(message=", ".join(run.name for run in dead) or "all runs are alive")


@flow(name="ingest-drop-folder", flow_run_name="drop folder")
def ingest_drop_folder(
    folder: Path | None = None,
    quiet_minutes: Annotated[float | None, Field(ge=0)] = None,
    map_name: MapName = None,
    map_srid: MapSrid = None,
    params: IngestParams = IngestParams(),  # noqa: B008 -- frozen
) -> State[Any]:
    """Queue new drives for the workers; report the rest. What failed is skipped until it changes, or a person runs a backfill.

    Args:
        folder: Folder in which drives arrive; default: CONETL_DROP_FOLDER of the worker.
        quiet_minutes: A drive is complete after this many minutes without a change; default: CONETL_DROP_QUIET_MINUTES.
        map_name: Name of the map; default: CONETL_MAP_NAME of the worker.
        map_srid: EPSG code of the map; default: the UTM zone of the first drive.
        params: Parameters of all steps.
    """
    settings = read_settings(map_name)
    inbox = (folder or settings.inbox).absolute()
    settings.require_readable(inbox)
    quiet_s = 60.0 * (settings.drop_quiet_minutes if quiet_minutes is None else quiet_minutes)
    with alive(settings) as database:
        catch_up_all(settings, database, send_events)
        notify_map_receivers(settings, database)
        entries = find_entries(inbox, may_be_drive=False, quiet_s=quiet_s, settings=settings)
        with database.connection() as conn:
            plan = plan_drives(conn, inbox, settings=settings, params=params, once=True, entries=entries)
        refused = refuse(database, [*plan.refused, *plan.strays], plan, settings)
        # Once for each start of work, whatever became of that run; in the order of recording.
        waiting = {
            f"{settings.map_name} {line.header.header_sha256} {plan.analysis.sha256} {line.starts}": line.header
            for line in plan.lines
            if line.action == "ingest"
        }
        started = dispatch.started_with(list(waiting))
        new = {key: header for key, header in waiting.items() if key not in started}
        for key, header in new.items():
            dispatch.start_on_worker(header, settings, params, map_srid, key)
    arriving = sum(entry.kind == "arriving" for entry in entries)
    if new or refused:
        rename_run(f"drop folder: {len(new)} queued, {len(refused)} not recognised")
    if new or refused or arriving:
        show_entries(plan)
    message = f"queued: {len(new)}; still arriving in {printable(inbox)}: {arriving}{attention_text(plan)}"
    if refused:
        return needs_attention("NotRecognised", message)
    if waiting and (note := dispatch.missing_workers()):
        return needs_attention("NoWorkers", f"{message}; {note}")
    if new:
        return Completed(message=message)
    return Completed(name="NeedsAttention" if plan.open_lines else "NothingNew", message=message)
