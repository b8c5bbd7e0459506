"""Fixtures of the integration tests: the command line in this process, and maps in databases of their own."""

from __future__ import annotations

import fcntl
import os
import subprocess
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from prefect.context import refresh_global_settings_context
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.db.connection import Connection
from conetl.files.home import make_home
from conetl.model.errors import ConetlError
from conetl.model.map_records import MapFeature
from conetl.pipeline.settings import prefect_environment, prefect_login, prefect_server_environment
from conetl.services import processes
from flows.server import SERVICES_OFF
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


@pytest.fixture(scope="session")
def prefect(pytestconfig: pytest.Config) -> dict[str, str]:
    """What leads a command to the one Prefect server of this test run, which ends with it. A start costs about 10 s."""
    home = run_home(pytestconfig)
    make_home(home)
    with (home / "prefect" / "start.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        server = processes.read_services(home).get("prefect")
        if server is None:
            port = command.free_port()
            address = f"http://127.0.0.1:{port}"
            ours = prefect_server_environment(home, address) | SERVICES_OFF | QUIET
            server = processes.start_service(
                "prefect", processes.server_command("127.0.0.1", port), home=home, address=address,
                environment=command.environment_of(PREFECT_HOME=home / "prefect", **ours),
            )  # fmt: skip
            processes.wait_healthy(server, lambda: processes.is_healthy(f"{address}/api"), 300)
            processes.write_services(home, {"prefect": server})
    return {"PREFECT_API_URL": f"{server.address}/api", "PREFECT_API_AUTH_STRING": prefect_login(home)}


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
