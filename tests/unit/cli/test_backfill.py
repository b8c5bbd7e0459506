"""What `conetl backfill` advises at its end."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import pytest

from conetl.cli.backfill import _exit_code, _print_plan, _print_summary
from conetl.model.errors import ConetlError, MapMismatchError, ServiceError
from conetl.pipeline.backfill_plan import Plan, PlanLine
from conetl.pipeline.chunks import Analysis
from conetl.pipeline.ingest import failed_receipt, new_receipt
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import DriveHeader, read_header
from flows.backfill import Standing

REFUSED = MapMismatchError("this is the recording of drive a again")
UNAVAILABLE = ServiceError("the database cannot be reached")


@pytest.mark.parametrize(
    ("errors", "retry", "correct", "code"),
    [([UNAVAILABLE], True, False, 3), ([REFUSED], False, True, 2), ([REFUSED, UNAVAILABLE], True, True, 2)],
)
def test_a_retry_is_advised_only_where_it_can_help(
    errors: list[ConetlError], retry: bool, correct: bool, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begun = new_receipt(read_header(tmp_path), Settings(), "0" * 64, uuid4(), None)
    plan: Any = SimpleNamespace(map_name="default")
    stored = [replace(begun, state=state) for state in ("committed", "held", "known")]
    standing = Standing(plan, 1, "here", 0.0, [], [*stored, *(failed_receipt(begun, error) for error in errors)])
    assert (len(standing.failed), standing.done) == (len(errors), len(stored))
    _print_summary(standing)
    said = capsys.readouterr().out
    assert _exit_code(standing) == code
    assert ("to retry" in said, "fail again" in said) == (retry, correct)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_the_plan_notes_what_the_user_has_to_know_of_drives_to_ingest(
    count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [
        PlanLine(DriveHeader(tmp_path, f"d{k}", f"{k}", 10, 0, 1, None, remarks=(f"heights of d{k}",)), action, "")
        for k, action in enumerate(["skip", *["ingest"] * count])
    ]
    now = datetime.now(UTC)
    _print_plan(Plan(tmp_path, "m", None, None, Analysis("p", "m", "d", "e"), tuple(lines), None, now, 0.1), 1)
    notes = ["", "conetl: note: heights of d1\n", "", "conetl: note: heights of d1 (2 more notes like this)\n"]
    assert capsys.readouterr().err == notes[count]
