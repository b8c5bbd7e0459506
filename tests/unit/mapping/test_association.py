"""Near pairs and assignment, rows of near cones, the drive's offset, and the rarer kinds of change."""

from __future__ import annotations

from collections.abc import Sequence
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from conetl.mapping.association import Comparison, assign, common_offset, match_unmoved, near_pairs
from conetl.mapping.changes import reconcile
from conetl.mapping.deltas import ReconcileContext, confirm_features
from conetl.mapping.existence_update import sighting_evidence
from conetl.model.drive import Track
from conetl.model.feature_classes import CONE, FEATURE_CLASSES
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from tests import records
from tests.unit.mapping.test_changes import NO_FIX, PARAMS, RTK, NotObserved, changes, feature, track


def kinds(found: dict[DeltaKind, list[Delta]]) -> dict[DeltaKind, int]:
    return {kind: len(deltas) for kind, deltas in found.items() if deltas}


def chain(rng: np.random.Generator, count: int) -> list[tuple[float, float]]:
    """Cones 0.5 to 2 m apart along a bent line."""
    steps = rng.uniform(0.5, 2.0, count)
    along = np.cumsum(steps)
    return [(float(x), float(3.0 + 0.2 * np.sin(x / 7))) for x in along]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_row_is_paired_cone_by_cone_despite_the_drives_offset(seed: int) -> None:
    """15 % of the cones were removed; all others are paired with themselves."""
    rng = np.random.default_rng(seed)
    positions = chain(rng, int(rng.integers(8, 40)))
    offset = rng.normal(0, 0.3, 2)
    stays = rng.random(len(positions)) > 0.15
    features = [feature(i, *position, sigma_m=NO_FIX) for i, position in enumerate(positions)]
    observed = [i for i in range(len(positions)) if stays[i]]
    noise = rng.normal(0, 0.03, (len(positions), 2))
    tracks = [track(i, *(np.array(positions[i]) + offset + noise[i]).tolist(), sigma_m=NO_FIX) for i in observed]
    estimated, weight = common_offset(tracks, features, PARAMS)
    assert estimated[:2] == pytest.approx(offset, abs=0.1)
    map_xyz_m = np.array([t.xyz_m for t in tracks]) - weight * estimated
    pairs = match_unmoved(Comparison(tracks, features, map_xyz_m, PARAMS), estimated, weight)
    assert {j: tracks[i].track_index for j, i in pairs.items()} == {i: i for i in observed}


@pytest.mark.parametrize("axis", [(1.0, 1.0), (1.0, -1.0)])
def test_a_cone_is_sought_along_the_long_axis_of_its_error_ellipse(axis: tuple[float, float]) -> None:
    along = np.array(axis) / np.sqrt(2)
    xx, xy, yy = (np.outer(along, along) + 1e-4 * np.eye(2))[[0, 0, 1], [0, 1, 1]].tolist()
    there = feature(0, 0.0, 3.0).model_copy(update={"cov_m2": (xx, xy, 0.0, yy, 0.0, 0.01)})
    for direction, pairs in ((along, {0: 0}), (along * [1, -1], {})):
        aside = track(0, *(np.array([0.0, 3.0]) + 1.2 * PARAMS.min_gate_m * direction).tolist(), sigma_m=RTK)
        comparison = Comparison([aside], [there], np.array([aside.xyz_m]), PARAMS)
        assert match_unmoved(comparison, np.zeros(3), 0.0) == pairs


def test_a_row_that_lost_its_first_cone_and_got_a_last_one_is_not_shifted() -> None:
    features = [feature(i, 0.5 * i, 3.0) for i in range(5)]
    tracks = [track(i, 0.5 * i, 3.0) for i in range(1, 6)]
    found = changes(tracks, features)
    confirmed = found[DeltaKind.CONFIRMED]
    assert {(d.feature_id.int, d.track_index) for d in confirmed} == {(i, i) for i in range(1, 5)}
    assert all(d.shift_m == pytest.approx(0.0, abs=0.01) for d in confirmed)


def test_many_cones_are_compared_without_a_full_matrix() -> None:
    """10,000 cones: a full cost matrix would need 0.8 GB, and minutes."""
    rng = np.random.default_rng(3)
    positions = [(x, y + 10.0 * row) for row in range(10) for x, y in chain(rng, 1000)]
    features = [feature(i, *position, sigma_m=NO_FIX) for i, position in enumerate(positions)]
    tracks = [track(i, x + 0.4, y - 0.3, sigma_m=NO_FIX) for i, (x, y) in enumerate(positions)]
    offset, weight = common_offset(tracks, features, PARAMS)
    assert offset[:2] == pytest.approx((0.4, -0.3), abs=1e-6)
    map_xyz_m = np.array([t.xyz_m for t in tracks]) - weight * offset
    pairs = match_unmoved(Comparison(tracks, features, map_xyz_m, PARAMS), offset, weight)
    assert pairs == {i: i for i in range(len(positions))}


def test_a_cone_of_another_height_at_the_same_position_replaces_the_height() -> None:
    found = changes([track(0, 0.0, 3.0, height_m=0.5)], [feature(0, 0.0, 3.0, height_m=0.75)])
    assert kinds(found) == {DeltaKind.HEIGHT_CHANGED: 1}
    (delta,) = found[DeltaKind.HEIGHT_CHANGED]
    assert delta.new is not None
    assert (delta.new.feature_id, delta.new.object_height_m) == (UUID(int=0), 0.5)
    assert kinds(changes([track(0, 0.0, 3.0, height_m=0.6)], [feature(0, 0.0, 3.0)])) == {DeltaKind.CONFIRMED: 1}


@settings(max_examples=40, deadline=None)
@given(order=st.permutations([(0.69, 0.009), (0.70, 0.02), (0.72, 0.012), (0.705, 0.05)]), count=st.integers(1, 20))
def test_drives_do_not_average_what_heights_of_a_class_have_in_common(
    order: list[tuple[float, float]], count: int
) -> None:
    """The order of drives is all the same, and the sigma stays above that of the common part however many there are."""
    share = FEATURE_CLASSES[CONE].height_common

    def seen(heights: list[tuple[float, float]]) -> MapFeature:
        there = records.feature(0, object_height_m=0.7, object_height_sigma_m=0.03)
        for height_m, sigma_m in heights:
            of_drive = records.track(object_height_m=height_m, object_height_sigma_m=sigma_m)
            (delta,) = confirm_features({0: 0}, [there], [of_drive], {0: sighting_evidence(there, of_drive)})
            assert delta.new is not None
            there = delta.new
        return there

    there = seen(order)
    assert there.object_height_m == pytest.approx(seen(sorted(order)).object_height_m, abs=1e-5)
    common_m = share * there.object_height_m
    own_m2 = sum(1 / (sigma_m**2 - (share * height_m) ** 2) for height_m, sigma_m in [*order, (0.7, 0.03)]) ** -1
    assert there.object_height_sigma_m == pytest.approx(np.hypot(common_m, own_m2**0.5), rel=1e-4)
    assert common_m < seen(order * count).object_height_sigma_m <= there.object_height_sigma_m


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
        "the position of the mixture is not averaged with that of a half"
    )
    apart = changes(two, [feature(0, 0.0, 3.0)])
    assert kinds(apart) == {DeltaKind.CONFIRMED: 1, DeltaKind.ADDED: 1}, "no image shows both"
    beside = changes(together([track(0, 0.02, 3.0), track(1, 0.6, 3.0)]), [feature(0, 0.0, 3.0)])
    assert kinds(beside) == {DeltaKind.CONFIRMED: 1, DeltaKind.ADDED: 1}, "the feature is one of them"


def test_features_whose_base_plates_overlap_are_merged() -> None:
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


def test_misses_of_several_drives_remove_from_the_first_miss_on() -> None:
    cone, first_ns = feature(0, 0.0, 3.0, sigma_m=RTK), 10**18
    for drive in range(4):
        at_ns = cone.last_seen_ns + (drive + 1) * first_ns

        def check_visibility(_feature: MapFeature, _offset: object, _others: object, at_ns: int = at_ns) -> NotObserved:
            return NotObserved(8, at_ns, -0.9)

        (delta,) = reconcile([], [cone], check_visibility, ReconcileContext(PARAMS, "d"))
        if delta.new is None:
            break
        cone = delta.new
        assert (cone.version, cone.missed_count) == (1, drive + 1)
    assert drive == 2
    assert delta.kind is DeltaKind.REMOVED
    assert delta.changed_at_ns == cone.last_seen_ns + first_ns


COORDINATES = st.integers(0, 40).map(lambda n: n / 4)
POINTS = st.lists(st.tuples(COORDINATES, COORDINATES), max_size=14).map(lambda rows: np.array(rows).reshape(-1, 2))


@given(POINTS, POINTS, st.sampled_from([0.5, 1.0, 2.5]))
def test_near_pairs_are_those_of_the_whole_matrix(a, b, reach_m):
    rows, columns = near_pairs(a, b, reach_m)
    distances = np.linalg.norm(a[:, None] - b[None], axis=2).reshape(len(a), len(b))
    expected = np.argwhere(distances <= reach_m)
    assert np.column_stack([rows, columns]).tolist() == expected.tolist()


@settings(max_examples=200)
@given(POINTS, POINTS, st.sampled_from([1.0, 3.0]))
def test_groups_cost_no_more_than_the_whole_matrix_and_pair_as_many(a, b, reach_m):
    rows, columns = near_pairs(a, b, reach_m)
    costs = np.linalg.norm(a[rows] - b[columns], axis=1)
    pairs = assign(rows, columns, costs)
    assert len(set(pairs.values())) == len(pairs)
    allowed = dict(zip(zip(rows.tolist(), columns.tolist(), strict=True), costs.tolist(), strict=True))
    assert all(pair in allowed for pair in pairs.items())
    matrix = np.full((len(a), len(b)), 1e6)
    matrix[rows, columns] = costs
    whole = [(i, j) for i, j in zip(*linear_sum_assignment(matrix), strict=True) if matrix[i, j] < 1e6]
    assert len(pairs) == len(whole)
    assert np.isclose(sum(allowed[pair] for pair in pairs.items()), sum(matrix[i, j] for i, j in whole))
