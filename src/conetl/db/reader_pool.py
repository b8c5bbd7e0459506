"""Read-only connections, lent to one request at a time: for the web view, and for `asyncio` (tipg uses asyncpg)."""

from __future__ import annotations

import asyncio
import json
import select
import threading
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing, contextmanager, suppress
from urllib.parse import quote, urlencode

import asyncpg

from conetl.db import connection as db
from conetl.db.connection import Connection
from conetl.model.errors import DatabaseError

#: The server cancels statements of the web view that take longer.
STATEMENT_TIMEOUT = "10s"
#: Of a download: a map of millions of features takes a minute.
EXPORT_TIMEOUT = "10min"
WAIT_S = 5.0
#: Two processors do not answer sooner with more.
MAX_CONNECTIONS = 6
#: Keywords of a libpq address that asyncpg supports; others (such as keepalives) concern the kind of connection only.
_KEYWORDS = (
    "host", "port", "user", "password", "passfile", "sslmode", "sslcert", "sslkey", "sslrootcert", "sslcrl",
)  # fmt: skip
_SESSION = {
    "application_name": "conetl ogc",
    "jit": "off",
    "plan_cache_mode": "force_generic_plan",  # planning is a fifth of a page; a query for a whole map is another statement
}


class ReaderPool:
    """At most `MAX_CONNECTIONS` read-only connections, opened when first needed and again after they were lost."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._free: list[Connection] = []
        self._slots = threading.BoundedSemaphore(MAX_CONNECTIONS)
        self._exports = threading.BoundedSemaphore(1)

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """One read-only transaction. Raises DatabaseError if none is available within some seconds."""
        if not self._slots.acquire(timeout=WAIT_S):
            raise DatabaseError("The database is busy: all connections of the view are in use. Try again.")
        try:
            conn = self._idle() or open_reader(self._url)
            try:
                yield conn
            finally:
                with suppress(Exception):  # a lost connection is not used again
                    conn.rollback()
                    self._free.append(conn)
        finally:
            self._slots.release()

    def _idle(self) -> Connection | None:
        """A returned connection that still works: after a restart of PostgreSQL, no request must fail for each idle one."""
        while self._free:
            conn = self._free.pop()
            waiting = select.poll()  # supports file numbers beyond select's 1024
            waiting.register(conn.fileno(), select.POLLIN)
            if not waiting.poll(0):  # no query is pending, so any input means that the connection was closed
                return conn
            conn.close()
        return None

    @contextmanager
    def exporting(self) -> Iterator[Connection]:
        """A read-only connection for a long answer, one at a time. Raises DatabaseError while another one takes longer."""
        if not self._exports.acquire(timeout=WAIT_S):
            raise DatabaseError("Another download is in progress: try again in a moment.")
        try:
            with closing(open_reader(self._url, EXPORT_TIMEOUT)) as conn:
                yield conn
        finally:
            self._exports.release()

    def close(self) -> None:
        """Close the connections that are not lent."""
        while self._free:
            self._free.pop().close()


def open_reader(url: str, timeout: str = STATEMENT_TIMEOUT) -> Connection:
    """A connection whose transactions only read, as role conetl_reader if the user is a member of it. Raises DatabaseError."""
    conn = db.connect(url)
    with db.database_errors("The connection could not be made read-only"):
        conn.autocommit = True
        db.query(conn, "schema.reader_session", timeout=timeout)
        conn.autocommit = False
    return conn


class AsyncReaderPool:
    """`MAX_CONNECTIONS` read-only connections, as role conetl_reader if the user is a member of it.

    All are opened with the first request and stay open: a new session takes 30 ms and more to plan its first statement, which
    would make the slowest answers at busy times.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._pool: asyncpg.Pool | None = None
        self._opening = asyncio.Lock()

    @asynccontextmanager
    async def acquire(self) -> AsyncIterator[asyncpg.Connection]:
        """One connection whose transactions only read. Raises DatabaseError if none is available, or it is lost."""
        try:
            pool = await self._opened()
            conn = await pool.acquire(timeout=WAIT_S)
        except TimeoutError as error:
            raise DatabaseError(
                "The database is busy: all connections of the OGC API are in use. Try again."
            ) from error
        except (OSError, asyncpg.PostgresError, asyncpg.InterfaceError) as error:
            raise DatabaseError(
                f"The PostgreSQL database cannot be reached: {error}. Start it (`conetl db up`)."
            ) from error
        try:
            yield conn
        except (OSError, asyncpg.InterfaceError, asyncpg.PostgresConnectionError) as error:
            raise DatabaseError(f"The connection to the database was lost: {error}. Try again.") from error
        finally:
            await pool.release(conn)

    async def close(self) -> None:
        """Close all connections; the next request opens new ones."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.terminate()

    async def _opened(self) -> asyncpg.Pool:
        async with self._opening:
            if self._pool is None:
                parts = db.address_parts(self._url)
                query = urlencode({name: parts[name] for name in _KEYWORDS if name in parts})
                self._pool = await asyncpg.create_pool(
                    f"postgresql:///{quote(parts.get('dbname', ''), safe='')}?{query}",
                    min_size=MAX_CONNECTIONS,
                    max_size=MAX_CONNECTIONS,
                    max_inactive_connection_lifetime=0,
                    timeout=db.CONNECT_TIMEOUT_S,
                    init=self._prepare,
                    reset=_keep_session,
                    server_settings=_SESSION,
                )
            return self._pool

    async def _prepare(self, conn: asyncpg.Connection) -> None:
        await conn.execute(db.load_sql("schema.session"))
        await conn.fetch(db.load_sql("schema.reader_session").replace("%(timeout)s", "$1"), STATEMENT_TIMEOUT)
        for name in ("json", "jsonb"):
            await conn.set_type_codec(name, encoder=json.dumps, decoder=json.loads, schema="pg_catalog")


async def _keep_session(_: asyncpg.Connection) -> None:
    """Between two requests a session stays as it is: the usual reset would restore its user and its right to write."""
