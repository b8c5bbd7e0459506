"""The stream of new changesets, decisions and base layers: twice per second the heads of all maps are read for all open pages."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable

from fastapi import APIRouter, HTTPException, Request
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool

from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import Head, read_heads
from conetl.model.errors import DatabaseError
from conetl.web.parameters import MapName

#: Period at which streams look for something new, and whether the server stops. LISTEN would need a connection of its own, and a
#: pooler may drop notifications.
ROUND_S = 0.5
PING_S = 15.0
MAX_STREAMS = 64
_TOO_MANY = f"{MAX_STREAMS} pages are open already: close some, or reload by hand."
router = APIRouter(tags=["events"])


@router.get("/maps/{map_name}/events", response_class=StreamingResponse)
async def events(map_name: MapName, request: Request) -> StreamingResponse:
    """Server-sent events, at once and after every commit: `changeset` and `decision` with their number, `base`, `trouble`."""
    watcher: HeadWatcher = request.app.state.watcher
    if watcher.full():
        # Closed, since idle connections count towards the server's limit and would keep others out for seconds.
        raise HTTPException(503, _TOO_MANY, headers={"Retry-After": "30", "Connection": "close"})
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(watcher.events(map_name), media_type="text/event-stream", headers=headers)


class HeadWatcher:
    """Sends the newest state of every map to every open stream."""

    def __init__(self, pool: ReaderPool, *, closing: Callable[[], bool]) -> None:
        self._pool, self._closing = pool, closing
        self._heads: dict[str, Head] = {}
        self._problem: str | None = None
        self._streams = 0
        self._reading = asyncio.Lock()
        self._read_at_s = -ROUND_S

    def full(self) -> bool:
        """True if no further stream may be opened."""
        return self._streams >= MAX_STREAMS

    async def events(self, map_name: str) -> AsyncIterator[str]:
        """Server-sent events, at once and after every commit that changes them: `changeset` and `decision` with the number of the
        map's newest one (0: none), `base` with a text that changes with the base layers; `trouble` with a message while the
        database is unavailable."""
        if self.full():  # many were opened at the same moment
            yield _event("trouble", _TOO_MANY)
            return
        self._streams += 1
        sent: Head | None = None
        sent_problem: str | None = None
        idle_s = 0.0
        try:
            while not self._closing():
                await self._refresh()
                head, problem = self._heads.get(map_name, Head()), self._problem
                if problem and problem != sent_problem:
                    yield _event("trouble", problem)
                    sent, idle_s = None, 0.0  # everything is sent again afterwards
                elif not problem and head != sent:
                    news = [(name, new) for name, new in head._asdict().items() if new != getattr(sent, name, None)]
                    yield "".join(_event(name.removesuffix("_no"), str(new)) for name, new in news)
                    sent, idle_s = head, 0.0
                elif idle_s >= PING_S:
                    yield ": still here\n\n"
                    idle_s = 0.0
                sent_problem = problem
                await asyncio.sleep(ROUND_S)
                idle_s += ROUND_S
        finally:
            self._streams -= 1

    async def _refresh(self) -> None:
        """Read the heads if that is a round ago."""
        async with self._reading:
            if time.monotonic() < self._read_at_s + ROUND_S:
                return
            try:
                self._heads, self._problem = await run_in_threadpool(self._read), None
            except DatabaseError as error:
                self._problem = str(error)
            self._read_at_s = time.monotonic()

    def _read(self) -> dict[str, Head]:
        with self._pool.reading() as conn:
            return read_heads(conn)


def _event(name: str, data: str) -> str:
    return f"event: {name}\ndata: {' '.join(data.split())}\n\n"
