"""`conetl status` where nothing was started, and where nothing can be."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.model.errors import InputError


def test_an_empty_home_is_told_and_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CONETL_HOME", str(tmp_path))
    monkeypatch.delenv("CONETL_DATABASE_URL", raising=False)
    done = CliRunner().invoke(app, ["status"])
    assert done.exit_code == 3
    assert "Nothing of `conetl up` runs for this home" in done.output
    assert str(tmp_path) in done.output.replace("\n", "")


@pytest.mark.parametrize("command", ["status", "up"])
def test_a_home_that_is_a_file_is_told(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "file"
    home.touch()
    monkeypatch.setenv("CONETL_HOME", str(home))
    monkeypatch.delenv("CONETL_DATABASE_URL", raising=False)
    done = CliRunner().invoke(app, [command])
    assert isinstance(done.exception, InputError)
    assert str(home) in str(done.exception)
    assert "CONETL_HOME" in str(done.exception)
