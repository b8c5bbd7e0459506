"""What follows the commit of a run: the durations of its steps, and the publication of its changeset."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import timedelta
from typing import NamedTuple
from uuid import UUID

from conetl.db.connection import Connection, execute, load_sql, transaction
from conetl.model.records import Vec3

#: A run that has just committed publishes its changes itself within this time.
QUIET = timedelta(minutes=2)


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
    """Write the durations of a changeset's run, in a transaction of their own; existing ones stay."""
    with transaction(conn, "The times of the run cannot be written"):
        for time in steps:
            execute(
                conn,
                load_sql("commit.insert_run_step"),
                {
                    "changeset_id": changeset_id, "step": time.step, "task_count": time.task_count, "busy_s": time.busy_s,
                    "started_s": time.started_s, "ended_s": max(time.ended_s, time.started_s),
                },
            )  # fmt: skip


@dataclass(frozen=True)
class RemovedCone:
    """A feature that a changeset removed; last known position and height, in metres of the map's CRS."""

    feature_id: UUID
    xyz_m: Vec3
    cone_height_m: float


@dataclass(frozen=True)
class PendingChangeset:
    """A changeset on the map that was not published."""

    idempotency_key: str
    map_srid: int
    content_sha256: str
    expected_frame_count: int


def is_published(conn: Connection, changeset_id: UUID) -> bool:
    """Whether the events of this changeset were handed to Prefect."""
    return bool(execute(conn, load_sql("commit.is_published"), {"changeset_id": changeset_id})[0]["is_published"])


def pending_changesets(conn: Connection, *, map_name: str, quiet: timedelta) -> list[PendingChangeset]:
    """Changesets of drives that were not published, oldest first, except those committed within `quiet`."""
    parameters = {"map_name": map_name, "quiet_s": quiet.total_seconds()}
    with transaction(conn, "The pending changesets cannot be read"):
        return [PendingChangeset(**row) for row in execute(conn, load_sql("commit.pending_changesets"), parameters)]


def mark_published(conn: Connection, changeset_id: UUID) -> None:
    """Remember that the events of this changeset were handed to Prefect."""
    with transaction(conn, "The publication of a changeset cannot be recorded"):
        execute(conn, load_sql("commit.mark_published"), {"changeset_id": changeset_id})


def removed_by_changeset(conn: Connection, changeset_id: UUID) -> list[RemovedCone]:
    """The cones that a changeset removed, as it was committed."""
    rows = execute(conn, load_sql("commit.removed_features"), {"changeset_id": changeset_id})
    return [
        RemovedCone(r["feature_id"], (r["easting_m"], r["northing_m"], r["height_m"]), r["cone_height_m"]) for r in rows
    ]
