"""Many drives: plan on disk first, then one sub-flow per drive. Run again, it tries again what failed or was interrupted."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Annotated, Any, Literal
from uuid import uuid4

from prefect import State, flow
from prefect.runtime import flow_run
from prefect.states import Completed
from pydantic import Field

from conetl.db.connection import Connection
from conetl.db.map.decision_store import held_drives, hold_events
from conetl.db.map.map_store import find_map
from conetl.db.receipt_store import Receipt, attempt_ends, end_crashed, latest_receipts, write_receipt
from conetl.files.names import minutes, printable
from conetl.files.storage import as_path
from conetl.model.health import HeldDrive, HoldEvent
from conetl.model.params import IngestParams
from conetl.pipeline.backfill_plan import Plan, PlanLine, attention_text, plan_drives, write_plan
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.ingest import new_receipt
from conetl.pipeline.publish import catch_up_all
from conetl.pipeline.settings import Settings, read_settings
from flows import dispatch
from flows.artifacts import batch_progress, send_events, send_not_recognised, show_entries
from flows.runs import BACKFILL_QUEUE, MapName, MapSrid, alive, needs_attention

_log = logging.getLogger(__name__)
#: A drive whose process died is started at most this many times; then it counts as failed.
TRIES = 2
_POLL_S = 1.0
#: Ends of a batch of which a drive needs attention: Prefect's dashboard counts what failed.
SOME_FAILED, SOME_ON_HOLD, NOT_RECOGNISED = "SomeFailed", "SomeOnHold", "NotRecognised"
Parallel = Annotated[int | None, Field(ge=1, le=1000)]
Watcher = Callable[["Standing"], None]


@dataclass
class Standing:
    """The state of a batch."""

    plan: Plan
    parallel: int
    where: Literal["workers", "here"]
    started: float
    running: list[dispatch.DriveRun]
    ended: list[Receipt]
    pairs_done: int = 0
    held: list[HeldDrive] = field(default_factory=list)
    """Drives that are on hold now: those of the batch, and those that it put on hold."""
    hold_events: list[HoldEvent] = field(default_factory=list)
    """Holds and releases since the batch began, in order."""
    note: str = ""
    """What a person has to correct while the batch waits."""
    strays: list[Receipt] = field(default_factory=list)
    """Of what is no drive, or not yet."""
    map_existed: bool = False
    """When the batch began."""

    @property
    def todo(self) -> int:
        return len(self.plan.todo) + len(self.plan.refused)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.started

    @property
    def done(self) -> int:
        """Drives on the map, without those on hold."""
        waiting = {drive.changeset_id for drive in self.held}
        return sum(receipt.done and receipt.changeset_id not in waiting for receipt in self.ended)

    @property
    def map_exists(self) -> bool:
        """Whether the map must be there, unless it was renamed or deleted since."""
        return self.map_existed or any(receipt.done for receipt in self.ended)

    @property
    def failed(self) -> list[Receipt]:
        return [receipt for receipt in self.ended if not receipt.done]

    @property
    def left_s(self) -> float | None:
        """Time left by the rate so far; before the first drive is done, by that of earlier days; None without either."""
        if self.pairs_done:
            return (self.plan.frame_pairs - self.pairs_done) * self.seconds / self.pairs_done
        return self.plan.estimate_s(self.parallel)

    @property
    def percent(self) -> float:
        if pairs := self.plan.frame_pairs:
            return min(100.0, 100.0 * self.pairs_done / pairs)
        return 100.0 * len(self.ended) / max(1, self.todo)

    @property
    def sentence(self) -> str:
        """How many drives have ended, and when the others will."""
        rate = f", {self.pairs_done / self.seconds:.1f} frame pairs per second" if self.pairs_done else ""
        when = "" if self.left_s is None else f", about {minutes(self.left_s)} left"
        ended = f"{len(self.ended)} of {self.todo} drives ({len(self.failed)} failed)"
        return f"{ended}, {len(self.running)} running{rate}{when}"


def _batch_run_name() -> str:
    parameters = flow_run.parameters
    since, until = (str(parameters.get(name) or "")[:10] for name in ("since", "until"))
    span = f" {since or '...'} to {until or '...'}" if since or until else ""
    return f"backfill {printable(as_path(parameters['root']).name)}{span}"


@flow(name="backfill", flow_run_name=_batch_run_name)
def backfill(
    root: str,
    since: datetime | None = None,
    until: datetime | None = None,
    max_parallel: Parallel = None,
    map_name: MapName = None,
    map_srid: MapSrid = None,
    params: IngestParams = IngestParams(),  # noqa: B008 -- frozen
    recheck: bool = False,
    reanalyse: bool = False,
    where: dispatch.Where = "auto",
) -> State[Any]:
    """Ingest all drives below a folder that are not on the map yet. Run it again after a stop: it continues.

    Args:
        root: Folder with drives, or with folders of drives, or its s3:// address; as on the workers.
        since: Only drives recorded since this time.
        until: Only drives recorded before this time.
        max_parallel: Drives to run in parallel; default: one per worker, 1 without workers.
        map_name: Name of the map; default: CONETL_MAP_NAME of the worker.
        map_srid: EPSG code of the map; default: the UTM zone of the first drive.
        params: Parameters of all steps.
        recheck: Also compare the content of drives already on the map.
        reanalyse: Also analyse drives again that another version of conetl analysed, and replace what it found.
        where: Where to run the drives: on workers, in processes beside this run (here), or on workers if there are any (auto).
    """
    settings = read_settings(map_name)
    folder = as_path(root)
    settings.require_readable(folder)
    with alive(settings) as database:
        catch_up_all(settings, database, send_events)
        with database.connection() as conn:
            plan = plan_drives(
                conn,
                folder,
                settings=settings,
                params=params,
                since=utc(since),
                until=utc(until),
                recheck=recheck,
                reanalyse=reanalyse,
            )
        if not plan.has_news:  # started for what was pending
            message = f"no new drives; {len(plan.lines)} entries need no ingest{attention_text(plan)}"
            return Completed(name="NeedsAttention" if plan.open_lines else "NothingNew", message=message)
        return _run_batch(database, plan, settings, params, map_srid=map_srid, max_parallel=max_parallel, where=where)


def _run_batch(
    database: MapDatabase,
    plan: Plan,
    settings: Settings,
    params: IngestParams,
    *,
    map_srid: int | None,
    max_parallel: int | None,
    where: dispatch.Where,
) -> State[Any]:
    """Execute a plan inside a flow run. The state says how many drives failed; the receipts say which and why."""
    place = dispatch.resolve_where(where)
    parallel = max_parallel or (max(1, dispatch.online_workers()) if place == "workers" else 1)
    write_plan(plan, parallel, settings.home / "plans")
    standing = Standing(plan, parallel, place, time.monotonic(), [], [])
    board = batch_progress(standing.sentence)
    look_at_s = standing.started + dispatch.WORKERS_GONE_S  # whether workers are there
    with database.connection() as conn:
        held_before = {drive.changeset_id for drive in held_drives(conn, map_name=settings.map_name)}
        standing.map_existed = find_map(conn, settings.map_name) is not None
        known_events = set(hold_events(conn, map_name=settings.map_name))
    waiting: deque[tuple[PlanLine, int]] = deque((line, 1) for line in plan.todo)
    standing.ended += refuse(database, plan.refused, plan, settings)
    standing.strays += refuse(database, plan.strays, plan, settings)
    show_entries(plan)
    _tell(standing, board)
    try:
        while waiting or standing.running:
            while waiting and len(standing.running) < parallel:
                line, number = waiting.popleft()
                standing.running.append(_start(line, number, standing, settings, params, map_srid))
                _tell(standing, board)
            with database.connection() as conn:
                landed = _landed(conn, standing.running, plan, settings)
            for run, receipt, again in landed:
                standing.running.remove(run)
                if again and run.number < TRIES:
                    waiting.append((run.line, run.number + 1))
                    continue
                standing.ended.append(receipt)
                standing.pairs_done += run.line.header.frame_pairs
                _tell(standing, board)
            if place == "workers" and standing.running and not standing.note and time.monotonic() >= look_at_s:
                look_at_s = time.monotonic() + dispatch.WORKERS_GONE_S / 6
                if note := dispatch.missing_workers():
                    standing.note = note
                    _log.warning(note)
                    _tell(standing, board)
            if standing.running:
                time.sleep(_POLL_S)
    finally:
        dispatch.abandon(standing.running)
    with database.connection() as conn:
        own = {receipt.changeset_id for receipt in standing.ended}
        held = held_drives(conn, map_name=settings.map_name)
        standing.held = [drive for drive in held if drive.changeset_id in own or drive.changeset_id not in held_before]
        events = hold_events(conn, map_name=settings.map_name)
        standing.hold_events = [event for event in events if event not in known_events]
    _tell(standing, board)
    return _end(standing)


def _start(
    line: PlanLine, number: int, standing: Standing, settings: Settings, params: IngestParams, map_srid: int | None
) -> dispatch.DriveRun:
    """Start a drive of the plan. On workers at most once for each try, also when this run itself was started again."""
    if standing.where == "here":
        run, process = dispatch.start_here(
            line.header, settings, params, map_srid, standing.parallel, standing.map_exists
        )
        return dispatch.DriveRun(line, number, run.id, process)
    key = f"{flow_run.id} {line.header.header_sha256} {line.starts + number}"
    run = dispatch.start_on_worker(
        line.header, settings, params, map_srid, key, BACKFILL_QUEUE, map_exists=standing.map_exists
    )
    return dispatch.DriveRun(line, number, run.id, None)


def _landed(
    conn: Connection, running: list[dispatch.DriveRun], plan: Plan, settings: Settings
) -> list[tuple[dispatch.DriveRun, Receipt, bool]]:
    """Runs that ended, with their receipts, and whether another try may help."""
    # Read first: runs that ended before this have their receipts by now.
    ends_of_processes = {run.attempt_id: dispatch.over(run) for run in running}
    ends = attempt_ends(conn, [run.attempt_id for run in running])
    landed: list[tuple[dispatch.DriveRun, Receipt, bool]] = []
    latest = latest_receipts(conn, map_name=settings.map_name, headers=[f.line.header.header_sha256 for f in running])
    for run in running:
        if run.attempt_id in ends:
            if run.process is not None:
                run.process.join()
            landed.append((run, ends[run.attempt_id], False))
            continue
        reason = ends_of_processes[run.attempt_id]
        begun = latest.get(run.line.header.header_sha256)
        if begun is not None and begun.attempt_id == run.attempt_id and begun.state == "started":
            # It was started. Its lock shows whether it is running, not Prefect's state.
            crashed = end_crashed(conn, begun, reason or "its process has ended", settings.receipts_folder)
            if crashed is not None:
                dispatch.mark_crashed(run.flow_run_id, crashed.reason)
                landed.append((run, crashed, not dispatch.was_cancelled(run)))
        elif reason is not None:  # it could not be started, or a person cancelled it
            never = new_receipt(run.line.header, settings, plan.analysis.sha256, run.attempt_id, str(run.flow_run_id))
            lost = replace(never, state="crashed", reason=reason)
            write_receipt(conn, lost, settings.receipts_folder)
            dispatch.mark_crashed(run.flow_run_id, reason)
            landed.append((run, lost, not dispatch.was_cancelled(run)))
    return landed


def refuse(database: MapDatabase, lines: Iterable[PlanLine], plan: Plan, settings: Settings) -> list[Receipt]:
    """The receipts of what cannot be ingested; each is also sent as an event."""
    receipts = []
    for line in lines:
        begun = new_receipt(line.header, settings, plan.analysis.sha256, uuid4(), flow_run.id)
        receipts.append(replace(begun, state="failed", reason=line.reason, may_pass=line.header.problem_may_pass))
        with database.connection() as conn:
            write_receipt(conn, receipts[-1], settings.receipts_folder)
    send_not_recognised(receipts)
    return receipts


_watchers: list[Watcher] = []


@contextmanager
def watch_batch(watcher: Watcher) -> Iterator[None]:
    """Call `watcher(standing)` whenever something changes in a batch of this process."""
    _watchers.append(watcher)
    try:
        yield
    finally:
        _watchers.remove(watcher)


def _tell(standing: Standing, board: Callable[[float, str], None]) -> None:
    board(standing.percent, standing.sentence)
    for watcher in _watchers:
        watcher(standing)


def _end(standing: Standing) -> State[Any]:
    failed = standing.failed
    on_hold = f"{len(standing.held)} on hold, " if standing.held else ""
    message = (
        f"{on_hold}{standing.done} on the map, {len(failed)} failed, {standing.plan.count('skip')} had nothing to do; "
        f"{standing.seconds:.0f} s"
    )
    if standing.strays:
        message += attention_text(standing.plan)
    if failed:
        return needs_attention(SOME_FAILED, f"{message}. {failed[0].drive_id}: {failed[0].reason}")
    if standing.held:
        return needs_attention(SOME_ON_HOLD, f"{message}. {standing.held[0].drive_id}: {standing.held[0].reason}")
    if standing.plan.open_lines:
        return needs_attention(NOT_RECOGNISED, message)
    _log.info(message)
    return Completed(message=message)


def utc(at: datetime | None) -> datetime | None:
    """A time without a zone is UTC."""
    return at if at is None or at.tzinfo else at.replace(tzinfo=UTC)
