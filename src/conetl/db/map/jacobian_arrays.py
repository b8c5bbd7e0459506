"""SharedErrorJacobian as the columns calibrations (uuid[]) and shared_jacobian_m (real[][][]) of the database, in PostgreSQL's
binary format.

An array: number of dimensions, whether any item is null, type of the items, then length and first index of each dimension, then
the items, each with its length before it; all big-endian (`array_send` in PostgreSQL's src/backend/utils/adt/arrayfuncs.c).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache
from uuid import UUID

import numpy as np

from conetl.db.copy_binary import Column, nulls, wires
from conetl.model.records import SharedErrorJacobian

_UUID_TYPE, _REAL_TYPE = 2950, 700
_UUID_BYTES, _REAL_BYTES = 16, 4
#: Bytes before the items of an array of one dimension and of three, and where the former has its length.
_HEAD_OF_ONE, _HEAD_OF_THREE, _LENGTH_AT = 20, 36, 12
_REALS = np.dtype([("length", ">i4"), ("value", ">f4")])


def jacobian_columns(shared_jacobian: Sequence[SharedErrorJacobian | None]) -> dict[str, Column]:
    """The columns calibrations and shared_jacobian_m of some rows."""
    if not any(shared_jacobian):
        return {"calibrations": nulls(len(shared_jacobian)), "shared_jacobian_m": nulls(len(shared_jacobian))}
    return {
        "calibrations": wires([None if one is None else _calibrations(one.calibrations) for one in shared_jacobian]),
        "shared_jacobian_m": wires([None if one is None else _jacobian(one) for one in shared_jacobian]),
    }


def jacobian_from_wire(wire: bytes | memoryview) -> SharedErrorJacobian:
    """Both columns as `array_send` makes them, one after the other."""
    both, (count,) = bytes(wire), struct.unpack_from(">i", wire, _LENGTH_AT)
    step = 4 + _UUID_BYTES
    starts = range(_HEAD_OF_ONE, _HEAD_OF_ONE + count * step, step)
    ids = tuple(UUID(bytes=both[at + 4 : at + step]) for at in starts)
    items = np.frombuffer(both, _REALS, offset=_HEAD_OF_ONE + count * step + _HEAD_OF_THREE)
    return SharedErrorJacobian(ids, items["value"].tobytes())


@lru_cache(maxsize=1024)
def _calibrations(calibrations: tuple[UUID, ...]) -> bytes:
    items = (struct.pack(">i", _UUID_BYTES) + one.bytes for one in calibrations)
    return struct.pack(">5i", 1, 0, _UUID_TYPE, len(calibrations), 1) + b"".join(items)


def _jacobian(shared_jacobian: SharedErrorJacobian) -> bytes:
    values = np.frombuffer(shared_jacobian.moved_m, ">f4")
    count = len(shared_jacobian.calibrations)
    items = np.empty(len(values), _REALS)
    items["length"], items["value"] = _REAL_BYTES, values
    errors = len(values) // (3 * count)
    return struct.pack(">9i", 3, 0, _REAL_TYPE, count, 1, 3, 1, errors, 1) + items.tobytes()
