"""The laws of differences between maps."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.mapping.map_diff import diff
from conetl.model.map_records import DeltaKind, MapFeature
from tests import records


def cone(number: int, east_m: float) -> MapFeature:
    return records.feature(number, existence_probability=0.9, **records.standing_at((east_m, 0.0, 0.0)))


MAPS = st.dictionaries(
    st.integers(0, 6), st.tuples(st.sampled_from([0.0, 0.1, 0.4, 2.0]), st.sampled_from([0.9, 0.6])), max_size=6
).map(
    lambda cones: [
        cone(number, east_m).model_copy(update={"existence_probability": existence})
        for number, (east_m, existence) in cones.items()
    ]
)


def test_a_cone_that_was_looked_for_in_vain_is_not_confirmed() -> None:
    """A miss lowers the existence probability of a version and makes no other one."""
    before = cone(1, 0)
    after = before.model_copy(update={"existence_probability": 0.6})
    seen = after.model_copy(update={"version": 2, "observation_count": 4})
    assert [change.kind for change in diff([before], [after])] == [DeltaKind.MISSED]
    assert [change.kind for change in diff([before], [seen])] == [DeltaKind.CONFIRMED], (
        "seen, whatever the existence probability"
    )


def test_a_lane_marking_is_compared_across_its_line() -> None:
    """Painted anew along a part of the old stretch, so that the middle vertices are not beside each other."""
    old, new = (
        records.line_feature(records.marking([(east_m, north_m, 0.0) for east_m in easts_m]))
        for easts_m, north_m in (((0.0, 2.5, 5.0, 7.5, 10.0), 0.0), ((0.0, 2.5, 5.0), 0.3))
    )
    [change] = diff([old], [new])
    assert change.kind is DeltaKind.MOVED and change.shift_m == pytest.approx(0.3)


@given(before=MAPS, after=MAPS)
def test_the_difference_leads_from_one_map_to_the_other(before: list[MapFeature], after: list[MapFeature]) -> None:
    found = diff(before, after)
    assert diff(before, before) == []
    assert [(one.feature_id, one.old, one.new) for one in diff(after, before)] == [
        (one.feature_id, one.new, one.old) for one in found
    ]
    features = {feature.feature_id: feature for feature in before}
    assert all(one.old == features.get(one.feature_id) for one in found)
    features |= {one.feature_id: one.new for one in found if one.new is not None}
    gone = {one.feature_id for one in found if one.new is None}
    assert {key: one for key, one in features.items() if key not in gone} == {one.feature_id: one for one in after}
