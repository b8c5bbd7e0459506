"""Cones become work zones that keep their ids and end."""

from __future__ import annotations

from uuid import UUID, uuid5

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.model.map_records import FeatureVersion
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import DrivePath
from conetl.workzones.work_zones import chain_stations, zones_over_time
from conetl.workzones.zone_layout import describe, layout_of
from tests.synthetic.tapers import ORIGIN_M, cone

PARAMS = WorkZoneParams()
DAY_NS = 86_400_000_000_000
NAMES = UUID(int=0)


def drive(day: int, *, to_m: float = 600.0, y: float = 0.0, back: bool = False) -> DrivePath:
    x = np.arange(-80.0, to_m, 5.0)
    line = ORIGIN_M + np.stack([x, np.full(len(x), y)], axis=1)
    return DrivePath(f"day {day}", day * DAY_NS, line[::-1] if back else line)


def stand(number: int, x: float, y: float = -3.0, *, days: tuple[int, int | None] = (1, None), version: int = 1):
    """A version that a drive of the first day made, and one of the last day ended."""
    feature = cone(number, ORIGIN_M + np.array([x, y]), 0.05).model_copy(
        update={
            "version": version,
            "last_seen_ns": days[0] * DAY_NS + number,
            "first_seen_ns": days[0] * DAY_NS + number,
        }
    )
    return FeatureVersion(
        feature=feature,
        changeset_id=uuid5(NAMES, f"day {days[0]}"),
        present=True,
        suppressed=False,
        version_from_ns=days[0] * DAY_NS + number,
        valid_from_ns=days[0] * DAY_NS + number,
        valid_to_ns=None if days[1] is None else days[1] * DAY_NS + number,
    )


def gone(version: FeatureVersion, day: int) -> FeatureVersion:
    """The version that says that it is gone, as the map holds one."""
    return version.model_copy(
        update={
            "present": False,
            "changeset_id": uuid5(NAMES, f"day {day}"),
            "valid_from_ns": version.valid_to_ns,
            "valid_to_ns": None,
            "feature": version.feature.model_copy(update={"version": version.feature.version + 1}),
        }
    )


def zones(versions, paths, day=None):
    at_ns = None if day is None else day * DAY_NS + DAY_NS // 2
    return zones_over_time(versions, paths, PARAMS, map_name="m", at_ns=at_ns)


def row(first: int, x_m: float, count: int = 6, step_m: float = 6.0, **options):
    return [stand(first + k, x_m + k * step_m, **options) for k in range(count)]


def ids(zone):
    return {c.feature_id.int - 1 for c in zone.cones}


def test_two_zones_on_one_road_stay_apart_and_a_missing_cone_does_not_split_one():
    versions = row(0, 0.0) + [v for k, v in enumerate(row(10, 120.0)) if k not in (2, 3)]
    found = zones(versions, [drive(1)])
    assert [ids(zone) for zone in found] == [set(range(6)), {10, 11, 14, 15}]
    assert [zone.end_ns for zone in found] == [None, None]


def test_a_tangent_belongs_to_its_taper():
    gaps = np.array([10.0] * 6 + [20.0] * 5)
    assert len(chain_stations(np.concatenate([[0.0], np.cumsum(gaps)]), PARAMS)) == 1
    # The last cone of the taper missing: four times its spacing, but not much for the tangent.
    assert len(chain_stations(np.delete(np.concatenate([[0.0], np.cumsum(gaps)]), 6), PARAMS)) == 1
    assert len(chain_stations(np.array([0.0, 10, 20, 30, 70, 80, 90]), PARAMS)) == 2


@given(shift=st.floats(-1e4, 1e4), gaps=st.lists(st.floats(1, 60), min_size=1, max_size=20))
def test_chains_do_not_depend_on_where_counting_begins_or_in_which_direction(shift, gaps):
    s = np.round(np.concatenate([[0.0], np.cumsum(np.round(gaps, 1))]), 1)
    groups = [set(group.tolist()) for group in chain_stations(s, PARAMS)]
    other = [set(group.tolist()) for group in chain_stations(np.round(-s, 1), PARAMS)]
    assert other == groups[::-1]
    assert sorted(k for group in groups for k in group) == list(range(len(s)))


def test_a_zone_keeps_its_id_while_cones_come_move_and_go():
    first = row(0, 0.0)
    ends = {1: 2, 3: 3}
    versions = [v if k not in ends else stand(k, 6.0 * k, days=(1, ends[k])) for k, v in enumerate(first)]
    versions += [
        gone(versions[1], 2),
        gone(versions[3], 3),
        stand(20, 36.0, days=(2, None)),
        stand(21, 40.0, days=(3, None)),
    ]
    paths = [drive(1), drive(2), drive(3)]
    by_day = [zones(versions, paths, day) for day in (1, 2, 3)]
    assert [len(found) for found in by_day] == [1, 1, 1]
    assert len({found[0].zone_id for found in by_day}) == 1
    assert [ids(found[0]) for found in by_day] == [{0, 1, 2, 3, 4, 5}, {0, 2, 3, 4, 5, 20}, {0, 2, 4, 5, 20, 21}]
    assert {found[0].start_ns for found in by_day} == {DAY_NS}
    assert zones(versions, paths)[0] == by_day[2][0]


def test_a_zone_that_is_gone_ends_and_one_set_up_there_later_is_another():
    old = row(0, 0.0, days=(1, 3))
    versions = [*old, *(gone(v, 3) for v in old)]
    paths = [drive(1), drive(2), drive(3), drive(5)]
    [standing] = zones(versions, paths, 2)
    [ended] = zones(versions, paths, 3)
    assert standing.end_ns is None
    assert ended.zone_id == standing.zone_id
    assert ended.end_ns == 3 * DAY_NS + 5
    assert ended.cones == standing.cones
    later = zones([*versions, *row(30, 0.0, days=(5, None))], paths)
    assert [zone.end_ns for zone in later] == [ended.end_ns, None]
    assert later[0].zone_id == ended.zone_id != later[1].zone_id


def test_all_cones_set_anew_between_two_drives_is_the_same_zone():
    old = row(0, 0.0, days=(1, 2))
    versions = [*old, *(gone(v, 2) for v in old), *row(30, 3.0, days=(2, None))]
    paths = [drive(1), drive(2)]
    [before], [after] = zones(versions, paths, 1), zones(versions, paths, 2)
    assert before.zone_id == after.zone_id
    assert ids(after) == set(range(30, 36))


def test_a_split_founds_one_and_a_merge_ends_the_younger():
    """Two closures, a day apart, are joined by cones between them, which are taken away again."""
    between = [stand(40 + k, 36.0 + 12.0 * k, days=(3, 4)) for k in range(7)]
    versions = [*row(0, 0.0), *row(10, 120.0, days=(2, None)), *between, *(gone(v, 4) for v in between)]
    paths = [drive(day) for day in (1, 2, 3, 4)]
    apart, joined, again = (zones(versions, paths, day) for day in (2, 3, 4))
    assert [zone.end_ns for zone in apart] == [None, None]
    older, younger = joined
    assert (older.zone_id, younger.zone_id) == (apart[0].zone_id, apart[1].zone_id)
    assert (older.end_ns, younger.merged_into) == (None, older.zone_id)
    assert younger.end_ns == 3 * DAY_NS + 46
    assert [zone.end_ns is None for zone in again] == [True, False, True]
    assert len({zone.zone_id for zone in again}) == 3
    assert ids(again[2]) == set(range(10, 16))


def test_rows_on_both_sides_of_the_driven_lane_are_two_zones():
    versions = row(0, 0.0) + [stand(20 + k, 6.0 * k, 3.0) for k in range(5)]
    assert sorted(len(zone.cones) for zone in zones(versions, [drive(1)])) == [5, 6]


def test_fewer_than_three_cones_found_nothing_but_two_that_are_left_go_on():
    assert zones(row(0, 0.0, count=2), [drive(1)]) == []
    old = row(0, 0.0, count=2, days=(1, 2))
    versions = [*old, *(gone(v, 2) for v in old), *row(5, 12.0, count=2)]
    [zone] = zones(versions, [drive(1), drive(2)])
    assert (ids(zone), zone.end_ns) == ({5, 6}, None)


def test_suppressed_cones_and_drives_to_come_are_left_out():
    versions = [*row(0, 0.0), stand(9, 36.0).model_copy(update={"suppressed": True})]
    [zone] = zones(versions, [drive(1)])
    assert ids(zone) == set(range(6))
    assert zones(versions, [drive(1)], 0) == []


@pytest.mark.parametrize("kerb_side", ["right", "left"])
def test_the_direction_is_that_of_the_kerb_where_drives_came_from_both_sides(kerb_side):
    params = PARAMS.model_copy(update={"kerb_side": kerb_side})
    [zone] = zones(row(0, 0.0), [drive(1)])
    both = [drive(1, y=0.0), drive(2, y=3.5, back=True)]
    layout = layout_of(zone, both, [], params)
    numbers = [c.feature_id.int - 1 for c in layout.cones]
    assert numbers == (list(range(6)) if kerb_side == "right" else list(range(6))[::-1])
    assert layout.two_way
    assert describe(zone, layout, params).closed_side == kerb_side


def test_without_any_drive_the_direction_is_not_claimed():
    [zone] = zones(row(0, 0.0), [])
    found = describe(zone, layout_of(zone, [], [], PARAMS), PARAMS)
    assert (found.layout.direction_known, found.layout.axis_source, found.impact) == (False, "cones", "unknown")


def test_an_axis_is_put_together_from_drives_that_overlap():
    """A row of 300 m, one drive along its first half, one along its second: one zone, in order."""
    versions = row(0, 0.0, count=50)
    halves = [drive(1, to_m=150.0), DrivePath("other", 1, drive(1).xy_m[40:] + np.array([0.0, 1.5]))]
    [zone] = zones(versions, halves)
    layout = layout_of(zone, halves, [], PARAMS)
    assert [c.feature_id.int - 1 for c in layout.cones] == list(range(50))
