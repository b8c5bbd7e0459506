"""Tells open pages about news: one listener for all of them, and only while somebody listens.

PostgreSQL notifies of each commit (`listen` in sql/schema.sql); then, and every `LOOK_S` in case a connection pool swallows
notices, the heads of all maps are read once for all pages.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import suppress

from starlette.concurrency import run_in_threadpool

from conetl.db.connection import Connection
from conetl.db.reader_pool import ReaderPool, wait_for_news
from conetl.db.serve_store import Head, read_heads
from conetl.model.errors import DatabaseError

#: How often streams look whether the server stops, and the listener whether anybody still listens.
ROUND_S = 0.5
LOOK_S = 5.0
RETRY_S = 1.0
PING_S = 15.0
MAX_STREAMS = 64
TOO_MANY = f"{MAX_STREAMS} pages listen already: close some, or reload by hand."


class HeadWatcher:
    """Listens to the database and hands the newest state of every map to every open stream."""

    def __init__(self, pool: ReaderPool, *, closing: Callable[[], bool]) -> None:
        self._pool, self._closing = pool, closing
        self._heads: dict[str, Head] = {}
        self._problem: str | None = None
        self._streams = 0
        self._round = asyncio.Condition()
        self._listener: asyncio.Task[None] | None = None

    def full(self) -> bool:
        """True where no further stream may be opened."""
        return self._streams >= MAX_STREAMS

    async def events(self, map_name: str) -> AsyncIterator[str]:
        """Server-sent events, at once and after every commit that changes them: `changeset` and `decision` with the number of the
        map's newest one (0: none), `base` with a text that differs where the base layers do; `trouble` with what is wrong, while
        the database cannot be asked."""
        if self.full():  # many came at the same moment
            yield _event("trouble", TOO_MANY)
            return
        self._streams += 1
        sent: Head | None = None
        said: str | None = None
        idle_s = 0.0
        try:
            if self._listener is None or self._listener.done():
                self._listener = asyncio.create_task(self._listen())
            while not self._closing():
                async with self._round:
                    await self._round.wait()
                head, problem = self._heads.get(map_name, Head()), self._problem
                idle_s += ROUND_S
                if problem and problem != said:
                    yield _event("trouble", problem)
                    sent, idle_s = None, 0.0  # afterwards everything is told again
                elif not problem and head != sent:
                    yield "".join(_news(sent, head))
                    sent, idle_s = head, 0.0
                elif idle_s >= PING_S:
                    yield ": still here\n\n"
                    idle_s = 0.0
                said = problem
        finally:
            self._streams -= 1
            if self._streams == 0 and self._listener is not None:
                self._listener.cancel()
                self._listener = None

    async def _listen(self) -> None:
        conn: Connection | None = None
        since_look_s = LOOK_S
        with suppress(asyncio.CancelledError):
            try:
                while True:
                    try:
                        if conn is None:
                            conn = await run_in_threadpool(self._pool.listener)
                        if since_look_s >= LOOK_S:
                            self._heads, since_look_s = await run_in_threadpool(self._read), 0.0
                        self._problem = None
                        await self._tell()
                        told = await run_in_threadpool(wait_for_news, conn, ROUND_S)
                        since_look_s = LOOK_S if told else since_look_s + ROUND_S
                    except DatabaseError as error:
                        self._problem, since_look_s = str(error), LOOK_S
                        _close(conn)
                        conn = None
                        await self._tell()
                        await asyncio.sleep(RETRY_S)
            finally:
                _close(conn)

    async def _tell(self) -> None:
        async with self._round:
            self._round.notify_all()

    def _read(self) -> dict[str, Head]:
        with self._pool.reading() as conn:
            return read_heads(conn)


def _close(conn: Connection | None) -> None:
    if conn is not None:
        with suppress(Exception):  # it may be broken already
            conn.close()


def _news(sent: Head | None, head: Head) -> list[str]:
    named = {"changeset": "changeset_no", "decision": "decision_no", "base": "base"}
    return [
        _event(name, str(getattr(head, field)))
        for name, field in named.items()
        if sent is None or getattr(sent, field) != getattr(head, field)
    ]


def _event(name: str, data: str) -> str:
    return f"event: {name}\ndata: {' '.join(data.split())}\n\n"
