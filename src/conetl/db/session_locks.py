"""Locks that say who lives, held in sessions of their own while the work goes on elsewhere.

Such a session is idle for as long as the work takes, and may be lost on the way: a server that was restarted, a firewall that
forgets, an administrator. That ends nobody's work. A thread sees the loss and takes the locks again. Where another has one of
them meanwhile, both go on, and this process asks for it again until it ends: what comes onto the map once does not rest on these
locks, but on the map's own and on the second look under it.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from conetl.db.connection import Connection, connect, database_errors, execute, load_sql
from conetl.model.errors import DatabaseError

#: Between two tries to have a lost lock again. The server may hold it for the lost session until that one's time is over.
RETAKE_EVERY_S = 5.0


@contextmanager
def holding(url: str, *names: str) -> Iterator[None]:
    """Hold locks in a session of their own; waits for whoever has them. Always give several in the same order.

    Raises `DatabaseError` where they cannot be had at first. Losing them later, and freeing them, raises nothing: neither says
    anything about the work.
    """
    locks = _HeldLocks(url, names)
    try:
        yield
    finally:
        locks.free()


class _HeldLocks:
    """Locks of one session, and the thread that takes them again in another where that one is lost."""

    def __init__(self, url: str, names: tuple[str, ...]) -> None:
        self._url = url
        self._names = names
        self._missing: list[str] = []
        self._conn: Connection | None = self._take_all()
        self._ending, self._end = socket.socketpair()
        self._thread = threading.Thread(target=self._watch, name="locks", daemon=True)
        self._thread.start()

    def free(self) -> None:
        self._end.close()  # the other end becomes readable
        self._thread.join()
        self._ending.close()
        if self._conn is not None:
            # Said, because the server would notice the closed session only a moment later.
            with suppress(DatabaseError), database_errors("A lock could not be freed"):
                for name in self._names:
                    if name not in self._missing:
                        execute(self._conn, load_sql("write/free_lock"), {"name": name})
            self._conn.close()

    def _take_all(self) -> Connection:
        conn = connect(self._url)
        try:
            with database_errors("A lock could not be had"):
                conn.autocommit = True
                for name in self._names:
                    execute(conn, load_sql("write/take_lock"), {"name": name})
        except BaseException:
            conn.close()
            raise
        return conn

    def _watch(self) -> None:
        while not self._must_end():
            if self._conn is not None and not is_alive(self._conn):
                self._conn.close()
                self._conn = None
            if self._conn is None or self._missing:
                self._retake()

    def _must_end(self) -> bool:
        """Wait until the session has something to tell, a lost lock is to be tried again, or the work ends (True)."""
        waiting = select.poll()  # takes file numbers beyond select's 1024
        waiting.register(self._ending.fileno(), select.POLLIN)
        if self._conn is not None:
            waiting.register(self._conn.fileno(), select.POLLIN)
        whole = self._conn is not None and not self._missing
        ready = waiting.poll(None if whole else RETAKE_EVERY_S * 1000)
        return any(number == self._ending.fileno() for number, _ in ready)

    def _retake(self) -> None:
        """Take what is free of the missing locks, in a new session where the old one is lost."""
        try:
            if self._conn is None:
                self._missing = list(self._names)
                self._conn = connect(self._url)
            with database_errors("A lock could not be had"):
                self._conn.autocommit = True
                for name in tuple(self._missing):
                    if execute(self._conn, load_sql("write/try_lock"), {"name": name})[0]["taken"]:
                        self._missing.remove(name)
        except DatabaseError:  # tried again, but not at once: the server may be starting
            if self._conn is not None:
                self._conn.close()
            self._conn = None


def is_alive(conn: Connection) -> bool:
    """False where the server, or the kernel by its keepalives, has ended the session. Sends nothing, so it never waits."""
    with suppress(DatabaseError), database_errors("The session of the locks is lost"):
        conn.poll()
        return not conn.closed
    return False
