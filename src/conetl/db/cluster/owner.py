"""Where the server of a private cluster runs: in this PID namespace, in another container, or on another machine.

A process id says nothing outside of its namespace, so where a home folder is shared, the server of another container looks like
a dead one; and two servers on one data folder destroy it. Beside the data lie `server.host`, which says where the server was
started, and `server.lock`, which every process of the server holds locked by a file that it inherited: the kernel knows by it
across all containers of one machine whether the server lives, however it ended.
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

from conetl.db.cluster.location import ClusterPlace, run_as
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
    """Where this process runs; empty what the kernel does not tell (some sandboxes), so that it makes no difference."""
    boot_id = namespace = ""
    with suppress(OSError):
        boot_id = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    with suppress(OSError):
        namespace = os.readlink("/proc/self/ns/pid")  # noqa: PTH115 -- no path, but a name of the kernel's
    return ServerHost(socket.gethostname(), boot_id, namespace)


def require_no_server_elsewhere(place: ClusterPlace) -> None:
    """Call where no process here is the server. Raises DatabaseError where one of another container or machine may be."""
    host = host_elsewhere(place)
    if host is None:
        return
    raise DatabaseError(
        f"The private PostGIS cluster in {place.directory} is used by another machine or container (host {host}), and a "
        "second server would destroy its data. Give this one a home folder of its own (CONETL_HOME), or let both use one "
        f"PostGIS by CONETL_DATABASE_URL. Where that server is known to be dead, remove {_pid_file(place)}."
    )


def require_stopped_elsewhere(place: ClusterPlace) -> None:
    """Call where no process here is the server and none is to be. Raises DatabaseError where another place has it to stop."""
    host = host_elsewhere(place)
    if host is not None:
        raise DatabaseError(
            f"The private PostGIS cluster in {place.directory} runs on another machine or container (host {host}): stop it "
            f"there. Nothing was stopped. Where that server is known to be dead, remove {_pid_file(place)}."
        )


def host_elsewhere(place: ClusterPlace) -> str | None:
    """The other machine or container whose process may be the server, by its name; None where there is none for certain.

    Call where no process here is the server.
    """
    if not _pid_file(place).exists():
        return None
    started = _read_host(place)
    return None if started is None or _is_gone(place, started, this_host()) else started.host


@contextmanager
def lock_for_server(place: ClusterPlace) -> Iterator[int]:
    """A file for the server to inherit, and to hold as long as any of its processes lives. Writes down where it is started."""
    _write_host(place, this_host())
    handle = os.open(_lock_file(place), os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        # Shared: what is left of a server that was killed may hold it for a moment still.
        fcntl.flock(handle, fcntl.LOCK_SH)
        yield handle
    finally:
        os.close(handle)
    # A shell may have closed it on the way to the server: then a free lock proves nothing.
    _write_host(place, replace(this_host(), locked=_is_locked(place)))


def _is_gone(place: ClusterPlace, started: ServerHost, here: ServerHost) -> bool:
    """Whether a server that is no process here is dead for certain."""
    if started.boot_id == here.boot_id and started.pid_namespace == here.pid_namespace:
        return True
    if started.locked and _is_locked(place):
        return False
    if started.boot_id == here.boot_id:  # another container: the same kernel keeps its locks
        return started.locked
    return started.host == here.host  # the machine was started again


def _is_locked(place: ClusterPlace) -> bool:
    """Whether any process holds the lock; also where that cannot be known."""
    try:
        handle = os.open(_lock_file(place), os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
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


def _read_host(place: ClusterPlace) -> ServerHost | None:
    """None where nothing was written down: an older conetl started the server."""
    try:
        return ServerHost(**json.loads((place.directory / HOST_NAME).read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError) as error:
        raise DatabaseError(
            f"{place.directory / HOST_NAME} should say where the private cluster's server was started, but cannot be understood "
            f"({error}): remove it once no server of these data runs on any machine."
        ) from error


def _write_host(place: ClusterPlace, host: ServerHost) -> None:
    """As the server's user, who owns the folder: all of it or nothing."""
    script = 'cat > "$0.new" && mv -T "$0.new" "$0" && touch "$1"'
    command = ["sh", "-c", script, HOST_NAME, LOCK_NAME]
    done = run_as(place, command, stdin=json.dumps(asdict(host)) + "\n", timeout_s=10)
    if done.code != 0:
        raise DatabaseError(
            f"{place.directory / HOST_NAME} could not be written (as user {place.user.name}): {done.output.strip()}"
        )


def _pid_file(place: ClusterPlace) -> Path:
    return place.data / "postmaster.pid"


def _lock_file(place: ClusterPlace) -> Path:
    return place.directory / LOCK_NAME
