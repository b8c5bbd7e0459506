"""HTTP connections that cannot block a server: each must send a request in time, and too many idle ones are closed."""

from __future__ import annotations

import asyncio
from typing import ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

#: Seconds for the lines and headers of a request.
REQUEST_TIMEOUT_S = 10.0
#: Connections without a request; where there are more the one that has been silent for longest is closed.
MAX_IDLE = 128


class BoundedProtocol(H11Protocol):
    """uvicorn's protocol with a deadline for requests and a limit on idle connections, for `uvicorn.Config(http=...)`.

    All callers on loopback share one address, so a limit for each address would let one user lock out the others; a client that
    sends its request at once is never the one that has been silent for longest.
    """

    _idle: ClassVar[dict[BoundedProtocol, asyncio.TimerHandle]] = {}

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._begin_idle()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._end_idle()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.cycle.response_complete and not self.transport.is_closing():  # else the next request is here already
            self._begin_idle()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._end_idle()  # the connection goes to another protocol
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        self._end_idle()
        super().connection_lost(exc)

    def _begin_idle(self) -> None:
        self._end_idle()
        self._idle[self] = self.loop.call_later(REQUEST_TIMEOUT_S, self._close_idle)
        while len(self._idle) > MAX_IDLE:
            next(iter(self._idle))._close_idle()

    def _end_idle(self) -> None:
        if (timer := self._idle.pop(self, None)) is not None:
            timer.cancel()

    def _close_idle(self) -> None:
        self._end_idle()
        self.transport.abort()
