"""The search for reference cycles is paused while millions of records are made."""

from __future__ import annotations

import gc

from conetl.pipeline.replay import gc_paused


def test_what_was_made_meanwhile_is_not_searched_right_afterwards():
    assert gc.isenabled()
    with gc_paused():
        assert not gc.isenabled()
        made = [[number] for number in range(10_000)]
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    old = {id(thing) for thing in gc.get_objects(generation=2)}
    assert all(id(thing) in old for thing in made)
