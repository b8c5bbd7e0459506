"""A Prefect server for one command, where none is configured and none of `conetl up` is running.

Prefect's own temporary server loses events when it stops and outlives a killed client. This one is a full server with its state
in `<home>/prefect`, where past runs can be inspected later; the kernel stops it when this process ends.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from prefect.context import refresh_global_settings_context
from prefect.events.worker import EventsWorker
from prefect.logging.handlers import APILogWorker
from prefect.settings import (
    PREFECT_API_AUTH_STRING,
    PREFECT_API_URL,
    PREFECT_FLOWS_HEARTBEAT_FREQUENCY,
    temporary_settings,
)
from pydantic import SecretStr

from conetl.files.home import make_home
from conetl.model.errors import ServiceError
from conetl.pipeline.settings import SERVER_AUTH, prefect_login, prefect_server_environment
from conetl.services import processes

_START_TIMEOUT_S = 180
#: Settings without the services that a server of one command does not need: schedules, late and paused runs, automations.
SERVICES_OFF = {
    f"PREFECT_SERVER_SERVICES_{name}_ENABLED": "false"
    for name in ("SCHEDULER", "LATE_RUNS", "FOREMAN", "PAUSE_EXPIRATIONS", "REPOSSESSOR", "TRIGGERS")
}
_DRAIN_TIMEOUT_S = 5


@contextlib.contextmanager
def prefect_server(home: Path) -> Iterator[str]:
    """Address of a Prefect API: of PREFECT_API_URL, of `conetl up`, or of a server that runs until the end of the block.

    Raises ServiceError if it does not answer, or requires a password that is not known here.
    """
    configured = os.environ.get("PREFECT_API_URL")
    if configured:
        given = PREFECT_API_AUTH_STRING.value()
        login = given.get_secret_value() if isinstance(given, SecretStr) else given
        processes.require_configured(configured, login)
        yield configured
        return
    own = processes.read_services(home).get("prefect")
    if own is not None and own.address and processes.is_running(own) and processes.is_healthy(f"{own.address}/api"):
        with _settings_for(home, f"{own.address}/api"):
            yield f"{own.address}/api"
        return
    server = _start(home)
    url = f"{server.address}/api"
    try:
        with _settings_for(home, url):
            try:
                yield url
            finally:  # the last log lines and events may still be queued
                APILogWorker.drain_all(timeout=_DRAIN_TIMEOUT_S)
                EventsWorker.drain_all(timeout=_DRAIN_TIMEOUT_S)
    finally:
        processes.stop_service(server)


def _start(home: Path) -> processes.Service:
    """Start a server and wait until it answers; try again once if it fails. Raises ServiceError.

    One at a time per home: while it starts, a server creates the tables of a SQLite file that all of them share, and gives up if
    it is locked. A running server, or a port taken in between, can still interfere: therefore the second attempt.
    """
    make_home(home)
    with (home / "prefect" / "start.lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        try:
            return _start_once(home)
        except ServiceError:
            return _start_once(home)


def _start_once(home: Path) -> processes.Service:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    address = f"http://127.0.0.1:{port}"
    environment = {**SERVICES_OFF, **os.environ, **prefect_server_environment(home, address)}
    server = processes.start_service(
        "prefect-command", processes.server_command("127.0.0.1", port), home=home, environment=environment, address=address,
        die_with_parent=True,
    )  # fmt: skip
    try:
        processes.wait_healthy(server, lambda: processes.is_healthy(f"{address}/api"), _START_TIMEOUT_S)
    except BaseException:
        processes.stop_service(server)
        raise
    return server


@contextlib.contextmanager
def _settings_for(home: Path, url: str) -> Iterator[None]:
    """Prefect's settings for the runs of this command, in all its threads. Prefect itself reads its environment when imported.

    Settings of one thread are not enough: Prefect would start another server for what the threads of Dask report.
    No heartbeats: every flow would wait a second for their thread, and locks in the database show which runs are alive.
    """
    login = prefect_login(home)
    processes.require_access(url, login, SERVER_AUTH)
    ours = {PREFECT_API_URL.name: url, PREFECT_API_AUTH_STRING.name: login}
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update(ours)
    try:
        refresh_global_settings_context()
        with temporary_settings(updates={PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None}):
            yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
        refresh_global_settings_context()
