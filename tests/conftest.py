"""Fixtures that every test may use: a private PostGIS cluster, and small made-up drives and maps."""

from __future__ import annotations

import fcntl
import itertools
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hypothesis import settings

from tests import records

# A busy machine is no defect of the code: tests do not assert times.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

HOMES = Path("/tmp")
TEMPLATE = "conetl_template"
#: Files that take the most time, those that wait for servers and those that compute in turn.
LONGEST = (
    "integration/test_operations.py", "integration/test_ingest.py", "integration/test_without_services.py",
    "mutants/test_recordings.py", "integration/test_drop_folder.py", "integration/test_cluster.py",
    "unit/readers/test_video_drives.py", "integration/test_scale_out.py", "browser/test_ten_tasks.py",
    "integration/test_adjoining_drives.py", "mutants/test_cameras.py",
)  # fmt: skip
_numbers = itertools.count()


def run_home(config: pytest.Config) -> Path:
    """One cluster per test run, shared by the workers of pytest-xdist, whose parent is the run's main process."""
    main_pid = os.getppid() if hasattr(config, "workerinput") else os.getpid()
    return HOMES / f"conetl-test-{os.geteuid()}-{main_pid}"


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        _remove_leftovers()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, so that no worker of pytest-xdist works on one when the others have nothing left to do."""
    rank = {f"tests/{name}": number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.nodeid.partition("::")[0], len(LONGEST)))


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        _remove(run_home(config))


def _remove(home: Path) -> None:
    from conetl.services.processes import read_services, stop_service
    from tests.clusters import remove_cluster

    if home.is_dir():
        for service in read_services(home).values():
            stop_service(service)
        remove_cluster(home)
        shutil.rmtree(home, ignore_errors=True)  # services that were just stopped may still remove their own files


def _remove_leftovers() -> None:
    """Services and clusters of test runs that were killed; their homes' names end with the run's process id."""
    for home in HOMES.glob(f"conetl-test-{os.geteuid()}-*"):
        if not Path(f"/proc/{home.name.rsplit('-', 1)[1]}").exists():
            _remove(home)


@pytest.fixture(scope="session")
def cluster_url(pytestconfig: pytest.Config) -> str:
    """A private cluster for this test run; fails with a clear message where PostGIS is not installed."""
    from conetl.db.cluster.cluster import SERVER_SETTINGS, cluster_up

    with (
        pytest.MonkeyPatch.context() as patch
    ):  # no test cuts the power; databases are made and dropped in half the time
        patch.setitem(SERVER_SETTINGS, "fsync", "off")
        return cluster_up(run_home(pytestconfig))


@pytest.fixture(scope="session")
def services_home(pytestconfig: pytest.Config) -> Path:
    """A home folder for services that outlive their command; the next test run ends what a killed one left there."""
    cluster_home = run_home(pytestconfig)
    prefix, main_pid = cluster_home.name.rsplit("-", 1)
    return cluster_home.with_name(f"{prefix}-services-{main_pid}")


@pytest.fixture(scope="session")
def sample_settings(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> Any:
    """Settings of all that analyse the sample drives: what one test has computed the others read, on whatever worker."""
    from conetl.pipeline.settings import Settings

    folder = tmp_path_factory.getbasetemp()
    home = (folder.parent if hasattr(pytestconfig, "workerinput") else folder) / "samples-home"
    home.mkdir(mode=0o700, exist_ok=True)
    return Settings(home=home, workers=2)


@pytest.fixture(scope="session")
def template_database(cluster_url: str, pytestconfig: pytest.Config) -> str:
    """A migrated database that each test clones."""
    from conetl.db.connection import connect, execute
    from conetl.db.schema import migrate

    with (run_home(pytestconfig) / "template.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        conn = connect(cluster_url)
        conn.autocommit = True
        if not execute(conn, "select 1 from pg_database where datname = %(name)s", {"name": TEMPLATE}):
            execute(conn, "create database conetl_unfinished")
            unfinished = connect(cluster_url.replace("@/conetl?", "@/conetl_unfinished?"))
            migrate(unfinished)
            unfinished.close()
            execute(conn, f"alter database conetl_unfinished rename to {TEMPLATE}")
        conn.close()
    return TEMPLATE


@contextmanager
def cloned_database(cluster_url: str, template: str) -> Iterator[str]:
    """libpq URL of a new database, dropped at the end."""
    from conetl.db.connection import connect, execute

    name = f"t_{os.getpid()}_{next(_numbers)}"
    conn = connect(cluster_url)
    conn.autocommit = True
    # A copy of the files; since PostgreSQL 15 each page is written to the log otherwise, which takes twice the time.
    strategy = "strategy file_copy" if conn.info.server_version >= 150_000 else ""
    execute(conn, f"create database {name} template {template} {strategy}")
    yield cluster_url.replace("@/conetl?", f"@/{name}?")
    execute(conn, f"drop database {name} with (force)")
    conn.close()


@contextmanager
def filled_template(cluster_url: str, template: str, fill: Callable[[Any], object]) -> Iterator[str]:
    """Name of a database that `fill` wrote a map into. Tests clone it, which takes a tenth of the time of making the map."""
    from conetl.db.connection import connect

    with cloned_database(cluster_url, template) as url:
        with closing(connect(url)) as conn:
            fill(conn)
            conn.commit()
            name = str(conn.info.dbname)
        yield name


@pytest.fixture(scope="session")
def another_database(cluster_url: str, template_database: str) -> Callable[[], AbstractContextManager[Any]]:
    """`with another_database() as conn`: an open connection to one more migrated, empty database."""
    from conetl.db.connection import connect

    @contextmanager
    def clone() -> Iterator[Any]:
        with cloned_database(cluster_url, template_database) as url, closing(connect(url)) as connection:
            yield connection

    return clone


@pytest.fixture
def database_url(cluster_url: str, template_database: str) -> Iterator[str]:
    """libpq URL of a migrated, empty database of this test's own."""
    with cloned_database(cluster_url, template_database) as url:
        yield url


@pytest.fixture(scope="module")
def module_database_url(cluster_url: str, template_database: str) -> Iterator[str]:
    """libpq URL of a migrated, empty database that the tests of one file share: they must leave it as they found it."""
    with cloned_database(cluster_url, template_database) as url:
        yield url


@pytest.fixture
def conn(database_url: str) -> Iterator[Any]:
    """Open connection to `database_url`."""
    from conetl.db.connection import connect

    with closing(connect(database_url)) as connection:
        yield connection


@pytest.fixture(scope="module")
def module_conn(module_database_url: str) -> Iterator[Any]:
    """Open connection to `module_database_url`."""
    from conetl.db.connection import connect

    with closing(connect(module_database_url)) as connection:
        yield connection


@pytest.fixture(scope="session")
def samples() -> ModuleType:
    """Makers of small valid records, and `commit(conn, *deltas, key=...)`: `tests/records.py`."""
    return records
