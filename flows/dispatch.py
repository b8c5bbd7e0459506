"""Start one drive in a process of its own: on a worker of the pool where there is one, else as a child of this process.

Either way it is a sub-flow of the present run, and a drive that kills its process costs only itself. Children are our own:
without a worker Prefect runs sub-flows in the process of their parent (PrefectHQ/prefect #6689).
"""

from __future__ import annotations

import multiprocessing.process
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal, cast
from uuid import UUID, uuid4

from prefect import Task
from prefect.client.schemas.filters import FlowRunFilter, FlowRunFilterIdempotencyKey
from prefect.client.schemas.objects import FlowRun, Worker, WorkerStatus
from prefect.context import FlowRunContext
from prefect.deployments import run_deployment
from prefect.exceptions import ObjectNotFound
from prefect.flow_engine import run_flow_in_subprocess
from prefect.states import Crashed, Pending

from conetl.model.errors import ServiceError
from conetl.model.params import IngestParams
from conetl.pipeline.backfill_plan import PlanLine
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import DriveHeader
from flows.ingest_drive import ingest_drive
from flows.runs import attempt_of, client, drive_run_name, drive_tags

POOL = "conetl"
DRIVE_DEPLOYMENT = "ingest-drive/ingest-drive"
DRIVE_QUEUE = "drives"
#: Workers are restarted, and Prefect takes a minute or two to notice that one is gone.
WORKERS_GONE_S = 180.0
#: Prefect's server answers with at most so many runs.
_PAGE = 200
Where = Literal["auto", "workers", "here"]


@dataclass(frozen=True)
class DriveRun:
    """The run of a drive, which may still wait for a worker."""

    line: PlanLine
    number: int
    """Of the try, from 1."""
    flow_run_id: UUID
    process: multiprocessing.process.BaseProcess | None
    """The child of this process; None where a worker runs it."""

    @property
    def attempt_id(self) -> UUID:
        """Of its receipts: another try is another run."""
        return attempt_of(self.flow_run_id, 1)


def resolve_where(where: Where) -> Literal["workers", "here"]:
    """`auto`: workers where `conetl up` has made the deployment and one is online, else children of this process.

    Without a worker a drive would wait forever. Raises ServiceError.
    """
    if where == "here":
        return where
    with client() as api:
        try:
            api.read_deployment_by_name(DRIVE_DEPLOYMENT)
        except ObjectNotFound:
            if where == "auto":
                return "here"
            raise ServiceError(f"this Prefect server has no deployment {DRIVE_DEPLOYMENT}: run `conetl up`") from None
    return "workers" if where == "workers" or online_workers() else "here"


def online_workers() -> int:
    """Number of workers of the pool that ingest drives and are online."""
    return sum(worker.status == WorkerStatus.ONLINE for worker in _workers())


def missing_workers() -> str | None:
    """What to do where no worker that ingests drives has been online for WORKERS_GONE_S, as a sentence."""
    beats = [worker.last_heartbeat_time for worker in _workers() if worker.last_heartbeat_time]
    if beats and (datetime.now(UTC) - max(beats)).total_seconds() < WORKERS_GONE_S:
        return None
    return (
        f"no worker of the queue '{DRIVE_QUEUE}' has been online for {WORKERS_GONE_S / 60:.0f} minutes, so the drives "
        "wait: `conetl status` shows what runs, `conetl up` starts what is missing, and `conetl backfill --here` needs "
        "no workers"
    )


def started_with(keys: Sequence[str]) -> set[str]:
    """Those of the idempotency keys with which a run exists."""
    found: set[str] = set()
    with client() as api:
        for first in range(0, len(keys), _PAGE):
            some = FlowRunFilterIdempotencyKey(any_=list(keys[first : first + _PAGE]))
            runs = api.read_flow_runs(flow_run_filter=FlowRunFilter(idempotency_key=some), limit=_PAGE)
            found |= {run.idempotency_key for run in runs if run.idempotency_key}
    return found


def _workers() -> list[Worker]:
    """The workers of the pool that ingest drives, online or not."""
    with client() as api:
        pool = api.read_deployment_by_name(DRIVE_DEPLOYMENT).work_pool_name or POOL
        return [worker for worker in api.read_workers_for_work_pool(pool) if DRIVE_QUEUE in worker.name]


def start_on_worker(
    header: DriveHeader,
    settings: Settings,
    params: IngestParams,
    map_srid: int | None,
    key: str,
    queue: str | None = None,
    *,
    map_exists: bool = False,
) -> FlowRun:
    """Queue the ingest of one drive for a worker, unless a run with this idempotency key exists; the run.

    queue: of workers; None: the deployment's. map_exists: as of `ingest_drive`.
    """
    return cast(
        FlowRun,
        run_deployment(
            DRIVE_DEPLOYMENT,
            parameters=_parameters(header, settings, params, map_srid, map_exists),
            flow_run_name=drive_run_name(header),
            tags=drive_tags(header, settings.map_name),
            idempotency_key=key,
            work_queue_name=queue,
            timeout=0,
        ),
    )


def start_here(
    header: DriveHeader, settings: Settings, params: IngestParams, map_srid: int | None, parallel: int, map_exists: bool
) -> tuple[FlowRun, multiprocessing.process.BaseProcess]:
    """Start the ingest of one drive in a child of this process, one of `parallel`."""
    parameters, name = _parameters(header, settings, params, map_srid, map_exists), drive_run_name(header)
    context = FlowRunContext.get()
    assert context is not None and context.flow_run is not None
    with client() as api:
        # A task of the present run that represents the sub-flow, as `run_deployment` makes one.
        represents = Task(name=name, fn=_nothing)
        parent = api.create_task_run(
            represents, context.flow_run.id, dynamic_key=str(uuid4()), name=name, state=Pending()
        )
        run = api.create_flow_run(
            ingest_drive, name=name, parameters=parameters, tags=drive_tags(header, settings.map_name),
            parent_task_run_id=parent.id, state=Pending(),
        )  # fmt: skip
    process = run_flow_in_subprocess(
        ingest_drive, flow_run=run, parameters=ingest_drive.validate_parameters(parameters),
        env={
            "CONETL_HOME": str(settings.home.resolve()),
            "CONETL_WORKERS": str(max(1, settings.workers // parallel)),
        },
    )  # fmt: skip
    return run, process


def _parameters(
    header: DriveHeader, settings: Settings, params: IngestParams, map_srid: int | None, map_exists: bool
) -> dict[str, Any]:
    return {
        "drive": str(header.path),
        "map_name": settings.map_name,
        "map_srid": map_srid,
        "params": params.model_dump(mode="json"),
        "map_exists": map_exists,
    }


def over(run: DriveRun) -> str | None:
    """Why a run ended; None while it may be running. Its results are in the receipts."""
    if run.process is not None:
        if run.process.is_alive():
            return None
        code = run.process.exitcode or 0
        if code < 0:
            return f"its process was ended by signal {-code}"
    state = read_run(run.flow_run_id).state
    if state is None or not state.is_final():
        return None if run.process is None else "its process ended without a message"
    return f"{state.name}: {state.message or 'without a message'}"


def was_cancelled(run: DriveRun) -> bool:
    """Whether a person cancelled it."""
    state = read_run(run.flow_run_id).state
    return state is not None and state.is_cancelled()


def read_run(flow_run_id: UUID) -> FlowRun:
    with client() as api:
        return api.read_flow_run(flow_run_id)


def mark_crashed(flow_run_id: UUID, reason: str) -> None:
    """Mark a run as crashed in Prefect; one that has ended is left as it is."""
    with client() as api:
        run = api.read_flow_run(flow_run_id)
        if run.state is None or not run.state.is_final():
            api.set_flow_run_state(flow_run_id, Crashed(message=reason), force=True)


def abandon(runs: Sequence[DriveRun]) -> None:
    """End the children of this process; runs of workers continue."""
    children = [run.process for run in runs if run.process is not None and run.process.is_alive()]
    for child in children:
        child.terminate()
    deadline = time.monotonic() + 10
    for child in children:
        child.join(max(0.1, deadline - time.monotonic()))
        if child.is_alive():
            child.kill()
            child.join()


def _nothing() -> None:
    """The body of a task run that represents a sub-flow."""
