"""Planned against found: each difference of its kind, only where drives looked, in any order of plans, zones and drives."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from conetl.model.base import ns_from_utc
from conetl.model.planned_zones import DifferenceKind, PlannedZone
from conetl.model.work_zone_params import PlanParams
from conetl.workzones.looks import DriveFrames, FoundZone, Looks, ZonePhase
from conetl.workzones.plan_comparison import PlacedPlan, compare, shape_of
from tests.synthetic.permitted_city import CASES, score

PARAMS = PlanParams()
K = DifferenceKind
NOON = datetime(2026, 3, 1, 12, tzinfo=UTC)


def day(number: float) -> datetime:
    return NOON + timedelta(days=number)


def ns(number: float) -> int:
    return ns_from_utc(day(number))


def plan(
    name: str = "A",
    *,
    begin: float = 0,
    end: float | None = 10,
    x: tuple[float, float] = (0, 100),
    y: float = 0,
    **more: object,
):
    zone = PlannedZone(
        plan_id=name,
        kind="permit",
        starts_at=day(begin),
        ends_at=None if end is None else day(end),
        parts=(((0.0, 0.0),),),
        **more,
    )
    return PlacedPlan("permits", zone, shape_of([np.array([[x[0], y], [x[1], y]], float)]))


def zone(
    number: int = 1,
    *,
    seen: tuple[float, float] = (1, 9),
    gone: float | None = None,
    x: tuple[float, float] = (5, 95),
    y: float = 3,
    **more,
):
    xy_m = np.column_stack([np.arange(*x, 6.0), np.full(len(np.arange(*x, 6.0)), y)])
    return FoundZone(
        UUID(int=number),
        (ZonePhase(ns(seen[0]), ns(seen[1]), xy_m),),
        ns(seen[0]),
        ns(seen[1]),
        None if gone is None else ns(gone),
        0.05,
        0.99,
        **more,
    )


def drive(
    at: float, *, x: tuple[float, float] = (-100, 300), y: float = 0, step_m: float = 2.0, name: str = ""
) -> DriveFrames:
    along = np.arange(*x, step_m)
    frames = np.arange(len(along))
    return DriveFrames(
        name or f"day {at}", frames, ns(at) + frames * 100_000_000, np.column_stack([along, np.full(len(along), y)])
    )


DAILY = [drive(number) for number in range(-3, 15)]


def rows(plans, zones, drives=DAILY, at: float = 14):
    return [
        (row.plan_id, row.zone_id and row.zone_id.int, row.kind)
        for row in compare(plans, zones, drives, PARAMS, at_ns=ns(at))
    ]


@pytest.mark.parametrize(
    ("plans", "zones", "expected"),
    [
        ([plan()], [zone()], [("A", 1, K.PERMITTED)]),
        ([], [zone()], [(None, 1, K.NO_PERMIT)]),
        ([plan()], [], [("A", None, K.NOT_FOUND)]),
        ([plan(begin=20, end=30)], [], []),
        ([plan(status="Cancelled")], [zone()], [(None, 1, K.NO_PERMIT)]),
        ([plan()], [zone(seen=(-2, 9))], [("A", 1, K.EARLY)]),
        ([plan()], [zone(seen=(1, 13))], [("A", 1, K.OVERRUN)]),
        ([plan()], [zone(seen=(1, 4), gone=5)], [("A", 1, K.ENDED_EARLY)]),
        ([plan(end=None)], [zone(seen=(1, 4), gone=5)], [("A", 1, K.PERMITTED)]),
        # Set up by the same permit, somewhere in its place, one after the other.
        (
            [plan()], [zone(seen=(1, 4), gone=5, x=(5, 40)), zone(2, seen=(6, 9), x=(50, 95))],
            [("A", 1, K.PERMITTED), ("A", 2, K.PERMITTED)],
        ),
        ([plan()], [zone(x=(-25, 65))], [("A", 1, K.ELSEWHERE)]),
        ([plan()], [zone(y=33)], [("A", 1, K.ELSEWHERE)]),
        ([plan()], [zone(y=90)], [("A", None, K.NOT_FOUND), (None, 1, K.NO_PERMIT)]),
        ([plan()], [zone(x=(5, 160))], [("A", 1, K.LONGER)]),
        ([plan(lanes=("right lane",))], [zone(closed_side="left")], [("A", 1, K.OTHER_LANES)]),
        ([plan(lanes=("right lane",))], [zone(closed_side="right")], [("A", 1, K.PERMITTED)]),
        ([plan(lanes=("allLanesCompleteCarriageway",))], [zone(closed_side="left")], [("A", 1, K.PERMITTED)]),
        ([plan(closed_lane_count=1)], [zone(closed_lane_count=2)], [("A", 1, K.OTHER_LANES)]),
        # Of two places that touch both are met, or only the one where something stands.
        ([plan(), plan("B", x=(100, 200))], [zone(x=(5, 195))], [("A", 1, K.PERMITTED), ("B", 1, K.PERMITTED)]),
        ([plan(), plan("B", x=(100, 200))], [zone(x=(105, 195))], [("A", None, K.NOT_FOUND), ("B", 1, K.PERMITTED)]),
        # The zone of a permit that has ended stands in the time of its neighbour.
        ([plan(end=4), plan("B", x=(100, 200))], [zone()], [("A", 1, K.OVERRUN), ("B", None, K.NOT_FOUND)]),
        # Two records of one permit.
        ([plan("A-1"), plan("A-2")], [zone()], [("A-1", 1, K.PERMITTED), ("A-2", 1, K.PERMITTED)]),
        # Nothing stood there at the end of the permit: the zone is none of it.
        ([plan(end=4)], [zone(seen=(6, 9))], [("A", None, K.NOT_FOUND), (None, 1, K.NO_PERMIT)]),
        # An unmet permit has one zone elsewhere at most, the nearer one.
        ([plan()], [zone(1, y=40), zone(2, y=-25)], [("A", 2, K.ELSEWHERE), (None, 1, K.NO_PERMIT)]),
        # Several differences of one zone.
        (
            [plan(lanes=("right",))], [zone(seen=(-2, 13), closed_side="left")],
            [("A", 1, K.OTHER_LANES), ("A", 1, K.EARLY), ("A", 1, K.OVERRUN)],
        ),
    ],
)  # fmt: skip
def test_each_difference_is_of_its_kind(plans, zones, expected):
    assert sorted(rows(plans, zones), key=str) == sorted(expected, key=str)


def test_nothing_is_missing_where_nobody_looked():
    for drives in ([], [drive(-1), drive(11)], [drive(5, x=(-100, 50))], [drive(5, y=40)], [drive(5, step_m=30)]):
        [found] = compare([plan()], [], drives, PARAMS, at_ns=ns(14))
        assert found.kind is K.NOT_LOOKED and found.coverage < 0.9
        if found.coverage == 0:
            assert found.text == "no drive passed it in its time"
    [half] = compare([plan()], [], [drive(5, x=(-100, 50))], PARAMS, at_ns=ns(14))
    assert half.coverage == pytest.approx(0.6, abs=0.1) and half.first.drive_id == "day 5"
    assert half.text == f"drives passed {half.coverage:.0%} of it in its time"
    [roughly] = compare([plan(approximate=True)], [], DAILY, PARAMS, at_ns=ns(14))
    assert roughly.kind is K.NOT_LOOKED and roughly.coverage == 1.0
    assert roughly.text == "drives passed all of it in its time, but its place is only known roughly"
    # Two halves are a whole.
    [both] = compare([plan()], [], [drive(5, x=(-100, 50)), drive(6, x=(40, 300))], PARAMS, at_ns=ns(14))
    assert both.kind is K.NOT_FOUND and both.confidence == both.coverage == 1.0
    assert both.text == "nothing stands there: drives passed all of it in its time"


def test_times_of_night_works():
    nights = [{"starts_at": day(n + 0.4), "ends_at": day(n + 0.7)} for n in range(10)]
    by_night = [drive(n + 0.5) for n in range(10)]
    [found] = compare([plan(periods=nights)], [zone(seen=(1.5, 8.5))], by_night, PARAMS, at_ns=ns(14))
    assert found.kind is K.PERMITTED, "nobody passed by day"
    [found] = compare([plan(periods=nights)], [zone(seen=(1.5, 8.5))], [*by_night, drive(3)], PARAMS, at_ns=ns(14))
    assert (found.kind, found.amount, found.unit) == (K.OVERRUN, pytest.approx(0.3 * 24, abs=0.01), "h")
    [found] = compare([plan(periods=nights)], [], [drive(3)], PARAMS, at_ns=ns(14))
    assert found.kind is K.NOT_LOOKED


def test_a_row_says_between_which_drives_and_by_how_much():
    [found] = compare([plan()], [zone(seen=(-2, 12), gone=13)], DAILY, PARAMS, at_ns=ns(14))[:1]
    passes = [found.absent, found.first, found.last, found.gone]
    assert [one.drive_id for one in passes] == ["day -3", "day -2", "day 12", "day 13"]
    assert passes[1].at == day(-2) and passes[1].frame_index is not None
    early, late = compare([plan()], [zone(seen=(-2, 12), gone=13)], DAILY, PARAMS, at_ns=ns(14))
    assert (early.amount, late.amount) == (48.0, pytest.approx(48.0, abs=0.01))
    [away] = compare([plan()], [zone(x=(-25, 65))], DAILY, PARAMS, at_ns=ns(14))
    assert (away.amount, away.sigma, away.unit) == (
        pytest.approx(25.2, abs=0.2),
        0.05,
        "m",
    ) and away.confidence == pytest.approx(0.99)
    [unsure] = compare(
        [plan()], [FoundZone(**(vars(zone(x=(-25, 65))) | {"sigma_m": 4.0}))], DAILY, PARAMS, at_ns=ns(14)
    )
    beyond = norm.cdf((unsure.amount - PARAMS.tolerance_m) / 4.0)
    assert unsure.confidence == pytest.approx(0.99 * beyond) and 0.9 < beyond < 0.999
    assert away.xy_m == pytest.approx((17.0, 3.0), abs=1) and away.radius_m == pytest.approx(45, abs=3)


def test_a_row_has_the_times_of_its_plan_in_utc():
    """As its other times, whatever zone the permit states."""
    placed, berlin = plan(), timezone(timedelta(hours=1))
    here = {"starts_at": day(0).astimezone(berlin), "ends_at": day(10).astimezone(berlin)}
    stated = PlacedPlan(placed.list_name, placed.plan.model_copy(update=here), placed.shape)
    [row] = compare([stated], [zone()], DAILY, PARAMS, at_ns=ns(14))
    assert (str(row.planned_from), str(row.planned_until)) == ("2026-03-01 12:00:00+00:00", "2026-03-11 12:00:00+00:00")


def test_a_zone_that_shrinks_was_there_before():
    whole = zone(x=(5, 195))
    left = ZonePhase(ns(6), ns(9), whole.phases[0].xy_m[17:])
    shrunk = FoundZone(**(vars(whole) | {"phases": (*whole.phases, left)}))
    plans = [plan(end=5), plan("B", x=(100, 200))]
    assert rows(plans, [shrunk]) == [("A", 1, K.PERMITTED), ("B", 1, K.PERMITTED)]


plans_drawn = st.lists(
    st.builds(
        plan, st.sampled_from("ABCDEF"), begin=st.integers(-3, 5), end=st.integers(6, 12),
        x=st.tuples(st.integers(-50, 50), st.integers(60, 250)), y=st.sampled_from([0, 3, 22, 45]),
        lanes=st.sampled_from([(), ("right",)]), approximate=st.booleans(),
    ),
    max_size=4, unique_by=lambda one: one.key,
)  # fmt: skip
zones_drawn = st.lists(
    st.builds(
        zone, st.integers(1, 9), seen=st.tuples(st.integers(-3, 4), st.integers(5, 11)), gone=st.sampled_from([None, 12]),
        x=st.tuples(st.integers(-50, 50), st.integers(70, 250)), y=st.sampled_from([3, 25, -40]),
        closed_side=st.sampled_from([None, "left", "right"]),
    ),
    max_size=4, unique_by=lambda one: one.zone_id,
)  # fmt: skip
drives_drawn = st.lists(
    st.builds(
        drive, st.integers(-3, 13), x=st.tuples(st.integers(-100, 90), st.integers(100, 300)), y=st.sampled_from([0, 8, 30]),
        name=st.sampled_from(["p", "q"]),
    ),
    max_size=6, unique_by=lambda one: (one.drive_id, int(one.at_ns[0])),
)  # fmt: skip


@settings(max_examples=60)
@given(plans_drawn, zones_drawn, drives_drawn, st.randoms())
def test_any_order_gives_the_same_rows(plans, zones, drives, random):
    before = compare(plans, zones, drives, PARAMS, at_ns=ns(14))
    for some in (plans, zones, drives):
        random.shuffle(some)
    assert compare(plans, zones, drives, PARAMS, at_ns=ns(14)) == before


@settings(max_examples=60)
@given(plans_drawn, zones_drawn, drives_drawn)
def test_every_zone_and_every_plan_has_a_row_and_nothing_is_missing_unseen(plans, zones, drives):
    found = compare(plans, zones, drives, PARAMS, at_ns=ns(14))
    assert {row.zone_id for row in found} - {None} == {one.zone_id for one in zones}
    assert {row.plan_id for row in found} - {None} == {one.plan.plan_id for one in plans}
    assert len({row.difference_id for row in found}) == len(found)
    looks = Looks(drives, PARAMS)
    for row in found:
        assert (row.kind is K.NO_PERMIT) == (row.plan_id is None)
        assert (row.kind in (K.NOT_FOUND, K.NOT_LOOKED)) == (row.zone_id is None)
        if row.kind is K.NOT_FOUND:
            [of] = [one for one in plans if one.plan.plan_id == row.plan_id]
            x = np.linspace(*of.shape.bounds[::2], 40)
            passed = [
                look for look in looks.at(np.column_stack([x, np.full(40, of.shape.bounds[1])]))
                if ns_from_utc(of.plan.starts_at) <= look.from_ns and look.until_ns <= ns_from_utc(of.plan.ends_at)
            ]  # fmt: skip
            assert np.any([look.seen for look in passed], axis=0).mean() > 0.8
            assert row.coverage >= PARAMS.least_coverage


@pytest.mark.release
def test_a_small_city_of_permits():
    result = score(len(CASES) * 2, 30, seed=1)
    assert result.rows > len(CASES) * 2 and result.not_looked_called_not_found == 0
    assert min(result.precision, result.recall) >= 0.98, result.wrong
