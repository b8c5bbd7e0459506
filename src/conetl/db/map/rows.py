"""Rows of the map's tables as records, without checking them again, and SharedErrorJacobian in PostgreSQL's binary array format.

An array: number of dimensions, whether any item is null, type of the items, then length and first index of each dimension, then
the items, each after its length; all big-endian (`array_send` in PostgreSQL's src/backend/utils/adt/arrayfuncs.c).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import Any
from uuid import UUID

import numpy as np

from conetl.db.copy_binary import Column, byteas, nulls
from conetl.model.map_records import FeatureVersion, MapFeature
from conetl.model.records import SharedErrorJacobian, sound

_UUID_TYPE, _REAL_TYPE = 2950, 700
_UUID_BYTES, _REAL_BYTES = 16, 4
#: Bytes before the items of an array of one dimension and of three, and the offset of the former's length.
_HEAD_OF_ONE, _HEAD_OF_THREE, _LENGTH_AT = 20, 36, 12
_REALS = np.dtype([("length", ">i4"), ("value", ">f4")])


def feature_of(row: tuple[Any, ...]) -> MapFeature:
    """Columns as in `map.current_features`; further ones may follow."""
    return sound(
        MapFeature,
        feature_id=row[0],
        version=row[1],
        category=row[2],
        xyz_m=row[3:6],
        cov_m2=row[6:12],
        centre_xyz_m=row[12:15],
        cone_height_m=row[15],
        cone_height_sigma_m=row[16],
        existence_probability=row[17],
        observation_count=row[18],
        first_seen_ns=row[19],
        last_seen_ns=row[20],
        shared_jacobian=None if row[21] is None else jacobian_from_wire(row[21]),
    )


def version_of(row: tuple[Any, ...]) -> FeatureVersion:
    """Columns as in `replay.standing_around`; further ones may follow."""
    return sound(
        FeatureVersion,
        feature=feature_of(row),
        changeset_id=row[22],
        present=row[23],
        suppressed=row[24],
        valid_from_ns=row[25],
        valid_to_ns=row[26],
    )


def jacobian_columns(jacobians: Sequence[SharedErrorJacobian | None]) -> dict[str, Column]:
    """The columns calibrations (uuid[]) and shared_jacobian_m (real[][][]) of some rows."""
    if not any(jacobians):
        return {"calibrations": nulls(len(jacobians)), "shared_jacobian_m": nulls(len(jacobians))}
    return {
        "calibrations": byteas([None if one is None else _calibrations(one.calibrations) for one in jacobians]),
        "shared_jacobian_m": byteas([None if one is None else _jacobian(one) for one in jacobians]),
    }


def jacobian_from_wire(wire: bytes | memoryview) -> SharedErrorJacobian:
    """Both columns as `array_send` makes them, concatenated."""
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


def _jacobian(jacobian: SharedErrorJacobian) -> bytes:
    values = np.frombuffer(jacobian.moved_m, ">f4")
    count = len(jacobian.calibrations)
    items = np.empty(len(values), _REALS)
    items["length"], items["value"] = _REAL_BYTES, values
    errors = len(values) // (3 * count)
    return struct.pack(">9i", 3, 0, _REAL_TYPE, count, 1, 3, 1, errors, 1) + items.tobytes()
