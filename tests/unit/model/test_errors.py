"""Which errors another try may get over, and which stay until the drive changes."""

from __future__ import annotations

import errno

import httpx
import pytest
from prefect.exceptions import ObjectNotFound, PrefectHTTPStatusError

from conetl.model.errors import (
    CalibrationError,
    ConetlError,
    DatabaseError,
    DriveFolderError,
    InputError,
    MapMismatchError,
    ModelFileError,
    StorageError,
    may_pass,
)


def caused(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    "error",
    [
        DatabaseError("no server"),
        StorageError("disk full"),
        OSError(errno.EIO, "of the storage"),
        MemoryError(),
        httpx.ConnectError("Prefect restarts"),
        httpx.ReadTimeout("Prefect is slow"),
        PrefectHTTPStatusError("503", request=httpx.Request("GET", "http://p"), response=httpx.Response(503)),
        ObjectNotFound(Exception()),
        ModelFileError("the model's file is being replaced"),
        InputError("the home folder cannot be written to"),
        caused(CalibrationError("calib.txt: cannot be read: Stale file handle"), OSError(errno.ESTALE, "stale")),
        caused(DriveFolderError("an image of the bag cannot be unpacked"), OSError(errno.ENOSPC, "full")),
        KeyError("a mistake of conetl, or of a library"),
    ],
    ids=lambda error: f"{type(error).__name__} {error}"[:40],
)
def test_what_may_pass(error: Exception) -> None:
    assert may_pass(error)


@pytest.mark.parametrize(
    "error",
    [
        DriveFolderError("not one usable pose"),
        CalibrationError("P_rect_03 is missing"),
        MapMismatchError("another CRS"),
        caused(CalibrationError("no such file"), FileNotFoundError(errno.ENOENT, "no such file")),
        caused(DriveFolderError("the bag cannot be read"), OSError("a library's own words")),
    ],
    ids=lambda error: f"{type(error).__name__} {error}"[:40],
)
def test_what_stays_until_the_drive_changes(error: ConetlError) -> None:
    assert not may_pass(error)
