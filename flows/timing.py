"""How long each step of a flow run takes, for its report: every task tells it here when it is done.

Tasks that run in a process of their own (Dask) have nobody to tell; their steps are missing then.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from datetime import datetime
from typing import Any, NamedTuple
from uuid import UUID

#: Runs whose times nobody asked for are forgotten when so many newer ones were timed in this process.
_REMEMBERED_RUNS = 16
_lock = threading.Lock()
_spans: dict[UUID, dict[str, list[tuple[datetime, datetime]]]] = {}


class StepTime(NamedTuple):
    """One step, seconds by the clock."""

    step: str
    task_count: int
    busy_s: float
    """Summed over its tasks, which may run beside each other."""
    started_s: float
    """Since the first step of the run began."""
    ended_s: float


def note_time(task: Any, task_run: Any, _state: Any) -> None:
    """Prefect calls this when a task has completed."""
    run, start, end = task_run.flow_run_id, task_run.start_time, task_run.end_time
    if run is None or start is None or end is None:
        return
    with _lock:
        if run not in _spans:
            for old in list(_spans)[: len(_spans) - _REMEMBERED_RUNS + 1]:
                del _spans[old]
            _spans[run] = defaultdict(list)
        _spans[run][task.name].append((start, end))


def times_of(flow_run_id: UUID | str | None) -> list[StepTime]:
    """The steps of a flow run that have completed so far, in the order in which they began."""
    with _lock:
        spans = {} if flow_run_id is None else {k: list(v) for k, v in _spans.get(UUID(str(flow_run_id)), {}).items()}
    if not spans:
        return []
    zero = min(start for parts in spans.values() for start, _ in parts)
    found = [
        StepTime(
            name, len(parts), sum(max((end - start).total_seconds(), 0.0) for start, end in parts),
            (min(start for start, _ in parts) - zero).total_seconds(), (max(end for _, end in parts) - zero).total_seconds(),
        )
        for name, parts in spans.items()
    ]  # fmt: skip
    return sorted(found, key=lambda time: time.started_s)
