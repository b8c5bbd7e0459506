"""The private cluster, for real: started, killed, shared, hidden from other users; one server on its data, never two."""

from __future__ import annotations

import json
import os
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.db.cluster.cluster import cluster_down, cluster_status, cluster_up
from conetl.db.cluster.location import find_location
from conetl.db.cluster.postgres_install import find_installs
from conetl.db.connection import connect, execute
from conetl.model.errors import DatabaseError, ServiceError
from conetl.services.processes import Service, read_services, write_services
from tests.clusters import remove_cluster
from tests.command import until

AS_ROOT = os.geteuid() == 0
#: What a container is to a process id: a PID namespace with a /proc of its own, and shared memory of its own.
CONTAINER = ["unshare", "--pid", "--ipc", "--fork", "--mount-proc", "--kill-child"]
UP = (
    "import sys, pathlib; from conetl.db.cluster.cluster import cluster_up\n"
    "print(cluster_up(pathlib.Path(sys.argv[1])), flush=True)"
)
SERVER = f"{UP}; sys.stdin.read()"
ELSEWHERE = "another machine or container"


@contextmanager
def new_home(name: str):
    """A home folder that the server's user can reach, with a space, a dollar and a quote in its name."""
    path = Path(f"/tmp/conetl-test-home-{os.getpid()}-{name} $HOME 'x'")
    path.mkdir()
    yield path
    remove_cluster(path)
    shutil.rmtree(path)


@pytest.fixture
def home(request):
    """A home without a cluster."""
    with new_home(request.node.name[:40]) as path:
        yield path


@pytest.fixture(scope="module")
def used_home():
    """A home whose cluster the tests of this file share; each begins with `cluster_up`."""
    with new_home("shared") as path:
        yield path


def write_note(url: str) -> None:
    with closing(connect(url)) as conn:
        execute(conn, "create table if not exists note (text text)")
        execute(conn, "insert into note values ('kept')")
        conn.commit()


def up_without_notes(home: Path) -> str:
    """The address of a cluster that other tests have used."""
    url = cluster_up(home)
    with closing(connect(url)) as conn:
        execute(conn, "drop table if exists note")
        conn.commit()
    return url


def count_notes(url: str) -> int:
    with closing(connect(url)) as conn:
        return int(execute(conn, "select count(*) as n from note")[0]["n"])


def test_life_of_a_cluster(used_home):
    home = used_home
    remove_cluster(home)
    assert cluster_status(home).state == "absent"
    assert not cluster_down(home)

    url = cluster_up(home)
    write_note(url)
    running = cluster_status(home)
    assert (running.state, running.url) == ("running", url)
    assert cluster_up(home) == url
    assert cluster_status(home).pid == running.pid, "a second up must not start another server"

    assert cluster_down(home)
    assert cluster_status(home).state == "stopped"
    assert not cluster_down(home)
    assert count_notes(cluster_up(home)) == 1

    # kill -9 of the server, its children left to notice
    os.kill(cluster_status(home).pid, signal.SIGKILL)
    assert count_notes(cluster_up(home)) == 1

    # power cut: the pid file stays behind, and its number now belongs to somebody else
    place = find_location(home)
    os.kill(cluster_status(home).pid, signal.SIGKILL)
    pid_file = place.data / "postmaster.pid"
    other = subprocess.Popen(["sleep", "600"], user=place.user.pw_uid if AS_ROOT else None)
    try:
        lines = pid_file.read_text().splitlines()
        pid_file.write_text("\n".join([str(other.pid), *lines[1:]]) + "\n")
        assert cluster_status(home).state == "stopped"
        assert count_notes(cluster_up(home)) == 1
        assert other.poll() is None
    finally:
        other.kill()
        other.wait()

    # a sweeper of temporary files took the socket
    (place.socket_directory / ".s.PGSQL.5432").unlink()
    assert count_notes(cluster_up(home)) == 1


def test_settings_are_safe(used_home):
    wanted = {"fsync": "on", "full_page_writes": "on", "synchronous_commit": "on", "listen_addresses": ""}
    with closing(connect(cluster_up(used_home))) as conn:
        rows = execute(
            conn, "select name, setting from pg_settings where name = any(%(names)s)", {"names": list(wanted)}
        )
    assert {row["name"]: row["setting"] for row in rows} == wanted


def test_only_the_owner_and_root_are_let_in(used_home):
    home = used_home
    url = cluster_up(home)
    place = find_location(home)
    for path in (place.directory, place.socket_directory):
        assert path.stat().st_mode & 0o077 == 0
        assert path.stat().st_uid == place.user.pw_uid
    assert (place.socket_directory / ".s.PGSQL.5432").stat().st_mode & 0o077 == 0
    if not AS_ROOT:
        pytest.skip("only root can try it as another user")
    stranger = next(entry for entry in pwd.getpwall() if entry.pw_uid not in (0, place.user.pw_uid))
    psql = [str(find_installs()[0].bin_directory / "psql"), url, "-c", "select 1"]
    refused = subprocess.run(psql, user=stranger.pw_uid, capture_output=True, text=True, check=False, cwd="/")
    assert refused.returncode != 0
    assert "ermission denied" in refused.stderr
    # even with the folders open the server itself asks who is there
    opened = [home, place.directory, place.socket_directory]
    for path in opened:
        path.chmod(0o755)
    (place.socket_directory / ".s.PGSQL.5432").chmod(0o777)
    refused = subprocess.run(psql, user=stranger.pw_uid, capture_output=True, text=True, check=False, cwd="/")
    for path in opened[1:]:
        path.chmod(0o700)
    (place.socket_directory / ".s.PGSQL.5432").chmod(0o700)
    assert "eer authentication failed" in refused.stderr


def test_many_ups_at_once_make_one_cluster_beside_others_in_a_home_too_deep_for_a_socket(home, cluster_url):
    deep = home / "/".join(["a_rather_long_folder_name"] * 5)
    deep.mkdir(parents=True)
    command = [sys.executable, "-c", UP, str(deep)]
    try:
        with ThreadPoolExecutor(4) as pool:
            runs = list(
                pool.map(lambda _: subprocess.run(command, capture_output=True, text=True, check=False), range(4))
            )
        assert [run.returncode for run in runs] == [0] * 4, runs[0].stderr
        assert len({run.stdout for run in runs}) == 1
        assert cluster_status(deep).state == "running"
        place = find_location(deep)
        assert place.socket_directory.parent == Path("/tmp")
        assert place.socket_directory.stat().st_mode & 0o777 == 0o700
        write_note(runs[0].stdout.strip())
        with closing(connect(cluster_url)) as conn:
            assert execute(conn, "select to_regclass('note') as note") == [{"note": None}]
        # a socket's folder that somebody else prepared is refused
        cluster_down(deep)
        shutil.rmtree(place.socket_directory)
        place.socket_directory.mkdir()
        place.socket_directory.chmod(0o777)
        with pytest.raises(DatabaseError, match="mode 0700"):
            cluster_up(deep)
    finally:
        remove_cluster(deep)
    assert not place.socket_directory.exists()
    assert cluster_status(deep).state == "absent"


@pytest.mark.skipif(not AS_ROOT, reason="the cluster of an ordinary user always lies in the home folder")
def test_root_with_a_private_home(home, tmp_path):
    private = home / "private"
    private.mkdir(mode=0o700)
    hidden = private / "home"
    try:
        url = cluster_up(hidden)
        write_note(url)
        place = find_location(hidden)
        assert place.directory.parent == Path("/var/lib/conetl")
        assert (hidden / "postgres.location").read_text().strip() == str(place.directory)
        assert cluster_status(hidden).url == url
        # moved, the home keeps its cluster; copied, it gets another one
        moved, copied = private / "moved", private / "copied"
        hidden.rename(moved)
        assert count_notes(cluster_up(moved)) == 1
        shutil.copytree(moved, copied)
        assert cluster_status(copied).state == "absent"
    finally:
        remove_cluster(private / "moved")
        remove_cluster(hidden)
    assert not place.directory.exists()


def test_a_server_that_cannot_start_says_why(used_home, monkeypatch):
    home = used_home
    cluster_up(home)
    cluster_down(home)
    place = find_location(home)
    control, away = place.data / "global" / "pg_control", place.directory / "pg_control.away"
    control.rename(away)
    with pytest.raises(DatabaseError, match=r"does not start[\s\S]*pg_control[\s\S]*CONETL_DATABASE_URL"):
        cluster_up(home)
    full = "FATAL:  could not write to file: No space left on device\nHINT:  some data is corrupted"
    with monkeypatch.context() as patch, pytest.raises(DatabaseError, match="disk is full: free space") as raised:
        patch.setattr("conetl.db.cluster.cluster._log_tail", lambda _: full)
        cluster_up(home)
    assert "corrupted" not in str(raised.value)
    away.rename(control)
    cluster_up(home)


def test_an_interrupted_first_start_is_made_good(home):
    place_directory = home / "postgres"
    child = subprocess.Popen([sys.executable, "-c", UP, str(home)])
    until(lambda: list(place_directory.glob("data.new.*/base/1")), "the first files", 30, 0.01)
    child.kill()
    child.wait()
    assert cluster_status(home).state == "absent"
    write_note(cluster_up(home))
    time.sleep(1)  # what the orphaned initdb still writes
    cluster_down(home)
    cluster_up(home)
    assert not list(place_directory.glob("data.new.*"))


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


@pytest.mark.skipif(not has_containers(), reason="needs the right to make PID namespaces (root)")
def test_a_server_in_another_container_is_left_alone(used_home: Path) -> None:
    home = used_home
    up_without_notes(home)
    cluster_down(home)
    with server_in_a_container(home) as url:
        write_note(url)
        with pytest.raises(DatabaseError, match=rf"{ELSEWHERE}[\s\S]*CONETL_DATABASE_URL[\s\S]*postmaster.pid"):
            cluster_up(home)
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


def test_what_a_pid_file_means_depends_on_where_it_was_written(used_home: Path) -> None:
    home = used_home
    write_note(up_without_notes(home))
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


def test_status_and_down_tell_of_what_runs_on_another_host(used_home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing there may be called stopped, or be forgotten. Last in this file: its server is gone then."""
    home = used_home
    cluster_up(home)
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
