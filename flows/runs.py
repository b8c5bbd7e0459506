"""What all flows of deployments share: their parameters, the lock that shows that they live, and recovery of dead runs.

Prefect leaves a run whose worker died running for ever (PrefectHQ/prefect #16746), and its automation by heartbeats crashes
living runs (#20887). Every run of conetl holds a lock in the database as long as its process lives (`db/receipt_store.py`), so
one that runs without its lock is dead, on whatever machine it was.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any
from uuid import UUID, uuid5

from prefect import State
from prefect.client.orchestration import SyncPrefectClient, get_client
from prefect.client.schemas import filters
from prefect.client.schemas.objects import FlowRun, StateType
from prefect.runtime import flow_run
from prefect.states import Cancelled, Crashed, Failed, Scheduled
from pydantic import Field

from conetl.db.receipt_store import held_locks, holding, run_lock
from conetl.model.map_records import MAP_NAME
from conetl.pipeline.backfill_plan import RECOVERED_FOR
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import DriveHeader

_log = logging.getLogger(__name__)
FLOWS = ("ingest-drive", "backfill", "ingest-drop-folder", "publish-map", "audit", "recover")
#: Between the state "running" and its lock a run imports and connects.
GRACE = timedelta(seconds=30)
#: A run that a worker took and never started.
PENDING_GRACE = timedelta(minutes=5)
MAX_CRASHES = 3
#: Made after the queue of the deployment `ingest-drive` (`register.py`), so workers take it up when that one is empty.
BACKFILL_QUEUE = "backfill"
_REASON = "its process has ended: no session holds its lock in the database"

# Prefect's forms take descriptions from the docstrings of flows.
MapName = Annotated[str | None, Field(pattern=f"^{MAP_NAME.pattern}$")]
MapSrid = Annotated[int | None, Field(gt=0)]


def client() -> SyncPrefectClient:
    """The Prefect server that this process uses."""
    return get_client(sync_client=True)


@contextmanager
def alive(settings: Settings, *more_locks: str) -> Iterator[MapDatabase]:
    """Hold the lock that shows that this flow run's process lives, and others after it; the map's database."""
    with MapDatabase(settings) as database, holding(database.url, run_lock(str(flow_run.id)), *more_locks):
        yield database


def drive_run_name(header: DriveHeader) -> str:
    """Drive and date, as Prefect's lists show them."""
    at = header.captured_from
    return f"{header.drive_id} ({at:%Y-%m-%d %H:%M})" if at else header.drive_id


def drive_tags(header: DriveHeader, map_name: str) -> list[str]:
    """Tags by which a run is found in Prefect."""
    day = [f"day:{header.captured_from:%Y-%m-%d}"] if header.captured_from else []
    return [f"drive:{header.drive_id}", f"map:{map_name}", *day]


def needs_attention(name: str, message: str) -> State[Any]:
    """The end of a run that needs attention: a failed state, which Prefect's dashboard counts."""
    _log.warning(message)  # in the run's log Prefect writes only a traceback
    return Failed(name=name, message=message)


def rename_run(name: str) -> None:
    """Give the present flow run another name."""
    with client() as api:
        api.update_flow_run(UUID(flow_run.id), name=name)


def attempt_of(flow_run_id: UUID, run_count: int) -> UUID:
    """Id of the receipts of one execution of a flow run, which can be started again."""
    return uuid5(flow_run_id, str(run_count))


def recover_runs(database: MapDatabase) -> list[FlowRun]:
    """Mark dead runs as crashed, and queue those again that no backfill started and that crashed fewer than `MAX_CRASHES` times.

    Returns all dead runs, with those that Prefect itself has marked as crashed lately.
    """
    alive_states = [StateType.RUNNING, StateType.PENDING, StateType.CANCELLING]
    lately = filters.FlowRunFilterEndTime(after_=datetime.now(UTC) - RECOVERED_FOR)
    with client() as api, database.connection() as conn:
        runs = [
            run
            for states, ended in ((alive_states, None), ([StateType.CRASHED], lately))
            for run in api.read_flow_runs(
                flow_filter=filters.FlowFilter(name=filters.FlowFilterName(any_=list(FLOWS))),
                flow_run_filter=filters.FlowRunFilter(
                    state=filters.FlowRunFilterState(type=filters.FlowRunFilterStateType(any_=states)), end_time=ended
                ),
            )
        ]
        held = held_locks(conn, [run_lock(str(run.id)) for run in runs])
        dead = [run for run in runs if run_lock(str(run.id)) not in held and _is_overdue(run)]
        for run in dead:
            if run.state and run.state.is_cancelling():
                api.set_flow_run_state(run.id, Cancelled(message=_REASON), force=True)
                continue
            if run.state and not run.state.is_crashed():
                api.set_flow_run_state(run.id, Crashed(message=_REASON), force=True)
            # A backfill starts its own drives again.
            if run.deployment_id and run.work_queue_name != BACKFILL_QUEUE:
                crashes = sum(state.is_crashed() for state in api.read_flow_run_states(run.id))
                if crashes < MAX_CRASHES:
                    api.set_flow_run_state(run.id, Scheduled(message="started again after a crash"), force=True)
    return dead


def _is_overdue(run: FlowRun) -> bool:
    if run.state is None:
        return False
    return datetime.now(UTC) - run.state.timestamp > (PENDING_GRACE if run.state.is_pending() else GRACE)
