"""The writer token of the web view: a file that only its owner may read."""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from pydantic import SecretStr

from conetl.model.errors import InputError

MIN_LENGTH = 16
_NAME = "writer_token"


def make_writer_token(home: Path) -> Path:
    """The token's file under `home`, made with a new token (256 bits) where there is none."""
    path = home / _NAME
    home.mkdir(parents=True, exist_ok=True)
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    except FileExistsError:
        return path
    with os.fdopen(handle, "w") as file:
        file.write(f"{secrets.token_urlsafe(32)}\n")
    return path


def read_writer_token(path: Path) -> SecretStr:
    """The token in a file. Raises InputError where it cannot be read, others may read it, or it is too short; never quotes it."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        text = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeError) as error:
        raise InputError(f"the writer token in {path} cannot be read: {type(error).__name__}") from error
    if mode & 0o077:
        raise InputError(f"{path} may be read or written by others (mode {mode:o}): run `chmod 600 {path}`")
    return checked_token(SecretStr(text), f"the file {path}")


def checked_token(token: SecretStr, where: str) -> SecretStr:
    """The token, where it is one that can be sent and not guessed. Raises InputError."""
    text = token.get_secret_value()
    if len(text) < MIN_LENGTH or not text.isascii() or not text.isprintable() or " " in text:
        raise InputError(
            f"{where} holds no writer token: at least {MIN_LENGTH} printable ASCII characters without a space"
        )
    return token
