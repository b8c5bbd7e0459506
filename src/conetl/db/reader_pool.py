"""Connections that can only read, lent to one request at a time."""

from __future__ import annotations

import select
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from conetl.db.connection import Connection, connect, database_errors, execute
from conetl.db.statements import load_sql
from conetl.model.errors import DatabaseError

#: Queries of the web view that take longer are ended by the server.
STATEMENT_TIMEOUT = "10s"
WAIT_S = 5.0


class ReaderPool:
    """At most `size` read-only connections, opened when first needed and opened anew where the database went away."""

    def __init__(self, url: str, size: int = 6) -> None:
        self._url = url
        self._free: list[Connection] = []
        self._slots = threading.BoundedSemaphore(size)

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """One read-only transaction. Raises DatabaseError where none is to be had within some seconds."""
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
        """One more connection, which is told of changes; the caller closes it. Raises DatabaseError."""
        return open_listener(self._url)

    def close(self) -> None:
        """Close what is not lent."""
        while self._free:
            self._free.pop().close()


def open_listener(url: str) -> Connection:
    """A connection that is told of every change of a map or its base layers. Raises DatabaseError."""
    conn = open_reader(url)
    with database_errors("The connection could not listen for news"):
        conn.autocommit = True
        execute(conn, load_sql("schema.listen"))
    return conn


def wait_for_news(conn: Connection, timeout_s: float) -> bool:
    """Block until the database tells of a change, True, or the time is over, False. Raises DatabaseError where it went away."""
    waiting = select.poll()  # takes file numbers beyond select's 1024
    waiting.register(conn.fileno(), select.POLLIN)
    waiting.poll(timeout_s * 1000)
    with database_errors("The database went away"):
        conn.poll()
    told = bool(conn.notifies)
    conn.notifies.clear()
    return told


def open_reader(url: str) -> Connection:
    """A connection whose transactions only read, as role conetl_reader where the user may take it. Raises DatabaseError."""
    conn = connect(url)
    with database_errors("The connection could not be made read-only"):
        conn.autocommit = True
        execute(conn, load_sql("schema.reader_session"), {"timeout": STATEMENT_TIMEOUT})
        conn.autocommit = False
    return conn
