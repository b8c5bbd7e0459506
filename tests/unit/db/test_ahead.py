"""Items that a thread produces ahead: all of them in order, not too many, and no thread left behind."""

from __future__ import annotations

import threading
import time

import pytest

from conetl.db.map.commit import made_ahead


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
        while len(made) < 3 and time.monotonic() < deadline:
            time.sleep(0.001)
        assert made == [0, 1, 2]
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
