"""What one thread makes while another waits for the database: a few items ahead, so that neither waits for the other.

`read_ahead.py` is the other way round: rows of a query, read ahead of what is made of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Semaphore, Thread
from typing import Generic, TypeVar

T = TypeVar("T")


class _Ahead(Generic[T]):
    """Items in order, an end (None) or the error that ended them; at most so many wait."""

    def __init__(self, ahead: int) -> None:
        self.items: SimpleQueue[tuple[T] | BaseException | None] = SimpleQueue()
        self.room = Semaphore(ahead)
        self.unwanted = False

    def make(self, source: Iterable[T]) -> None:
        """What the thread does."""
        try:
            for item in source:
                self.room.acquire()
                if self.unwanted:
                    return
                self.items.put((item,))
            self.items.put(None)
        except BaseException as error:  # handed over, not lost
            self.items.put(error)

    def take(self) -> Iterator[T]:
        """What the caller gets; raises what the source raised."""
        while isinstance(item := self.items.get(), tuple):
            self.room.release()
            yield item[0]
        if item is not None:
            raise item


@contextmanager
def made_ahead(source: Iterable[T], *, ahead: int) -> Iterator[Iterator[T]]:
    """The items of `source` in their order, made by a thread that begins at once; at most `ahead` of them wait in memory.

    What source raises is raised where its item would have come. After the block the thread has ended, also where not all items
    were taken. The source must not touch what the caller uses meanwhile.
    """
    made: _Ahead[T] = _Ahead(ahead)
    thread = Thread(target=made.make, args=(source,), name="made-ahead", daemon=True)
    thread.start()
    try:
        yield made.take()
    finally:
        made.unwanted = True
        made.room.release()
        thread.join()
