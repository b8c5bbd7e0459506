"""The people who log in to the web view: names, roles and hashes of tokens, in a file of the home folder (mode 600)."""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import SecretStr

from conetl.files.atomic import temporary_path
from conetl.files.home import make_home
from conetl.model.base import Record
from conetl.model.errors import InputError, write_error

PEOPLE, IMAGE_LOG = "users.json", "whole_images.log"
Role = Literal["read", "review", "admin"]


class Person(Record):
    """Somebody who may log in."""

    name: str
    role: Role
    """read: sees the map; review: also whole images, and decides about features; admin: also decides about drives."""
    token_sha256: str
    """The token has 256 random bits, so its hash needs no salt."""

    @property
    def may_decide(self) -> bool:
        return self.role != "read"

    @property
    def sees_whole_images(self) -> bool:
        return self.role != "read"

    @property
    def may_decide_drives(self) -> bool:
        return self.role == "admin"


def read_people(home: Path) -> list[Person]:
    """In the order in which they were added. Raises InputError if the file is unreadable, or open to others."""
    path = home / PEOPLE
    try:
        if path.stat().st_mode & 0o077:
            raise InputError(f"{path} may be read or written by others: run `chmod 600 {path}`")
        return [Person.model_validate(one) for one in json.loads(path.read_text(encoding="utf-8"))]
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        remedy = "restore it, or remove it and add the users again"
        raise InputError(f"{path} cannot be read ({type(error).__name__}): {remedy}") from error


def add_person(home: Path, name: str, role: Role) -> SecretStr:
    """Returns the new token, which is stored nowhere. Raises InputError if there is somebody of this name."""
    people = read_people(home)
    name = " ".join(name.split())
    if not 2 <= len(name) <= 80 or not name.isprintable():
        raise InputError("a name has 2 to 80 printable characters")
    if any(one.name == name for one in people):
        raise InputError(f"there is already a user {name}: remove it first with `conetl user remove`")
    token = secrets.token_urlsafe(32)
    _write(home, [*people, Person(name=name, role=role, token_sha256=_hash(token))])
    return SecretStr(token)


def remove_person(home: Path, name: str) -> None:
    """The token is refused from now on. Raises InputError if there is nobody of this name."""
    people = read_people(home)
    kept = [one for one in people if one.name != name]
    if len(kept) == len(people):
        raise InputError(f"there is no user {name}: see `conetl user list`")
    _write(home, kept)


def people_of(home: Path) -> Callable[[str], Person | None]:
    """Finds who has a token; reads the file again when it has changed. A file that cannot be read admits nobody."""
    known: list[Person] = []
    stamp: tuple[int, int] | None = None

    def find(token: str) -> Person | None:
        nonlocal known, stamp
        try:
            info = (home / PEOPLE).stat()
            now = (info.st_mtime_ns, info.st_ino)
            if now != stamp:
                known, stamp = read_people(home), now
        except (OSError, InputError):
            known, stamp = [], None
        given = _hash(token)
        return next((one for one in known if hmac.compare_digest(one.token_sha256, given)), None)

    return find


def log_whole_image(path: Path, name: str | None, **what: Any) -> None:
    """Append who saw which image. name: None if nobody was named. Raises StorageError: then the image is not shown."""
    line = json.dumps({"at": datetime.now(UTC).isoformat(timespec="seconds"), "name": name, **what}, default=str)
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with os.fdopen(os.open(path, os.O_CREAT | os.O_APPEND | os.O_WRONLY, 0o600), "a", encoding="utf-8") as file:
            file.write(f"{line}\n")
    except OSError as error:
        raise write_error(f"{path} cannot be written", "free some space", error) from error


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def _write(home: Path, people: Sequence[Person]) -> None:
    make_home(home)
    path = home / PEOPLE
    new = temporary_path(path)
    try:
        with os.fdopen(os.open(new, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w", encoding="utf-8") as file:
            json.dump([one.model_dump() for one in people], file, ensure_ascii=False, indent=1)
        new.replace(path)
    except OSError as error:
        new.unlink(missing_ok=True)
        raise write_error(f"{path} cannot be written", "set CONETL_HOME to another folder", error) from error
