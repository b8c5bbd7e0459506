"""Write a file, or several that belong together, completely or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from conetl.files.partial_files import aside
from conetl.model.errors import cannot_write


@contextmanager
def atomic_text_file(path: Path) -> Iterator[TextIO]:
    """A UTF-8 text file that gets the name `path` only when the block succeeds; readers never see half of it.

    A missing folder is created. Raises InputError where the path cannot be written to, StorageError where the disk is full or
    fails.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = aside(path)
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise cannot_write(f"{path} cannot be written", "choose another file", error) from error
    try:
        with open(handle, "w", encoding="utf-8", newline="") as file:  # noqa: PTH123 -- takes over the open descriptor
            yield file
            file.flush()
            os.fsync(handle)
        temporary.replace(path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise cannot_write(f"{path} cannot be written", "choose another file", error) from error
        raise


@contextmanager
def atomic_files(*paths: Path) -> Iterator[list[Path]]:
    """Files to write that get the names `paths` (in one folder) only when the block succeeds, the last one last.

    Until then they are in a hidden folder beside `paths`, with whatever a library writes beside its file (journals, indices).
    Everything is on the disk before the first rename. Errors are those of `atomic_text_file`.
    """
    folder = paths[0].parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = aside(paths[0])
        unfinished.mkdir()
    except OSError as error:
        raise cannot_write(f"{paths[0]} cannot be written", "choose another file", error) from error
    try:
        written = [unfinished / path.name for path in paths]
        yield written
        for path in written:
            _sync(path)
        for path, final in zip(written, paths, strict=True):
            path.replace(final)
        _sync(folder)
    except OSError as error:
        raise cannot_write(f"{paths[0]} cannot be written", "choose another file", error) from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
