"""The command line over the database of a test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.model.errors import ConetlError


@pytest.fixture
def conetl(database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """The command line in this process: what a command prints, or (code) the words of the error that it ends with."""

    def run(*arguments: object, code: int = 0) -> str:
        with monkeypatch.context() as patch:
            patch.setenv("CONETL_DATABASE_URL", database_url)
            patch.setenv("CONETL_HOME", str(tmp_path / "home"))
            done = CliRunner().invoke(app, list(map(str, arguments)))
        if code:
            assert isinstance(done.exception, ConetlError), done.output
            assert done.exception.exit_code == code
            return str(done.exception)
        assert done.exception is None, done.exception
        return done.output

    return run
