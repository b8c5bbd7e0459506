"""Errors that end a command, each with the exit code that outsiders rely on.

A bad *record* is never one of these: it becomes a `Rejection` (see `rejections.py`) and the run goes on.
"""

from __future__ import annotations

import errno

EXIT_DONE = 0
#: Done, but something needs a look: too many rejections, or what was committed could not be published.
EXIT_TOO_MANY_REJECTIONS = 1
EXIT_BAD_INPUT = 2
EXIT_SERVICE_MISSING = 3
#: An error that nobody foresaw (EX_SOFTWARE); Python's own 1 would read as "done, but".
EXIT_BUG = 70
#: Ctrl-C: 128 + SIGINT, as shells have it.
EXIT_INTERRUPTED = 130


class ConetlError(Exception):
    """Base of every error that conetl raises on purpose; its text is one message for the user."""

    exit_code = EXIT_BAD_INPUT


class InputError(ConetlError):
    """The input as a whole cannot be used: nothing was written."""


class ConflictError(InputError):
    """What was decided does not fit what is there now: somebody or some drive was faster. Nothing was written."""


class DriveFolderError(InputError):
    """A drive folder is missing, empty, or lacks a file without which no frame pair can be placed."""


class CalibrationError(InputError):
    """A calibration file is missing, incomplete or contradicts itself."""


class ModelFileError(InputError):
    """A detector's model file or its sidecar is missing, corrupt, or not what it claims to be."""


class MapMismatchError(InputError):
    """The drive and the map do not fit together, for example another coordinate reference system."""


class ServiceError(ConetlError):
    """A service that conetl needs (database, Prefect) cannot be reached or started: nothing was written."""

    exit_code = EXIT_SERVICE_MISSING


class StorageError(ServiceError):
    """A disk or a storage does not read or write at the moment: failing, full, not mounted, refused. Another time it may."""


class DatabaseError(ServiceError):
    """PostGIS is not to be had: no server, no rights, no extension, or a schema of another version."""


#: What the system says of a file, and not of the storage that it lies on.
_ABOUT_THE_FILE = frozenset(
    {
        errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ELOOP, errno.ENAMETOOLONG, errno.EINVAL, errno.EACCES,
        errno.EPERM, errno.EROFS,
    }
)  # fmt: skip


def is_of_storage(error: BaseException | None) -> bool:
    """Whether the system says of a disk or a storage that it fails or is full; such errors pass."""
    return isinstance(error, OSError) and error.errno is not None and error.errno not in _ABOUT_THE_FILE


def storage_failed(error: OSError) -> StorageError:
    """The error of a file that cannot be read or written, for a person."""
    return StorageError(
        f"{error.filename or 'a file'}: the storage failed ({error.strerror or error}). Look at the disk or the network file "
        "system, and run the same command again."
    )


def may_pass(error: BaseException) -> bool:
    """Whether the same work may succeed another time: unless the drive's own content stands against it.

    That holds for errors that nobody foresaw, too. Who tries again counts the tries.
    """
    if isinstance(error, DriveFolderError | CalibrationError | MapMismatchError):
        return is_of_storage(error.__cause__)
    return True


def cannot_write(message: str, remedy: str, error: OSError) -> InputError | StorageError:
    """The error of a file that cannot be written: InputError where the place is not one to write to, else StorageError.

    message: what cannot be written; remedy: what to do where the place is the reason.
    """
    why = error.strerror or error
    if is_of_storage(error):
        return StorageError(f"{message} ({why}): free space or look at the disk, and run the same command again.")
    return InputError(f"{message} ({why}): {remedy}.")
