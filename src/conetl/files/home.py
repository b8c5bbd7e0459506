"""The home folder (CONETL_HOME): open to its owner only, unless it is shared with a group on purpose; and its secrets."""

from __future__ import annotations

import grp
import os
import secrets
import shutil
import stat
from contextlib import suppress
from pathlib import Path

from pydantic import SecretStr

from conetl.model.errors import InputError, write_error

FOLDERS = ("exports", "images", "inbox", "logs", "plans", "prefect", "receipts", "results")
#: What `share_home` shares; the others hold secrets (the log of the view its token), or images and drives of others.
SHARED = ("exports", "results")
PREFECT_LOGIN, VIEW_TOKEN, WRITER_TOKEN = "prefect_login", "view_token", "writer_token"
MIN_SECRET_LENGTH = 16
_OTHERS, _GROUP = 0o007, 0o070


def make_home(home: Path) -> None:
    """Create the home folder and its folders, and take away what other users may do in them. Raises InputError.

    A home folder of root lets other users pass through (mode 0711), since PostgreSQL does not run as root. A folder that was
    there before keeps its own mode: it may hold more than conetl's. A group keeps its rights to what `share_home` shared, as
    the set-group-ID bit shows.
    """
    try:
        if not home.is_dir():
            home.mkdir(mode=0o700, parents=True, exist_ok=True)
            home.chmod(0o711 if os.geteuid() == 0 else 0o700)
        for folder in (home / name for name in FOLDERS):
            folder.mkdir(mode=0o700, exist_ok=True)
            info = folder.stat()
            is_shared = folder.name in SHARED and info.st_mode & stat.S_ISGID
            closed = info.st_mode & ~(_OTHERS if is_shared else _OTHERS | _GROUP)
            if closed != info.st_mode and info.st_uid == os.geteuid():
                folder.chmod(stat.S_IMODE(closed))
    except OSError as error:
        raise write_error(
            f"The home folder {home} cannot be used", "choose another one (CONETL_HOME)", error
        ) from error


def share_home(home: Path, group: str) -> None:
    """Let a group of the operating system read results, reports and exports (`SHARED`), and pass through the home folder to them.

    Raises InputError if there is no such group or this user may not give files to it.
    """
    make_home(home)
    try:
        gid = grp.getgrnam(group).gr_gid
        shutil.chown(home, group=gid)
        mode = stat.S_IMODE(home.stat().st_mode)
        home.chmod(
            (mode & ~0o2060 if mode & stat.S_ISGID else mode) | 0o010
        )  # an earlier version shared its list of names
        for name in SHARED:
            for folder, _, files in os.walk(home / name):
                _share(Path(folder), gid)
                for file in files:
                    _share(Path(folder, file), gid)
    except KeyError:
        raise InputError(f"this machine has no group {group}: create it, or name another one") from None
    except OSError as error:
        raise InputError(f"{home} cannot be given to the group {group}: {error.strerror} ({error.filename})") from error


def home_access(home: Path) -> str:
    """Who may read what is in the home folder: `owner only`, `owner and group NAME (folders)` or `everybody (names)`."""
    found = {path.name: path.stat() for path in sorted(home.iterdir())} if home.is_dir() else {}
    open_to_all = [name for name, entry in found.items() if entry.st_mode & _OTHERS]
    if open_to_all and home.stat().st_mode & _OTHERS:
        return f"everybody ({', '.join(open_to_all)})"
    shared = {
        name: entry.st_gid for name, entry in found.items() if entry.st_mode & _GROUP and stat.S_ISDIR(entry.st_mode)
    }
    groups = ", ".join(sorted({_group_name(gid) for gid in shared.values()}))
    return f"owner and group {groups} ({', '.join(shared)})" if shared else "owner only"


def make_secret(path: Path, prefix: str = "") -> Path:
    """The file `path` (mode 600) in the home folder, created with `prefix` and 256 random bits if it is missing.

    Raises StorageError where the disk is full, and leaves no part of it.
    """
    make_home(path.parent)
    with suppress(FileExistsError):
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
        try:
            with os.fdopen(handle, "w") as file:
                file.write(f"{prefix}{secrets.token_urlsafe(32)}\n")
        except OSError as error:
            path.unlink()
            raise write_error(f"{path} cannot be written", "set CONETL_HOME to another folder", error) from error
    return path


def read_secret(path: Path) -> SecretStr:
    """The secret in a file. Raises InputError if it is unreadable, accessible to others or too short; never quotes it."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        text = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeError) as error:
        raise InputError(f"the secret in {path} cannot be read: {type(error).__name__}") from error
    if mode & (_OTHERS | _GROUP):
        raise InputError(f"{path} may be read or written by others (mode {mode:o}): run `chmod 600 {path}`")
    return validated_secret(SecretStr(text), f"the file {path}")


def view_token(home: Path) -> SecretStr:
    """The token for readers of the web view, from its file in the home folder; a missing one is created."""
    return read_secret(make_secret(home / VIEW_TOKEN))


def login_address(address: str, token: SecretStr | None) -> str:
    """The address that logs a browser in to the web view."""
    return f"{address.rstrip('/')}/?token={token.get_secret_value()}" if token else address


def validated_secret(secret: SecretStr, source: str) -> SecretStr:
    """The secret, if it is long enough and can be sent in a header. Raises InputError."""
    text = secret.get_secret_value()
    if len(text) < MIN_SECRET_LENGTH or not text.isascii() or not text.isprintable() or " " in text:
        raise InputError(
            f"{source} must hold at least {MIN_SECRET_LENGTH} printable ASCII characters without a space: remove it to get a "
            "new one, or write a longer one"
        )
    return secret


def _group_name(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _share(path: Path, gid: int) -> None:
    if path.is_symlink():
        return
    shutil.chown(path, group=gid)
    path.chmod(stat.S_IMODE(path.stat().st_mode) | (0o2050 if path.is_dir() else 0o040))
