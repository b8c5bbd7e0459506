"""How long the steps of a run took, kept beside the changeset that it made."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple
from uuid import UUID

from conetl.db.connection import Connection, execute, load_sql, transaction


class StepTime(NamedTuple):
    """One step of a run; seconds by the clock."""

    step: str
    task_count: int
    busy_s: float
    """Summed over its calls, which may run beside each other."""
    started_s: float
    """Since the first step of the run began."""
    ended_s: float


def write_run_steps(conn: Connection, changeset_id: UUID, steps: Iterable[StepTime]) -> None:
    """Keep the times of the run that made a changeset, in a transaction of their own; what is there already stays."""
    with transaction(conn, "The times of the run cannot be written"):
        for time in steps:
            execute(
                conn,
                load_sql("write/insert_run_step"),
                {
                    "changeset_id": changeset_id, "step": time.step, "task_count": time.task_count, "busy_s": time.busy_s,
                    "started_s": time.started_s, "ended_s": max(time.ended_s, time.started_s),
                },
            )  # fmt: skip
