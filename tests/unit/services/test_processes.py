"""Processes that outlive their command: found again, ended with their children, and never a stranger."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from conetl.model.errors import InputError, ServiceError
from conetl.services.processes import (
    Service,
    is_running,
    read_services,
    require_free_port,
    start_service,
    stop_service,
    wait_healthy,
    write_services,
)

#: A parent with a child in a session of its own, as Prefect's workers have them; the child's id goes to the log.
PARENT = (
    "import subprocess, sys, time\n"
    "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(300)'], start_new_session=True)\n"
    "print(child.pid, flush=True); time.sleep(300)"
)
#: When it is to end it loses its environment first, as for a moment every process does, and takes a second more.
FORGETFUL = (
    "import ctypes, os, signal, time\n"
    "fields = open('/proc/self/stat').read().rpartition(')')[2].split()\n"
    "first, last = int(fields[47]), int(fields[48])\n"
    "def end(number, frame):\n"
    "    ctypes.memset(first, 0, last - first); time.sleep(1); os._exit(0)\n"
    "signal.signal(signal.SIGTERM, end)\n"
    "print(os.getpid(), flush=True); time.sleep(300)"
)


def start(home: Path, code: str) -> Service:
    return start_service("thing", [sys.executable, "-c", code], home=home, environment=dict(os.environ), address=None)


def last_line(service: Service, word: str = "") -> str:
    for _ in range(600):
        lines = Path(service.log).read_text().splitlines()
        if len(lines) > 1 and word in lines[-1]:
            return lines[-1]
        time.sleep(0.1)
    raise AssertionError("the service said nothing")


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in {"Z", "X"}
    except FileNotFoundError:
        return False


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    started = start(tmp_path, PARENT)
    yield started
    stop_service(started, grace_s=1)


def test_what_was_written_down_is_found_again(service: Service, tmp_path: Path) -> None:
    write_services(tmp_path, {"thing": service})
    assert is_running(read_services(tmp_path)["thing"])


def test_children_end_too_also_of_a_service_that_was_killed(service: Service) -> None:
    child = int(last_line(service))
    os.kill(service.pid, signal.SIGKILL)
    for _ in range(100):
        if not is_running(service):
            break
        time.sleep(0.05)
    assert is_alive(child)
    assert stop_service(service)
    assert not is_alive(child)
    assert not stop_service(service)


@pytest.mark.parametrize("begun", [False, True], ids=["during", "before"])
def test_what_has_lost_its_environment_on_its_way_out_is_waited_for(tmp_path: Path, begun: bool) -> None:
    forgetful = start(tmp_path, FORGETFUL)
    pid = int(last_line(forgetful))
    if begun:
        os.kill(pid, signal.SIGTERM)
        while Path(f"/proc/{pid}/environ").read_bytes().strip(b"\0"):
            time.sleep(0.01)
    assert stop_service(forgetful)
    assert not is_alive(pid)


def test_what_has_no_environment_and_does_not_end_is_killed(tmp_path: Path) -> None:
    stubborn = start(tmp_path, FORGETFUL.replace("time.sleep(1); os._exit(0)", "time.sleep(300)"))
    pid = int(last_line(stubborn))
    assert stop_service(stubborn, grace_s=1)
    assert not is_alive(pid)


@pytest.mark.parametrize("difference", ["start", "boot", "token"])
def test_a_process_that_got_a_used_id_is_never_ended(tmp_path: Path, difference: str) -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(300)"]) as stranger:
        ours = start(tmp_path, "import time; time.sleep(300)")
        stop_service(ours, grace_s=1)
        recycled = replace(ours, pid=stranger.pid)
        if difference == "boot":
            recycled = replace(recycled, boot_id="another")
        if difference == "start":
            recycled = replace(recycled, start_ticks=ours.start_ticks + 1)
        assert not stop_service(recycled)
        assert stranger.poll() is None
        stranger.kill()


def test_an_early_end_is_told_with_the_log(tmp_path: Path) -> None:
    started = start(tmp_path, "raise SystemExit('the disk is full')")
    with pytest.raises(ServiceError, match="the disk is full"):
        wait_healthy(started, lambda: False, 60)


def test_a_port_in_use_is_told_with_the_option(tmp_path: Path) -> None:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match="--port"):
            require_free_port("127.0.0.1", taken.getsockname()[1], "Prefect", "--port")
