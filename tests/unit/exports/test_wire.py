"""COPY BINARY as Arrow columns: nulls, texts of any length, whole numbers, times and UUIDs, in the order of the rows."""

from __future__ import annotations

import struct
from datetime import UTC, datetime, timedelta
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.exports.wire import decode_rows
from conetl.model.errors import DatabaseError

EPOCH = datetime(2000, 1, 1, tzinfo=UTC)
#: OID, values, and how PostgreSQL sends one.
TYPES = [
    (2950, st.uuids(), lambda v: v.bytes),
    (25, st.text(max_size=5).filter(lambda v: "\0" not in v), lambda v: v.encode()),
    (16, st.booleans(), lambda v: struct.pack(">?", v)),
    (23, st.integers(-(2**31), 2**31 - 1), lambda v: struct.pack(">i", v)),
    (20, st.integers(-(2**63), 2**63 - 1), lambda v: struct.pack(">q", v)),
    (701, st.floats(allow_nan=False), lambda v: struct.pack(">d", v)),
    (
        1184,
        st.datetimes(datetime(1900, 1, 1), datetime(2200, 1, 1), timezones=st.just(UTC)),
        lambda v: struct.pack(">q", (v - EPOCH) // timedelta(microseconds=1)),
    ),
]
OIDS = [oid for oid, _, _ in TYPES]


def sent(row):
    fields = [None if value is None else pack(value) for value, (_, _, pack) in zip(row, TYPES, strict=True)]
    parts = [struct.pack(">i", -1) if field is None else struct.pack(">i", len(field)) + field for field in fields]
    return struct.pack(">h", len(fields)) + b"".join(parts)


@given(st.lists(st.tuples(*(st.none() | values for _, values, _ in TYPES)), min_size=1, max_size=30))
def test_every_value_comes_back(rows):
    columns = decode_rows([sent(row) for row in rows], OIDS)
    found = [tuple(row) for row in zip(*(column.to_pylist() for column in columns), strict=True)]
    assert found == [tuple(str(value) if isinstance(value, UUID) else value for value in row) for row in rows]


def test_another_table_than_expected_is_refused():
    row = sent((None, "a", True, 1, 2, 3.0, EPOCH))
    with pytest.raises(DatabaseError, match="2 columns, but the database sent 7"):
        decode_rows([row], OIDS[:2])
    with pytest.raises(DatabaseError, match="type 20 with 4 bytes, not 8"):
        decode_rows([row], [2950, 25, 16, 20, 20, 701, 1184])
