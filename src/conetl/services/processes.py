"""Processes that go on after the command that started them: started, found again and ended without ever touching a stranger's.

A process id alone proves nothing, since ids are used again. A service is known by its id, the time of its start as the kernel
counts it, the kernel's own start (`boot_id`), and a token in its environment, which its children inherit: so the children of a
service that was killed are found as well. Signals go through a process descriptor, which cannot come to mean another process.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

from conetl.files.atomic import atomic_text_file
from conetl.model.errors import InputError, ServiceError, cannot_write

TOKEN = "CONETL_SERVICE_TOKEN"
_STATE, _LOCK = "services.json", "services.lock"
_MAX_LOG_BYTES = 20_000_000


@dataclass(frozen=True)
class Service:
    """One process that was started, as it is written down."""

    name: str
    pid: int
    start_ticks: int
    boot_id: str
    token: str
    started_at: str
    log: str
    address: str | None


@contextmanager
def services_lock(home: Path) -> Iterator[None]:
    """Only one command at a time starts or ends services of a home folder. Raises InputError where it cannot be used."""
    try:
        home.mkdir(parents=True, exist_ok=True)
        handle = (home / _LOCK).open("w")
    except OSError as error:
        raise cannot_write(
            f"The home folder {home} cannot be used", "choose another one (CONETL_HOME)", error
        ) from error
    with handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def read_services(home: Path) -> dict[str, Service]:
    """The services of a home folder as they were written down, alive or not. Raises InputError where it cannot be read."""
    try:
        rows = json.loads((home / _STATE).read_text(encoding="utf-8"))
        return {row["name"]: Service(**row) for row in rows}
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise InputError(
            f"{home / _STATE} cannot be read ({error.strerror}): give a home folder of yours (CONETL_HOME)"
        ) from error
    except (ValueError, TypeError, KeyError) as error:
        raise ServiceError(
            f"{home / _STATE} cannot be understood ({error}): remove it once nothing of it runs any more"
        ) from error


def write_services(home: Path, services: Mapping[str, Service]) -> None:
    """Write down what runs."""
    with atomic_text_file(home / _STATE) as file:
        json.dump([asdict(service) for service in services.values()], file, indent=1)
        file.write("\n")


def start_service(
    name: str, command: Sequence[str], *, home: Path, environment: Mapping[str, str], address: str | None
) -> Service:
    """Start a process in a session of its own; its output goes to `home/logs/<name>.log`."""
    log = home / "logs" / f"{name}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    if log.exists() and log.stat().st_size > _MAX_LOG_BYTES:
        log.replace(log.with_suffix(".log.1"))
    token = uuid4().hex
    with log.open("ab") as output:
        output.write(f"--- {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC: starting {name}\n".encode())
        output.flush()
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
            env={**environment, TOKEN: token},
        )  # fmt: skip
    ticks = _start_ticks(process.pid)
    _children.append(process)  # reaped by poll(); its return code tells an early end
    return Service(
        name, process.pid, 0 if ticks is None else ticks, _boot_id(), token, datetime.now(UTC).isoformat(timespec="seconds"),
        str(log.resolve()), address,
    )  # fmt: skip


_children: list[subprocess.Popen[bytes]] = []


def is_running(service: Service) -> bool:
    """The very process that was started is there, and no zombie."""
    for child in _children:
        child.poll()
    return service.boot_id == _boot_id() and _start_ticks(service.pid) == service.start_ticks


def stop_service(service: Service, *, grace_s: float = 15.0) -> bool:
    """End a service and what it started; True where there was anything to end. Data and logs stay."""
    found = _members(service)
    if is_running(service) and _environment(service.pid) == [b""]:  # lost already, and so not found by it
        found[service.pid] = service.start_ticks
    if not found:
        return False
    # The service first: it ends its own children in order.
    leader = [pid for pid in found if pid == service.pid]
    _signal_all(found, leader or list(found), signal.SIGTERM)
    deadline = time.monotonic() + grace_s
    while (left := _left(service, found)) and time.monotonic() < deadline:
        if service.pid not in left:
            _signal_all(found, left, signal.SIGTERM)
        time.sleep(0.2)
    _signal_all(found, list(found), signal.SIGKILL)
    deadline = time.monotonic() + 5
    while _left(service, found) and time.monotonic() < deadline:
        time.sleep(0.1)
    return True


def log_tail(service: Service, lines: int = 15) -> str:
    """The end of a service's log."""
    try:
        with Path(service.log).open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 20_000))
            return "\n".join(file.read().decode(errors="replace").splitlines()[-lines:])
    except OSError:
        return ""


def wait_healthy(service: Service, is_healthy: Callable[[], bool], timeout_s: float) -> None:
    """Wait until a service does its work. Raises ServiceError with the end of its log where it ends or takes too long."""
    deadline = time.monotonic() + timeout_s
    while not is_healthy():
        if not is_running(service):
            raise ServiceError(
                f"{service.name} ended while it was starting; the end of {service.log}:\n{log_tail(service)}"
            )
        if time.monotonic() > deadline:
            raise ServiceError(
                f"{service.name} was not ready within {timeout_s:.0f} s; the end of {service.log}:\n{log_tail(service)}"
            )
        time.sleep(0.5)  # asking costs the service, which is still starting, time as well


def require_free_port(host: str, port: int, what: str, option: str) -> None:
    """Raises InputError where something listens on the port already."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise InputError(
                f"port {port} of {host}, where {what} should listen, cannot be used ({error.strerror}): end the program that has "
                f"it, or choose another port with {option}"
            ) from error


def _left(service: Service, found: dict[int, int]) -> list[int]:
    """Those of `found`, and of what the service started since and is added to it, that have not ended.

    A process that ends loses its environment, by which it is known, before its files and ports: so it is waited for by the time
    of its start.
    """
    found |= _members(service)
    return [pid for pid, ticks in found.items() if _start_ticks(pid) == ticks]


def _members(service: Service) -> dict[int, int]:
    """Process ids of a service and all that it started, by the token in their environment, and when each was started."""
    if service.boot_id != _boot_id():
        return {}
    wanted = f"{TOKEN}={service.token}".encode()
    for child in _children:
        child.poll()
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            with suppress(OSError):
                if wanted in _environment(int(entry.name)):
                    ticks = _start_ticks(int(entry.name))
                    if ticks is not None:
                        found[int(entry.name)] = ticks
    return found


def _signal_all(found: Mapping[int, int], pids: Sequence[int], number: signal.Signals) -> None:
    for pid in pids:
        try:
            descriptor = os.pidfd_open(pid)
        except OSError:
            continue
        try:  # From here on the descriptor means one process; is it still ours?
            with suppress(OSError):
                if _start_ticks(pid) == found[pid]:
                    signal.pidfd_send_signal(descriptor, number)
        finally:
            os.close(descriptor)


def _environment(pid: int) -> list[bytes]:
    """What a process was started with; [b""] where it has none, or none any more. Raises OSError where it does not exist."""
    return Path(f"/proc/{pid}/environ").read_bytes().strip(b"\0").split(b"\0")


def _start_ticks(pid: int) -> int | None:
    """When a process started, in clock ticks since the kernel's start; None where there is none, or only a zombie."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in {"Z", "X"} else int(fields[19])


def _boot_id() -> str:
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
