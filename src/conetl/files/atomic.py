"""Write a file, or several that belong together, completely or not at all; remove old ones.

Until it is complete, a file has the name `.<name>.<host>.<pid>.<random>.tmp` beside its own. Host and process number tell files
of killed processes, which `remove_leftovers` deletes, from those that another process is writing.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any, TextIO
from uuid import uuid4

from conetl.files.names import truncate_to_bytes
from conetl.model.errors import InputError, write_error

_NAME = re.compile(r"\.(?P<host>[A-Za-z0-9-]+)\.(?P<pid>[0-9]+)\.[0-9a-f]{32}\.tmp$")
#: Name of the link to the newest publication.
LATEST = "latest"


@contextmanager
def atomic_text_file(path: Path) -> Iterator[TextIO]:
    """A UTF-8 text file that gets the name `path` only when the block succeeds; readers never see half of it.

    A missing folder is created. Raises InputError where the path cannot be written to, StorageError where the disk is full or
    fails.
    """
    with atomic_files(path) as (unfinished,), unfinished.open("w", encoding="utf-8", newline="") as file:
        yield file


def write_json(path: Path, content: object, *, indent: int | None = 1, private: bool = False, **options: Any) -> None:
    """Write a JSON file by `atomic_text_file`. private: for its owner only; options: of `json.dump`."""
    with atomic_text_file(path) as file:
        if private:
            os.fchmod(file.fileno(), 0o600)
        json.dump(content, file, indent=indent, **options)
        file.write("\n")


@contextmanager
def atomic_files(*paths: Path) -> Iterator[list[Path]]:
    """Files to write that get the names `paths` (in one folder) only when the block succeeds, the last one last.

    Until then they are in a hidden folder beside `paths`, with whatever a library writes beside its file (journals, indices).
    Everything is on the disk before the first rename. Errors are those of `atomic_text_file`.
    """
    folder, unfinished = paths[0].parent, temporary_path(paths[0])
    try:
        folder.mkdir(parents=True, exist_ok=True)
        unfinished.mkdir()
        written = [unfinished / path.name for path in paths]
        yield written
        for path in written:
            _sync(path)
        for path, final in zip(written, paths, strict=True):
            path.replace(final)
        _sync(folder)
    except OSError as error:
        raise write_error(f"{paths[0]} cannot be written", "choose another file", error) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def temporary_path(path: Path) -> Path:
    """Temporary path for a file that is being written to `path`."""
    return path.with_name(f".{truncate_to_bytes(path.name, 100)}.{_host()}.{os.getpid()}.{uuid4().hex}.tmp")


def remove_leftovers(folders: Iterable[Path]) -> list[Path]:
    """Remove temporary files and folders that killed processes of this machine left directly in the folders; returns their paths.

    A file whose process number is in use again is kept; one that cannot be removed is skipped.
    """
    removed = []
    for folder in folders:
        for path in folder.glob(".*.tmp"):
            name = _NAME.search(path.name)
            if name is None or name["host"] != _host() or Path(f"/proc/{name['pid']}").exists():
                continue
            try:
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink()
            except OSError:
                continue
            removed.append(path)
    return removed


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname()) or "host"


def old_results(folder: Path, before: datetime) -> list[Path]:
    """Intermediate results written before a time; they can be computed again from the drives."""
    return _older(folder.glob("*.parquet"), before)


def old_images(folder: Path, before: datetime) -> list[Path]:
    """Images unpacked from bags and not used since a time; they are unpacked again when needed."""
    return _older((path for path in folder.glob("*/*") if path.is_file()), before)


def old_publications(folder: Path, before: datetime) -> list[Path]:
    """Folders of publications finished before a time, without the newest."""
    newest = (folder / LATEST).resolve()
    finished = _older(folder.glob("*/publication.json"), before)
    return [path.parent for path in finished if not path.parent.is_symlink() and path.parent.resolve() != newest]


def size_bytes(paths: Sequence[Path]) -> int:
    """Size of files, and of all files in folders; 0 for missing ones."""
    files = (file for path in paths for file in (path.rglob("*") if path.is_dir() else (path,)))
    return sum(file.stat().st_size for file in files if file.is_file())


def remove(paths: Sequence[Path]) -> int:
    """Delete files and folders, skipping missing ones. Returns the number of bytes freed. Raises InputError."""
    freed = 0
    for path in paths:
        size = size_bytes([path])
        try:
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
        except FileNotFoundError:
            continue
        except OSError as error:
            raise InputError(f"{path} cannot be removed ({error.strerror})") from error
        freed += size
    return freed


def _older(paths: Iterable[Path], before: datetime) -> list[Path]:
    limit_s = before.timestamp()
    return sorted(path for path in paths if path.stat().st_mtime < limit_s)
