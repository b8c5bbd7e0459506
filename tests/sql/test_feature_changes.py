"""The read model: what stood there (`feature_states`), and how a map differs between two instants (`feature_changes`)."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from functools import partial

import numpy as np
import pytest

from conetl.db.connection import execute
from conetl.model.base import utc_from_ns
from conetl.model.columns import COLUMNS, DERIVED, Face, stored_names
from tests import records
from tests.records import DAY_NS, START_NS

XYZ_M = (458_000.0, 5_428_000.0, 114.5)
#: As PostgreSQL calls the types of columns.
TYPES = {"float8": "double precision", "timestamptz": "timestamp with time zone"}
HOUR = timedelta(hours=1)


def day(number: float) -> datetime:
    return utc_from_ns(START_NS + int(number * DAY_NS))


def at(number: int, east_m: float = 0.0, height_m: float = 1.0):
    """Every 5 m a cone."""
    x, y, z = XYZ_M
    return records.standing_at((x + 5 * number + east_m, y, z), height_m)


def line(name: str, north_m: float, east_m: float = 0.0):
    x, y, z = XYZ_M
    shape = records.marking([(x + east_m + 2.5 * k, y + north_m, z) for k in range(5)])
    return records.line_feature(shape, name, first_seen_ns=START_NS)


#: name of a feature -> its state of day 2 (None: removed), and what a comparison of the days 1 and 3 says: change, shift (m).
CONES = {
    "stays": (at(0), None),
    "leaves": (None, ("removed", None)),
    "moves within the gate": (at(2, east_m=0.5), ("confirmed", 0.5)),
    "moves beyond the gate": (at(3, east_m=0.5001), ("moved", 0.5001)),
    "is as high": (at(4, height_m=1.1499), ("confirmed", 0.0)),
    "is higher": (at(5, height_m=1.1501), ("height_changed", 0.0)),
    "moves and is higher": (at(6, east_m=2.0, height_m=0.5), ("moved", 2.0)),
    "is missed": (at(7), ("missed", 0.0)),
}
LINES = {
    "line within the gate": (line("line within the gate", 20.25), ("confirmed", 0.25)),
    "line beyond the gate": (line("line beyond the gate", 20.2501), ("moved", 0.2501)),
    "line along itself": (line("line along itself", 20.0, east_m=5.0), ("confirmed", 0.0)),
}


@pytest.fixture(scope="module")
def numbers(module_conn):
    """Features of a map by name, committed on the days 0 and 2; one more came on day 2."""
    conn = module_conn
    cones = {name: records.feature(name, **at(number)) for number, name in enumerate(CONES)}
    lines = {name: line(name, 20.0) for name in LINES}
    records.commit(conn, *(records.added(one, track_index=None) for one in (cones | lines).values()), key="1")
    two = START_NS + 2 * DAY_NS
    deltas = [records.removed(cones["leaves"], two), records.not_seen(cones["is missed"], two)]
    for name, old in (cones | lines).items():
        new = LINES[name][0].__dict__ if name in LINES else CONES[name][0]
        if name not in ("stays", "leaves", "is missed"):
            state = {key: new[key] for key in ("xyz_m", "centre_xyz_m", "marking", "object_height_m") if key in new}
            deltas.append(records.changed("confirmed", old, two, **state, observation_count=6))
    new = records.feature("comes", seen_ns=two, **at(9))
    records.commit(conn, *deltas, records.added(new), key="2", start_ns=two)
    return {one.feature_id: name for name, one in (cones | lines | {"comes": new}).items()}


def rows_of(function, conn, numbers, **given):
    """Rows of a function of the default map by the name of the feature."""
    named = ", ".join(f"{name} => %({name})s" for name in given)
    rows = execute(conn, f"select * from {function}('default'{named and ', ' + named})", given)
    found = {numbers[row["feature_id"]]: row for row in rows}
    assert len(found) == len(rows)
    return found


changes = partial(rows_of, "feature_changes")
states = partial(rows_of, "feature_states")


def kinds(found):
    return {name: row["change"] for name, row in found.items()}


def test_what_differs_between_two_days(module_conn, numbers):
    found = changes(module_conn, numbers, from_at=day(1), to_at=day(3))
    expected = {name: told for name, (_, told) in (CONES | LINES).items() if told} | {"comes": ("added", None)}
    assert kinds(found) == {name: kind for name, (kind, _) in expected.items()}
    for name, (kind, shift_m) in expected.items():
        row = found[name]
        assert row["shift_m"] == (None if shift_m is None else pytest.approx(shift_m, abs=1e-6)), name
        assert row["changed_at"] == day(2), name
        assert row["is_line"] == (name in LINES)
        versions = {"added": (None, 1), "removed": (1, None), "missed": (1, 1)}.get(kind, (1, 2))
        assert (row["old_version"], row["new_version"]) == versions, name
        old_m = [row["old_easting_m"], row["old_northing_m"], row["old_ellipsoidal_height_m"]]
        assert (old_m == [None] * 3) == (kind == "added")
    assert found["moves and is higher"]["old_easting_m"] == XYZ_M[0] + 30


def test_nothing_differs_where_nothing_happened(module_conn, numbers):
    assert changes(module_conn, numbers, from_at=day(1), to_at=day(1.5)) == {}
    assert changes(module_conn, numbers, from_at=day(3)) == {}
    assert execute(module_conn, "select * from feature_changes('no map')") == []
    everything = changes(module_conn, numbers)
    assert kinds(everything) == dict.fromkeys((CONES | LINES | {"comes": None}).keys() - {"leaves"}, "added")
    assert {row["changed_at"] for name, row in everything.items() if name != "comes"} == {day(0)}


def test_the_horizontal_sigma_is_that_of_the_longest_axis(module_conn, numbers):
    for row in states(module_conn, numbers).values():
        cov_m2 = np.array([[row["sigma_e_m"] ** 2, row["cov_en_m2"]], [row["cov_en_m2"], row["sigma_n_m"] ** 2]])
        assert cov_m2[0, 1] and row["sigma_m"] == pytest.approx(np.linalg.eigvalsh(cov_m2)[-1] ** 0.5, rel=1e-9)


def test_from_later_to_earlier_is_the_inverse(module_conn, numbers):
    forth, back = (changes(module_conn, numbers, from_at=day(a), to_at=day(b)) for a, b in ((1, 3), (3, 1)))
    assert forth.keys() == back.keys()
    swapped = {"added": "removed", "removed": "added", "missed": "confirmed"}
    for name, row in forth.items():
        assert back[name]["change"] == swapped.get(row["change"], row["change"]), name
        assert (back[name]["old_row_id"], back[name]["new_row_id"]) == (row["new_row_id"], row["old_row_id"])


def test_states_of_an_instant(module_conn, numbers):
    assert states(module_conn, numbers, valid_at=day(-0.1)) == {}
    before, after = states(module_conn, numbers, valid_at=day(1)), states(module_conn, numbers)
    assert before.keys() == (CONES | LINES).keys()
    assert after.keys() == before.keys() - {"leaves"} | {"comes"}
    assert before["moves and is higher"]["easting_m"] == after["moves and is higher"]["easting_m"] - 2.0
    old, new = before["is missed"], after["is missed"]
    assert (old["version"], old["missed_count"], old["first_missed_at"], old["change"]) == (1, 0, None, "added")
    assert (new["version"], new["missed_count"], new["first_missed_at"], new["change"]) == (1, 1, day(2), "missed")
    assert (old["seen_count"], new["seen_count"]) == (1, 1)
    assert old["existence_probability"] > new["existence_probability"]
    assert (old["valid_to"], new["valid_from"], new["valid_to"]) == (day(2), day(2), None)
    assert (old["drive_id"], new["drive_id"], new["changeset_no"]) == ("drive_1", "drive_2", 2)
    assert all(
        row["object_height_m"] is row["object_height_sigma_m"] is None for name, row in after.items() if name in LINES
    )


def test_states_since_an_instant_are_the_last_ones_between(module_conn, numbers):
    now, since = states(module_conn, numbers), states(module_conn, numbers, since=day(1))
    assert since.keys() == now.keys() | {"leaves"}
    assert since["leaves"]["valid_to"] == day(2)
    assert {name: row["version_row_id"] for name, row in now.items()} == {
        name: row["version_row_id"] for name, row in since.items() if name != "leaves"
    }
    assert states(module_conn, numbers, since=day(2)) == now, "it was gone from then on"


def test_a_box_contains_what_stands_or_stood_in_it(module_conn, numbers):
    def box(west_m, east_m, south_m=-1.0, north_m=1.0):
        sides = (XYZ_M[0] + west_m, XYZ_M[1] + south_m, XYZ_M[0] + east_m, XYZ_M[1] + north_m)
        return execute(module_conn, "select ST_MakeEnvelope(%s, %s, %s, %s, 32632)::text as box", list(sides))[0]["box"]

    span = {"from_at": day(1), "to_at": day(3)}
    assert states(module_conn, numbers, box=box(-1, 6)).keys() == {"stays"}
    assert states(module_conn, numbers, box=box(-1, 6), valid_at=day(1)).keys() == {"stays", "leaves"}
    assert changes(module_conn, numbers, **span, box=box(-1, 6)).keys() == {"leaves"}
    for inside in (box(29, 31), box(31, 33)):  # where it came from, and where it went
        assert changes(module_conn, numbers, **span, box=inside).keys() == {"moves and is higher"}
    # A line is found by all of it, though its middle vertex is elsewhere.
    ends = box(9.5, 11, 19, 22)
    assert states(module_conn, numbers, box=ends).keys() == LINES.keys()
    assert states(module_conn, numbers, box=box(10.5, 11, 19, 22)).keys() == {"line along itself"}
    assert states(module_conn, numbers, box=box(40, 41, 19, 22)) == {}


def test_what_is_known_now_and_was_known_then(conn, samples):
    """A drive of day 0 comes after the one of day 1."""
    old, late = samples.feature("old", **at(0)), samples.feature("late", **at(1))
    known = [samples.commit(conn, samples.added(old), key="1").committed_at]
    unseen = samples.not_seen(old, START_NS + DAY_NS)
    known.append(samples.commit(conn, unseen, key="2", start_ns=START_NS + DAY_NS).committed_at)
    known.append(samples.commit(conn, samples.added(late), key="3").committed_at)
    ids = {old.feature_id: "old", late.feature_id: "late"}
    road = {"from_at": day(3), "to_at": day(3)}
    assert changes(conn, ids, **road) == {}, "one instant, as known now"
    told = [kinds(changes(conn, ids, **road, known_from=then)) for then in known]
    assert told == [{"old": "missed", "late": "added"}, {"late": "added"}, {}]
    assert kinds(changes(conn, ids, **road, known_from=known[0], known_at=known[1])) == {"old": "missed"}
    added = changes(conn, ids, **road, known_from=known[1])["late"]
    assert added["changed_at"] == day(0), "on the road, not in the database"
    gone = changes(conn, ids, **road, known_from=known[2], known_at=known[1])["late"]
    assert (gone["change"], gone["changed_at"]) == ("removed", None), "as known then it never stood there"
    assert [len(states(conn, ids, known_at=then)) for then in (known[0] - HOUR, *known)] == [0, 1, 1, 2]
    counts = [states(conn, ids, known_at=then, valid_at=day(3))["old"]["missed_count"] for then in known]
    assert counts == [0, 1, 1]


def test_the_thresholds_are_the_parameters_of_the_newest_changeset(module_conn, numbers):
    given = {"min_gate_m": 0.6, "marking_gate_m": 0.3, "moved_height_tolerance_m": 0.2}
    try:
        change = "update drive set reconcile = reconcile || %s where drive_id = 'drive_2'"
        execute(module_conn, change, [json.dumps(given)])
        found = kinds(changes(module_conn, numbers, from_at=day(1), to_at=day(3)))
        assert {name for name, kind in found.items() if kind in ("moved", "height_changed")} == {"moves and is higher"}
    finally:
        module_conn.rollback()


def test_the_view_has_every_shown_column_with_its_type(module_conn):
    """Those of changes alone are of `feature_changes`; longitude and latitude depend on the CRS, and are computed in Python."""
    execute(module_conn, "create temporary view changes as select * from feature_changes('default')")
    of_table = """
        select attname as name, format_type(atttypid, atttypmod) as type from pg_attribute
        where attrelid = %s::regclass and attnum > 0 and not attisdropped"""
    state, change, table = (
        {row["name"]: row["type"] for row in execute(module_conn, of_table, [name])}
        for name in ("conetl.feature_state", "changes", "conetl.feature_version")
    )
    module_conn.rollback()
    for column in COLUMNS:
        wanted = TYPES.get(column.kind, column.kind)
        if column.stored:
            assert table[column.name] == wanted
        if column.name in DERIVED or column.name in ("lon_deg", "lat_deg"):
            assert column.name not in state | change
        elif column.shown == Face.CHANGE:
            assert change[column.name] == wanted
        else:
            assert state[column.name] == wanted
    assert set(stored_names()) <= table.keys()


@pytest.mark.parametrize("call", [
    "feature_states('default', now())", "feature_states('default', since => now())", "feature_changes('default')",
    "feature cross join lateral state_after(cell, feature_id, 1, null, 'infinity')",
])  # fmt: skip
def test_functions_are_inlined(module_conn, numbers, call):
    """Otherwise they compute every row and column, whatever is asked for."""
    plan = "\n".join(row["QUERY PLAN"] for row in execute(module_conn, f"explain select 1 from {call}"))
    assert "Function Scan" not in plan.replace("Function Scan on comparison", ""), plan
