"""Rows of a query as COPY sends them, read by a thread ahead of what is made of them.

The server works on the next rows while the last ones are turned into a file, and a row costs one call instead of a Python object
a value. COPY sends one message a row (PostgreSQL's documentation, *Message Formats*, CopyData).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Semaphore, Thread
from typing import Protocol

from conetl.model.errors import DatabaseError

#: Of the binary format: signature, flags, length of what else the header has; and the length that ends it.
_SIGNATURE = b"PGCOPY\n\xff\r\n\0"
_HEADER_BYTES = len(_SIGNATURE) + 8
_END = b"\xff\xff"
#: Batches that wait at most.
_AHEAD = 2


class Sink(Protocol):
    """What COPY writes to."""

    def write(self, data: bytes, /) -> object:
        """Take one message."""


class _Ahead:
    """Rows in batches, handed from the thread that reads them to the one that uses them."""

    def __init__(self, batch: int) -> None:
        self.batches: SimpleQueue[list[bytes] | BaseException | None] = SimpleQueue()
        self.room = Semaphore(_AHEAD)
        self.unwanted = False
        self.ended = False
        self._batch = batch
        self._rows: list[bytes] = []
        self._begun = False

    def write(self, data: bytes, /) -> None:
        """One message of COPY: a row; the header comes with the first one, the end in one of its own."""
        if not self._begun:
            if not data.startswith(_SIGNATURE):
                raise DatabaseError("the database did not answer COPY in the binary format")
            data, self._begun = data[_HEADER_BYTES + int.from_bytes(data[_HEADER_BYTES - 4 : _HEADER_BYTES]) :], True
        if data in (b"", _END) or self.unwanted:
            return
        self._rows.append(data)
        if len(self._rows) == self._batch:
            self.hand_over()

    def hand_over(self) -> None:
        if self._rows:
            self.room.acquire()
            self.batches.put(self._rows)
            self._rows = []


@contextmanager
def read_ahead(
    copy: Callable[[Sink], None], cancel: Callable[[], None], *, batch: int
) -> Iterator[Iterator[list[bytes]]]:
    """All rows that `copy` writes to its sink, `batch` in a list and a few lists at a time in memory.

    copy runs in a thread, and what it raises is raised here. Where the block ends before the rows do, cancel is called to
    end copy. After the block the thread has ended.
    """
    ahead = _Ahead(batch)

    def work() -> None:
        try:
            copy(ahead)
            ahead.hand_over()
            ahead.batches.put(None)
        except BaseException as error:  # handed over, not lost
            ahead.batches.put(error)

    def rows() -> Iterator[list[bytes]]:
        while isinstance(item := ahead.batches.get(), list):
            ahead.room.release()
            yield item
        ahead.ended = True
        if item is not None:
            raise item

    thread = Thread(target=work, name="read-ahead", daemon=True)
    thread.start()
    try:
        yield rows()
    finally:
        if not ahead.ended:  # else a cancellation would hit what the connection is asked next
            ahead.unwanted = True
            ahead.room.release()
            cancel()
        thread.join()
