"""Read-only connections, lent to one request at a time."""

from __future__ import annotations

import select
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from conetl.db.connection import Connection, connect, database_errors, execute
from conetl.db.statements import load_sql
from conetl.model.errors import DatabaseError

#: The server cancels statements of the web view that take longer.
STATEMENT_TIMEOUT = "10s"
WAIT_S = 5.0


class ReaderPool:
    """At most `size` read-only connections, opened when first needed and again after they were lost."""

    def __init__(self, url: str, size: int = 6) -> None:
        self._url = url
        self._free: list[Connection] = []
        self._slots = threading.BoundedSemaphore(size)

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """One read-only transaction. Raises DatabaseError if none is available within some seconds."""
        if not self._slots.acquire(timeout=WAIT_S):
            raise DatabaseError("The database is busy: all connections of the view are in use. Try again.")
        try:
            conn = self._free.pop() if self._free else open_reader(self._url)
            try:
                yield conn
            finally:
                with suppress(Exception):  # a broken connection is not lent again
                    conn.rollback()
                    self._free.append(conn)
        finally:
            self._slots.release()

    def listener(self) -> Connection:
        """One more connection, which receives notifications of changes; the caller closes it. Raises DatabaseError."""
        conn = open_reader(self._url)
        with database_errors("The connection could not listen for changes"):
            conn.autocommit = True
            execute(conn, load_sql("schema.listen"))
        return conn

    def close(self) -> None:
        """Close the connections that are not lent."""
        while self._free:
            self._free.pop().close()


def wait_for_news(conn: Connection, timeout_s: float) -> bool:
    """Wait for a notification of a change; False if none came in time. Raises DatabaseError if the connection was lost."""
    waiting = select.poll()  # supports file numbers beyond select's 1024
    waiting.register(conn.fileno(), select.POLLIN)
    waiting.poll(timeout_s * 1000)
    with database_errors("The connection to the database was lost"):
        conn.poll()
    notified = bool(conn.notifies)
    conn.notifies.clear()
    return notified


def open_reader(url: str) -> Connection:
    """A connection whose transactions only read, as role conetl_reader if the user is a member of it. Raises DatabaseError."""
    conn = connect(url)
    with database_errors("The connection could not be made read-only"):
        conn.autocommit = True
        execute(conn, load_sql("schema.reader_session"), {"timeout": STATEMENT_TIMEOUT})
        conn.autocommit = False
    return conn
