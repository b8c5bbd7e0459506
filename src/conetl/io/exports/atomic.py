"""Write a file completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from conetl.errors import InputError
from conetl.io.leftovers import aside


@contextmanager
def atomic_text_file(path: Path) -> Iterator[TextIO]:
    """A UTF-8 text file that takes the name `path` only when the block ends well; readers never see half of it.

    The folder is made where it is missing. Raises InputError where nothing can be written there.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = aside(path)
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror}): choose another file.") from error
    try:
        with open(handle, "w", encoding="utf-8", newline="") as file:  # noqa: PTH123 -- takes over the open descriptor
            yield file
            file.flush()
            os.fsync(handle)
        temporary.replace(path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(
                f"{path} cannot be written ({error.strerror}): free space or choose another file."
            ) from error
        raise
