"""How far a drive is: one count for whoever listens in this process (a bar on the terminal, an artifact in Prefect)."""

from __future__ import annotations

import threading
from collections.abc import Callable

Listener = Callable[[str, int, int], None]

_lock = threading.Lock()
_listeners: list[Listener] = []
_done: dict[str, int] = {}
_total: dict[str, int] = {}


def listen(listener: Listener) -> None:
    """Call `listener(drive_id, done, total)` after every image from now on. Called from several threads, one at a time."""
    with _lock:
        _listeners.append(listener)


def ignore(listener: Listener) -> None:
    """Stop calling `listener`."""
    with _lock:
        _listeners.remove(listener)


def expect(drive_id: str, total: int) -> None:
    """Start counting a drive of `total` images."""
    with _lock:
        _done[drive_id], _total[drive_id] = 0, total
    tell_progress(drive_id, 0)


def tell_progress(drive_id: str, images: int) -> None:
    """`images` more are done."""
    with _lock:
        if drive_id not in _total:  # a task that runs in a process of its own has nobody to tell
            return
        _done[drive_id] += images
        for listener in _listeners:
            listener(drive_id, _done[drive_id], _total[drive_id])
