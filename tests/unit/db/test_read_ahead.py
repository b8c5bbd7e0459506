"""Rows that a thread reads ahead: all of them in order, and no thread left behind."""

from __future__ import annotations

import threading

import pytest

from conetl.db.read_ahead import read_ahead
from conetl.model.errors import DatabaseError

HEADER = b"PGCOPY\n\xff\r\n\0" + bytes(8)
ROWS = [bytes([0, 1, k]) for k in range(23)]


def copier(rows, stopped):
    """What COPY does: the header with the first row, a message a row, and the end; ends early once cancelled."""

    def copy(sink):
        if not rows:
            sink.write(HEADER + b"\xff\xff")
            return
        sink.write(HEADER + rows[0])
        for row in rows[1:]:
            if stopped.is_set():
                raise DatabaseError("cancelled")
            sink.write(row)
        sink.write(b"\xff\xff")

    return copy


@pytest.mark.parametrize("count", [0, 1, 4, 5, 23])
@pytest.mark.parametrize("batch", [1, 4, 100])
def test_every_row_comes_once_and_in_order(count, batch):
    stopped = threading.Event()
    with read_ahead(copier(ROWS[:count], stopped), stopped.set, batch=batch) as chunks:
        found = list(chunks)
    assert [row for chunk in found for row in chunk] == ROWS[:count]
    assert all(len(chunk) == batch for chunk in found[:-1])
    assert not stopped.is_set()  # a cancellation after the end would hit what the connection is asked next


@pytest.mark.parametrize("taken", [0, 1, 3])
def test_who_leaves_early_leaves_no_thread(taken):
    stopped = threading.Event()
    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt), read_ahead(copier(ROWS * 100, stopped), stopped.set, batch=2) as chunks:
        for _ in range(taken):
            next(chunks)
        raise KeyboardInterrupt
    assert stopped.is_set()
    assert threading.active_count() == before


def test_what_the_reading_raises_is_raised_where_rows_are_used():
    stopped = threading.Event()
    stopped.set()
    with (
        pytest.raises(DatabaseError, match="cancelled"),
        read_ahead(copier(ROWS, stopped), stopped.set, batch=2) as chunks,
    ):
        list(chunks)
    with (
        pytest.raises(DatabaseError, match="binary"),
        read_ahead(lambda sink: sink.write(b"1,2"), stopped.set, batch=2) as chunks,
    ):
        list(chunks)
