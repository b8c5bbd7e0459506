"""Reference lines against closed forms, and lane borders against what their widths add up to."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import fresnel

from conetl.model.errors import InputError
from conetl.readers.base_layers import roads
from conetl.readers.base_layers.opendrive import read_opendrive
from conetl.readers.base_layers.roads import (
    Border,
    Piece,
    RoadShape,
    RoadSpan,
    arc,
    lines_of,
    param_poly3,
    poly3,
    spiral,
)


def straight(length_m, k0=0.0, k1=0.0, *, start_m=0.0, heading_rad=0.0):
    return Piece(start_m, 0.0, 0.0, heading_rad, length_m, spiral, (k0, k1))


def reference_line(piece, s):
    """As the second one of two roads."""
    other = Piece(0.0, 7.0, 7.0, 1.0, 5.0, arc, (0.1,))
    return roads.reference_line([other, piece], np.array([0, 1]), s, np.ones(len(s), np.int64))


def cubics(*pieces):
    """Start, a, b, ... of each, the others 0."""
    return [[*piece, *[0.0] * (5 - len(piece))] for piece in pieces]


def lane(number, inner, widths=(), borders=()):
    return Border(f"lane {number}", {}, abs(number), int(np.sign(number)), inner, widths, borders)


@given(st.floats(20.0, 300.0), st.floats(10.0, 500.0))
def test_a_spiral_is_eulers(length_m, radius_m):
    """Clothoid from straight to radius: x = a C(t), y = a S(t) with Fresnel's integrals."""
    piece = straight(length_m, 0.0, 1 / radius_m)
    s = np.linspace(0, length_m, 7)
    xy, heading = reference_line(piece, s)
    scale = math.sqrt(math.pi * length_m * radius_m)
    sine, cosine = fresnel(s / scale)
    assert xy == pytest.approx(np.column_stack([scale * cosine, scale * sine]), abs=1e-6)
    assert heading == pytest.approx(s**2 / (2 * length_m * radius_m))


def test_a_spiral_whose_curvature_hardly_changes_is_an_arc():
    """Which is tested with its straight and its end in `test_base_layers.py`."""
    exact = Piece(0.0, 0.0, 0.0, 0.3, 80.0, arc, (0.02,))
    nearly = straight(80.0, 0.02, 0.02 + 1e-12, heading_rad=0.3)
    s = np.linspace(0, 80, 9)
    assert reference_line(nearly, s)[0] == pytest.approx(reference_line(exact, s)[0], abs=1e-6)


def test_poly3_counts_along_the_curve():
    """v = u: a line at 45 degrees, so the end after s = 10 is 10 / sqrt(2) away on both axes."""
    piece = Piece(0.0, 1.0, 2.0, 0.0, 10.0, poly3, (0.0, 1.0, 0.0, 0.0))
    xy, heading = reference_line(piece, np.array([0.0, 10.0]))
    assert xy[1] == pytest.approx([1 + 10 / math.sqrt(2), 2 + 10 / math.sqrt(2)], abs=1e-6)
    assert heading[1] == pytest.approx(math.pi / 4)


@pytest.mark.parametrize("normalised", [False, True])
def test_param_poly3(normalised):
    """A parabola v = u^2 / 20 over u = 0..10, turned by a right angle."""
    factor = 10.0 if normalised else 1.0
    shape = (factor, 0.0, factor, 0.0, 0.0, 0.0, 0.0, factor**2 / 20, 0.0)
    piece = Piece(0.0, 0.0, 0.0, math.pi / 2, 10.0, param_poly3, shape)
    xy, heading = reference_line(piece, np.array([5.0, 10.0]))
    assert xy == pytest.approx(np.array([[-1.25, 5.0], [-5.0, 10.0]]))
    assert heading[1] == pytest.approx(math.pi / 2 + math.pi / 4)


def test_lane_borders_add_up_from_the_centre():
    borders = [
        Border("centre", {}, 0), lane(1, 0, cubics((0.0, 3.0))), lane(2, 1, cubics((0.0, 2.0), (10.0, 2.0, 0.1))),
        lane(-1, 0, cubics((0.0, 3.5))), lane(-2, 3, (), cubics((0.0, -5.0))),
    ]  # fmt: skip
    alone = RoadShape([straight(10.0)], [], [], [], [RoadSpan(0.0, 10.0, [Border("reference_line", {}, None)])])
    own = RoadShape([straight(200.0)], [], [], cubics((0.0, 0.5)), [RoadSpan(100.0, 120.0, borders)])
    _, found, [line] = lines_of([alone, own, alone])
    t = {one.kind: np.interp([100.0, 110.0, 120.0], *one.xyz[:, :2].T) for one in found}
    assert t["centre"] == pytest.approx([0.5, 0.5, 0.5])
    assert t["lane 1"] == pytest.approx([3.5, 3.5, 3.5])
    assert t["lane 2"] == pytest.approx([5.5, 5.5, 6.5])
    assert t["lane -1"] == pytest.approx([-3.0, -3.0, -3.0])
    assert t["lane -2"] == pytest.approx([-5.0, -5.0, -5.0])
    assert line.xyz == pytest.approx(np.column_stack([np.arange(11), np.zeros((11, 2))]))


def test_heights_follow_elevation_and_superelevation():
    borders = [Border(None, {}, 0), lane(1, 0, cubics((0.0, 4.0)))]
    own = RoadShape(
        [straight(100.0)], cubics((0.0, 100.0, 0.02)), cubics((0.0, 0.05)), [], [RoadSpan(0.0, 50.0, borders)]
    )  # fmt: skip
    [[line]] = lines_of([own])
    assert line.xyz[[0, -1], 2] == pytest.approx([100 + 4 * math.sin(0.05), 101 + 4 * math.sin(0.05)])
    assert line.xyz[[0, -1], 1] == pytest.approx([4 * math.cos(0.05)] * 2)


def test_cubics_hold_from_their_start_and_samples_meet_the_joints():
    table = [cubics((0.0, 9.0)), cubics((5.0, 2.0, 1.0), (0.0, 1.0)), []]
    owner, s = np.array([1, 1, 1, 1, 2]), np.array([-1.0, 4.9, 5.0, 6.0, 1.0])
    assert roads.cubics_at(table, owner, s) == pytest.approx([0.0, 1.0, 2.0, 3.0, 0.0])
    joints = 0 + 1j * np.array([0.0, 3.3, 6.6])
    s, span = roads.samples_m(joints, np.array([0, 0]), np.array([0.0, 3.3]), np.array([9.9, 4.0]))
    assert {0.0, 3.3, 6.6, 9.9} <= set(s[span == 0].tolist())
    assert (np.diff(s[span == 0]) > 0).all() and np.diff(s[span == 0]).max() <= 1.0 + 1e-9
    assert s[span == 1].tolist() == [3.3, 4.0]


def road(inner: str) -> str:
    return f'<road id="7" length="10"><planView>{inner}</planView></road>'


def test_a_road_without_lanes_is_its_reference_line(tmp_path):
    path = tmp_path / "lanes.xodr"
    straight_on = '<geometry s="0" x="1" y="2" hdg="0" length="10"/>'
    path.write_text(f"<OpenDRIVE>{road(straight_on)}</OpenDRIVE>")
    [line] = read_opendrive(path).lines
    assert line.kind == "reference_line"
    np.testing.assert_allclose(line.xyz, [[1, 2, 0], [11, 2, 0]], atol=1e-9)


def test_a_map_of_which_nearly_nothing_can_be_used_is_refused(tmp_path):
    path = tmp_path / "lanes.xodr"
    path.write_text(f"<OpenDRIVE>{road('') * 20_001}</OpenDRIVE>")
    with pytest.raises(
        InputError, match="more than 20,000 of its records cannot be used; the first: road '7': it has no"
    ):
        read_opendrive(path)


def test_a_road_that_is_too_far_away_costs_itself_only(tmp_path):
    path = tmp_path / "lanes.xodr"
    roads = [road(f'<geometry s="0" x="{x}" y="2" hdg="0" length="10"/>') for x in ("1", "1e12", "20")]
    path.write_text(f"<OpenDRIVE>{''.join(roads)}</OpenDRIVE>")
    found = read_opendrive(path)
    assert [line.xyz[0, 0] for line in found.lines] == [1, 20]
    assert found.refused[0] == "road '7': it has coordinates beyond 1e+09 m"


@pytest.mark.parametrize(
    "text",
    [
        "<{0}/>",
        "<OpenDRIVE>" + road("<geometry s='0' x='1' y='2' hdg='0' length='10'><{0}/></geometry>") + "</OpenDRIVE>",
    ],
)
def test_long_names_of_elements_are_cut_in_messages(text, tmp_path):
    path = tmp_path / "lanes.xodr"
    path.write_text(text.format("a" * 10_000))
    with pytest.raises(InputError, match="<aaa") as raised:
        read_opendrive(path)
    assert len(str(raised.value)) < 1000
