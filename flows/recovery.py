"""Runs whose process died without a word: found, marked, and put back in the queue.

Prefect believes a run to be running until somebody says otherwise. Every run of ours holds a lock in the database as long as its
process lives (`db/receipt_store.py`), so one that runs without its lock is dead, on whatever machine it was.
"""

from datetime import UTC, datetime, timedelta

from prefect.client.schemas.filters import (
    FlowFilter,
    FlowFilterName,
    FlowRunFilter,
    FlowRunFilterState,
    FlowRunFilterStateType,
)
from prefect.client.schemas.objects import FlowRun, StateType
from prefect.states import Crashed, Scheduled

from conetl.db.connection import Connection
from conetl.db.receipt_store import held_locks, run_lock
from flows.dispatch import client

FLOWS = ("ingest-drive", "backfill", "ingest-drop-folder", "publish-map", "audit")
#: Between the state "running" and its lock a run imports and connects.
GRACE = timedelta(seconds=30)
#: A run that a worker took and never started.
PENDING_GRACE = timedelta(minutes=5)
MAX_RUNS = 3
_REASON = "its process is gone: nobody holds its lock in the database"


def recover(conn: Connection) -> list[FlowRun]:
    """Mark dead runs as crashed and queue those again that belong to no other run and were not tried too often; all the dead."""
    states = [StateType.RUNNING, StateType.PENDING, StateType.CANCELLING]
    with client() as api:
        runs = api.read_flow_runs(
            flow_filter=FlowFilter(name=FlowFilterName(any_=list(FLOWS))),
            flow_run_filter=FlowRunFilter(state=FlowRunFilterState(type=FlowRunFilterStateType(any_=states))),
        )
        # A run of the command line that ingests without a worker holds no lock: not ours to judge.
        runs = [run for run in runs if run.work_pool_name or run.parent_task_run_id or run.name.startswith("backfill")]
        held = held_locks(conn, [run_lock(str(run.id)) for run in runs])
        dead = [run for run in runs if run_lock(str(run.id)) not in held and _is_overdue(run)]
        for run in dead:
            api.set_flow_run_state(run.id, Crashed(message=_REASON), force=True)
            again = run.deployment_id and not run.parent_task_run_id and run.run_count < MAX_RUNS
            if again and run.state and not run.state.is_cancelling():
                api.set_flow_run_state(run.id, Scheduled(message="taken up again after a crash"), force=True)
    return dead


def _is_overdue(run: FlowRun) -> bool:
    if run.state is None:
        return False
    return datetime.now(UTC) - run.state.timestamp > (PENDING_GRACE if run.state.is_pending() else GRACE)
