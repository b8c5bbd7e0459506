"""What `conetl backfill` advises at its end."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import pytest

from conetl.cli.backfill import _print_summary
from conetl.model.errors import ConetlError, MapMismatchError, ServiceError
from conetl.pipeline.ingest import failed, new_receipt
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import read_header
from flows.backfill import Standing

REFUSED = MapMismatchError("this is the recording of drive a again")
UNAVAILABLE = ServiceError("the database cannot be reached")


@pytest.mark.parametrize(
    ("errors", "retry", "correct"),
    [([UNAVAILABLE], True, False), ([REFUSED], False, True), ([REFUSED, UNAVAILABLE], True, True)],
)
def test_a_retry_is_advised_only_where_it_can_help(
    errors: list[ConetlError], retry: bool, correct: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begun = new_receipt(read_header(tmp_path), Settings(), "0" * 64, uuid4(), None)
    plan: Any = SimpleNamespace(map_name="default")
    _print_summary(Standing(plan, 1, "here", 0.0, [], [failed(begun, error) for error in errors]))
    said = capsys.readouterr().out
    assert ("to retry" in said, "fail again" in said) == (retry, correct)
