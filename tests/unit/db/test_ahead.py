"""Items and rows that a thread produces ahead: all of them in order, not too many, and no thread left behind."""

from __future__ import annotations

import threading
import time

import pytest

from conetl.db.ahead import made_ahead, read_ahead
from conetl.model.errors import DatabaseError

HEADER = b"PGCOPY\n\xff\r\n\0" + bytes(8)
ROWS = [bytes([0, 1, k]) for k in range(23)]


@pytest.mark.parametrize("count", [0, 1, 3, 50])
@pytest.mark.parametrize("ahead", [1, 3, 100])
def test_every_item_comes_once_and_in_order(count, ahead):
    with made_ahead(iter(range(count)), ahead=ahead) as items:
        assert list(items) == list(range(count))


def test_items_are_made_before_they_are_asked_for_but_only_a_few():
    made = []

    def source():
        for k in range(100):
            made.append(k)
            yield k

    with made_ahead(source(), ahead=3) as items:
        deadline = time.monotonic() + 10
        while len(made) < 4 and time.monotonic() < deadline:
            time.sleep(0.001)
        assert made == [0, 1, 2, 3]  # three wait, and one more waits for room
        assert list(items) == list(range(100))


@pytest.mark.parametrize("taken", [0, 1, 5])
def test_who_leaves_early_leaves_no_thread(taken):
    before = threading.active_count()
    made = []
    with pytest.raises(KeyboardInterrupt), made_ahead((made.append(k) or k for k in range(10_000)), ahead=2) as items:
        for k in range(taken):
            assert next(items) == k
        raise KeyboardInterrupt
    assert threading.active_count() == before
    assert len(made) <= taken + 4


def test_what_the_source_raises_is_raised_where_its_item_would_have_come():
    def source():
        yield 1
        raise ValueError("no second one")

    with made_ahead(source(), ahead=4) as items:
        assert next(items) == 1
        with pytest.raises(ValueError, match="no second one"):
            next(items)


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
def test_leaving_rows_early_leaves_no_thread(taken):
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
