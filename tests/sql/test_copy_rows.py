"""What COPY takes in is what the table gives back."""

from __future__ import annotations

import json
from uuid import uuid4

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from conetl.db import copy_rows
from conetl.db.connection import copy_columns, execute

TEXTS = st.none() | st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=20)
JSONS = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc", max_size=3), inner, max_size=3),
    max_leaves=6,
)
ROWS = st.lists(
    st.tuples(
        st.none() | st.integers(-(2**31), 2**31 - 1),
        st.integers(-(2**63), 2**63 - 1),
        st.none() | st.floats(allow_nan=False),
        st.booleans(),
        TEXTS,
        JSONS,
        st.uuids(),
    ),
    max_size=12,
)


@pytest.fixture
def table(conn):
    execute(conn, "create temp table t (i integer, b bigint, d float8, f boolean, s text, j jsonb, u uuid)")
    return conn


def comparable(rows):
    """In one order of rows and of JSON keys: neither is kept."""
    return sorted(repr((*row[:5], json.dumps(row[5], sort_keys=True), row[6])) for row in rows)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=ROWS)
def test_every_row_comes_back(table, rows):
    execute(table, "truncate t")
    i, b, d, f, s, j, u = ([row[k] for row in rows] for k in range(7))
    columns = {"i": i, "b": b, "d": d, "f": f, "s": s, "j": [{"value": value} for value in j], "u": u}
    copy_columns(table, "t", columns)
    found = execute(table, "select * from t")
    cleaned = [json.loads(copy_rows.json_text({"value": value})) for value in j]
    expected = [(*row[:5], value, row[6]) for row, value in zip(rows, cleaned, strict=True)]
    assert comparable(tuple(row.values()) for row in found) == comparable(expected)


def test_points_arrays_and_times(conn):
    execute(conn, "create temp table g (u uuid, p geometry(PointZ, 32632), a float8[], t timestamptz)")
    key = uuid4()
    columns = {
        "u": [key] * 2,
        "p": copy_rows.points([(1.5, -2.25, 1e-9), (3e8, 0, 7)], 32632),
        "a": copy_rows.arrays([[1.0, 2.0], [0.1, -1e300]]),
        "t": copy_rows.timestamps_from_ns([946_684_800_000_000_999, -1_000]),
    }
    copy_columns(conn, "g", columns)
    rows = execute(
        conn, "select u, ST_X(p) as x, ST_Y(p) as y, ST_Z(p) as z, a, extract(epoch from t)::float8 as t from g"
    )
    assert [tuple(row.values()) for row in rows] == [
        (key, 1.5, -2.25, 1e-9, [1.0, 2.0], 946_684_800),
        (key, 3e8, 0, 7, [0.1, -1e300], pytest.approx(-1e-6, abs=1e-12)),
    ]


def test_no_rows_are_no_rows(table):
    copy_columns(table, "t", {"i": [], "s": []})
    assert execute(table, "select count(*) as n from t") == [{"n": 0}]
