"""A Prefect server for the time of one command, where none is configured.

Prefect's own temporary server loses events when it stops and outlives a killed client. This one is a real server with its
state under `<home>/prefect`, so past runs can be looked at later; the kernel ends it when this process dies.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from prefect.events.worker import EventsWorker
from prefect.logging.handlers import APILogWorker
from prefect.settings import (
    PREFECT_API_AUTH_STRING,
    PREFECT_API_URL,
    PREFECT_FLOWS_HEARTBEAT_FREQUENCY,
    temporary_settings,
)

from conetl.model.errors import ServiceError
from conetl.pipeline.settings import SERVER_AUTH, prefect_auth_string
from conetl.services.prefect_api import is_healthy, require_access
from conetl.services.processes import is_running, read_services

_START_TIMEOUT_S = 180
_LOG = "server.log"
#: Services that the server of one command does not need: nothing is scheduled, late, paused or awaited by an automation.
_NOT_NEEDED = ("SCHEDULER", "LATE_RUNS", "FOREMAN", "PAUSE_EXPIRATIONS", "REPOSSESSOR", "TRIGGERS")
_DRAIN_TIMEOUT_S = 5
_PR_SET_PDEATHSIG = 1


@contextlib.contextmanager
def prefect_server(home: Path) -> Iterator[str]:
    """Address of a Prefect API: the configured one (PREFECT_API_URL), that of `conetl up`, or one started here and stopped at the
    end.

    Raises ServiceError where it does not answer, or requires a password that is not known here.
    """
    configured = os.environ.get("PREFECT_API_URL")
    own = None if configured else read_services(home).get("prefect")
    if own is not None and own.address and is_running(own) and is_healthy(f"{own.address}/api"):
        with _settings_for(f"{own.address}/api"):  # of `conetl up`
            yield f"{own.address}/api"
        return
    if configured:
        if not is_healthy(configured):
            raise ServiceError(
                f"PREFECT_API_URL names {configured}, but no Prefect server answers there. Start it, or unset "
                "PREFECT_API_URL to let conetl start one for this command. Nothing was written."
            )
        given = PREFECT_API_AUTH_STRING.value()
        require_access(configured, given.get_secret_value() if given else None, PREFECT_API_AUTH_STRING.name)
        yield configured
        return
    with _own_server(home / "prefect") as url, _settings_for(url):
        try:
            yield url
        finally:  # the last log lines and events are still on their way
            APILogWorker.drain_all(timeout=_DRAIN_TIMEOUT_S)
            EventsWorker.drain_all(timeout=_DRAIN_TIMEOUT_S)


@contextlib.contextmanager
def _own_server(state: Path) -> Iterator[str]:
    """Address of a server that runs while the block does, with its state in a folder."""
    state.mkdir(parents=True, exist_ok=True)
    url, process = _start(state)
    try:
        yield url
    finally:
        _end(process)


def _start(state: Path) -> tuple[str, subprocess.Popen[bytes]]:
    """Start a server and wait until it answers; try once more where it stops meanwhile. Raises ServiceError.

    One at a time in a home: until it answers, a server fills the tables of a SQLite file that all of them share, and finding it
    locked it gives up. Servers that run already, or a port that is in use by now, may still be in the way: hence once more.
    """
    with _start_lock(state):
        for _ in range(2):
            port = _free_port()
            url, process = f"http://127.0.0.1:{port}/api", _spawn(state, port)
            try:
                if _becomes_healthy(url, process, state / _LOG):
                    return url, process
            except BaseException:
                _end(process)
                raise
    raise ServiceError(
        f"the Prefect server stopped twice while starting (exit code {process.returncode}); see {state / _LOG}. Nothing was "
        "written."
    )


@contextlib.contextmanager
def _start_lock(state: Path) -> Iterator[None]:
    """Waits for other commands of this home; the kernel frees it with this process."""
    with (state / "start.lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _spawn(state: Path, port: int) -> subprocess.Popen[bytes]:
    quiet = {f"PREFECT_SERVER_SERVICES_{name}_ENABLED": "false" for name in _NOT_NEEDED}
    with (state / _LOG).open("ab") as log:
        return subprocess.Popen(
            _command(port),
            stdout=log,
            stderr=log,
            stdin=subprocess.DEVNULL,
            # Before any thread of ours runs; nothing else ties a child to a parent that is killed with -9.
            preexec_fn=_die_with_parent if sys.platform == "linux" else None,  # noqa: PLW1509
            env={**quiet, **os.environ, "PREFECT_SERVER_UI_API_URL": f"http://127.0.0.1:{port}/api"},
        )


def _command(port: int) -> list[str]:
    command = [sys.executable, "-m", "uvicorn", "--factory", "prefect.server.api.server:create_app"]
    return [*command, "--host", "127.0.0.1", "--port", str(port), "--log-level", "warning"]


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(timeout=10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _settings_for(url: str) -> contextlib.AbstractContextManager[object]:
    """Prefect's settings for runs of this command. It read its environment when it was imported: a variable comes too late.

    No heartbeats: every flow would wait a second for their thread to end, and locks show which runs live (`runs.py`).
    """
    auth = prefect_auth_string()
    require_access(url, auth, SERVER_AUTH)
    known = {} if auth is None else {PREFECT_API_AUTH_STRING: auth}
    return temporary_settings(updates={PREFECT_API_URL: url, PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None, **known})


def _die_with_parent() -> None:
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _becomes_healthy(url: str, process: subprocess.Popen[bytes], log: Path) -> bool:
    """False where the server stops before it answers. Raises ServiceError where it does neither."""
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            return False
        if is_healthy(url):
            return True
        time.sleep(0.1)
    raise ServiceError(
        f"the Prefect server did not answer within {_START_TIMEOUT_S} s; see {log}. Nothing was written."
    )
