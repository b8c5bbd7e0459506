"""The Prefect server of one command: started one at a time in a home, and once more where it stops while it starts."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from threading import Barrier, Lock

import pytest

from conetl.model.errors import ServiceError
from flows import server
from flows.server import prefect_server

LIVES = [sys.executable, "-c", "import time; time.sleep(600)"]
DIES = [sys.executable, "-c", "import sys; print('database is locked', file=sys.stderr); sys.exit(3)"]


class Servers:
    """Made-up servers: which are started, and how many of them are starting at the same time."""

    def __init__(self, *commands: list[str]) -> None:
        self.commands = list(commands)
        self.started: list[str] = []
        self.starting: set[str] = set()
        self.most_at_once = 0
        self._lock = Lock()

    def command(self, _host: str, port: int) -> list[str]:
        with self._lock:
            self.started.append(f"http://127.0.0.1:{port}/api")
            self.starting.add(self.started[-1])
            self.most_at_once = max(self.most_at_once, len(self.starting))
            return self.commands[min(len(self.started), len(self.commands)) - 1]

    def is_healthy(self, url: str) -> bool:
        """Not at the first question; and never, where the process dies."""
        with self._lock:
            asked_before = url not in self.starting
            lives = self.commands[min(self.started.index(url), len(self.commands) - 1)] is LIVES
            self.starting.discard(url)
            return asked_before and lives


@pytest.fixture(autouse=True)
def no_other_server(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    def talking_to(home: Path, url: str) -> AbstractContextManager[None]:
        return nullcontext()

    monkeypatch.delenv("PREFECT_API_URL", raising=False)
    monkeypatch.setattr(server, "_settings_for", talking_to)
    yield


def use(servers: Servers, monkeypatch: pytest.MonkeyPatch) -> Servers:
    monkeypatch.setattr(server.processes, "server_command", servers.command)
    monkeypatch.setattr(server.processes, "is_healthy", servers.is_healthy)
    return servers


def test_commands_at_once_start_their_servers_one_after_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All make the tables of one SQLite file; but the servers themselves then run beside each other."""
    servers = use(Servers(LIVES), monkeypatch)
    together = Barrier(3, timeout=60)

    def command(_: int) -> str:
        with prefect_server(tmp_path) as url:
            together.wait()
            return url

    with ThreadPoolExecutor(3) as pool:
        urls = set(pool.map(command, range(3)))
    assert urls == set(servers.started) and len(urls) == 3
    assert servers.most_at_once == 1


def test_a_server_that_stops_while_it_starts_is_started_once_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    servers = use(Servers(DIES, LIVES), monkeypatch)
    with prefect_server(tmp_path) as url:
        assert url == servers.started[1]
    servers = use(Servers(DIES), monkeypatch)
    with (
        pytest.raises(ServiceError, match=r"stopped while starting[\s\S]*database is locked"),
        prefect_server(tmp_path),
    ):
        raise AssertionError("there is no server")
    assert len(servers.started) == 2


def test_what_was_started_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[subprocess.Popen[bytes]] = []

    class Seen(subprocess.Popen):
        def __init__(self, *args: object, **named: object) -> None:
            super().__init__(*args, **named)  # type: ignore[call-overload]
            begun.append(self)

    monkeypatch.setattr(subprocess, "Popen", Seen)
    use(Servers(LIVES), monkeypatch)
    with prefect_server(tmp_path):
        assert begun[0].poll() is None
    assert begun[0].poll() is not None
    monkeypatch.setattr(server, "_START_TIMEOUT_S", 0)
    with pytest.raises(ServiceError, match="was not ready"), prefect_server(tmp_path):
        raise AssertionError("there is no server")
    assert len(begun) == 3 and all(process.poll() is not None for process in begun)
