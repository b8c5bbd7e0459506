"""One drive as a job: its lock, its receipts, its run. What schedules, backfills and the form in Prefect's UI start.

Annotations are evaluated here and not put off: Prefect sends a flow to a child process by value, with those globals only that its
body uses, and the child could not make sense of their names.
"""

import socket
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any
from uuid import UUID, uuid4

from prefect import State, flow, get_client
from prefect.runtime import flow_run
from prefect.states import Completed
from pydantic import Field

from conetl.db.connection import connect
from conetl.db.receipt_store import Receipt, run_lock, write_receipt
from conetl.db.schema import migrate_once
from conetl.db.session_locks import holding
from conetl.files.storage import place
from conetl.model.errors import ConetlError, may_pass
from conetl.model.ingest_report import IngestReport, TooManyRejectionsError
from conetl.model.params import IngestParams
from conetl.pipeline.backfill_plan import analysis_of
from conetl.pipeline.settings import Settings, read_settings
from conetl.readers.drives.header import DriveHeader, read_header
from flows.drive_artifacts import name_of_run
from flows.ingest_drive import ingest_drive
from flows.merge import database_url
from flows.retries import as_known
from flows.runners import task_runner

MapName = Annotated[
    str | None,
    Field(pattern=r"^[a-z0-9_-]{1,40}$", description="Map to work on; CONETL_MAP_NAME of the worker unless given."),
]
MapSrid = Annotated[
    int | None, Field(gt=0, description="EPSG code of the map; the first drive's UTM zone unless given.")
]


def settings_for(map_name: str | None) -> Settings:
    """Settings of this process, for another map where one is named."""
    settings = read_settings()
    return settings.model_copy(update={"map_name": map_name}) if map_name else settings


def drive_tags(outline: DriveHeader, map_name: str) -> list[str]:
    """By what a run is found again in Prefect."""
    day = [f"day:{outline.captured_from:%Y-%m-%d}"] if outline.captured_from else []
    return [f"drive:{outline.drive_id}", f"map:{map_name}", *day]


def put_tags(outline: DriveHeader, map_name: str) -> None:
    """Tag this flow run: one that the form started has no tags of its drive.

    Its tasks get none: before a task with tags begins, Prefect asks the server for limits of how many may run, and detections
    waited two seconds for the answer, twice a minute.
    """
    wanted = {*flow_run.tags, *drive_tags(outline, map_name)}
    if wanted != set(flow_run.tags):
        with get_client(sync_client=True) as api:
            api.update_flow_run(UUID(flow_run.id), tags=wanted)


@contextmanager
def alive(settings: Settings) -> Iterator[str]:
    """Hold the lock that says that this flow run's process lives; the database's address."""
    url = database_url(settings)
    with closing(connect(url)) as conn:
        migrate_once(conn)
    with holding(url, run_lock(str(flow_run.id))):
        yield url


@flow(
    name="ingest-drive",
    flow_run_name=name_of_run,
    task_runner=task_runner(read_settings()),
)
def ingest_one(
    drive: Annotated[Path, Field(description="Drive folder, as the worker sees it.")],
    map_name: MapName = None,
    map_srid: MapSrid = None,
    params: Annotated[IngestParams, Field(description="Parameters of all steps.")] = IngestParams(),  # noqa: B008 -- frozen
    attempt_id: Annotated[UUID | None, Field(description="Leave empty.")] = None,
) -> State[Any]:
    """Ingest one drive: into the map once, whoever else tries at the same time, with a receipt of what became of it."""
    settings = settings_for(map_name)
    outline = read_header(place(drive).absolute())  # links stay: a calibration may lie beside the link
    begun = new_receipt(outline, settings, analysis_of(params, settings).sha256, attempt_id or uuid4(), flow_run.id)
    with alive(settings) as url, holding(url, begun.drive_lock):
        keep(url, begun, settings)
        started = time.monotonic()
        try:
            put_tags(outline, settings.map_name)
            report = ingest_drive.fn(outline.path, settings, params, map_srid=map_srid)
            look = report.unpublished or ""
        except TooManyRejectionsError as error:
            report, look = error.report, " ".join(filter(None, (str(error), error.report.unpublished)))
        except Exception as error:
            keep(url, _failed(begun, error), settings)
            raise
        keep(url, _ended(begun, report, started, look), settings)
    if look:
        return Completed(name="CommittedNeedsALook", message=look)
    counts = ", ".join(f"{count} {kind}" for kind, count in report.counts.items())
    return Completed(message=f"{report.status}: {counts}")


def new_receipt(
    outline: DriveHeader, settings: Settings, analysis_sha256: str, attempt_id: UUID, flow_run_id: str | None
) -> Receipt:
    """The receipt of work that begins now."""
    return Receipt(
        attempt_id=attempt_id,
        map_name=settings.map_name,
        drive_path=outline.shown_path,
        drive_id=outline.drive_id,
        header_sha256=outline.header_sha256,
        analysis_sha256=analysis_sha256,
        content_sha256=None,
        state="started",
        reason="",
        may_pass=True,
        changeset_id=None,
        frame_pairs=outline.frame_pairs,
        seconds=None,
        flow_run_id=flow_run_id,
        host=socket.gethostname(),
    )


def keep(url: str, receipt: Receipt, settings: Settings) -> None:
    """Write a receipt over a connection of its own: work takes long, and idle connections are cut."""
    with closing(connect(url)) as conn:
        write_receipt(conn, receipt, settings.receipts_folder)


def _failed(begun: Receipt, error: Exception) -> Receipt:
    """The receipt of work that ended before the commit; whether it is tried again depends on what stood in its way."""
    known = as_known(error)
    reason = str(known) if isinstance(known, ConetlError) else f"{type(error).__name__}: {error}"
    return replace(begun, state="failed", reason=reason[:2000] or "no reason given", may_pass=may_pass(error))


def _ended(begun: Receipt, report: IngestReport, started: float, reason: str) -> Receipt:
    return replace(
        begun,
        state="committed" if report.status == "committed" else "known",
        reason=reason[:2000],
        may_pass=False,
        changeset_id=report.changeset_id,
        content_sha256=report.content_sha256,
        frame_pairs=report.frame_pairs,
        seconds=time.monotonic() - started,
    )
