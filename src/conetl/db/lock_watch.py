"""Who holds the lock that a statement of this process waits for: reported after 5 s, then once a minute.

PostgreSQL says nothing to a session that waits. A thread looks at this process's connections, which costs the server nothing, and
asks it, in a session of its own, about one that has been busy for long.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

REPORT_AFTER_S = 5.0
REPORT_EVERY_S = 60.0
_log = logging.getLogger(__name__)


class LockWatch:
    """Watches connections of one process. blockers: asks the server who blocks a connection, one line for each."""

    def __init__(self, is_busy: Callable[[Any], bool], blockers: Callable[[Any], list[str]]) -> None:
        self._is_busy = is_busy
        self._blockers = blockers
        self._report_at: WeakKeyDictionary[Any, float] = WeakKeyDictionary()
        self._thread: threading.Thread | None = None
        self.holders: WeakKeyDictionary[Any, str] = WeakKeyDictionary()
        """Who was last seen to block a connection."""

    def add(self, conn: Any) -> None:
        """Watch a connection as long as it exists."""
        self._report_at[conn] = math.inf
        if self._thread is None or not self._thread.is_alive():  # a forked process has this object, but no thread
            self._thread = threading.Thread(target=self._watch, name="lock watch", daemon=True)
            self._thread.start()

    def _watch(self) -> None:
        while True:
            time.sleep(REPORT_AFTER_S / 5)
            for conn in list(self._report_at):
                self._look(conn, time.monotonic())
            conn = None

    def _look(self, conn: Any, now: float) -> None:
        due = self._report_at.get(conn, math.inf)
        if conn.closed or not self._is_busy(conn):
            self._report_at[conn] = math.inf
        elif due == math.inf:
            self._report_at[conn] = now + REPORT_AFTER_S
        elif now >= due:
            holders = self._blockers(conn)
            self._report_at[conn] = now + (REPORT_EVERY_S if holders else REPORT_AFTER_S)
            if holders:
                self.holders[conn] = "; ".join(holders)
                _log.warning("waiting for a lock in the database that is held by %s", self.holders[conn])
