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
PREFECT_LOGIN, VIEW_TOKEN, WRITER_TOKEN = "prefect_login", "view_token", "writer_token"
SECRETS = (PREFECT_LOGIN, VIEW_TOKEN, WRITER_TOKEN)
MIN_SECRET_LENGTH = 16
_OTHERS, _GROUP = 0o007, 0o070


def make_home(home: Path) -> None:
    """Create the home folder and its folders, and take away what other users may do in them. Raises InputError.

    A home folder of root lets other users pass through (mode 0711), since PostgreSQL does not run as root. A folder that was
    there before keeps its own mode: it may hold more than conetl's. A group keeps its rights where `share_home` gave them,
    which the set-group-ID bit shows.
    """
    try:
        if not home.is_dir():
            home.mkdir(mode=0o700, parents=True, exist_ok=True)
            home.chmod(0o711 if os.geteuid() == 0 else 0o700)
        for folder in (home / name for name in FOLDERS):
            folder.mkdir(mode=0o700, exist_ok=True)
            info = folder.stat()
            closed = info.st_mode & ~(_OTHERS if info.st_mode & stat.S_ISGID else _OTHERS | _GROUP)
            if closed != info.st_mode and info.st_uid == os.geteuid():
                folder.chmod(stat.S_IMODE(closed))
    except OSError as error:
        raise write_error(
            f"The home folder {home} cannot be used", "choose another one (CONETL_HOME)", error
        ) from error


def share_home(home: Path, group: str) -> None:
    """Let a group of the operating system read the home folder: results, reports and exports, but no secrets and no database.

    Raises InputError if there is no such group or this user may not give files to it.
    """
    make_home(home)
    try:
        gid = grp.getgrnam(group).gr_gid
        _share(home, gid)
        for name in FOLDERS:
            for folder, _, files in os.walk(home / name):
                _share(Path(folder), gid)
                for file in files:
                    _share(Path(folder, file), gid)
    except KeyError:
        raise InputError(f"this machine has no group {group}: create it, or name another one") from None
    except OSError as error:
        raise InputError(f"{home} cannot be given to the group {group}: {error.strerror} ({error.filename})") from error


def home_access(home: Path) -> str:
    """Who may read the home folder: `owner only`, `owner and group NAME` or `everybody`."""
    folders = [folder.stat() for folder in (home / name for name in FOLDERS) if folder.is_dir()]
    files = [file.stat() for file in (home / name for name in SECRETS) if file.is_file()]
    passage = home.is_dir() and home.stat().st_mode & _OTHERS
    if passage and any(entry.st_mode & _OTHERS for entry in (*folders, *files)):
        return "everybody"
    groups = {entry.st_gid for entry in folders if entry.st_mode & _GROUP}
    return f"owner and group {', '.join(sorted(map(_group_name, groups)))}" if groups else "owner only"


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
    if path.name in SECRETS or path.is_symlink():
        return
    shutil.chown(path, group=gid)
    path.chmod(stat.S_IMODE(path.stat().st_mode) | (0o2050 if path.is_dir() else 0o040))
