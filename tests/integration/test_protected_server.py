"""`conetl up --host` with a password: everything of conetl gets in, nobody else does, and the password is written nowhere."""

from __future__ import annotations

import json
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path
from subprocess import CompletedProcess

import httpx
import pytest

from conetl.db.cluster.cluster import cluster_remove
from tests import command
from tests.integration.small_drives import SAMPLES, cut_drive, processes_with

#: Loopback, but none of the addresses that need no password.
HOST = "127.0.0.2"
WORD = "s3cr3t-of-the-desk"
AUTH = f"desk:{WORD}"


def free_port(host: str) -> int:
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


def conetl(home: Path, *arguments: object, auth: str | None = AUTH) -> CompletedProcess[str]:
    """One command with --json, in a shell that knows the password, another one, or none."""
    password = {"PREFECT_SERVER_API_AUTH_STRING": auth} if auth else {}
    return command.conetl(*arguments, "--json", CONETL_HOME=home, TMPDIR=home / "tmp", **password)


@pytest.fixture(scope="module")
def home(services_home: Path) -> Iterator[Path]:
    # The run's process id last, or another test run takes it for a leftover.
    prefix, main_pid = services_home.name.rsplit("-", 1)
    place = services_home.with_name(f"{prefix}-protected-{main_pid}")
    (place / "tmp").mkdir(parents=True)
    try:
        yield place
    finally:
        conetl(place, "down")
        cluster_remove(place)
        left = processes_with("CONETL_HOME", place)
        shutil.rmtree(place)
    assert left == set()


def test_a_protected_server_serves_those_who_know_the_password(home: Path, tmp_path: Path) -> None:
    port = free_port(HOST)
    up = ("up", "--host", HOST, "--port", port, "--view-port", free_port("127.0.0.1"))
    drives = [cut_drive(SAMPLES[n], tmp_path / f"2026-05-0{n + 1}_run", f"2026-05-0{n + 1}") for n in (0, 1)]
    open_to_all = conetl(home, *up, auth=None)
    assert open_to_all.returncode == 2
    assert "PREFECT_SERVER_API_AUTH_STRING" in open_to_all.stderr

    done = conetl(home, *up)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["deployments_registered"]
    api = f"http://{HOST}:{port}/api"
    assert httpx.post(f"{api}/deployments/filter", json={}, trust_env=False).status_code == httpx.codes.UNAUTHORIZED
    assert conetl(home, "status", auth=None).returncode == 0

    for auth, words in (
        (None, ("ingest", drives[0])),
        ("desk:guessed", ("backfill", tmp_path)),
        ("desk:guessed", up),
        (None, ("up", "--port", port)),
    ):
        refused = conetl(home, *words, auth=auth)
        assert refused.returncode == 3, (words, refused.stdout, refused.stderr)
        assert "set PREFECT_SERVER_API_AUTH_STRING" in refused.stderr
        assert "Traceback" not in refused.stderr

    done = conetl(home, "ingest", drives[0])
    assert done.returncode == 0, done.stderr
    assert [report["status"] for report in json.loads(done.stdout)] == ["committed"]
    # By a worker, which has the password from `up`.
    done = conetl(home, "backfill", tmp_path)
    assert done.returncode == 0, done.stderr
    assert [(d["drive_id"], d["state"]) for d in json.loads(done.stdout)["drives"]] == [("2026-05-02_run", "committed")]
    done = conetl(home, "backfill", tmp_path, "--here", "--recheck")
    assert done.returncode == 0, done.stderr
    assert [d["state"] for d in json.loads(done.stdout)["drives"]] == ["known", "known"]

    assert files_with(home, WORD) == []
    assert arguments_with(WORD) == []
    assert conetl(home, "down").returncode == 0
    assert files_with(home, WORD) == []  # what was still in memory is on disk now, Prefect's database included


def files_with(folder: Path, word: str) -> list[Path]:
    """Files that hold a word; what vanishes in between does not count."""
    found = []
    for path in folder.rglob("*"):
        try:
            if path.is_file() and word.encode() in path.read_bytes():
                found.append(path)
        except FileNotFoundError:
            continue
    return found


def arguments_with(word: str) -> list[int]:
    """Living processes that show a word to whoever lists them."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and word.encode() in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return found
