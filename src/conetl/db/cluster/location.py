"""Location of a private cluster, the user who runs it, and commands run as that user. See `cluster.py`."""

from __future__ import annotations

import fcntl
import hashlib
import os
import pwd
import stat
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from conetl.db.cluster.postgres_install import OWN_DATABASE_HINT
from conetl.files.home import make_home
from conetl.model.errors import DatabaseError

#: Users that may run the server for root, in this order.
UNPRIVILEGED_USERS = ("postgres", "nobody")
#: Clusters of root whose home the server's user cannot reach.
SYSTEM_DIRECTORY = Path("/var/lib/conetl")
#: The kernel's limit on a socket's path.
MAX_SOCKET_PATH_BYTES = 107
LOCK_NAME, POINTER_NAME, HOME_NAME = "cluster.lock", "postgres.location", "home.path"


@dataclass(frozen=True)
class ClusterLocation:
    """One cluster: its folder, its socket's folder and its user."""

    directory: Path
    socket_directory: Path
    user: pwd.struct_passwd
    """The operating-system user that runs the server."""
    caller_name: str | None
    """Name of the calling user, None if that uid has no passwd entry."""

    @property
    def data(self) -> Path:
        return self.directory / "data"

    @property
    def pid_file(self) -> Path:
        return self.data / "postmaster.pid"

    @property
    def data_major(self) -> int | None:
        """Major version of the PostgreSQL that created the data; None without data."""
        try:
            return int((self.data / "PG_VERSION").read_text().strip())
        except FileNotFoundError:
            return None
        except PermissionError as error:
            raise DatabaseError(
                f"The private cluster in {self.directory} belongs to user {self.user.pw_name}: run as that user or as root, "
                f"choose another home folder (CONETL_HOME), {OWN_DATABASE_HINT}."
            ) from error


@contextmanager
def cluster_lock(home: Path) -> Iterator[None]:
    """Hold the home folder's cluster lock; waits for other processes; the kernel frees it when this one dies."""
    make_home(home)
    try:
        handle = os.open(home / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise DatabaseError(
            f"The home folder {home} cannot be used by user {_name_of(os.geteuid()) or os.geteuid()} ({error.strerror}): "
            f"choose another one (CONETL_HOME), {OWN_DATABASE_HINT}."
        ) from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def find_location(home: Path) -> ClusterLocation | None:
    """The cluster of `home`, None if none was created."""
    home = home.resolve()
    pointer = home / POINTER_NAME
    directory = Path(pointer.read_text().strip()) if pointer.is_file() else home / "postgres"
    if not directory.is_dir():
        return None
    if pointer.is_file() and (directory.parent != SYSTEM_DIRECTORY or not _belongs_to(directory, home)):
        return None  # a copied home: its pointer names the cluster of the original
    owner = _user_of(directory.stat().st_uid, f"The private cluster in {directory} belongs to ")
    if os.geteuid() not in (0, owner.pw_uid):
        raise DatabaseError(
            f"The private cluster in {directory} belongs to user {owner.pw_name}: run as that user or as root, "
            f"choose another home folder (CONETL_HOME), {OWN_DATABASE_HINT}."
        )
    return _location(directory, owner)


def make_location(home: Path) -> ClusterLocation:
    """Choose and create the folder of a new cluster."""
    home = home.resolve()
    user = server_user()
    directory = home / "postgres"
    if not _prepare(directory, user):
        directory = SYSTEM_DIRECTORY / _digest(home)
        SYSTEM_DIRECTORY.mkdir(mode=0o755, parents=True, exist_ok=True)
        if directory.is_dir() and not _belongs_to(directory, home):
            raise DatabaseError(f"{directory} belongs to another project: remove it, {OWN_DATABASE_HINT}.")
        if not _prepare(directory, user):
            raise DatabaseError(
                f"User {user.pw_name}, who runs PostgreSQL for root, can reach neither {home / 'postgres'} nor {directory}: "
                f"choose another home folder (CONETL_HOME), {OWN_DATABASE_HINT}."
            )
        (directory / HOME_NAME).write_text(f"{home}\n")
        (home / POINTER_NAME).write_text(f"{directory}\n")
    return _location(directory, user)


def make_socket_directory(location: ClusterLocation) -> None:
    """Create the socket's folder, mode 0700, owned by the server's user; refuse one that another user prepared in /tmp."""
    path = location.socket_directory
    try:
        path.mkdir(mode=0o700)
        os.chown(path, location.user.pw_uid, location.user.pw_gid, follow_symlinks=False)
    except FileExistsError:
        found = path.lstat()
        mine = found.st_uid in (location.user.pw_uid, os.geteuid())
        if not stat.S_ISDIR(found.st_mode) or not mine or stat.S_IMODE(found.st_mode) & 0o077:
            raise DatabaseError(
                f"{path} should be a folder of user {location.user.pw_name} with mode 0700 for the socket, but is not: "
                f"remove it, {OWN_DATABASE_HINT}."
            ) from None
        if found.st_uid != location.user.pw_uid:
            os.chown(path, location.user.pw_uid, location.user.pw_gid, follow_symlinks=False)


def run_as(
    location: ClusterLocation, command: list[str], *, timeout_s: float, stdin: str = "", inherit: tuple[int, ...] = ()
) -> subprocess.CompletedProcess[str]:
    """Run a command as the cluster's user in the cluster's folder, with an environment of its own.

    No PG* variable may lead PostgreSQL's programs to another server; messages are in English, all of them in `stdout`. inherit:
    open files that the command and its children keep.
    """
    other = os.geteuid() != location.user.pw_uid
    try:
        return subprocess.run(
            command,
            input=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            cwd=location.directory,
            env={"PATH": os.defpath, "LC_ALL": "C"},
            start_new_session=True,
            timeout=timeout_s,
            check=False,
            user=location.user.pw_uid if other else None,
            group=location.user.pw_gid if other else None,
            extra_groups=[] if other else None,
            umask=0o077,
            pass_fds=inherit,
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(
            command, 124, f"{Path(command[0]).name} did not finish within {timeout_s:.0f} s"
        )
    except OSError as error:
        return subprocess.CompletedProcess(command, 126, f"{command[0]}: {error.strerror}")


def working_folder(location: ClusterLocation, pid: int) -> str | None:
    """Working folder of a process of the cluster's user; None if it is dead, a zombie, or another user's.

    Read as that user: root in a container may lack the right to inspect other users' processes.
    """
    link = f"/proc/{pid}/cwd"
    if os.geteuid() == location.user.pw_uid:
        try:
            return os.readlink(link)  # noqa: PTH115 -- Path would not distinguish a dead process from a strange path
        except OSError:
            return None
    done = run_as(location, ["readlink", "-n", link], timeout_s=10)
    return done.stdout if done.returncode == 0 else None


def server_user() -> pwd.struct_passwd:
    """The user who runs a new cluster of this user. Raises DatabaseError if root finds none."""
    if os.geteuid() != 0:
        return _user_of(os.geteuid())
    for name in UNPRIVILEGED_USERS:
        with suppress(KeyError):
            return pwd.getpwnam(name)
    raise DatabaseError(
        f"PostgreSQL refuses to run as root and there is neither a user {' nor a user '.join(UNPRIVILEGED_USERS)}: "
        f"run as an ordinary user, {OWN_DATABASE_HINT}."
    )


def _location(directory: Path, user: pwd.struct_passwd) -> ClusterLocation:
    socket_directory = directory / "socket"
    if len(os.fsencode(socket_directory / ".s.PGSQL.00000")) > MAX_SOCKET_PATH_BYTES:
        socket_directory = Path("/tmp") / f"conetl-{_digest(directory)}"
    return ClusterLocation(directory, socket_directory, user, _name_of(os.geteuid()))


def _user_of(uid: int, what: str = "") -> pwd.struct_passwd:
    try:
        return pwd.getpwuid(uid)
    except KeyError:
        raise DatabaseError(
            f"{what}uid {uid}, which has no entry in the passwd file; PostgreSQL requires one: add it, {OWN_DATABASE_HINT}."
        ) from None


def _prepare(directory: Path, user: pwd.struct_passwd) -> bool:
    """Create the folder, mode 0700, owned by `user`; False if that user cannot use it."""
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.geteuid() == 0:
            os.chown(directory, user.pw_uid, user.pw_gid, follow_symlinks=False)
    except OSError:
        return False
    probe = ["sh", "-c", 'test -w "$0" && test -x "$0"', str(directory)]
    works = run_as(ClusterLocation(Path("/"), directory, user, None), probe, timeout_s=10).returncode == 0
    if not works:
        with suppress(OSError):
            directory.rmdir()
    return works


def _belongs_to(directory: Path, home: Path) -> bool:
    """Whether the cluster was created for `home`, or for a home that was moved here."""
    marker = directory / HOME_NAME
    if not marker.is_file():
        return False
    made_for = Path(marker.read_text().strip())
    if made_for == home:
        return True
    if (made_for / POINTER_NAME).is_file():
        return False
    marker.write_text(f"{home}\n")
    return True


def _digest(path: Path) -> str:
    return hashlib.sha256(os.fsencode(path)).hexdigest()[:16]


def _name_of(uid: int) -> str | None:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return None
