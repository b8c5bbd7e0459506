"""Tells open pages about new changesets: one poller for all of them, and only while somebody listens."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import suppress

from starlette.concurrency import run_in_threadpool

from conetl.errors import DatabaseError
from conetl.io.stores.reader_pool import ReaderPool
from conetl.io.stores.serve_store import read_heads

POLL_S = 0.4
PING_S = 15.0
MAX_STREAMS = 64
TOO_MANY = f"{MAX_STREAMS} pages listen already: close some, or reload by hand."


class HeadWatcher:
    """Asks the database for the newest changesets, several times a second, and hands them to every open stream."""

    def __init__(self, pool: ReaderPool, *, closing: Callable[[], bool]) -> None:
        self._pool, self._closing = pool, closing
        self._heads: dict[str, int] = {}
        self._problem: str | None = None
        self._streams = 0
        self._round = asyncio.Condition()
        self._poller: asyncio.Task[None] | None = None

    def full(self) -> bool:
        """True where no further stream may be opened."""
        return self._streams >= MAX_STREAMS

    async def events(self, map_name: str) -> AsyncIterator[str]:
        """Server-sent events: `changeset` with the number of the map's newest one (0: none), at once and after every commit;
        `trouble` with what is wrong, while the database cannot be asked."""
        if self.full():  # many came at the same moment
            yield _event("trouble", TOO_MANY)
            return
        self._streams += 1
        sent: tuple[int | None, str | None] | None = None
        idle_s = 0.0
        try:
            if self._poller is None or self._poller.done():
                self._poller = asyncio.create_task(self._poll())
            while not self._closing():
                async with self._round:
                    await self._round.wait()
                now = (self._heads.get(map_name, 0), self._problem)
                idle_s += POLL_S
                if now != sent:
                    yield _event("trouble", now[1]) if now[1] else _event("changeset", str(now[0]))
                    sent, idle_s = now, 0.0
                elif idle_s >= PING_S:
                    yield ": still here\n\n"
                    idle_s = 0.0
        finally:
            self._streams -= 1
            if self._streams == 0 and self._poller is not None:
                self._poller.cancel()
                self._poller = None

    async def _poll(self) -> None:
        with suppress(asyncio.CancelledError):
            while True:
                try:
                    self._heads, self._problem = await run_in_threadpool(self._read), None
                except DatabaseError as error:
                    self._problem = str(error)
                async with self._round:
                    self._round.notify_all()
                await asyncio.sleep(POLL_S)

    def _read(self) -> dict[str, int]:
        with self._pool.reading() as conn:
            return read_heads(conn)


def _event(name: str, data: str) -> str:
    return f"event: {name}\ndata: {' '.join(data.split())}\n\n"
