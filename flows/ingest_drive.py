"""One drive folder becomes one changeset of the map, on a worker, in a backfill or by `conetl ingest`: with locks and receipts.

Annotations are evaluated at import: Prefect sends a flow to a child process by value, with only the globals that its body uses,
so the child could not resolve names in annotations.
"""

import time
from collections.abc import Callable
from contextvars import ContextVar
from typing import Any
from uuid import UUID

from prefect import State, flow
from prefect.runtime import flow_run
from prefect.states import Completed

from conetl.db.receipt_store import drive_lock
from conetl.exports.kind_marks import kinds_text
from conetl.files.storage import as_path
from conetl.model.ingest_report import IngestReport, NeedsAttentionError
from conetl.model.params import IngestParams
from conetl.pipeline.chunks import analysis_of
from conetl.pipeline.executor import Progress
from conetl.pipeline.ingest import failed_receipt, final_receipt, ingest, new_receipt, save_receipt
from conetl.pipeline.settings import Settings, read_settings
from conetl.readers.drives.header import DriveHeader, read_header
from flows.artifacts import progress_artifact, publish_drive, publish_pending
from flows.runs import MapName, MapSrid, alive, attempt_of, client, drive_run_name, drive_tags
from flows.tasks import PrefectExecutor, task_runner

#: Settings and progress bar of the present command. Prefect stores parameters, so these are none.
_command: ContextVar[tuple[Settings, Progress | None] | None] = ContextVar("command", default=None)


def ingest_here(
    header: DriveHeader, settings: Settings, params: IngestParams, *, map_srid: int | None, bar: Progress | None = None
) -> IngestReport:
    """Run the flow below in this process, as `conetl ingest` does. bar: shows its progress. Raises as `pipeline.ingest` does."""
    own = ingest_drive.with_options(task_runner=task_runner(settings), flow_run_name=lambda: drive_run_name(header))
    given = _command.set((settings, bar))
    try:
        state = own(str(header.path), settings.map_name, map_srid, params, return_state=True)
    finally:
        _command.reset(given)
    report, error = state.result()
    if error is not None:
        raise error
    return report


def _of_command() -> tuple[Settings, Progress | None] | None:
    """None on a worker. A function, because a flow is sent along with each task of Dask, and a ContextVar cannot be."""
    return _command.get()


def _finished(work: Callable[[], IngestReport]) -> tuple[IngestReport, NeedsAttentionError | None, str]:
    """The report of the work on a drive, the error if the drive needs attention, and what a person has to check."""
    try:
        report, error = work(), None
    except NeedsAttentionError as raised:
        report, error = raised.report, raised
    return report, error, " ".join((*([str(error)] if error else ()), *report.remarks))


@flow(name="ingest-drive", task_runner=task_runner(read_settings()))
def ingest_drive(
    drive: str,
    map_name: MapName = None,
    map_srid: MapSrid = None,
    params: IngestParams = IngestParams(),  # noqa: B008 -- frozen
    map_exists: bool = False,
) -> State[Any]:
    """Ingest one drive: once, even if another process tries at the same time, with a receipt of the outcome.

    Its steps run as tasks, in the order of `pipeline.ingest.ingest` and `pipeline.analysis.analyse`: read; follow points and
    self-calibrate; detect and match; refine; locate; fuse, three times with better sigmas; mark; merge; publish. Follow
    points, detect and match run in parallel. The result is the report, and the error if the drive needs attention.

    Args:
        drive: Drive folder, or its s3:// address; its path on the worker.
        map_name: Name of the map; default: CONETL_MAP_NAME of the worker.
        map_srid: EPSG code of the map; default: the UTM zone of the first drive.
        params: Parameters of all steps.
        map_exists: Miss the drive where the map is gone, as it was renamed or deleted, instead of making it anew.
    """
    of_command = _of_command()
    settings, bar = of_command or (read_settings(map_name), None)
    if of_command is None:  # a form or another flow has chosen the folder
        settings.require_readable(as_path(drive), links=True)
    header = read_header(as_path(drive).absolute())  # links are kept: the calibration may be beside the link
    with alive(settings, drive_lock(settings.map_name, header.header_sha256)) as database:
        analysis = analysis_of(params, settings).sha256
        begun = new_receipt(header, settings, analysis, attempt_of(UUID(flow_run.id), flow_run.run_count), flow_run.id)
        save_receipt(begun, settings, database)
        started = time.monotonic()
        try:
            _describe_run(header, settings.map_name)
            report, error, problem = _finished(
                lambda: ingest(
                    as_path(drive), params, settings, map_srid=map_srid, map_exists=map_exists, database=database,
                    executor=PrefectExecutor(), progress=progress_artifact(header.drive_id, bar), publish_new=publish_drive,
                    publish_known=publish_pending, flow_run_id=flow_run.id,
                )
            )  # fmt: skip
        except Exception as failure:
            save_receipt(failed_receipt(begun, failure), settings, database)
            raise
        save_receipt(final_receipt(begun, report, time.monotonic() - started, problem), settings, database)
    if problem:
        name = "OnHold" if report.on_hold else "CommittedNeedsALook"
        return Completed(name=name, message=problem, data=(report, error))
    return Completed(message=outcome(report), data=(report, None))


def outcome(report: IngestReport) -> str:
    """What became of a drive that needs no attention, as the message of its run's state."""
    if report.is_known:
        state = f", but not in effect: {report.not_counted}" if report.not_counted else ""
        return f"nothing to do, already on the map since {report.committed_at:%Y-%m-%d %H:%M} UTC{state}"
    return f"{report.status}: {kinds_text(report.counts) or 'no objects'}"


def _describe_run(header: DriveHeader, map_name: str) -> None:
    """Name and tag this flow run by its drive: one that the form started has neither.

    Its tasks get no tags: before a task with tags starts, Prefect queries the server for concurrency limits, and detections
    waited two seconds for the answer, twice a minute.
    """
    name, tags = drive_run_name(header), {*flow_run.tags, *drive_tags(header, map_name)}
    if name != flow_run.name or tags != set(flow_run.tags):
        with client() as api:
            api.update_flow_run(UUID(flow_run.id), name=name, tags=tags)
