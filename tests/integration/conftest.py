"""Fixtures of the integration tests: the command line in this process, and maps in databases of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.db.connection import Connection
from conetl.model.errors import ConetlError
from conetl.pipeline.settings import prefect_login
from tests import command
from tests.integration.drives_of_days import failed_audits
from tests.view_map import view_of

#: Prefect tells nobody that it runs.
QUIET = {"PREFECT_SERVER_ANALYTICS_ENABLED": "false", "DO_NOT_TRACK": "1"}


def command_line(home: Path, database_url: str, map_name: str = "default") -> Callable[..., str]:
    """`conetl(*arguments, code=0)`: what the command prints, or the words of the error that it ends with."""
    environment = {"CONETL_HOME": str(home), "CONETL_DATABASE_URL": database_url, "CONETL_MAP_NAME": map_name}

    def run(*arguments: object, code: int = 0) -> str:
        ours = dict(os.environ)
        try:
            done = CliRunner().invoke(app, list(map(str, arguments)), env=environment)
        finally:  # commands set variables for Prefect
            os.environ.clear()
            os.environ.update(ours)
        if isinstance(done.exception, ConetlError):
            assert done.exception.exit_code == code, done.exception
            return str(done.exception)
        assert done.exit_code == code, done.output
        return done.stdout

    return run


def conetl_process(
    home: Path, database_url: str, *arguments: object, before: str = "", folder: Path = command.ROOT, **environment: str
) -> subprocess.CompletedProcess[str]:
    """A command of conetl in a process of its own, with `--json`. before: Python that runs first."""
    where = {"CONETL_HOME": home, "CONETL_DATABASE_URL": database_url, **environment}
    return command.conetl(*arguments, "--json", before=before, cwd=folder, **where)


@pytest.fixture(scope="session")
def prefect(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """One Prefect server for the tests of all files that need any: what leads a command to it. A start costs about 10 s."""
    home = tmp_path_factory.mktemp("prefect-home")
    script = (
        "import sys; from pathlib import Path; from flows.server import prefect_server\n"
        "with prefect_server(Path(sys.argv[1])) as url:\n    print(url, flush=True); sys.stdin.read()"
    )
    environment = command.environment_of(PREFECT_HOME=home / "prefect", **QUIET)
    with subprocess.Popen(
        [sys.executable, "-c", script, str(home)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as server:
        assert server.stdin is not None and server.stdout is not None
        url = server.stdout.readline().strip()
        assert url.startswith("http://127.0.0.1:"), "the Prefect server did not start"
        yield {"PREFECT_API_URL": url, "PREFECT_API_AUTH_STRING": prefect_login(home)}
        server.stdin.close()


@pytest.fixture
def conetl(database_url: str, tmp_path: Path) -> Callable[..., str]:
    """The command line on the test's own database."""
    return command_line(tmp_path / "home", database_url)


@pytest.fixture
def own_view(database_url: str) -> Iterator[TestClient]:
    """The web view on the test's own database."""
    with view_of(database_url) as client:
        yield client


@pytest.fixture
def audited(conn: Connection) -> Iterator[None]:
    """The map passes its audits after the test."""
    yield
    assert failed_audits(conn) == []
