"""Items that a thread produces a few ahead of their use, so that neither Python nor the database waits for the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Semaphore, Thread
from typing import Generic, Protocol, TypeVar

from conetl.model.errors import DatabaseError

#: Of COPY's binary format: signature, flags, length of further header fields; and the length that ends it.
_SIGNATURE = b"PGCOPY\n\xff\r\n\0"
_HEADER_BYTES = len(_SIGNATURE) + 8
_END = b"\xff\xff"
#: Batches of rows that wait at most.
_BATCHES_AHEAD = 2

T = TypeVar("T")


class Sink(Protocol):
    """What COPY writes to."""

    def write(self, data: bytes, /) -> object:
        """Receive one message."""


class _Handover(Generic[T]):
    """Items in order, then the end (None) or the error that ended them; at most `ahead` wait."""

    def __init__(self, ahead: int) -> None:
        self.ended = False
        self._items: SimpleQueue[tuple[T] | BaseException | None] = SimpleQueue()
        self._free = Semaphore(ahead)
        self._abandoned = False

    def run(self, produce: Callable[[_Handover[T]], None]) -> None:
        """The thread's work."""
        try:
            produce(self)
            self._items.put(None)
        except BaseException as error:  # handed over, not lost
            self._items.put(error)

    def put(self, item: T) -> bool:
        """Wait until there is space for an item; False if nobody needs it any more."""
        self._free.acquire()
        if self._abandoned:
            self._free.release()
            return False
        self._items.put((item,))
        return True

    def take(self) -> Iterator[T]:
        """The items in order; raises what `produce` raised."""
        while isinstance(item := self._items.get(), tuple):
            self._free.release()
            yield item[0]
        self.ended = True
        if item is not None:
            raise item

    def abandon(self) -> None:
        self._abandoned = True
        self._free.release()


@contextmanager
def _in_thread(
    produce: Callable[[_Handover[T]], None], ahead: int, cancel: Callable[[], None] | None = None
) -> Iterator[Iterator[T]]:
    handover: _Handover[T] = _Handover(ahead)
    thread = Thread(target=handover.run, args=(produce,), name="ahead", daemon=True)
    thread.start()
    try:
        yield handover.take()
    finally:
        if not handover.ended:
            handover.abandon()
            if cancel is not None:  # only now: after the end it would cancel the connection's next statement
                cancel()
        thread.join()


@contextmanager
def made_ahead(source: Iterable[T], *, ahead: int) -> Iterator[Iterator[T]]:
    """The items of `source` in order, made by a thread that starts at once; at most `ahead` of them wait in memory.

    An error of the source is raised in place of its item. After the block the thread has ended, even if not all items were used.
    The source must not touch what the caller uses meanwhile.
    """

    def produce(handover: _Handover[T]) -> None:
        for item in source:
            if not handover.put(item):
                return

    with _in_thread(produce, ahead) as items:
        yield items


@contextmanager
def read_ahead(
    copy: Callable[[Sink], None], cancel: Callable[[], None], *, batch: int
) -> Iterator[Iterator[list[bytes]]]:
    """All rows that `copy` writes to its sink, one COPY message each, `batch` in a list and a few lists at a time in memory.

    copy runs in a thread, and its errors are raised here. If the block ends before the rows do, cancel is called to end copy.
    After the block the thread has ended. A row costs one call instead of a Python object per value.
    """

    def produce(handover: _Handover[list[bytes]]) -> None:
        rows = _Rows(handover, batch)
        copy(rows)
        rows.hand_over()

    with _in_thread(produce, _BATCHES_AHEAD, cancel) as batches:
        yield batches


class _Rows:
    """The sink of COPY, which sends the header with the first row and the end in a message of its own."""

    def __init__(self, handover: _Handover[list[bytes]], batch: int) -> None:
        self._handover, self._batch = handover, batch
        self._rows: list[bytes] = []
        self._started = False

    def write(self, data: bytes, /) -> None:
        if not self._started:
            if not data.startswith(_SIGNATURE):
                raise DatabaseError("the database did not answer COPY in the binary format")
            extension_bytes = int.from_bytes(data[_HEADER_BYTES - 4 : _HEADER_BYTES])
            data, self._started = data[_HEADER_BYTES + extension_bytes :], True
        if data not in (b"", _END):
            self._rows.append(data)
            if len(self._rows) == self._batch:
                self.hand_over()

    def hand_over(self) -> None:
        if self._rows:
            self._handover.put(self._rows)
            self._rows = []
