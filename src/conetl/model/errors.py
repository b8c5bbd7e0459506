"""Errors that end a command, with their exit codes. A bad *record* is a `Rejection` instead, and the run continues."""

from __future__ import annotations

import errno

EXIT_DONE = 0
#: Done, but needs attention: too many rejections, a drive on hold, or files that could not be published.
EXIT_NEEDS_ATTENTION = 1
EXIT_BAD_INPUT = 2
EXIT_SERVICE_MISSING = 3
#: Internal error (EX_SOFTWARE); Python's own 1 would mean EXIT_NEEDS_ATTENTION.
EXIT_BUG = 70
#: Ctrl-C: 128 + SIGINT, as in shells.
EXIT_INTERRUPTED = 130


class ConetlError(Exception):
    """Base of all errors raised on purpose; the text is one message for the user."""

    exit_code = EXIT_BAD_INPUT


class InputError(ConetlError):
    """The input as a whole cannot be used; nothing was written."""


class ConflictError(InputError):
    """A decision does not fit the current map, which has changed meanwhile; nothing was written."""


class DriveFolderError(InputError):
    """A drive as a whole cannot be used: of all that its reader found wrong, and of images that contradict the calibration."""


class ModelFileError(InputError):
    """A detector's model file or its sidecar is missing, corrupt, or does not match."""


class MapMismatchError(InputError):
    """Drive and map do not fit together, for example by their coordinate reference systems."""


class ServiceError(ConetlError):
    """A service (database, Prefect) cannot be reached or started; nothing was written."""

    exit_code = EXIT_SERVICE_MISSING


class StorageError(ServiceError):
    """A disk or storage cannot be read or written at the moment: failing, full, not mounted, refused."""


class DatabaseError(ServiceError):
    """PostGIS is unavailable: no server, no rights, no extension, or a schema of another version."""


#: Error numbers that concern a file, not the storage that holds it.
_ABOUT_THE_FILE = frozenset(
    {
        errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ELOOP, errno.ENAMETOOLONG, errno.EINVAL, errno.EACCES,
        errno.EPERM, errno.EROFS,
    }
)  # fmt: skip


def is_of_storage(error: BaseException | None) -> bool:
    """Whether the error concerns a disk or storage that fails or is full; such errors are temporary."""
    return isinstance(error, OSError) and error.errno is not None and error.errno not in _ABOUT_THE_FILE


def storage_failed(error: OSError) -> StorageError:
    """The error of a file that cannot be read or written, as a message for the user."""
    return StorageError(
        f"{error.filename or 'a file'}: the storage failed ({error.strerror or error}). Check the disk or the network file "
        "system and run the same command again."
    )


def may_pass(error: BaseException) -> bool:
    """Whether the same work may succeed on another try: all errors but those of the drive's own content.

    Callers limit the number of tries.
    """
    if isinstance(error, DriveFolderError | MapMismatchError):
        return is_of_storage(error.__cause__)
    return True


def cannot_write(message: str, remedy: str, error: OSError) -> InputError | StorageError:
    """The error of a file that cannot be written: InputError if the path is the reason, else StorageError.

    message: what cannot be written; remedy: what to do about the path.
    """
    why = error.strerror or error
    if is_of_storage(error):
        return StorageError(f"{message} ({why}): free space or check the disk and run the same command again.")
    return InputError(f"{message} ({why}): {remedy}.")
