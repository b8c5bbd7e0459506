"""Errors that another try may avoid, and errors of the drive itself."""

from __future__ import annotations

import errno

import httpx
import pytest
from prefect.exceptions import ObjectNotFound, PrefectHTTPStatusError

from conetl.model import errors


def caused(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    "error",
    [
        errors.DatabaseError("no server"),
        errors.StorageError("disk full"),
        OSError(errno.EIO, "of the storage"),
        MemoryError(),
        httpx.ConnectError("Prefect restarts"),
        httpx.ReadTimeout("Prefect is slow"),
        PrefectHTTPStatusError("503", request=httpx.Request("GET", "http://p"), response=httpx.Response(503)),
        ObjectNotFound(Exception()),
        errors.ModelFileError("the model's file is being replaced"),
        errors.InputError("the home folder cannot be written to"),
        caused(errors.DriveFolderError("calib.txt: cannot be read: Stale file handle"), OSError(errno.ESTALE, "stale")),
        caused(errors.DriveFolderError("a image of the bag cannot be unpacked"), OSError(errno.ENOSPC, "full")),
        KeyError("an internal error"),
    ],
    ids=lambda error: f"{type(error).__name__} {error}"[:40],
)
def test_temporary_errors_may_pass(error: Exception) -> None:
    assert errors.is_retryable(error)


@pytest.mark.parametrize(
    "error",
    [
        errors.DriveFolderError("no usable pose"),
        errors.DriveFolderError("P_rect_03 is missing"),
        errors.MapMismatchError("another CRS"),
        caused(errors.DriveFolderError("no such file"), FileNotFoundError(errno.ENOENT, "no such file")),
        caused(errors.DriveFolderError("the bag cannot be read"), OSError("a library's own words")),
    ],
    ids=lambda error: f"{type(error).__name__} {error}"[:40],
)
def test_errors_of_the_drive_stay(error: errors.ConetlError) -> None:
    assert not errors.is_retryable(error)
