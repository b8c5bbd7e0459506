"""Receipts: the outcome of every drive that was handed over, in the database and, for people, as files; locks of the work; and
what follows the commit of a run: the durations of its steps, and the publication of its changeset.

The locks are PostgreSQL's session locks: the server frees them when their process ends, on any machine and for any reason, so a
crash is detected and not guessed from a clock. (A pooler in transaction mode would break them.) `holding` keeps them in a session
of their own during the work. Such a session is idle as long as the work takes, and may be lost: a restarted server, a firewall,
an administrator. The work continues. A thread notices the loss and takes the locks again; if another process has one of them
meanwhile, both continue, and this one retries until it ends. That a drive is committed only once is ensured by
the map's lock and the check under it, not by these locks.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Literal, NamedTuple
from uuid import UUID

from conetl.db.connection import Connection, connect, database_errors, query, read, transaction
from conetl.files.atomic import write_json
from conetl.files.names import file_name_part, printable
from conetl.model.errors import DatabaseError, InputError, StorageError

_log = logging.getLogger(__name__)

State = Literal["started", "committed", "held", "known", "failed", "crashed"]
#: Between two checks of the session, and two attempts to take a lost lock again: the server may keep it for the lost session
#: until that one times out.
CHECK_EVERY_S = 1.0
#: A run that has just committed publishes its changes itself within this time.
QUIET = timedelta(minutes=2)
#: Actions for what is no drive; the reason of its receipt begins with one of them.
STRAYS = ("needs init", "not recognised")
_UNREAD = "The receipts cannot be read"


@dataclass(frozen=True, kw_only=True)
class Receipt:
    """One row of `conetl.receipt`."""

    attempt_id: UUID
    map_name: str
    drive_path: str
    drive_id: str
    header_sha256: str
    analysis_sha256: str
    content_sha256: str | None = None
    state: State = "started"
    reason: str = ""
    may_pass: bool = True
    changeset_id: UUID | None = None
    frame_pairs: int | None
    seconds: float | None = None
    flow_run_id: str | None
    host: str
    at: datetime | None = None
    """Time of writing; None before."""
    attempts: int = 0
    """Number of starts of work on the drive, this one included; 0 if not counted."""

    @property
    def done(self) -> bool:
        """The drive is stored: on the map, or on hold."""
        return self.state in {"committed", "held", "known"}

    @property
    def drive_lock(self) -> str:
        return drive_lock(self.map_name, self.header_sha256)


def drive_lock(map_name: str, header_sha256: str) -> str:
    """Name of the lock that is held while a drive is being ingested."""
    return f"conetl.drive/{map_name}/{header_sha256}"


def run_lock(flow_run_id: str) -> str:
    """Name of the lock that a flow run holds while its process runs."""
    return f"conetl.flow_run/{flow_run_id}"


def write_receipt(conn: Connection, receipt: Receipt, folder: Path) -> None:
    """Write a receipt: a row, and its copy `folder/<drive>-<header>.json` with the drive's last receipt.

    File names may contain any bytes, also within reasons, so texts are stored in printable form.
    """
    parameters = {k: printable(v, lines=True) if isinstance(v, str) else v for k, v in asdict(receipt).items()}
    with transaction(conn, f"The receipt of drive {receipt.drive_id} cannot be written"):
        query(conn, "receipts.insert_receipt", **parameters)
        written = latest_receipts(conn, map_name=receipt.map_name, headers=[receipt.header_sha256])
    name = f"{file_name_part(receipt.drive_id)}-{receipt.header_sha256[:12]}.json"
    try:
        content = asdict(written[receipt.header_sha256]) if written else parameters
        write_json(folder / receipt.map_name / name, content, default=str)
    except (InputError, StorageError) as error:
        _log.warning("The receipt of drive %s is in the database, its copy is not: %s", receipt.drive_id, error)


def latest_receipts(conn: Connection, *, map_name: str, headers: Sequence[str]) -> dict[str, Receipt]:
    """The last receipt of drives of a map, by header_sha256."""
    rows = read(conn, _UNREAD, "receipts.latest_receipts", map_name=map_name, headers=list(headers))
    return {row["header_sha256"]: Receipt(**row) for row in rows}


def attempt_ends(conn: Connection, attempt_ids: Sequence[UUID]) -> dict[UUID, Receipt]:
    """The receipts of attempts that ended, by attempt."""
    rows = read(conn, _UNREAD, "receipts.receipt_ends", attempt_ids=[str(a) for a in attempt_ids])
    return {row["attempt_id"]: Receipt(**row) for row in rows}


def headers_by_changeset(conn: Connection, *, map_name: str) -> dict[UUID, set[str]]:
    """Header hashes of the folders of drives by their changesets; nothing of those that were ingested by hand."""
    rows = read(conn, _UNREAD, "receipts.headers_by_changeset", map_name=map_name)
    return {row["changeset_id"]: set(row["headers"]) for row in rows}


def pairs_per_second(conn: Connection, *, map_name: str) -> float | None:
    """Median frame pairs per second of recent drives; None if none was timed."""
    rate = read(conn, _UNREAD, "receipts.pairs_per_second", map_name=map_name)[0]["pairs_per_second"]
    return None if rate is None else float(rate)


def held_locks(conn: Connection, names: Sequence[str]) -> set[str]:
    """Those of the locks that a running process holds."""
    return {row["name"] for row in read(conn, "The locks cannot be read", "locks.held_locks", names=list(names))}


def drives_under_way(conn: Connection, *, map_name: str) -> list[str]:
    """Ids of the drives that are being ingested into the map by a running process."""
    begun = read(conn, _UNREAD, "receipts.under_way", map_name=map_name)
    held = held_locks(conn, [drive_lock(map_name, row["header_sha256"]) for row in begun])
    return sorted(row["drive_id"] for row in begun if drive_lock(map_name, row["header_sha256"]) in held)


@contextmanager
def try_lock(conn: Connection, name: str) -> Iterator[bool]:
    """Hold a lock, if it is free, in the session that also does the work; yields whether it was free."""
    with database_errors("A lock in PostgreSQL could not be taken"):
        conn.rollback()
        taken = bool(query(conn, "locks.try_lock", name=name)[0]["taken"])
        conn.commit()
    try:
        yield taken
    finally:
        if taken:
            # A lost session holds nothing.
            with suppress(DatabaseError), database_errors("A lock could not be freed"):
                conn.rollback()
                query(conn, "locks.free_lock", name=name)
                conn.commit()


def end_crashed(conn: Connection, started: Receipt, reason: str, folder: Path) -> Receipt | None:
    """Record that an attempt was interrupted; None if its process is running, or it ended meanwhile."""
    with try_lock(conn, started.drive_lock) as free:
        if not free or attempt_ends(conn, [started.attempt_id]):
            return None
        crashed = replace(started, state="crashed", reason=reason, may_pass=True, at=None)
        write_receipt(conn, crashed, folder)
        return crashed


@contextmanager
def holding(url: str, *names: str) -> Iterator[None]:
    """Hold locks in a session of their own; waits for other holders. Always give several in the same order.

    Raises `DatabaseError` if they cannot be taken at first. Losing or freeing them later raises nothing.
    """
    locks = _HeldLocks(url, names)
    try:
        yield
    finally:
        locks.free()


class _HeldLocks:
    """Locks of one session, and the thread that takes them again in another one if that is lost."""

    def __init__(self, url: str, names: tuple[str, ...]) -> None:
        self._url = url
        self._names = names
        self._missing: list[str] = []
        self._conn: Connection | None = None
        self._take("locks.take_lock")
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="locks", daemon=True)
        self._thread.start()

    def free(self) -> None:
        self._ending.set()
        self._thread.join()
        if self._conn is not None:
            # Explicitly: the server notices a closed session only a moment later.
            with suppress(DatabaseError), database_errors("A lock could not be freed"):
                for name in self._names:
                    if name not in self._missing:
                        query(self._conn, "locks.free_lock", name=name)
            self._close()

    def _take(self, statement: str) -> None:
        """Take the missing locks, in a new session if there is none. Raises DatabaseError; then there is none again."""
        if self._conn is None:
            self._missing = list(self._names)
            self._conn = connect(self._url)
        try:
            with database_errors("A lock in PostgreSQL could not be taken"):
                self._conn.autocommit = True
                query(self._conn, "locks.wait_without_limit")
                for name in tuple(self._missing):
                    if query(self._conn, statement, name=name)[0]["taken"]:
                        self._missing.remove(name)
        except BaseException:
            self._close()
            raise

    def _watch(self) -> None:
        while not self._ending.wait(CHECK_EVERY_S):
            if self._conn is not None and not is_alive(self._conn):
                self._close()
            if self._conn is None or self._missing:
                with suppress(DatabaseError):  # retried, but not immediately: the server may be starting
                    self._take("locks.try_lock")

    def _close(self) -> None:
        if self._conn is not None:
            self._conn.close()
        self._conn = None


def is_alive(conn: Connection) -> bool:
    """False if the server, or the kernel by its keepalives, has ended the session. Sends nothing, so it never waits."""
    with suppress(DatabaseError), database_errors("The session of the locks is lost"):
        conn.poll()
        return not conn.closed
    return False


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
            times = time._asdict() | {"ended_s": max(time.ended_s, time.started_s)}
            query(conn, "commit.insert_run_step", changeset_id=changeset_id, **times)


def is_published(conn: Connection, changeset_id: UUID) -> bool:
    """Whether the events of this changeset were handed to Prefect."""
    return bool(query(conn, "commit.is_published", changeset_id=changeset_id)[0]["is_published"])


def pending_changesets(conn: Connection, *, map_name: str, quiet: timedelta) -> list[UUID]:
    """Changesets of drives that were not published, oldest first, except those committed within `quiet`."""
    what, wanted = "The pending changesets cannot be read", {"map_name": map_name, "quiet_s": quiet.total_seconds()}
    rows = read(conn, what, "commit.pending_changesets", **wanted)
    return [row["changeset_id"] for row in rows]


def mark_published(conn: Connection, changeset_id: UUID) -> None:
    """Remember that the events of this changeset were handed to Prefect."""
    with transaction(conn, "The publication of a changeset cannot be recorded"):
        query(conn, "commit.mark_published", changeset_id=changeset_id)


def removed_by_changeset(conn: Connection, changeset_id: UUID) -> list[dict[str, Any]]:
    """The cones that a changeset removed, as it was committed: rows of `commit.removed_features`."""
    return query(conn, "commit.removed_features", changeset_id=changeset_id)
