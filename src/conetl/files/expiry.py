"""Old files that may be deleted: those that conetl can make again, and old publications."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from conetl.model.errors import InputError

#: Name of the link to the newest publication.
LATEST = "latest"


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
    """Delete files and folders, skipping missing ones; the number of bytes freed. Raises InputError."""
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
