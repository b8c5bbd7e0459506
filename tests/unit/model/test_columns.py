"""The list of columns of features: names, faces, and what records have of it."""

from __future__ import annotations

import pytest

from conetl.model.columns import BY_NAME, COLUMNS, DERIVED, GROUPS, Face, as_markdown, names, select_list, stored_names
from conetl.model.map_records import DeltaKind, MapFeature
from conetl.model.markings import Marking

LINES = set(stored_names("lines"))


def test_names_are_unique() -> None:
    assert len(BY_NAME) == len(COLUMNS)
    assert all(group and len(set(group)) == len(group) for group in GROUPS.values())


def test_every_stored_column_is_a_field_of_a_record() -> None:
    """Those of lines alone are of their shape."""
    assert Marking.model_fields.keys() >= LINES
    assert set(stored_names()) - LINES <= MapFeature.model_fields.keys()
    assert not LINES & MapFeature.model_fields.keys()


@pytest.mark.parametrize("column", COLUMNS, ids=lambda column: column.name)
def test_a_column_has_a_heading_and_a_meaning_and_says_when_it_is_null(column) -> None:
    assert column.title
    assert column.meaning.endswith(".")
    assert column.shown or column.stored, "nobody sees it"
    assert bool(column.unit) == (column.kind in ("float8", "timestamptz"))
    if column.of != "all" and column.shown & Face.FILE:
        assert column.null, "what it is of other features"


def test_derived_columns_exist_as_do_those_that_they_follow_from() -> None:
    assert DERIVED.keys() | set(DERIVED.values()) <= BY_NAME.keys()


def test_a_face_shows_its_columns_of_one_geometry_in_the_order_of_the_list() -> None:
    of_points, of_lines = names(Face.FILE, "points"), names(Face.FILE, "lines")
    assert "object_height_m" in of_points and "object_height_m" not in of_lines
    assert "width_m" in of_lines and "width_m" not in of_points
    assert set(of_points) | set(of_lines) == set(names(Face.FILE))
    assert sorted(of_points, key=list(BY_NAME).index) == list(of_points)


def test_a_group_is_a_list_of_a_select() -> None:
    assert select_list("listed").startswith("x.feature_id, x.version, ")
    assert select_list("listed").count("x.") == len(GROUPS["listed"])


def test_kinds_of_changes_are_those_of_deltas() -> None:
    assert set(BY_NAME["change"].words) == set(DeltaKind)


def test_the_table_of_the_documentation_has_a_row_for_each_column() -> None:
    rows = [line for line in as_markdown().splitlines() if line.startswith("| `")]
    assert [row.split("`")[1] for row in rows] == list(BY_NAME)
    assert all(row.count("|") == 5 for row in rows)
