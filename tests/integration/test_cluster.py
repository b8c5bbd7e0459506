"""The private cluster, for real: started, killed, shared, hidden from other users."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from conetl.db.cluster.cluster import cluster_down, cluster_remove, cluster_status, cluster_up
from conetl.db.cluster.location import find_location
from conetl.db.cluster.postgres_install import find_installs
from conetl.db.connection import connect, execute
from conetl.model.errors import DatabaseError

AS_ROOT = os.geteuid() == 0


@contextmanager
def new_home(name: str):
    """A home folder that the server's user can reach, with a space, a dollar and a quote in its name."""
    path = Path(f"/tmp/conetl-test-home-{os.getpid()}-{name} $HOME 'x'")
    path.mkdir()
    yield path
    cluster_remove(path)
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


def count_notes(url: str) -> int:
    conn = connect(url)
    try:
        return execute(conn, "select count(*) as n from note")[0]["n"]
    finally:
        conn.close()


def write_note(url: str) -> None:
    conn = connect(url)
    execute(conn, "create table if not exists note (text text)")
    execute(conn, "insert into note values ('kept')")
    conn.commit()
    conn.close()


def test_life_of_a_cluster(used_home):
    home = used_home
    cluster_remove(home)
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


def test_settings_are_safe(cluster_url):
    conn = connect(cluster_url)
    wanted = {"fsync": "on", "full_page_writes": "on", "synchronous_commit": "on", "listen_addresses": ""}
    rows = execute(conn, "select name, setting from pg_settings where name = any(%(names)s)", {"names": list(wanted)})
    conn.close()
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


def test_many_ups_at_once_make_one_cluster(home):
    command = [
        sys.executable,
        "-c",
        "import sys, pathlib; from conetl.db.cluster.cluster import cluster_up; print(cluster_up(pathlib.Path(sys.argv[1])))",
        str(home),
    ]
    with ThreadPoolExecutor(4) as pool:
        runs = list(pool.map(lambda _: subprocess.run(command, capture_output=True, text=True, check=False), range(4)))
    assert [run.returncode for run in runs] == [0] * 4, runs[0].stderr
    assert len({run.stdout for run in runs}) == 1
    assert cluster_status(home).state == "running"


def test_two_homes_and_a_home_too_deep_for_a_socket(home, cluster_url):
    deep = home / "/".join(["a_rather_long_folder_name"] * 5)
    deep.mkdir(parents=True)
    try:
        url = cluster_up(deep)
        place = find_location(deep)
        assert place.socket_directory.parent == Path("/tmp")
        assert place.socket_directory.stat().st_mode & 0o777 == 0o700
        write_note(url)
        conn = connect(cluster_url)
        assert execute(conn, "select to_regclass('note') as note") == [{"note": None}]
        conn.close()
        # a socket's folder that somebody else prepared is refused
        cluster_down(deep)
        shutil.rmtree(place.socket_directory)
        place.socket_directory.mkdir()
        place.socket_directory.chmod(0o777)
        with pytest.raises(DatabaseError, match="mode 0700"):
            cluster_up(deep)
    finally:
        cluster_remove(deep)
    assert not place.socket_directory.exists()
    assert cluster_status(deep).state == "absent"
    assert not cluster_remove(deep)


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
        cluster_remove(private / "moved")
        cluster_remove(hidden)
    assert not place.directory.exists()


def test_a_server_that_cannot_start_says_why(used_home):
    home = used_home
    cluster_up(home)
    cluster_down(home)
    place = find_location(home)
    control, away = place.data / "global" / "pg_control", place.directory / "pg_control.away"
    control.rename(away)
    with pytest.raises(DatabaseError, match=r"does not start[\s\S]*pg_control[\s\S]*CONETL_DATABASE_URL"):
        cluster_up(home)
    away.rename(control)
    cluster_up(home)


def test_an_interrupted_first_start_is_made_good(home):
    place_directory = home / "postgres"
    child = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import sys, pathlib; from conetl.db.cluster.cluster import cluster_up; cluster_up(pathlib.Path(sys.argv[1]))",
            str(home),
        ]
    )
    deadline = time.monotonic() + 30
    while not list(place_directory.glob("data.new.*/base/1")) and time.monotonic() < deadline:
        time.sleep(0.01)
    child.kill()
    child.wait()
    assert cluster_status(home).state == "absent"
    write_note(cluster_up(home))
    time.sleep(1)  # what the orphaned initdb still writes
    cluster_down(home)
    cluster_up(home)
    assert not list(place_directory.glob("data.new.*"))
