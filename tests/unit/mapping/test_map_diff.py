"""The laws of differences between maps."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.mapping.history import replay_drives
from conetl.mapping.map_diff import compose, diff, invert
from conetl.model.map_records import DeltaKind, MapFeature
from tests import records
from tests.unit.mapping.test_history import random_case


def cone(number: int, east_m: float) -> MapFeature:
    return records.feature(number, existence_probability=0.9, **records.standing_at((east_m, 0.0, 0.0)))


MAPS = st.dictionaries(
    st.integers(0, 6), st.tuples(st.sampled_from([0.0, 0.1, 0.4, 2.0]), st.sampled_from([0.9, 0.6])), max_size=6
).map(
    lambda cones: [
        cone(number, east_m).model_copy(update={"existence_probability": belief})
        for number, (east_m, belief) in cones.items()
    ]
)


def test_kinds() -> None:
    before, after = [cone(1, 0), cone(2, 0), cone(3, 0), cone(4, 0)], [cone(1, 0), cone(2, 0.1), cone(3, 2), cone(5, 0)]
    found = [(change.feature_id.int, change.kind) for change in diff(before, after)]
    assert found == [(2, DeltaKind.CONFIRMED), (3, DeltaKind.MOVED), (4, DeltaKind.REMOVED), (5, DeltaKind.ADDED)]


def test_a_cone_that_was_looked_for_in_vain_is_not_confirmed() -> None:
    """A miss lowers the belief in a version and makes no other one."""
    before = cone(1, 0)
    after = before.model_copy(update={"existence_probability": 0.6})
    seen = after.model_copy(update={"version": 2, "observation_count": 4})
    assert [change.kind for change in diff([before], [after])] == [DeltaKind.MISSED]
    assert [change.kind for change in diff([before], [seen])] == [DeltaKind.CONFIRMED], "seen, whatever the belief"
    assert compose(diff([before], [after]), diff([after], [seen])) == diff([before], [seen])
    assert invert(diff([before], [after])) == diff([after], [before])


@given(a=MAPS, b=MAPS, c=MAPS)
def test_differences_compose_and_invert(a: list[MapFeature], b: list[MapFeature], c: list[MapFeature]) -> None:
    assert diff(a, a) == []
    assert invert(diff(a, b)) == diff(b, a)
    assert invert(invert(diff(a, b))) == diff(a, b)
    assert compose(diff(a, b), diff(b, c)) == diff(a, c)
    assert compose(diff(a, b), diff(b, a)) == []


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_differences_between_the_maps_of_drives_compose_and_invert(seed: int) -> None:
    """The map before and after each of three drives, with all that happens there: cones founded, moved, removed, known better."""
    drives = sorted(random_case(seed, 3), key=lambda drive: drive.key)
    maps = []
    for count in range(4):
        chains = replay_drives(drives[:count]).chains.values()
        maps.append([chain[-1].feature for chain in chains if chain[-1].present])
    first, second, third = (diff(before, after) for before, after in pairwise(maps))
    assert compose(compose(first, second), third) == compose(first, compose(second, third)) == diff(maps[0], maps[3])
    reverted = compose(compose(first, second), invert(second))
    assert reverted == first
    assert compose(reverted, invert(invert(second))) == diff(maps[0], maps[2]), "the revert of the revert"


def test_differences_that_do_not_follow_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match="does not start where the first ends"):
        compose(diff([], [cone(1, 0)]), diff([cone(1, 2)], []))
