"""A home folder that several containers or machines see: one server on its data, never two."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.db.cluster.cluster import cluster_down, cluster_remove, cluster_status, cluster_up
from conetl.db.cluster.location import find_location
from conetl.db.connection import connect, execute
from conetl.model.errors import DatabaseError, ServiceError
from conetl.services.processes import Service, read_services, write_services

#: What a container is to a process id: a PID namespace with a /proc of its own, and shared memory of its own.
CONTAINER = ["unshare", "--pid", "--ipc", "--fork", "--mount-proc", "--kill-child"]
SERVER = (
    "import sys, pathlib; from conetl.db.cluster.cluster import cluster_up\n"
    "print(cluster_up(pathlib.Path(sys.argv[1])), flush=True); sys.stdin.read()"
)
ELSEWHERE = "another machine or container"


@pytest.fixture
def home() -> Iterator[Path]:
    path = Path(f"/tmp/conetl-test-shared-home-{os.getpid()}")
    path.mkdir()
    yield path
    cluster_remove(path)
    shutil.rmtree(path)


def has_containers() -> bool:
    if shutil.which("unshare") is None:
        return False
    return subprocess.run([*CONTAINER, "true"], capture_output=True, check=False).returncode == 0


@contextmanager
def server_in_a_container(home: Path) -> Iterator[str]:
    """The server's address; at the end the container is killed, and the server with it."""
    command = [*CONTAINER, sys.executable, "-c", SERVER, str(home)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as container:
        try:
            assert container.stdout is not None
            yield container.stdout.readline().strip()
        finally:
            container.kill()


def write_note(url: str) -> None:
    with closing(connect(url)) as conn:
        execute(conn, "create table if not exists note (text text)")
        execute(conn, "insert into note values ('kept')")
        conn.commit()


def count_notes(url: str) -> int:
    with closing(connect(url)) as conn:
        return int(execute(conn, "select count(*) as n from note")[0]["n"])


@pytest.mark.skipif(not has_containers(), reason="needs the right to make PID namespaces (root)")
def test_a_server_in_another_container_is_left_alone(home: Path) -> None:
    with server_in_a_container(home) as url:
        write_note(url)
        for attempt in (cluster_up, cluster_remove):
            with pytest.raises(DatabaseError, match=rf"{ELSEWHERE}[\s\S]*CONETL_DATABASE_URL[\s\S]*postmaster.pid"):
                attempt(home)
        write_note(url)
        told = cluster_status(home)
        assert (told.state, told.host, told.url, told.pid) == ("running elsewhere", socket.gethostname(), None, None)
        with pytest.raises(DatabaseError, match=f"{ELSEWHERE}.*stop it there"):
            cluster_down(home)
    # The container was killed: its lock is free, so its server is dead, and nobody has to say so.
    retried(lambda: count_notes(cluster_up(home)) == 2)
    url = cluster_up(home)
    # Now the other way round.
    command = [*CONTAINER, sys.executable, "-c", SERVER, str(home)]
    second = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert ELSEWHERE in second.stderr
    assert count_notes(url) == 2


def test_what_a_pid_file_means_depends_on_where_it_was_written(home: Path) -> None:
    write_note(cluster_up(home))
    place = find_location(home)
    assert place is not None
    host_file, pid_file = place.directory / "server.host", place.data / "postmaster.pid"
    written = json.loads(host_file.read_text())
    assert written["locked"], "the server holds its lock"

    def killed_there(**changes: object) -> None:
        """The server, gone without a word, was one of another place."""
        pid = cluster_status(home).pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        host_file.write_text(json.dumps(written | changes))

    def is_up() -> bool:
        return count_notes(cluster_up(home)) == 1

    killed_there(boot_id="before the machine was started again")
    retried(is_up)
    killed_there(pid_namespace="pid:[1]")  # a container of this machine that is gone
    retried(is_up)
    host_file.unlink()  # of an older conetl
    assert cluster_status(home).state == "running" and is_up()

    for unknown in ({"boot_id": "of another machine", "host": "other"}, {"pid_namespace": "pid:[1]", "locked": False}):
        killed_there(**unknown)
        with pytest.raises(DatabaseError, match=ELSEWHERE):
            cluster_up(home)
        assert pid_file.exists()
        pid_file.unlink()  # as the message says
        assert is_up()

    killed_there()
    host_file.write_text("?")
    with pytest.raises(DatabaseError, match=r"server\.host should name the host"):
        cluster_up(home)
    host_file.unlink()
    assert is_up()


def test_status_and_down_tell_of_what_runs_on_another_host(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing there may be called stopped, or be forgotten."""
    write_note(cluster_up(home))
    place = find_location(home)
    assert place is not None
    host_file = place.directory / "server.host"
    written = json.loads(host_file.read_text())
    pid = cluster_status(home).pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    host_file.write_text(json.dumps(written | {"boot_id": "of another machine", "host": "office-3"}))
    service = Service("view", pid, "t", "2026-03-01T08:00:00+00:00", "view.log", "http://127.0.0.1:1")
    write_services(home, {"view": service})
    monkeypatch.setenv("CONETL_HOME", str(home))
    monkeypatch.delenv("CONETL_DATABASE_URL", raising=False)

    def conetl(*words: str, code: int) -> str:
        done = CliRunner().invoke(app, words)
        assert done.exit_code == code, done.output
        return done.output

    found = json.loads(conetl("status", "--json", code=3))
    assert [(s["name"], s["state"], s["address"]) for s in found["services"]] == [
        ("postgis", "running elsewhere", "host office-3"),
        ("view", "not seen from here", "http://127.0.0.1:1"),
    ]
    assert json.loads(conetl("db", "status", "--json", code=0))["cluster"]["host"] == "office-3"
    for command in (["down"], ["db", "down"]):
        with pytest.raises(ServiceError, match=r"host office-3\): stop (it|them)"):
            raise CliRunner().invoke(app, command).exception  # type: ignore[misc]
    assert read_services(home) == {"view": service}
    (place.data / "postmaster.pid").unlink()
    assert cluster_status(home).state == "stopped"


def retried(is_up: Callable[[], bool]) -> None:
    """Processes of a killed server hold its lock until they notice."""
    for _ in range(600):
        try:
            assert is_up()
            return
        except DatabaseError as error:
            if ELSEWHERE not in str(error):
                raise
            time.sleep(0.05)
    raise AssertionError("the lock was never free")
