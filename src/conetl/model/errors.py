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
#: What each means, for help pages and the reference.
EXIT_CODES = {
    EXIT_DONE: "done",
    EXIT_NEEDS_ATTENTION: "done, but needs attention (too many records rejected, a drive on hold, files or events not published)",
    EXIT_BAD_INPUT: "bad usage or input, nothing written (with several drives, the valid ones are on the map)",
    EXIT_SERVICE_MISSING: "a service (database, Prefect, storage) is unavailable, nothing written (backfill: other drives are)",
    EXIT_BUG: "internal error",
    EXIT_INTERRUPTED: "interrupted with Ctrl-C",
}


class ConetlError(Exception):
    """Base of all errors raised on purpose; the text is one message for the user."""

    exit_code = EXIT_BAD_INPUT

    def __str__(self) -> str:
        """The message. Characters that a terminal would obey are escaped: messages quote names and contents of files."""
        text = super().__str__()
        return (
            text if text.isprintable() else "".join(c if c.isprintable() or c == "\n" else repr(c)[1:-1] for c in text)
        )


class InputError(ConetlError):
    """The input as a whole cannot be used; nothing was written."""


class ConflictError(InputError):
    """A decision does not fit the current map, which has changed meanwhile; nothing was written."""


class DriveFolderError(InputError):
    """A drive as a whole cannot be used: its files are wrong, or its images contradict the calibration."""


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


def is_storage_error(error: BaseException | None) -> bool:
    """Whether the error comes from a failing or full disk or storage. Such errors are temporary."""
    return isinstance(error, OSError) and error.errno is not None and error.errno not in _ABOUT_THE_FILE


def storage_error(error: OSError) -> StorageError:
    """The message for a file that cannot be read or written because its storage fails."""
    return StorageError(
        f"{error.filename or 'standard output or a file'}: the storage failed ({error.strerror or error}). Check the disk or the "
        "network file system and run the same command again."
    )


def is_retryable(error: BaseException) -> bool:
    """Whether another attempt may succeed: unless the content of the drive is the cause. Callers limit the attempts."""
    if isinstance(error, DriveFolderError | MapMismatchError):
        return is_storage_error(error.__cause__)
    return True


def write_error(message: str, remedy: str, error: OSError) -> InputError | StorageError:
    """InputError if the path of a file is why it cannot be written, else StorageError.

    message: what cannot be written; remedy: what to do about the path.
    """
    why = error.strerror or error
    if is_storage_error(error):
        return StorageError(f"{message} ({why}): free space or check the disk and run the same command again.")
    return InputError(f"{message} ({why}): {remedy}.")
