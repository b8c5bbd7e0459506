"""Worlds with all classes and several markings: what changes from day to day, and their truth files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.evaluation.markings import TRUTH_FILE, compare_markings, marking_figures, read_truth_markings
from conetl.evaluation.truth import read_truth, read_truth_cones
from conetl.geometry.packing import cov3
from conetl.model.errors import InputError
from conetl.model.feature_classes import FEATURE_CLASSES, LINE_CLASSES
from conetl.model.markings import Marking
from conetl.simulation.mixed_world import mixed_pass
from conetl.simulation.scenario import RoadMarking, painted_lines
from conetl.simulation.trajectory import MAP_SRID, map_SE3_road
from conetl.simulation.truth_files import write_truth


@given(st.integers(0, 1000))
def test_a_marking_moves_and_a_sign_is_added_on_day_2_and_a_marking_goes_on_day_3(seed: int) -> None:
    days = [mixed_pass(seed, number) for number in (1, 2, 3)]
    lines = [{one.marking_id: one for one in day.world.road.markings} for day in days]
    assert [name for name in lines[0] if lines[0][name] != lines[1][name]] == ["E2"]
    moved = np.array(lines[1]["E2"].points_m) - np.array(lines[0]["E2"].points_m)
    np.testing.assert_allclose(moved, [[0.0, -0.5]] * len(moved), atol=1e-12)
    assert lines[2] == {name: one for name, one in lines[1].items() if name != "T1"} and "T1" in lines[1]
    objects = [{one.object_id: one for one in day.world.objects if one.object_id} for day in days]
    (added,) = objects[1].keys() - objects[0].keys()
    assert days[1].changes[added] == "added" and {**objects[0], added: objects[1][added]} == objects[1] == objects[2]
    assert days[0].world.cones == days[2].world.cones
    assert set(days[0].changes.values()) == {"added"} and set(days[2].changes.values()) == {"confirmed"}
    assert mixed_pass(seed, 2) == days[1], "equal seeds give equal worlds"


def test_there_is_no_fourth_day() -> None:
    with pytest.raises(InputError, match="not 4"):
        mixed_pass(1, 4)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_truth_holds_every_class_within_its_heights_where_it_stands(seed: int, tmp_path: Path) -> None:
    day = mixed_pass(seed, 2)
    write_truth(tmp_path, day)
    rows = read_truth(tmp_path / "truth.csv")
    assert {row.category for row in rows} == set(FEATURE_CLASSES) - set(LINE_CLASSES)
    in_road = np.linalg.inv(map_SE3_road())
    by_id = {one.object_id: one for one in day.world.objects if one.object_id}
    for row in rows:
        low, high = FEATURE_CLASSES[row.category].heights_m
        assert low < row.cone_height_m < high, row
        x, y, z, _ = in_road @ [row.easting_m, row.northing_m, row.height_ellipsoidal_m, 1.0]
        if (item := by_id.get(row.cone_id)) is not None:
            assert (x, y) == (pytest.approx(item.x_m, abs=1e-3), pytest.approx(item.y_m, abs=1e-3))
            assert z + row.cone_height_m == pytest.approx(item.ground_m + item.height_m, abs=2e-3), "its upper end"
    assert len(read_truth_cones(tmp_path / "truth.csv")[0]) == len(rows)


def test_truth_of_markings_is_read_where_they_were_painted(tmp_path: Path) -> None:
    day = mixed_pass(5, 1)
    write_truth(tmp_path, day)
    known = read_truth_markings(tmp_path / TRUTH_FILE, MAP_SRID)
    place = map_SE3_road()
    painted = []
    for one in day.world.road.markings:
        points = (
            np.column_stack([np.array(one.points_m), np.full(len(one.points_m), 0.003)]) @ place[:3, :3].T
            + place[:3, 3]
        )
        pattern = "solid" if one.dash_m is None else "dashed"
        painted.append(
            Marking(
                vertices_m=tuple(map(tuple, points.tolist())), cov_m2=(cov3(np.eye(3) * 1e-4),) * len(points),
                width_m=one.width_m, width_sigma_m=0.01, colour=one.colour, pattern=pattern, dash_m=one.dash_m, gap_m=one.gap_m,
            )
        )  # fmt: skip
    figures = marking_figures([compare_markings(known, painted, lambda p: np.ones(len(p), dtype=bool))])
    assert (figures.completeness, figures.correctness, figures.pattern_share, figures.colour_share) == (1.0,) * 4
    assert figures.lateral_p95_m is not None and figures.lateral_p95_m < 1e-3
    assert figures.height_p95_m is not None and figures.height_p95_m < 1e-3


@given(st.floats(1.0, 8.0), st.floats(1.0, 12.0), st.floats(20.0, 60.0), st.floats(0.0, 3.0))
def test_dashes_are_whole_and_begin_where_the_pattern_says(dash: float, gap: float, length: float, bend: float) -> None:
    points = ((0.0, 0.0), (length / 2, bend), (length, 0.0))
    lines = painted_lines(RoadMarking("a", points, dash, gap))
    along = 2 * float(np.hypot(length / 2, bend))
    assert len(lines) == int(np.ceil(along / (dash + gap)))
    for line in lines:
        assert np.hypot(*np.diff(line, axis=0).T).sum() == pytest.approx(dash)
    (whole,) = painted_lines(RoadMarking("a", points))
    assert whole.tolist() == [list(point) for point in points]


@given(st.integers(0, 1000))
def test_objects_stand_on_the_ground(seed: int) -> None:
    """Of the asphalt, or of the pavement and the verge, which are higher."""
    world = mixed_pass(seed, 1).world
    surveyed = [one for one in world.objects if one.object_id]
    for one in surveyed:
        assert one.ground_m == world.road.ground_m(one.y_m), one.object_id
    assert {0.0, 0.08, 0.10} == {one.ground_m for one in surveyed}
