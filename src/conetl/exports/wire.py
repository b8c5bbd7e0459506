"""Decodes rows of PostgreSQL's COPY BINARY to Arrow columns, for millions of rows without a Python object per value.

A row is a column count, then a length (-1: NULL) and big-endian bytes per column. Rows of equal lengths share one numpy
structured type and are read column by column.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from conetl.model.errors import DatabaseError

#: PostgreSQL counts microseconds from 2000-01-01.
_POSTGRES_EPOCH_US = 946_684_800_000_000
_UUID, _TEXT, _TIMESTAMPTZ = 2950, 25, 1184
UTC_US = pa.timestamp("us", tz="UTC")
_FIXED: dict[int, tuple[str, pa.DataType]] = {
    16: ("?", pa.bool_()),
    20: (">i8", pa.int64()),
    23: (">i4", pa.int32()),
    701: (">f8", pa.float64()),
    _TIMESTAMPTZ: (">i8", UTC_US),
}
#: The two hexadecimal digits of every byte.
_HEX = np.frombuffer("".join(f"{byte:02x}" for byte in range(256)).encode(), np.uint16)
#: Slices of a UUID's text between its dashes, and of its digits.
_DIGITS = tuple(
    (slice(start + dashes, stop + dashes), slice(start, stop))
    for dashes, (start, stop) in enumerate(pairwise((0, 8, 12, 16, 20, 32)))
)
Parts: TypeAlias = list[tuple[NDArray[np.int64], Any]]
"""Row numbers of one column with their values, None where all are NULL."""


def arrow_type(oid: int) -> pa.DataType:
    """Arrow's type for a PostgreSQL type; uuid becomes text. Raises DatabaseError for an unsupported one."""
    if oid in (_UUID, _TEXT):
        return pa.string()
    if oid not in _FIXED:
        raise DatabaseError(f"an export has a column of PostgreSQL's type {oid}, which is not supported")
    return _FIXED[oid][1]


def decode_rows(rows: Sequence[bytes], oids: Sequence[int]) -> list[pa.Array]:
    """Columns of rows in their order, by PostgreSQL types `oids`."""
    lengths = np.fromiter(map(len, rows), np.int64, len(rows))
    columns: list[Parts] = [[] for _ in oids]
    for length in np.unique(lengths):
        _decode_group(rows, np.flatnonzero(lengths == length), oids, columns)
    return [_column(parts, oid, len(rows)) for parts, oid in zip(columns, oids, strict=True)]


def _decode_group(rows: Sequence[bytes], chosen: NDArray[np.int64], oids: Sequence[int], columns: list[Parts]) -> None:
    """Append rows of one total length to the columns, group by group of equal column lengths."""
    while len(chosen):
        lengths = _lengths(rows[chosen[0]], oids)
        fields: list[tuple[str, Any]] = [("count", ">i2")]
        for i, length in enumerate(lengths):
            fields += [(f"length{i}", ">i4"), (f"value{i}", f"V{max(length, 0)}")]
        together = b"".join(rows if len(chosen) == len(rows) else [rows[row] for row in chosen])
        block = np.frombuffer(together, np.dtype(fields))
        alike = np.ones(len(chosen), bool)
        for i, length in enumerate(lengths):
            alike &= block[f"length{i}"] == length
        if not alike.all():
            block = block[alike]
        for i, (length, oid) in enumerate(zip(lengths, oids, strict=True)):
            columns[i].append((chosen[alike], None if length < 0 else _values(block[f"value{i}"], oid, length)))
        chosen = chosen[~alike]


def _lengths(row: bytes, oids: Sequence[int]) -> list[int]:
    """Lengths of the values of a row. Raises DatabaseError where they contradict the types."""
    (count,) = struct.unpack_from(">h", row)
    if count != len(oids):
        raise DatabaseError(f"an export has {len(oids)} columns, but the database sent {count}")
    lengths, at = [], 2
    for oid in oids:
        (length,) = struct.unpack_from(">i", row, at)
        wanted = 16 if oid == _UUID else np.dtype(_FIXED[oid][0]).itemsize if oid in _FIXED else length
        if length not in (-1, wanted):
            raise DatabaseError(f"an export has a column of PostgreSQL's type {oid} with {length} bytes, not {wanted}")
        lengths.append(length)
        at += 4 + max(length, 0)
    return lengths


def _values(wire: NDArray[Any], oid: int, length: int) -> Any:
    """(n,) numbers of one column, or (n, length) bytes of text."""
    if oid in _FIXED:
        numbers = np.ascontiguousarray(wire).view(_FIXED[oid][0])
        numbers = numbers.astype(numbers.dtype.newbyteorder("="))
        return numbers + _POSTGRES_EPOCH_US if oid == _TIMESTAMPTZ else numbers
    if not length:
        return np.empty((len(wire), 0), np.uint8)
    letters = np.ascontiguousarray(wire).view(np.uint8).reshape(len(wire), length)
    if oid != _UUID:
        return letters
    text = np.full((len(wire), 36), ord("-"), np.uint8)
    digits = _HEX[letters].view(np.uint8)
    for target, chosen in _DIGITS:
        text[:, target] = digits[:, chosen]
    return text


def _column(parts: Parts, oid: int, count: int) -> pa.Array:
    if len(parts) == 1 and parts[0][1] is not None:  # all rows have one length: they are in order
        values = parts[0][1]
        return pa.array(values).cast(_FIXED[oid][1]) if oid in _FIXED else _strings(values)
    if oid in _FIXED:
        missing = np.zeros(count, bool)
        together = np.zeros(count, np.dtype(_FIXED[oid][0]).newbyteorder("="))
        for rows, values in parts:
            if values is None:
                missing[rows] = True
            else:
                together[rows] = values
        return pa.array(together, mask=missing).cast(_FIXED[oid][1])
    texts = [_strings(values) if values is not None else pa.nulls(len(rows), pa.string()) for rows, values in parts]
    order = np.empty(count, np.int64)
    order[np.concatenate([rows for rows, _ in parts])] = np.arange(count)
    return pa.concat_arrays(texts).take(pa.array(order))


def _strings(letters: NDArray[np.uint8]) -> pa.Array:
    """(n, length) bytes of UTF-8 as an array of strings."""
    count, length = letters.shape
    offsets = (np.arange(count + 1) * length).astype(np.int32)
    return pa.StringArray.from_buffers(count, pa.py_buffer(offsets), pa.py_buffer(np.ascontiguousarray(letters)))
