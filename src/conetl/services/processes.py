"""Background processes: start, find again and stop them, without ever signalling a process of someone else.

Process ids are reused, so a service is identified by a token in its environment. Its children inherit the token, so the children
of a killed service are found as well. Signals go through psutil, which checks that an id still is that of the same process.

Also a Prefect server from outside, without importing Prefect: its command, its health, access to it.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from uuid import uuid4

import httpx
import psutil

from conetl.files.atomic import write_json
from conetl.files.home import make_home
from conetl.model.errors import InputError, ServiceError, storage_error, write_error

TOKEN = "CONETL_SERVICE_TOKEN"
_STATE, _LOCK = "services.json", "services.lock"
_MAX_LOG_BYTES = 20_000_000
_PR_SET_PDEATHSIG = 1
_TIMEOUT_S = 5


@dataclass(frozen=True)
class Service:
    """One started process, as recorded in the home folder."""

    name: str
    pid: int
    token: str
    started_at: str
    log: str
    address: str | None


@contextmanager
def services_lock(home: Path) -> Iterator[None]:
    """Lock the services of a home folder while one command starts or stops them. Raises InputError if the folder cannot be
    used."""
    make_home(home)
    with (home / _LOCK).open("w") as handle:
        os.fchmod(handle.fileno(), 0o600)
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def read_services(home: Path) -> dict[str, Service]:
    """The recorded services of a home folder, running or not. Raises InputError if they cannot be read."""
    path = home / _STATE
    try:
        return {row["name"]: Service(**row) for row in json.loads(path.read_text(encoding="utf-8"))}
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}): use a home folder of your own (CONETL_HOME)"
        ) from error
    except (ValueError, TypeError, KeyError) as error:
        raise ServiceError(f"{path} is invalid ({error}): remove it when none of its services is running") from error


def write_services(home: Path, services: Mapping[str, Service]) -> None:
    """Record the services of a home folder, for its owner only."""
    write_json(home / _STATE, [asdict(service) for service in services.values()], private=True)


def start_service(
    name: str,
    command: Sequence[str],
    *,
    home: Path,
    environment: Mapping[str, str],
    address: str | None,
    die_with_parent: bool = False,
) -> Service:
    """Start a process in its own session; its output goes to `home/logs/<name>.log`.

    die_with_parent: on Linux, the kernel stops it when this process ends, however it ends.
    """
    log = home / "logs" / f"{name}.log"
    make_home(home)
    if log.exists() and log.stat().st_size > _MAX_LOG_BYTES:
        log.replace(log.with_suffix(".log.1"))
    token, now = uuid4().hex, datetime.now(UTC)
    with log.open("ab", buffering=0) as output:
        try:
            output.write(f"--- {now:%Y-%m-%d %H:%M:%S} UTC: starting {name}\n".encode())
        except OSError as error:
            raise write_error(f"{log} cannot be written", "set CONETL_HOME to another folder", error) from error
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
            env={**environment, TOKEN: token},
            preexec_fn=_die_with_parent if die_with_parent and sys.platform == "linux" else None,  # noqa: PLW1509
        )  # fmt: skip
    # Linux shows no environment for a moment while a program replaces its parent's: without it the service would not be found.
    deadline = time.monotonic() + 1
    service = Service(name, process.pid, token, now.isoformat(timespec="seconds"), str(log.resolve()), address)
    while process.poll() is None and not is_running(service) and time.monotonic() < deadline:
        time.sleep(0.001)
    return service


def is_running(service: Service) -> bool:
    """Whether the service still runs."""
    return _has_token(service.pid, service.token)


def stop_service(service: Service, *, grace_s: float = 15.0) -> bool:
    """Stop a service and its children; returns whether anything was running. Data and logs are kept."""
    found = _processes_with(service.token)
    if not found:
        return False
    deadline = time.monotonic() + grace_s
    # The leader first: it stops its own children in order.
    _end({process for process in found if process.pid == service.pid}, psutil.Process.terminate, grace_s)
    found |= _processes_with(service.token)
    _end(found, psutil.Process.terminate, max(deadline - time.monotonic(), 0.0))
    _end(found | _processes_with(service.token), psutil.Process.kill, 5)
    return True


def log_tail(service: Service) -> str:
    """The last 15 lines of a service's log."""
    try:
        with Path(service.log).open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 20_000))
            return "\n".join(file.read().decode(errors="replace").splitlines()[-15:])
    except OSError:
        return ""


def wait_healthy(service: Service, is_healthy: Callable[[], bool], timeout_s: float) -> None:
    """Wait until a service is ready. Raises ServiceError with the end of its log if it stops or takes too long."""
    deadline = time.monotonic() + timeout_s
    while not is_healthy():
        problem = None
        if not is_running(service):
            problem = "stopped while starting"
        elif time.monotonic() > deadline:
            problem = f"was not ready within {timeout_s:.0f} s"
        if problem:
            raise ServiceError(f"{service.name} {problem}; the end of {service.log}:\n{log_tail(service)}")
        time.sleep(0.2)  # each check costs the starting service time


def free_port(host: str, port: int, what: str, option: str) -> socket.socket:
    """A socket that is bound to the port. Raises InputError if a program already listens there."""
    bound = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        raise InputError(
            f"port {port} of {host}, for {what}, cannot be used ({error.strerror}): stop the program that uses it, or choose "
            f"another port with {option}"
        ) from error
    return bound


def _die_with_parent() -> None:
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _processes_with(token: str) -> set[psutil.Process]:
    """Processes that were started with this token, without zombies and processes of other users."""
    return {one for one in psutil.process_iter() if one.pid != os.getpid() and _has_token(one.pid, token)}


def _has_token(pid: int, token: str) -> bool:
    try:
        return bool(psutil.Process(pid).environ().get(TOKEN) == token)
    except psutil.Error:
        return False


def _end(found: Collection[psutil.Process], signal_it: Callable[[psutil.Process], None], timeout_s: float) -> None:
    """Signal processes and wait until they have ended."""
    for process in found:
        with suppress(psutil.NoSuchProcess):
            signal_it(process)
    psutil.wait_procs(found, timeout=timeout_s)


def server_command(host: str, port: int) -> list[str]:
    """Command line of a Prefect server that answers to its own names only."""
    return [sys.executable, "-m", "flows.server_app", host, str(port)]


def answers(url: str) -> bool:
    """Whether GET `url` returns 200 or requires a login."""
    try:
        answer = httpx.get(url, timeout=_TIMEOUT_S, trust_env=False)
        return answer.status_code in (httpx.codes.OK, httpx.codes.UNAUTHORIZED)
    except httpx.HTTPError:
        return False


def is_healthy(api: str) -> bool:
    """Whether a Prefect API answers; this requires no password."""
    return answers(f"{api}/health")


def require_access(api: str, auth: str | None, variable: str) -> None:
    """Raise ServiceError if a server rejects `auth` (user:password), naming the `variable` to set.

    Checked first because each of Prefect's clients fails differently. A server that does not answer is ignored.
    """
    credentials = None if auth is None else httpx.BasicAuth(*auth.partition(":")[::2])
    try:
        answer = httpx.get(f"{api}/admin/version", auth=credentials, timeout=_TIMEOUT_S, trust_env=False)
    except httpx.HTTPError:
        return
    if answer.status_code == httpx.codes.UNAUTHORIZED:
        given = "none was given" if auth is None else "it rejected the one given"
        raise ServiceError(
            f"the Prefect server at {api} requires a user and password, and {given}: set {variable} to the user:password that "
            "the server was started with. Nothing was written."
        )


def require_configured(api: str, auth: str | None) -> None:
    """Raise ServiceError if the server of PREFECT_API_URL does not answer, or rejects `auth` (PREFECT_API_AUTH_STRING)."""
    if not is_healthy(api):
        raise ServiceError(
            f"no Prefect server answers at PREFECT_API_URL, {api}. Start it, or unset PREFECT_API_URL to let conetl start one "
            "for this command. Nothing was written."
        )
    require_access(api, auth, "PREFECT_API_AUTH_STRING")


def unavailable(error: BaseException) -> ServiceError | None:
    """The error if a Prefect server, or its database, stopped answering, or a disk is full; None for other causes.

    If conetl detected first that a service is gone, and Prefect failed because of that, it is conetl's error.
    """
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in chain:
        chain.append(cause)
        cause = cause.__cause__ or cause.__context__
    for cause in chain:
        if isinstance(cause, ServiceError):
            return cause
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            return storage_error(cause)
    for cause in chain:
        failed = (
            isinstance(cause, httpx.HTTPStatusError) and cause.response.status_code >= httpx.codes.INTERNAL_SERVER_ERROR
        )
        if failed or isinstance(cause, httpx.TransportError):
            said = str(cause).partition("\n")[0].partition(" - ")[0] or type(cause).__name__
            return ServiceError(
                f"the Prefect server stopped answering ({said}); it may have lost its database, which is PostgreSQL under "
                "`conetl up`. `conetl status` shows what runs; run the same command again: what is on the map stays."
            )
    return None
