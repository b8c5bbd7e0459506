"""Chains of near cones, the drive's offset, and the rarer kinds of change."""

from __future__ import annotations

from collections.abc import Sequence
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.mapping.association import common_offset, pair
from conetl.mapping.changes import reconcile
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from conetl.model.records import Track
from tests.unit.mapping.test_changes import NO_FIX, PARAMS, RTK, Look, changes, feature, track

Place = tuple[float, float]


def kinds(found: dict[DeltaKind, list[Delta]]) -> dict[DeltaKind, int]:
    return {kind: len(deltas) for kind, deltas in found.items() if deltas}


def chain(rng: np.random.Generator, count: int) -> list[Place]:
    """Cones 0.5 to 2 m apart along a bent line."""
    steps = rng.uniform(0.5, 2.0, count)
    along = np.cumsum(steps)
    return [(float(x), float(3.0 + 0.2 * np.sin(x / 7))) for x in along]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_chain_neither_swaps_nor_merges_under_the_drives_offset(seed: int) -> None:
    """Some cones were taken from the chain and others set up; every other pair is the same cone."""
    rng = np.random.default_rng(seed)
    places = chain(rng, int(rng.integers(8, 40)))
    offset = rng.normal(0, 0.3, 2)
    stays = rng.random(len(places)) > 0.15
    features = [feature(i, *place, sigma_m=NO_FIX) for i, place in enumerate(places)]
    seen = [i for i in range(len(places)) if stays[i]]
    noise = rng.normal(0, 0.03, (len(places), 2))
    tracks = [
        track(i, *(np.array(places[i]) + offset + noise[i]).tolist(), sigma_m=NO_FIX) for i in seen
    ]  # fmt: skip
    estimated, weight = common_offset(tracks, features, PARAMS)
    assert estimated[:2] == pytest.approx(offset, abs=0.1)
    placed = np.array([t.xyz_m for t in tracks]) - weight * estimated
    pairs = pair(placed, tracks, features, estimated, weight, PARAMS)
    assert {j: tracks[i].track_index for j, i in pairs.items()} == {i: i for i in seen}


def test_a_chain_that_lost_its_first_cone_and_got_a_last_one_is_not_moved_up_by_one() -> None:
    features = [feature(i, 0.5 * i, 3.0) for i in range(5)]
    tracks = [track(i, 0.5 * i, 3.0) for i in range(1, 6)]
    found = changes(tracks, features)
    confirmed = found[DeltaKind.CONFIRMED]
    assert {(d.feature_id.int, d.track_index) for d in confirmed} == {(i, i) for i in range(1, 5)}
    assert all(d.shift_m == pytest.approx(0.0, abs=0.01) for d in confirmed)


def test_a_thousand_cones_and_more_are_compared_without_matrices() -> None:
    """Thirty thousand of them would need a table of 7 GB."""
    rng = np.random.default_rng(3)
    places = [(x, y + 10.0 * row) for row in range(30) for x, y in chain(rng, 1000)]
    features = [feature(i, *place, sigma_m=NO_FIX) for i, place in enumerate(places)]
    tracks = [track(i, x + 0.4, y - 0.3, sigma_m=NO_FIX) for i, (x, y) in enumerate(places)]
    offset, weight = common_offset(tracks, features, PARAMS)
    assert offset[:2] == pytest.approx((0.4, -0.3), abs=1e-6)
    placed = np.array([t.xyz_m for t in tracks]) - weight * offset
    pairs = pair(placed, tracks, features, offset, weight, PARAMS)
    assert pairs == {i: i for i in range(len(places))}


def test_a_cone_of_another_height_in_the_same_place_is_a_change_and_not_a_mean() -> None:
    found = changes([track(0, 0.0, 3.0, height_m=0.5)], [feature(0, 0.0, 3.0, height_m=0.75)])
    assert kinds(found) == {DeltaKind.HEIGHT_CHANGED: 1}
    (delta,) = found[DeltaKind.HEIGHT_CHANGED]
    assert delta.new is not None
    assert (delta.new.feature_id, delta.new.cone_height_m) == (UUID(int=0), 0.5)
    assert kinds(changes([track(0, 0.0, 3.0, height_m=0.6)], [feature(0, 0.0, 3.0)])) == {DeltaKind.CONFIRMED: 1}


def together(tracks: Sequence[Track]) -> list[Track]:
    """Tracks that the same frame pairs saw."""
    return [t.model_copy(update={"members": ((5, i), (6, i))}) for i, t in enumerate(tracks)]


def test_a_feature_in_the_middle_of_two_cones_of_one_image_is_split() -> None:
    two = [track(0, -0.3, 3.0), track(1, 0.3, 3.0)]
    found = changes(together(two), [feature(0, 0.0, 3.0)])
    assert kinds(found) == {DeltaKind.CONFIRMED: 1, DeltaKind.SPLIT: 1}
    (split,), (kept,) = found[DeltaKind.SPLIT], found[DeltaKind.CONFIRMED]
    assert split.other_feature_id == kept.feature_id == UUID(int=0)
    assert kept.new is not None
    assert kept.shift_m == pytest.approx(0.3, abs=0.01), (
        "its place was that of neither, and is not averaged with either"
    )
    apart = changes(two, [feature(0, 0.0, 3.0)])
    assert kinds(apart) == {DeltaKind.CONFIRMED: 1, DeltaKind.ADDED: 1}, "no image shows both"
    beside = changes(together([track(0, 0.02, 3.0), track(1, 0.6, 3.0)]), [feature(0, 0.0, 3.0)])
    assert kinds(beside) == {DeltaKind.CONFIRMED: 1, DeltaKind.ADDED: 1}, "the feature is one of them"


def test_two_features_where_there_is_room_for_one_cone_are_merged() -> None:
    found = changes([track(0, 0.05, 3.0)], [feature(0, 0.0, 3.0), feature(1, 0.3, 3.0)])
    assert kinds(found) == {DeltaKind.CONFIRMED: 1, DeltaKind.MERGED: 1}
    (merged,) = found[DeltaKind.MERGED]
    assert (merged.feature_id.int, merged.other_feature_id) == (1, UUID(int=0))
    room = changes([track(0, 0.05, 3.0)], [feature(0, 0.0, 3.0), feature(1, 0.5, 3.0)])
    assert kinds(room) == {DeltaKind.CONFIRMED: 1, DeltaKind.REMOVED: 1}


def test_a_second_box_on_a_cone_makes_no_second_cone() -> None:
    twice = [track(0, 0.0, 3.0), track(1, 0.25, 3.0).model_copy(update={"observation_count": 4})]
    found = changes(twice, [])
    assert [d.track_index for d in found[DeltaKind.ADDED]] == [0]


def test_a_drive_without_shared_cones_has_no_offset() -> None:
    offset, weight = common_offset([track(0, 0, 0), track(1, 5, 0)], [feature(0, 500, 0), feature(1, 600, 0)], PARAMS)
    assert (offset.tolist(), weight) == ([0.0, 0.0, 0.0], 0.0)


def test_a_doubt_that_grows_over_drives_removes_from_the_first_miss_on() -> None:
    from conetl.mapping.existence_update import doubt_after

    cone, doubt, first_ns = feature(0, 0.0, 3.0, sigma_m=RTK), None, 10**18
    for drive in range(4):
        at_ns = cone.last_seen_ns + (drive + 1) * first_ns

        def look(_feature: MapFeature, _offset: object, _others: object, at_ns: int = at_ns) -> Look:
            return Look(8, at_ns, -0.9)

        doubts = {cone.feature_id: doubt} if doubt else {}
        (delta,) = reconcile([], [cone], look, PARAMS, founding_key="d", doubts=doubts)
        assert delta.evidence is not None
        if delta.kind is DeltaKind.REMOVED:
            break
        doubt = doubt_after(doubt, delta.evidence.existence_probability, delta.changed_at_ns)
    assert drive == 2
    assert delta.kind is DeltaKind.REMOVED
    assert delta.changed_at_ns == cone.last_seen_ns + first_ns
