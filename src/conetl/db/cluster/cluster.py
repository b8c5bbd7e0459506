"""conetl's private PostGIS cluster: one per home folder, reachable through a unix socket only.

Where things lie. An ordinary user's cluster is `HOME/postgres/`. PostgreSQL refuses to run as root, so for root it runs as the
user `postgres` (else `nobody`); where that user cannot reach `HOME/postgres` (a parent folder with mode 0700) the cluster
lies in `/var/lib/conetl/<hash of HOME>/`, and the pointer file `HOME/postgres.location` says so.

Who may connect. No TCP port; the socket's folder and the socket have mode 0700, and the server asks the kernel who is at
the other end (`peer`): only root, the server's user and the user who made the cluster are let in.

Shared homes. Only one server at a time: where a home lies on a volume that several containers or machines see, a server of
another one is found (`cluster_owner.py`) and no second one is started.

What survives. fsync is on, so a killed server or machine loses nothing that was committed; `cluster_up` clears a stale
`postmaster.pid`, may be called again at any time, and by several processes at once.
"""

from __future__ import annotations

import os
import shlex
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import quote
from uuid import uuid4

from conetl.db.cluster.location import (
    ClusterPlace,
    Done,
    cluster_lock,
    find_place,
    forget_place,
    make_place,
    make_socket_directory,
    run_as,
    working_folder,
)
from conetl.db.cluster.owner import (
    host_elsewhere,
    lock_for_server,
    require_no_server_elsewhere,
    require_stopped_elsewhere,
)
from conetl.db.cluster.postgres_install import OWN_DATABASE_HINT, PostgresInstall, choose_install, find_installs
from conetl.model.errors import DatabaseError

DATABASE = "conetl"
SUPERUSER = "conetl"
PORT = 5432  # only names the socket file; nothing listens on TCP
KEPT_LOG_FILES = 5
NEW_DATA_PREFIX = "data.new."
START_TIMEOUT_S = 60

#: Small on purpose: the cluster shares the machine with the detector. Nothing here trades safety for speed.
SERVER_SETTINGS = {
    "listen_addresses": "",
    "unix_socket_permissions": "0700",
    "max_connections": "60",
    "shared_buffers": "256MB",
    "work_mem": "16MB",
    "maintenance_work_mem": "64MB",
    "max_wal_size": "1GB",
    # A drive of 100,000 sightings writes 130 MB of log; with the default of 8 MB the session waits for it again and again.
    "wal_buffers": "32MB",
    "wal_level": "minimal",
    "max_wal_senders": "0",
    "fsync": "on",
    "synchronous_commit": "on",
    # Parallel plans need /dev/shm, of which a container has little, and gain nothing on two cores.
    "max_parallel_workers_per_gather": "0",
    "max_parallel_maintenance_workers": "0",
    "jit": "off",
    "timezone": "UTC",
    "log_timezone": "UTC",
    # A client that was killed must not keep the map's lock until its statement ends.
    "client_connection_check_interval": "5s",
    "logging_collector": "on",
    "log_filename": "server-%Y%m%d-%H%M%S.log",
    "log_rotation_size": "5MB",
    "log_rotation_age": "0",
}
if hasattr(os, "posix_fadvise"):  # without it the server refuses this
    # A box of a map that nobody visited lately lies on a hundred pages: they are asked for together.
    SERVER_SETTINGS["effective_io_concurrency"] = "64"


@dataclass(frozen=True)
class ClusterStatus:
    """What there is of a private cluster."""

    state: Literal["absent", "stopped", "running", "running elsewhere"]
    url: str | None
    """libpq URL; None unless running."""
    directory: Path | None
    """Holds the data, the log and, where its path is short enough, the socket; None where absent."""
    socket_directory: Path | None
    log_directory: Path | None
    server_user: str | None
    postgres_major: int | None
    pid: int | None
    host: str | None
    """The other machine or container where it runs; None unless it is one."""


def cluster_up(home: Path) -> str:
    """Start the private cluster of `home`, making it first where there is none; the libpq URL of its database.

    Idempotent and safe against a second call at the same time. Raises `DatabaseError` where PostGIS is not installed, the
    cluster belongs to another user or is used by another machine or container, or the server does not start (with the end of
    its log).
    """
    with cluster_lock(home):
        place = find_place(home) or make_place(home)
        if not _is_answering(place):
            install = choose_install(find_installs(), data_major=place.data_major)
            if place.data_major is None:
                _initialise(place, install)
            _start(place, install)
        return _url(place)


def cluster_down(home: Path) -> bool:
    """Stop the private cluster of `home`; True where it was running. Data stay.

    Raises `DatabaseError` where it does not stop, or runs on another machine or container.
    """
    if not home.is_dir():
        return False
    with cluster_lock(home):
        place = find_place(home)
        if place is None:
            return False
        if _running_pid(place) is None:
            require_stopped_elsewhere(place)
            return False
        _stop(place)
        return True


def cluster_status(home: Path) -> ClusterStatus:
    """What there is; changes nothing and needs no PostgreSQL."""
    place = find_place(home) if home.is_dir() else None
    if place is None or place.data_major is None:
        return ClusterStatus("absent", None, None, None, None, None, None, None, None)
    pid = _running_pid(place)
    host = None if pid else host_elsewhere(place)
    return ClusterStatus(
        state="running" if pid else "stopped" if host is None else "running elsewhere",
        url=_url(place) if pid else None,
        directory=place.directory,
        socket_directory=place.socket_directory,
        log_directory=place.directory / "log",
        server_user=place.user.name,
        postgres_major=place.data_major,
        pid=pid,
        host=host,
    )


def cluster_remove(home: Path) -> bool:
    """Stop the private cluster of `home` and DELETE its data; True where there was one."""
    if not home.is_dir():
        return False
    with cluster_lock(home):
        place = find_place(home)
        if place is None:
            return False
        if _running_pid(place) is not None:
            _stop(place, data_are_needed=False)
        require_no_server_elsewhere(place)
        shutil.rmtree(place.socket_directory, ignore_errors=True)
        shutil.rmtree(place.directory)
        forget_place(home)
        return True


def _url(place: ClusterPlace) -> str:
    return f"postgresql://{SUPERUSER}@/{DATABASE}?host={quote(str(place.socket_directory), safe='')}&port={PORT}"


def _initialise(place: ClusterPlace, install: PostgresInstall) -> None:
    """Make the data folder under another name first: a kill in between leaves nothing that looks like a cluster.

    The name is new each time, because initdb outlives a caller that was killed and would go on writing into it.
    """
    new = f"{NEW_DATA_PREFIX}{uuid4().hex}"
    initdb = [install.program("initdb"), "-D", new, "-U", SUPERUSER, "-A", "peer", "-E", "UTF8", "--locale=C", "-k"]
    _must(run_as(place, initdb, timeout_s=120), "PostgreSQL could not make a new cluster", place)
    allowed = dict.fromkeys([place.user.name, place.caller_name, "root"])
    _write_as(place, f"{new}/pg_hba.conf", f"local all all peer map={SUPERUSER}\n")
    _write_as(place, f"{new}/pg_ident.conf", "".join(f'{SUPERUSER} "{n}" {SUPERUSER}\n' for n in allowed if n))
    single = [install.program("postgres"), "--single", "-D", new, "postgres"]
    made = run_as(place, single, stdin=f"create database {DATABASE}\n", timeout_s=120)
    if any(word in made.output for word in ("ERROR:", "FATAL:", "PANIC:")):
        raise DatabaseError(
            f"PostgreSQL could not make the database {DATABASE} in {place.directory}: {made.output.strip()}"
        )
    _must(made, f"PostgreSQL could not make the database {DATABASE}", place)
    _must(run_as(place, ["mkdir", "-p", "log"], timeout_s=10), "the log folder could not be made", place)
    _must(run_as(place, ["mv", "-T", new, "data"], timeout_s=10), "the new cluster could not be put in place", place)


def _start(place: ClusterPlace, install: PostgresInstall) -> None:
    pid = _running_pid(place)
    if pid is not None:
        # Alive but not answering: still starting or recovering, or its socket was swept away from /tmp.
        if _wait_until_answering(place, START_TIMEOUT_S if _socket_file(place).exists() else 2):
            return
        _stop(place)
    require_no_server_elsewhere(place)
    make_socket_directory(place)
    _remove_stale_files(place)
    _sweep(place)
    settings = SERVER_SETTINGS | {
        "unix_socket_directories": '"' + str(place.socket_directory).replace('"', '""') + '"',
        "port": str(PORT),
        "log_directory": "../log",
    }
    options = " ".join(f"-c {shlex.quote(f'{name}={value}')}" for name, value in settings.items())
    # Relative paths: pg_ctl puts them into a shell command unquoted for `$`.
    command = [install.program("pg_ctl"), "start", "-D", "data", "-l", "log/start.log", "-w"]
    command += ["-t", str(START_TIMEOUT_S), "-o", options]
    with lock_for_server(place) as lock:
        _run_server(place, command, lock)


def _run_server(place: ClusterPlace, command: list[str], lock: int) -> None:
    deadline = time.monotonic() + 15
    while True:
        started = run_as(place, command, timeout_s=START_TIMEOUT_S + 30, inherit=(lock,))
        if started.code == 0 and _wait_until_answering(place, 5):
            return
        # Workers of a server that was killed take a moment to notice, and hold its shared memory until then.
        if "shared memory block" not in _log_tail(place) or time.monotonic() > deadline:
            raise DatabaseError(
                f"The private PostGIS cluster in {place.directory} does not start: {started.output.strip()}\n"
                f"{_log_tail(place)}\nFree the cause, {OWN_DATABASE_HINT}."
            )
        time.sleep(0.5)


def _stop(place: ClusterPlace, *, data_are_needed: bool = True) -> None:
    install = choose_install(find_installs(), data_major=place.data_major)
    for mode, timeout_s in (("fast", 60), ("immediate", 20)) if data_are_needed else (("immediate", 20),):
        stop = [install.program("pg_ctl"), "stop", "-D", "data", "-m", mode, "-w", "-t", str(timeout_s)]
        stopped = run_as(place, stop, timeout_s=timeout_s + 10)
        if stopped.code == 0 or _running_pid(place) is None:
            return
    raise DatabaseError(f"The private PostGIS cluster in {place.directory} does not stop: {stopped.output.strip()}")


def _running_pid(place: ClusterPlace) -> int | None:
    """Process id of the server of these data, None where the pid file is missing or was left over by a dead one.

    A number alone proves nothing: after a restart it may be anybody's, and in a container without an init process a killed
    server stays as a zombie. A living server's working folder is its data folder.
    """
    try:
        pid = int((place.data / "postmaster.pid").read_text().split("\n", 1)[0])
    except (OSError, ValueError):
        return None
    return pid if working_folder(place, pid) == os.path.realpath(place.data) else None


def _remove_stale_files(place: ClusterPlace) -> None:
    """PostgreSQL trusts the numbers in these files when any process has them; here it is known better."""
    if _running_pid(place) is None:
        (place.data / "postmaster.pid").unlink(missing_ok=True)
        _socket_file(place).with_name(f"{_socket_file(place).name}.lock").unlink(missing_ok=True)


def _socket_file(place: ClusterPlace) -> Path:
    return place.socket_directory / f".s.PGSQL.{PORT}"


def _is_answering(place: ClusterPlace) -> bool:
    if place.data_major is None or _running_pid(place) is None or not _socket_file(place).exists():
        return False
    # Any install's pg_isready will do; it only says whether the server accepts sessions.
    for install in find_installs()[:1]:
        ready = [install.program("pg_isready"), "-q", "-h", str(place.socket_directory), "-p", str(PORT)]
        return run_as(place, ready, timeout_s=10).code == 0
    return False


def _wait_until_answering(place: ClusterPlace, timeout_s: float) -> bool:
    deadline = time.monotonic() + timeout_s
    while not _is_answering(place):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.1)
    return True


def _write_as(place: ClusterPlace, relative_path: str, text: str) -> None:
    done = run_as(place, ["sh", "-c", 'cat > "$0"', relative_path], stdin=text, timeout_s=10)
    _must(done, f"{relative_path} could not be written", place)


def _must(done: Done, what: str, place: ClusterPlace) -> None:
    if done.code != 0:
        raise DatabaseError(f"{what} in {place.directory} (as user {place.user.name}): {done.output.strip()}")


def _log_files(place: ClusterPlace) -> list[Path]:
    return sorted((place.directory / "log").glob("server-*.log"))


def _sweep(place: ClusterPlace) -> None:
    """Remove old logs and what interrupted first starts left."""
    for unfinished in place.directory.glob(f"{NEW_DATA_PREFIX}*"):
        shutil.rmtree(unfinished, ignore_errors=True)
    for old in _log_files(place)[: -KEPT_LOG_FILES + 1]:
        old.unlink(missing_ok=True)
    start_log = place.directory / "log" / "start.log"
    if start_log.exists() and start_log.stat().st_size > 1_000_000:
        start_log.unlink()


def _log_tail(place: ClusterPlace) -> str:
    lines: list[str] = []
    for path in [place.directory / "log" / "start.log", *_log_files(place)[-1:]]:
        if path.exists():
            lines += path.read_text(errors="replace").splitlines()[-10:]
    return "\n".join(lines)
