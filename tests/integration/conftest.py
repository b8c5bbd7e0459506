"""Fixtures of the integration tests: the command line in this process, and maps in databases of their own."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from prefect.context import refresh_global_settings_context
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.db.connection import Connection
from conetl.model.errors import ConetlError
from conetl.model.map_records import MapFeature
from conetl.pipeline.settings import prefect_environment, prefect_login
from tests import command
from tests.conftest import run_home
from tests.integration.drives_of_days import failed_audits
from tests.view_map import two_drives, view_of

#: Prefect tells nobody that it runs.
QUIET = {"PREFECT_SERVER_ANALYTICS_ENABLED": "false", "DO_NOT_TRACK": "1"}


def outcome(arguments: Iterable[object], environment: dict[str, str]) -> tuple[int, str, str]:
    """Exit code of a command in this process, what it prints, and the words of the error that it ends with, if any.

    Raises what is an internal error.
    """
    ours = dict(os.environ)
    try:
        done = CliRunner().invoke(app, list(map(str, arguments)), env=environment)
    finally:  # commands set variables for Prefect
        os.environ.clear()
        os.environ.update(ours)
    if isinstance(done.exception, ConetlError):
        return done.exception.exit_code, done.stdout, str(done.exception)
    if isinstance(done.exception, Exception):
        raise done.exception
    return done.exit_code, done.stdout if done.exit_code == 0 else done.output, ""


def command_line(home: Path, database_url: str, map_name: str = "default") -> Callable[..., str]:
    """`conetl(*arguments, code=0)`: what the command prints, or the words of the error that it ends with."""
    environment = {"CONETL_HOME": str(home), "CONETL_DATABASE_URL": database_url, "CONETL_MAP_NAME": map_name}

    def run(*arguments: object, code: int = 0) -> str:
        found, output, message = outcome(arguments, environment)
        assert found == code, message or output
        return message or output

    return run


def conetl_process(
    home: Path, database_url: str, *arguments: object, before: str = "", folder: Path = command.ROOT, **environment: str
) -> subprocess.CompletedProcess[str]:
    """A command of conetl in a process of its own, with `--json`. before: Python that runs first."""
    where = {"CONETL_HOME": home, "CONETL_DATABASE_URL": database_url, **environment}
    return command.conetl(*arguments, "--json", before=before, cwd=folder, **where)


_SERVER = """
import sys, time
from pathlib import Path
from flows.server import prefect_server
home, main_process = map(Path, sys.argv[1:])
with prefect_server(home) as url:
    (home / "url.new").write_text(url)
    (home / "url.new").rename(home / "url")
    while main_process.exists():
        time.sleep(0.5)
"""


@pytest.fixture(scope="session")
def prefect(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> dict[str, str]:
    """What leads a command to the one Prefect server of this test run, which ends with it. A start costs about 10 s."""
    folder = tmp_path_factory.getbasetemp()
    home = (folder.parent if hasattr(pytestconfig, "workerinput") else folder) / "prefect-home"
    home.mkdir(exist_ok=True)
    main_process = Path("/proc", run_home(pytestconfig).name.rpartition("-")[2])
    with (home / "start.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (home / "url").exists():
            server = subprocess.Popen(
                [sys.executable, "-c", _SERVER, str(home), str(main_process)],
                env=command.environment_of(PREFECT_HOME=home / "prefect", **QUIET), cwd=command.ROOT,
                start_new_session=True,
            )  # fmt: skip
            command.until((home / "url").exists, "the start of the Prefect server", 300, 0.2)
            assert server.poll() is None
    return {"PREFECT_API_URL": (home / "url").read_text(), "PREFECT_API_AUTH_STRING": prefect_login(home)}


@pytest.fixture(scope="module")
def prefect_here(tmp_path_factory: pytest.TempPathFactory, prefect: dict[str, str]) -> Iterator[Path]:
    """A home folder, while this process and its children use that Prefect server."""
    folder = tmp_path_factory.mktemp("prefect-here")
    (folder / "prefect").mkdir()
    with pytest.MonkeyPatch.context() as environment:
        for name, value in (prefect_environment(folder) | prefect).items():
            environment.setenv(name, value)
        refresh_global_settings_context()
        yield folder
    refresh_global_settings_context()


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the images of `features`."""
    return tmp_path_factory.mktemp("images")


@pytest.fixture(scope="module")
def features(module_conn: Connection, samples: Any, images: Path) -> dict[str, MapFeature]:
    """Those of the map of two drives in the file's own database."""
    return two_drives(module_conn, samples, images)


@pytest.fixture(scope="module")
def client(module_database_url: str, features: dict[str, MapFeature]) -> Iterator[TestClient]:
    """The web view on that map."""
    with view_of(module_database_url) as test_client:
        yield test_client


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
