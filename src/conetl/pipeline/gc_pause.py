"""Memory while millions of records are made."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def no_cycle_search() -> Iterator[None]:
    """Do not look for reference cycles while many records are made. Records have none, and with millions of them alive the search
    for some takes a quarter of the whole time. What is no longer needed is freed as always, by its reference count. What is left
    afterwards counts as old, as if it had been searched: the first search after the block would go through all of it."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.freeze()
            gc.unfreeze()  # into the oldest generation
            gc.enable()
