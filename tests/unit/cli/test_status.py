"""`conetl status` where nothing was started."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from conetl.cli.app import app


def test_an_empty_home_is_told_and_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CONETL_HOME", str(tmp_path))
    monkeypatch.delenv("CONETL_DATABASE_URL", raising=False)
    done = CliRunner().invoke(app, ["status"])
    assert done.exit_code == 3
    assert "Nothing of `conetl up` runs for this home" in done.output
    assert str(tmp_path) in done.output.replace("\n", "")
