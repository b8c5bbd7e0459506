"""Where the server of a private cluster runs: in this PID namespace, in another container, or on another machine.

A process id means nothing outside its namespace, so in a shared home folder the server of another container looks like a dead
one; and two servers on one data folder destroy it. Beside the data are `server.host`, the host that started the server, and
`server.lock`, which every process of the server keeps locked through an inherited file. The kernel shares the lock among all
containers of a machine, and releases it however the server ends.
"""

from __future__ import annotations

import fcntl
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from conetl.db.cluster.location import ClusterLocation, run_as
from conetl.model.errors import DatabaseError

HOST_NAME, LOCK_NAME = "server.host", "server.lock"


@dataclass(frozen=True)
class ServerHost:
    """Where a server was started."""

    host: str
    boot_id: str
    """Of the kernel: new with each start of the machine, the same in all its containers."""
    pid_namespace: str
    locked: bool = False
    """The server was seen to hold `server.lock`."""


def this_host() -> ServerHost:
    """Where this process runs; fields that the kernel does not provide (some sandboxes) are empty."""
    boot_id = namespace = ""
    with suppress(OSError):
        boot_id = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    with suppress(OSError):
        namespace = os.readlink("/proc/self/ns/pid")  # noqa: PTH115 -- not a path, but a name of the kernel
    return ServerHost(socket.gethostname(), boot_id, namespace)


def require_no_server_elsewhere(location: ClusterLocation, *, to_stop: bool = False) -> None:
    """Raises DatabaseError if a server of another container or machine may be running. Call if no local process is the server."""
    host = host_elsewhere(location)
    if host is None:
        return
    remedy = (
        "stop it there. Nothing was stopped."
        if to_stop
        else "a second server would destroy its data. Give this one its own home folder (CONETL_HOME), or let both use "
        "one PostGIS by CONETL_DATABASE_URL."
    )
    raise DatabaseError(
        f"The private PostGIS cluster in {location.directory} is used by another machine or container (host {host}): {remedy} If "
        f"that server is known to be dead, remove {location.pid_file}."
    )


def host_elsewhere(location: ClusterLocation) -> str | None:
    """Name of the other machine or container that may run the server; None if certainly none does.

    Call if no local process is the server.
    """
    if not location.pid_file.exists():
        return None
    started = _read_host(location)
    return None if started is None or _is_gone(location, started, this_host()) else started.host


@contextmanager
def lock_for_server(location: ClusterLocation) -> Iterator[int]:
    """A file for the server to inherit, and to keep while any of its processes runs. Records the server's host."""
    _write_host(location, this_host())
    handle = os.open(location.directory / LOCK_NAME, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        # Shared: processes of a server that was killed may hold it for another moment.
        fcntl.flock(handle, fcntl.LOCK_SH)
        yield handle
    finally:
        os.close(handle)
    # A shell may have closed it before the server started; then a free lock does not show that the server has ended.
    _write_host(location, replace(this_host(), locked=_is_locked(location)))


def _is_gone(location: ClusterLocation, started: ServerHost, here: ServerHost) -> bool:
    """Whether a server that is not a local process is certainly dead."""
    if started.boot_id == here.boot_id and started.pid_namespace == here.pid_namespace:
        return True
    if started.locked and _is_locked(location):
        return False
    if started.boot_id == here.boot_id:  # another container: the same kernel keeps its locks
        return started.locked
    return started.host == here.host  # the machine was started again


def _is_locked(location: ClusterLocation) -> bool:
    """Whether any process holds the lock; True if that cannot be determined."""
    try:
        handle = os.open(location.directory / LOCK_NAME, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def _read_host(location: ClusterLocation) -> ServerHost | None:
    """None if nothing was recorded."""
    try:
        return ServerHost(**json.loads((location.directory / HOST_NAME).read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError) as error:
        raise DatabaseError(
            f"{location.directory / HOST_NAME} should name the host of the private cluster's server, but is invalid ({error}): "
            "remove it once no server of these data runs on any machine."
        ) from error


def _write_host(location: ClusterLocation, host: ServerHost) -> None:
    """As the server's user, who owns the folder: all of it or nothing."""
    script = 'cat > "$0.new" && mv -T "$0.new" "$0" && touch "$1"'
    command = ["sh", "-c", script, HOST_NAME, LOCK_NAME]
    done = run_as(location, command, stdin=json.dumps(asdict(host)) + "\n", timeout_s=10)
    if done.returncode != 0:
        raise DatabaseError(
            f"{location.directory / HOST_NAME} could not be written (as user {location.user.pw_name}): {done.stdout.strip()}"
        )
