"""Errors that end a command, each with the exit code that outsiders rely on.

A bad *record* is never one of these: it becomes a `Rejection` (see `rejections.py`) and the run goes on.
"""

from __future__ import annotations

EXIT_DONE = 0
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
