"""conetl's private PostGIS cluster: one per home folder, reachable through a unix socket only.

Location. An ordinary user's cluster is `HOME/postgres/`. PostgreSQL refuses to run as root, so for root it runs as the user
`postgres` (else `nobody`); if that user cannot reach `HOME/postgres` (a parent folder with mode 0700), the cluster is in
`/var/lib/conetl/<hash of HOME>/`, and the pointer file `HOME/postgres.location` names it.

Access. No TCP port; the socket and its folder have mode 0700, and the kernel identifies the client (`peer`): only root, the
server's user and the user who made the cluster may connect.

Shared homes. Only one server at a time: if a home is on a volume of several containers or machines, a server of another one is
found (`owner.py`) and no second one is started.

Durability. fsync is on, so a killed server or machine loses nothing that was committed; `cluster_up` clears a stale
`postmaster.pid`, and may be called at any time and by several processes at once.
"""

from __future__ import annotations

import errno
import os
import shlex
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import quote
from uuid import uuid4

from conetl.db.cluster import location as places
from conetl.db.cluster.location import ClusterLocation, run_as
from conetl.db.cluster.owner import host_elsewhere, lock_for_server, require_no_server_elsewhere
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
    # A drive of 100,000 sightings writes 130 MB of log; with the default of 8 MB the session waits for it repeatedly.
    "wal_buffers": "32MB",
    "wal_level": "minimal",
    "max_wal_senders": "0",
    "fsync": "on",
    "synchronous_commit": "on",
    # Parallel plans require /dev/shm, of which a container has little, and gain nothing on two cores.
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
    # A box of a map that was not read lately is on a hundred pages: they are read together.
    SERVER_SETTINGS["effective_io_concurrency"] = "64"


@dataclass(frozen=True)
class ClusterStatus:
    """State of a private cluster."""

    state: Literal["absent", "stopped", "running", "running elsewhere"]
    url: str | None
    """libpq URL; None unless running."""
    directory: Path | None
    """Holds the data, the log and, if its path is short enough, the socket; None if absent."""
    socket_directory: Path | None
    log_directory: Path | None
    server_user: str | None
    postgres_major: int | None
    pid: int | None
    host: str | None
    """The other machine or container where it runs; None otherwise."""


def cluster_up(home: Path) -> str:
    """Start the private cluster of `home`, created if it is missing. Returns the libpq URL of its database.

    Idempotent and safe against a second call at the same time. Raises `DatabaseError` if PostGIS is not installed, the cluster
    belongs to another user or is used by another machine or container, or the server does not start (with the end of its log).
    """
    with places.cluster_lock(home):
        location = places.find_location(home) or places.make_location(home)
        if not _is_answering(location):
            install = choose_install(find_installs(), data_major=location.data_major)
            if location.data_major is None:
                _initialise(location, install)
            _start(location, install)
        return _url(location)


def cluster_down(home: Path) -> bool:
    """Stop the private cluster of `home`; True if it was running. Data stay.

    Raises `DatabaseError` if it does not stop, or runs on another machine or container.
    """
    if not home.is_dir():
        return False
    with places.cluster_lock(home):
        location = places.find_location(home)
        if location is None:
            return False
        if _running_pid(location) is None:
            require_no_server_elsewhere(location, to_stop=True)
            return False
        _stop(location)
        return True


def cluster_status(home: Path) -> ClusterStatus:
    """State of the cluster; changes nothing and requires no PostgreSQL."""
    location = places.find_location(home) if home.is_dir() else None
    if location is None or location.data_major is None:
        return ClusterStatus("absent", None, None, None, None, None, None, None, None)
    pid = _running_pid(location)
    host = None if pid else host_elsewhere(location)
    return ClusterStatus(
        state="running" if pid else "stopped" if host is None else "running elsewhere",
        url=_url(location) if pid else None,
        directory=location.directory,
        socket_directory=location.socket_directory,
        log_directory=location.directory / "log",
        server_user=location.user.pw_name,
        postgres_major=location.data_major,
        pid=pid,
        host=host,
    )


def _url(location: ClusterLocation) -> str:
    return f"postgresql://{SUPERUSER}@/{DATABASE}?host={quote(str(location.socket_directory), safe='')}&port={PORT}"


def _initialise(location: ClusterLocation, install: PostgresInstall) -> None:
    """Make the data folder under a temporary name first, so that a kill leaves nothing that looks like a cluster.

    The name is new each time, because initdb survives a caller that was killed and continues to write into it.
    """
    new = f"{NEW_DATA_PREFIX}{uuid4().hex}"
    initdb = [install.program("initdb"), "-D", new, "-U", SUPERUSER, "-A", "peer", "-E", "UTF8", "--locale=C", "-k"]
    _run(location, initdb, "PostgreSQL could not create a new cluster", timeout_s=120)
    allowed = dict.fromkeys([location.user.pw_name, location.caller_name, "root"])
    _write_as(location, f"{new}/pg_hba.conf", f"local all all peer map={SUPERUSER}\n")
    _write_as(location, f"{new}/pg_ident.conf", "".join(f'{SUPERUSER} "{n}" {SUPERUSER}\n' for n in allowed if n))
    single = [install.program("postgres"), "--single", "-D", new, "postgres"]
    what, statement = f"PostgreSQL could not create the database {DATABASE}", f"create database {DATABASE}\n"
    said = _run(location, single, what, stdin=statement, timeout_s=120)
    if any(word in said for word in ("ERROR:", "FATAL:", "PANIC:")):  # it ends with success
        raise DatabaseError(f"{what} in {location.directory}: {said.strip()}")
    _run(location, ["mkdir", "-p", "log"], "the log folder could not be created")
    _run(location, ["mv", "-T", new, "data"], "the new cluster could not be renamed")


def _start(location: ClusterLocation, install: PostgresInstall) -> None:
    pid = _running_pid(location)
    if pid is not None:
        # Running but not answering: still starting or recovering, or its socket was removed from /tmp.
        if _wait_until_answering(location, START_TIMEOUT_S if _socket_file(location).exists() else 2):
            return
        _stop(location)
    require_no_server_elsewhere(location)
    places.make_socket_directory(location)
    _remove_stale_files(location)
    _sweep(location)
    settings = SERVER_SETTINGS | {
        "unix_socket_directories": '"' + str(location.socket_directory).replace('"', '""') + '"',
        "port": str(PORT),
        "log_directory": "../log",
    }
    options = " ".join(f"-c {shlex.quote(f'{name}={value}')}" for name, value in settings.items())
    # Relative paths: pg_ctl puts them into a shell command unquoted for `$`.
    command = [install.program("pg_ctl"), "start", "-D", "data", "-l", "log/start.log", "-w"]
    command += ["-t", str(START_TIMEOUT_S), "-o", options]
    with lock_for_server(location) as lock:
        _run_server(location, command, lock)


def _run_server(location: ClusterLocation, command: list[str], lock: int) -> None:
    deadline = time.monotonic() + 15
    while True:
        started = run_as(location, command, timeout_s=START_TIMEOUT_S + 30, inherit=(lock,))
        if started.returncode == 0 and _wait_until_answering(location, 5):
            return
        # Workers of a server that was killed hold its shared memory until they notice, which takes a moment.
        log = _log_tail(location)
        if os.strerror(errno.ENOSPC) in log:
            raise DatabaseError(
                f"The private PostGIS cluster in {location.directory} does not start, because the disk is full: free space there "
                "and run the same command again. What was committed is kept."
            )
        if "shared memory block" not in log or time.monotonic() > deadline:
            raise DatabaseError(
                f"The private PostGIS cluster in {location.directory} does not start: {started.stdout.strip()}\n"
                f"{log}\nRemove the cause, {OWN_DATABASE_HINT}."
            )
        time.sleep(0.5)


def _stop(location: ClusterLocation) -> None:
    install = choose_install(find_installs(), data_major=location.data_major)
    for mode, timeout_s in (("fast", 60), ("immediate", 20)):
        stop = [install.program("pg_ctl"), "stop", "-D", "data", "-m", mode, "-w", "-t", str(timeout_s)]
        stopped = run_as(location, stop, timeout_s=timeout_s + 10)
        if stopped.returncode == 0 or _running_pid(location) is None:
            return
    raise DatabaseError(f"The private PostGIS cluster in {location.directory} does not stop: {stopped.stdout.strip()}")


def _running_pid(location: ClusterLocation) -> int | None:
    """Process id of the server of these data, None if the pid file is missing or stale.

    A number alone proves nothing: after a restart it may belong to any process, and in a container without an init process a
    killed server stays as a zombie. A running server's working folder is its data folder.
    """
    try:
        pid = int(location.pid_file.read_text().split("\n", 1)[0])
    except (OSError, ValueError):
        return None
    return pid if places.working_folder(location, pid) == os.path.realpath(location.data) else None


def _remove_stale_files(location: ClusterLocation) -> None:
    """Remove files that PostgreSQL would trust if another process now had their process id."""
    if _running_pid(location) is None:
        location.pid_file.unlink(missing_ok=True)
        _socket_file(location).with_name(f"{_socket_file(location).name}.lock").unlink(missing_ok=True)


def _socket_file(location: ClusterLocation) -> Path:
    return location.socket_directory / f".s.PGSQL.{PORT}"


def _is_answering(location: ClusterLocation) -> bool:
    if location.data_major is None or _running_pid(location) is None or not _socket_file(location).exists():
        return False
    for install in find_installs()[:1]:  # pg_isready of any version
        ready = [install.program("pg_isready"), "-q", "-h", str(location.socket_directory), "-p", str(PORT)]
        return run_as(location, ready, timeout_s=10).returncode == 0
    return False


def _wait_until_answering(location: ClusterLocation, timeout_s: float) -> bool:
    deadline = time.monotonic() + timeout_s
    while not _is_answering(location):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.1)
    return True


def _write_as(location: ClusterLocation, relative_path: str, text: str) -> None:
    _run(location, ["sh", "-c", 'cat > "$0"', relative_path], f"{relative_path} could not be written", stdin=text)


def _run(location: ClusterLocation, command: list[str], what: str, *, stdin: str = "", timeout_s: float = 10) -> str:
    """Run a command as the cluster's user. Returns what it printed. Raises `DatabaseError` that says `what` if it fails."""
    done = run_as(location, command, stdin=stdin, timeout_s=timeout_s)
    if done.returncode != 0:
        raise DatabaseError(f"{what} in {location.directory} (as user {location.user.pw_name}): {done.stdout.strip()}")
    return done.stdout


def _log_files(location: ClusterLocation) -> list[Path]:
    return sorted((location.directory / "log").glob("server-*.log"))


def _sweep(location: ClusterLocation) -> None:
    """Remove old logs and the remains of interrupted first starts."""
    for unfinished in location.directory.glob(f"{NEW_DATA_PREFIX}*"):
        shutil.rmtree(unfinished, ignore_errors=True)
    for old in _log_files(location)[: -KEPT_LOG_FILES + 1]:
        old.unlink(missing_ok=True)
    start_log = location.directory / "log" / "start.log"
    if start_log.exists() and start_log.stat().st_size > 1_000_000:
        start_log.unlink()


def _log_tail(location: ClusterLocation) -> str:
    lines: list[str] = []
    for path in [location.directory / "log" / "start.log", *_log_files(location)[-1:]]:
        if path.exists():
            lines += path.read_text(errors="replace").splitlines()[-10:]
    return "\n".join(lines)
