"""Audits: one query per file of `sql/audit/`, each returns the rows that offend; no rows, no fault."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from typing import Any

from conetl.db.connection import Connection, execute, load_sql, sql_names, transaction

SHOWN_ROWS = 100


@dataclass(frozen=True)
class AuditResult:
    """What one audit found."""

    name: str
    purpose: str
    """One sentence, from the head of its file."""
    row_count: int
    rows: tuple[dict[str, Any], ...]
    """The first 100 offending rows; every one has a column `problem`."""
    seconds: float = 0.0
    """How long it took."""

    @property
    def passed(self) -> bool:
        return self.row_count == 0


def run_audits(conn: Connection) -> list[AuditResult]:
    """Run all audits over all maps of the database, on one snapshot; changes nothing."""
    with transaction(conn, "The audits could not be run"):
        execute(conn, "set transaction isolation level repeatable read, read only")
        return audits_of_open_transaction(conn)


def audits_of_open_transaction(conn: Connection) -> list[AuditResult]:
    """Run all audits on what the caller's open transaction sees, its own uncommitted changes included."""
    return [_run(conn, name) for name in sql_names("audit")]


def _run(conn: Connection, name: str) -> AuditResult:
    text = load_sql(name)
    purpose = re.match(r"-- Purpose: ((?:.*\n)(?:-- (?!Columns).*\n)*)", text)
    sentence = re.sub(r"\s*\n(-- )?", " ", purpose[1]).strip() if purpose else name
    start = time.monotonic()
    rows = execute(conn, text)
    seconds = time.monotonic() - start
    return AuditResult(name.removeprefix("audit/"), sentence, len(rows), tuple(rows[:SHOWN_ROWS]), seconds)
