"""Session locks that show which processes are alive, each held in a session of its own during the work.

Such a session is idle as long as the work takes, and may be lost: a restarted server, a firewall, an administrator. The work
continues. A thread notices the loss and takes the locks again; if another process has one of them meanwhile, both continue, and
this one retries until it ends. That nothing is committed twice does not depend on these locks, but on the map's lock and the
check under it.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from conetl.db.connection import Connection, connect, database_errors, execute
from conetl.db.statements import load_sql
from conetl.model.errors import DatabaseError

#: Between two checks of the session, and two attempts to take a lost lock again: the server may keep it for the lost session
#: until that one times out.
CHECK_EVERY_S = 1.0


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
        self._conn: Connection | None = self._take_all()
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
                        execute(self._conn, load_sql("locks.free_lock"), {"name": name})
            self._conn.close()

    def _take_all(self) -> Connection:
        conn = connect(self._url)
        try:
            with database_errors("A lock in PostgreSQL could not be taken"):
                conn.autocommit = True
                execute(conn, load_sql("locks.wait_without_limit"))
                for name in self._names:
                    execute(conn, load_sql("locks.take_lock"), {"name": name})
        except BaseException:
            conn.close()
            raise
        return conn

    def _watch(self) -> None:
        while not self._ending.wait(CHECK_EVERY_S):
            if self._conn is not None and not is_alive(self._conn):
                self._conn.close()
                self._conn = None
            if self._conn is None or self._missing:
                self._retake()

    def _retake(self) -> None:
        """Take the missing locks that are free, in a new session if the old one is lost."""
        try:
            if self._conn is None:
                self._missing = list(self._names)
                self._conn = connect(self._url)
            with database_errors("A lock in PostgreSQL could not be taken"):
                self._conn.autocommit = True
                for name in tuple(self._missing):
                    if execute(self._conn, load_sql("locks.try_lock"), {"name": name})[0]["taken"]:
                        self._missing.remove(name)
        except DatabaseError:  # retried, but not immediately: the server may be starting
            if self._conn is not None:
                self._conn.close()
            self._conn = None


def is_alive(conn: Connection) -> bool:
    """False if the server, or the kernel by its keepalives, has ended the session. Sends nothing, so it never waits."""
    with suppress(DatabaseError), database_errors("The session of the locks is lost"):
        conn.poll()
        return not conn.closed
    return False
