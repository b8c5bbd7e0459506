"""Intermediate results as Parquet files, named by the hash of everything they were computed from.

Equal inputs give an equal name, so a finished chunk is never computed twice: not after a crash, nor when the drive is ingested
again with other parameters for later steps. Files are written under a temporary name and renamed when they are complete.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import TypeAdapter, ValidationError

from conetl.files.atomic import temporary_path
from conetl.files.storage import NO_FILE_SHA256, is_present, is_remote, object_bytes
from conetl.model.base import Record
from conetl.model.errors import StorageError
from conetl.model.rejections import Rejection

R = TypeVar("R", bound=Record)
_REJECTIONS = b"conetl.rejections"


def result_key(*parts: str) -> str:
    """Content key: SHA-256 over the given hashes and names, in order."""
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes; `NO_FILE_SHA256` where the file is missing.

    Raises OSError where the storage fails, StorageError for an object.
    """
    if is_remote(path):
        try:
            return hashlib.sha256(object_bytes(path)).hexdigest()
        except FileNotFoundError:
            return NO_FILE_SHA256
    if not is_present(path):
        return NO_FILE_SHA256
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def has_result(folder: Path, key: str) -> bool:
    """Whether the chunk `key` was finished earlier and its file is whole; a damaged one is computed again."""
    try:
        table = read_table(result_path(folder, key))
    except (OSError, pa.ArrowException):
        return False
    return _REJECTIONS in (table.schema.metadata or {})


def save_result(folder: Path, key: str, records: Sequence[R], rejections: Sequence[Rejection]) -> Path:
    """Write the records and rejections of one finished chunk; the Parquet file is the last to appear.

    Raises StorageError where it cannot be written.
    """
    refused = TypeAdapter(list[Rejection]).dump_json(list(rejections)).decode()
    table = pa.Table.from_pylist([record.model_dump(mode="json") for record in records])
    table = table.replace_schema_metadata({_REJECTIONS: refused})
    path = result_path(folder, key)
    unfinished = temporary_path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_table(table, unfinished)
        os.replace(unfinished, path)  # noqa: PTH105 - atomic on every platform, unlike Path.rename
    except OSError as error:
        raise StorageError(
            f"{folder}: results cannot be written ({os.strerror(error.errno) if error.errno else error}): free space there, or "
            "set CONETL_HOME to another folder, and run the same command again; what is finished is not computed again."
        ) from error
    finally:
        with suppress(OSError):
            unfinished.unlink()
    return path


def load_result(path: Path, record_type: type[R]) -> tuple[list[R], list[Rejection]]:
    """Records and rejections of one chunk, validated again. Raises StorageError where they are not valid."""
    try:
        table = read_table(path)
        rejections = TypeAdapter(list[Rejection]).validate_json((table.schema.metadata or {})[_REJECTIONS])
        return TypeAdapter(list[record_type]).validate_python(table.to_pylist()), rejections  # type: ignore[valid-type]
    except (pa.ArrowException, KeyError, ValidationError) as error:
        raise StorageError(
            f"{path}: this intermediate result is damaged, or of another version of conetl. Remove the folder {path.parent} "
            "and run the same command again: results that are missing are computed again."
        ) from error


def load_results(paths: Iterable[Path], record_type: type[R]) -> tuple[list[R], list[Rejection]]:
    """All chunks of a drive, in order."""
    chunks = [load_result(path, record_type) for path in paths]
    return [r for records, _ in chunks for r in records], [r for _, refused in chunks for r in refused]


def write_table(table: pa.Table, path: Path) -> None:
    """Write a Parquet file, compressed and with checksums. Raises OSError."""
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def read_table(path: Path) -> pa.Table:
    """A Parquet file that `write_table` wrote. Raises OSError, ArrowException where it is missing or damaged."""
    # pq.read_table imports pandas, which takes as long as a few hundred images.
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        return file.read()


def result_path(folder: Path, key: str) -> Path:
    """Path of the result of a key; the file may be missing."""
    return folder / f"{key}.parquet"
