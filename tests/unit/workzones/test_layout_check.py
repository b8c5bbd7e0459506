"""The layout check on lane closures with known faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.model.work_zone_params import LayoutParams, WorkZoneParams
from conetl.model.work_zone_records import DrivePath, LaneLine, Level, Rule
from conetl.workzones import layout_check
from conetl.workzones.cone_rows import find_rows
from conetl.workzones.layout_check import FOOT_M, MILE_KM
from conetl.workzones.zone_layout import describe, layout_of
from tests.cases import cases
from tests.synthetic.tapers import LANE_M, Closure, closure, cone, zone_of

RULES, PARAMS = layout_check.layout_rules(), WorkZoneParams()
FAULTS = ("missing", "spacing", "in lane", "none", "short taper")
SURE = (Level.VIOLATION, Level.DEVIATION, Level.NOTICE)


def findings(made: Closure):
    layout = layout_of(made.zone, made.paths, made.lanes, PARAMS)
    return layout, layout_check.check_layout(made.zone, layout, made.speed_kmh, RULES, PARAMS)


def is_the_fault(finding, made: Closure) -> bool:
    if made.fault in ("missing", "spacing"):
        rules = (Rule.MISSING_CONE,) if made.fault == "missing" else (Rule.SPACING, Rule.MISSING_CONE)
        return set(finding.feature_ids) == set(made.gap) and finding.rule in rules
    if made.fault == "in lane":
        return finding.rule == Rule.CONE_IN_LANE and finding.feature_ids == (made.stray,)
    return made.fault == "short taper" and finding.rule == Rule.TAPER_LENGTH


@pytest.mark.parametrize("count", cases(30, release=[100]))
def test_every_fault_of_tapers_is_found_without_a_false_alarm(count):
    """Each with a missing cone, a wide gap or a cone in the lane; and others with a short taper or no fault. Sigma 0.1 m."""
    made_up = [(seed, FAULTS[seed % 3]) for seed in range(count)]
    made_up += [(seed, FAULTS[3 + seed % 2]) for seed in range(2 * count // 5)]
    for seed, fault in made_up:
        made = closure(seed, fault, sigma_m=0.1)
        layout, found = findings(made)
        assert layout.axis_source == "lanes", seed
        sure = [finding for finding in found if finding.level in SURE]
        assert all(is_the_fault(finding, made) for finding in sure), (seed, fault, sure)
        assert bool(sure) == (fault != "none"), (seed, fault, found)
        assert describe(made.zone, layout, PARAMS).closed_side == ("left" if seed % 2 else "right"), seed


def test_only_what_a_standard_states_is_a_violation():
    """Every number of a standard has its section or table; a cone in the lane departs from no standard."""
    for name in layout_check.STANDARDS:
        standard = layout_check.read_standard(name)
        assert all(rule.source and rule.text for rule in standard.rules.values()) and standard.not_covered
        assert standard.rules.keys() <= LayoutParams.model_fields.keys()
    ratios = [layout_check.taper_ratio(speed_mph * MILE_KM, RULES) for speed_mph in (40, 45)]
    assert ratios == pytest.approx([40**2 / 60, 45])
    assert layout_check.allowed_spacing_m(30 * MILE_KM, RULES) == pytest.approx((30 * FOOT_M, 60 * FOOT_M))
    for seed, fault in enumerate(FAULTS * 4):
        for finding in findings(closure(seed, fault, sigma_m=0.1))[1]:
            assert finding.level is not Level.VIOLATION or finding.norm.startswith("MUTCD 11 (2023), ")
            assert finding.level is not Level.DEVIATION or finding.norm.startswith("no standard")


def test_a_standard_without_figures_leaves_the_rows_own_spacing():
    rules = layout_check.layout_rules("rsa_21")
    assert layout_check.allowed_spacing_m(50.0, rules) == (np.inf, np.inf)
    found = 0
    for seed in range(12):
        made = closure(seed, "missing", sigma_m=0.05)
        some = layout_check.check_layout(
            made.zone, layout_of(made.zone, made.paths, made.lanes, PARAMS), made.speed_kmh, rules, PARAMS
        )
        assert all(
            is_the_fault(f, made) and f.level is Level.NOTICE and np.isfinite([f.limit, f.sigma]).all() for f in some
        ), some
        found += bool(some)
    assert found >= 10


def test_without_lane_lines_there_is_no_false_alarm_either():
    missed = 0
    for seed in range(40):
        made = closure(seed, FAULTS[seed % 4], sigma_m=0.1, with_lanes=False)
        layout, found = findings(made)
        assert layout.axis_source == "drives"
        right = [finding for finding in found if set(finding.feature_ids) == set(made.gap or (made.stray,))]
        wrong = [finding for finding in found if finding.level in SURE and finding not in right]
        assert not wrong, (seed, made.fault, wrong)
        missed += made.fault != "none" and not right
    assert missed <= 2, "of 30 faults"


def test_large_sigmas_make_no_violation_of_what_they_explain():
    """The same map, known ten times worse: nothing certain is left of a gap that exceeds the rule by a metre."""
    made = closure(6, "spacing", sigma_m=0.02)
    assert any(finding.level == Level.VIOLATION for finding in findings(made)[1])
    vague = tuple(c.model_copy(update={"cov_m2": (9.0, 0.0, 0.0, 9.0, 0.0, 9.0)}) for c in made.zone.cones)
    found = findings(replace(made, zone=replace(made.zone, cones=vague)))[1]
    assert not [finding for finding in found if finding.level in SURE]


@pytest.mark.parametrize(
    ("speed_mph", "length_ft"), [(25, 125), (30, 180), (35, 245), (40, 320), (45, 540), (55, 660), (65, 780), (70, 840)]
)
def test_taper_lengths_are_those_of_the_published_table(speed_mph, length_ft):
    """Merging tapers for 12 ft of width, as tabulated for use in California (rounded to 5 ft)."""
    assert 12 * layout_check.taper_ratio(speed_mph * MILE_KM, RULES) == pytest.approx(length_ft, abs=2.5)
    taper_m, tangent_m = layout_check.allowed_spacing_m(speed_mph * MILE_KM, RULES)
    assert (taper_m / FOOT_M, tangent_m / FOOT_M) == pytest.approx((speed_mph, 2 * speed_mph))


def moved(made: Closure, angle: float, shift) -> Closure:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    origin = made.paths[0].xy_m[0]

    def place(xy):
        return (np.asarray(xy) - origin) @ turn.T + origin + shift

    def turned(feature):
        x, y = place(feature.xyz_m[:2])
        return feature.model_copy(update={"xyz_m": (float(x), float(y), feature.xyz_m[2])})

    return replace(
        made,
        zone=replace(made.zone, cones=tuple(turned(c) for c in made.zone.cones)),
        paths=[DrivePath(p.drive_id, p.captured_from_ns, place(p.xy_m)) for p in made.paths],
        lanes=[LaneLine(place(line.xy_m)) for line in made.lanes],
    )


def essence(found):
    return {(f.rule, f.level, frozenset(f.feature_ids)) for f in found}


@settings(max_examples=4)
@given(
    seed=st.integers(0, 40),
    fault=st.sampled_from(("missing", "spacing", "in lane")),
    angle=st.floats(-3, 3),
    east=st.floats(-1e5, 1e5),
    north=st.floats(-1e5, 1e5),
)
def test_findings_do_not_depend_on_where_the_road_lies_and_turns(seed, fault, angle, east, north):
    made = closure(seed, fault)
    before, after = findings(made)[1], findings(moved(made, angle, np.array([east, north])))[1]
    assert essence(after) == essence(before)
    assert [f.value for f in after] == pytest.approx([f.value for f in before], abs=1e-5)


@settings(max_examples=4)
@given(seed=st.integers(0, 40), fault=st.sampled_from(("missing", "spacing", "in lane")))
def test_gaps_and_strays_are_the_same_seen_from_the_other_direction(seed, fault):
    made = closure(seed, fault)
    back = replace(
        made,
        paths=[DrivePath(p.drive_id, p.captured_from_ns, p.xy_m[::-1]) for p in made.paths],
        lanes=[LaneLine(line.xy_m[::-1]) for line in made.lanes],
    )
    (there, one), (here, other) = findings(made), findings(back)
    kinds = (Rule.SPACING, Rule.MISSING_CONE, Rule.CONE_IN_LANE)
    assert essence(f for f in other if f.rule in kinds and f.level in SURE) == essence(
        f for f in one if f.rule in kinds and f.level in SURE
    )
    assert there.cones == here.cones[::-1]


def test_a_shoulder_taper_is_not_asked_to_be_a_merging_one():
    way = np.arange(-60.0, 160.0, 2.0)
    lanes = [LaneLine(np.stack([way, np.full(len(way), y)], axis=1)) for y in (0.0, 3.5, 7.0)]
    path = [DrivePath("drive", 1, np.stack([way, np.full(len(way), 1.8)], axis=1))]
    # From 3 m beside the road to its edge line over 24 m; at 50 km/h a merging taper would need 48 m, a shoulder taper 16 m.
    s = [0.0, 6.0, 12.0, 18.0, 24.0, 36.0, 48.0, 60.0]
    o = [-3.1, -2.35, -1.6, -0.85, -0.1, -0.1, -0.1, -0.1]
    zone = zone_of([cone(k, np.array(xy), 0.02) for k, xy in enumerate(zip(s, o, strict=True))])
    layout = layout_of(zone, path, lanes, PARAMS)
    assert [round(t.shift_m, 1) for t in layout.rows[0].tapers] == [3.0]
    assert layout_check.check_layout(zone, layout, 50.0, RULES, PARAMS) == []
    found = describe(zone, layout, PARAMS)
    assert (found.impact, found.closed_lane_count, found.closed_side) == ("all-lanes-open", 0, "right")
    assert LANE_M == 3.5
    beside = describe(
        zone, layout_of(zone, path, [LaneLine(line.xy_m + np.array([0.0, 8.0])) for line in lanes], PARAMS), PARAMS
    )
    assert (beside.impact, beside.layout.axis_source) == ("unknown", "drives"), "the vehicle was not on this road"


def test_the_sigma_of_a_taper_is_that_of_its_line_with_the_scatter_of_the_row():
    """The prior counts as four cones; a line takes two of them."""
    stations_m, scatter_m = np.arange(6) * 10.0, np.array([0.2, -0.3, 0.1, 0.3, -0.1, -0.2])
    offsets_m, exact = 0.1 * stations_m + scatter_m, np.full(6, 1e-6)
    [row] = find_rows(stations_m, offsets_m, exact, exact, PARAMS, traffic_sign=1.0, axis_sigma_m=0.1)
    [taper] = row.tapers
    (slope, level_m), prior_m = np.polyfit(stations_m, offsets_m, 1), PARAMS.placement_sigma_m
    chi2 = (((offsets_m - slope * stations_m - level_m) / prior_m) ** 2).sum()
    variance_m2 = prior_m**2 * (4 + chi2) / (4 + len(stations_m) - 2)
    sigma = np.sqrt(variance_m2 / ((stations_m - stations_m.mean()) ** 2).sum())
    assert (taper.shift_m, taper.shift_sigma_m) == pytest.approx((slope * 50.0, sigma * 50.0), rel=1e-6)
