"""Stations and offsets along a line."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from conetl.geometry.linear_reference import locate, project, smoothed, spaced

BEND = np.stack([100 * np.sin(np.linspace(0, 1, 80)), 100 - 100 * np.cos(np.linspace(0, 1, 80))], axis=1)
finite = st.floats(-30, 130)


@given(s=finite, o=st.floats(-20, 20))
def test_locate_and_project_are_inverse(s, o):
    back_s, back_o = project(BEND, locate(BEND, np.array([s]), np.array([o])))
    # A polyline has corners: beside one, a point is nearest to the corner itself.
    assert back_s[0] == pytest.approx(s, abs=0.3)
    assert back_o[0] == pytest.approx(o, abs=0.01)


def test_left_is_positive_and_the_line_goes_on_straight_beyond_its_ends():
    line = np.array([[0.0, 0.0], [10.0, 0.0]])
    s, o = project(line, np.array([[5.0, 2.0], [-3.0, -1.0], [14.0, 1.0]]))
    assert s == pytest.approx([5.0, -3.0, 14.0])
    assert o == pytest.approx([2.0, -1.0, 1.0])


def test_many_points_are_projected_like_one():
    points = np.random.default_rng(1).uniform(-20, 110, (700, 2))
    together = project(BEND, points)
    alone = [project(BEND, point[None]) for point in points]
    assert np.allclose(together[0], [s[0] for s, _ in alone])
    assert np.allclose(together[1], [o[0] for _, o in alone])


def test_long_lines_with_uneven_parts_are_projected_as_shapely_does():
    """Also where parts of the line are long, cross each other or have no length, and far from all of them."""
    rng = np.random.default_rng(3)
    steps = rng.normal(0, 1, (2000, 2)) * rng.choice([0.0, 0.1, 2.0, 300.0], (2000, 1), p=[0.1, 0.3, 0.5, 0.1])
    line = np.cumsum(steps, axis=0) + np.array([458_000.0, 5_428_000.0])
    points = line[rng.integers(0, len(line), 700)] + rng.normal(0, 1, (700, 2)) * rng.choice([1, 2000], (700, 1))
    s, o = project(line, points)
    beyond_m = 1e5
    ends = locate(line, np.array([-beyond_m, float(np.hypot(*np.diff(line, axis=0).T).sum()) + beyond_m]), np.zeros(2))
    whole, places = shapely.LineString([ends[0], *line, ends[1]]), shapely.points(points)
    assert np.allclose(np.abs(o), shapely.distance(whole, places), atol=1e-6)
    assert np.allclose(s, shapely.line_locate_point(whole, places) - beyond_m, atol=1e-4)


def test_smoothing_removes_wiggles_and_keeps_straight_lines_to_their_ends():
    x = np.arange(0.0, 80.0, 0.5)
    line = np.stack([x, 0.02 * x], axis=1)
    assert np.abs(project(line, smoothed(line, 2.0, 5.0))[1]).max() < 1e-9
    assert np.allclose(smoothed(line, 2.0, 5.0)[[0, -1]], line[[0, -1]], atol=0.01)
    noisy = line + np.random.default_rng(2).normal(0, 0.1, line.shape)
    # The ends are held by their points.
    assert np.abs(project(line, smoothed(noisy, 2.0, 5.0)[4:-4])[1]).max() < 0.12


def test_a_standing_car_adds_nothing():
    line = np.array([[0.0, 0.0], [0.01, 0.0], [0.02, 0.01], [3.0, 0.0]])
    assert line[spaced(line, 0.5)].tolist() == [[0.0, 0.0], [3.0, 0.0]]
    with pytest.raises(ValueError, match="two different points"):
        project(np.zeros((3, 2)), np.zeros((1, 2)))
