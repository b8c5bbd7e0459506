"""Background processes: found again, stopped with their children, and never a process of somebody else."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from conetl.files.home import home_access, make_home
from conetl.model.errors import InputError, ServiceError, StorageError
from conetl.services import processes

#: A parent with a child in a session of its own, as Prefect's workers have them; the child's id goes to the log.
PARENT = (
    "import subprocess, sys, time\n"
    "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(300)'], start_new_session=True)\n"
    "print(child.pid, flush=True); time.sleep(300)"
)
#: On SIGTERM it loses its environment, as every process does for a moment, and keeps running.
STUBBORN = (
    "import ctypes, os, signal, time\n"
    "fields = open('/proc/self/stat').read().rpartition(')')[2].split()\n"
    "first, last = int(fields[47]), int(fields[48])\n"
    "def end(number, frame):\n"
    "    ctypes.memset(first, 0, last - first); time.sleep(300)\n"
    "signal.signal(signal.SIGTERM, end)\n"
    "print(os.getpid(), flush=True); time.sleep(300)"
)


def start(home: Path, code: str) -> processes.Service:
    return processes.start_service(
        "thing", [sys.executable, "-c", code], home=home, environment=dict(os.environ), address=None
    )


def test_the_record_of_services_is_for_the_owner_only(tmp_path: Path) -> None:
    """Also in the home folder of root, which other users may pass through, and where an older version made it."""
    home = tmp_path / "home"
    with processes.services_lock(home):
        processes.write_services(home, {})
    home.chmod(0o711)
    assert home_access(home) == "owner only"
    (home / "services.lock").chmod(0o644)
    with processes.services_lock(home):
        assert home_access(home) == "owner only"


def last_line(service: processes.Service, word: str = "") -> str:
    for _ in range(600):
        lines = Path(service.log).read_text().splitlines()
        if len(lines) > 1 and word in lines[-1]:
            return lines[-1]
        time.sleep(0.1)
    raise AssertionError("the service said nothing")


def is_alive(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] not in {"Z", "X"}


@pytest.fixture
def service(tmp_path: Path) -> Iterator[processes.Service]:
    started = start(tmp_path, PARENT)
    yield started
    processes.stop_service(started, grace_s=1)


def test_children_of_a_killed_service_are_stopped(service: processes.Service, tmp_path: Path) -> None:
    processes.write_services(tmp_path, {"thing": service})
    assert processes.is_running(processes.read_services(tmp_path)["thing"])
    child = int(last_line(service))
    os.kill(service.pid, signal.SIGKILL)
    while processes.is_running(service):
        time.sleep(0.05)
    assert is_alive(child)
    assert processes.stop_service(service)
    assert not is_alive(child)
    assert not processes.stop_service(service)


def test_a_process_that_ignores_sigterm_is_killed(tmp_path: Path) -> None:
    stubborn = start(tmp_path, STUBBORN)
    pid = int(last_line(stubborn))
    assert processes.stop_service(stubborn, grace_s=1)
    assert not is_alive(pid)


def test_a_process_with_a_reused_id_is_never_stopped(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(300)"]) as stranger:
        ours = start(tmp_path, "import time; time.sleep(300)")
        processes.stop_service(ours, grace_s=1)
        reused = replace(ours, pid=stranger.pid)
        assert not processes.is_running(reused)
        assert not processes.stop_service(reused)
        assert stranger.poll() is None
        stranger.kill()


def test_an_early_end_is_reported_with_the_log(tmp_path: Path) -> None:
    started = start(tmp_path, "raise SystemExit('the disk is full')")
    with pytest.raises(ServiceError, match="the disk is full"):
        processes.wait_healthy(started, lambda: False, 60)


def test_a_port_in_use_is_reported_with_the_option(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match="--port"):
            processes.free_port("127.0.0.1", taken.getsockname()[1], "Prefect", "--port")


def test_a_log_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    make_home(tmp_path)
    log = tmp_path / "logs" / "thing.log"
    log.symlink_to("/dev/full")
    with pytest.raises(StorageError, match=rf"{log} cannot be written \(No space left on device\): free space"):
        start(tmp_path, "pass")
