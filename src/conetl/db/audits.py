"""Audits: one statement each in `sql/audits.sql`, which returns the rows that offend; no rows, no fault."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from conetl.db.connection import Connection, execute, transaction
from conetl.db.statements import load_sql, statements

SHOWN_ROWS = 100


@dataclass(frozen=True)
class AuditResult:
    """What one audit found."""

    name: str
    purpose: str
    """The comment of its statement."""
    row_count: int
    rows: tuple[dict[str, Any], ...]
    """The first 100 offending rows; every one has a column `problem`."""
    seconds: float = 0.0
    """Duration."""

    @property
    def passed(self) -> bool:
        return self.row_count == 0


def run_audits(conn: Connection) -> list[AuditResult]:
    """Run all audits over all maps of the database, on one snapshot; changes nothing."""
    with transaction(conn, "The audits could not be run"):
        execute(conn, load_sql("exports.snapshot"))
        return audits_of_open_transaction(conn)


def audits_of_open_transaction(conn: Connection) -> list[AuditResult]:
    """Run all audits inside the caller's open transaction, its own uncommitted changes included."""
    return [_run(conn, name, text) for name, text in statements("audits").items()]


def _run(conn: Connection, name: str, text: str) -> AuditResult:
    purpose = text.partition("\n-- Columns:")[0].removeprefix("-- ").replace("\n-- ", " ")
    start = time.monotonic()
    rows = execute(conn, text)
    seconds = time.monotonic() - start
    return AuditResult(name, purpose, len(rows), tuple(rows[:SHOWN_ROWS]), seconds)
