from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from uuid import UUID

import numpy as np
import pytest

from conetl.geometry.packing import cov_matrix
from conetl.mapping.agreement import check_agreement
from conetl.mapping.association import common_offset
from conetl.mapping.changes import reconcile
from conetl.mapping.deltas import ReconcileContext, confirm_features
from conetl.mapping.existence_update import sighting_evidence
from conetl.mapping.visibility import NotObserved
from conetl.model.drive import Track
from conetl.model.map_records import Delta, DeltaKind, MapFeature
from conetl.model.params import ReconcileParams
from tests import records
from tests.synthetic.world import ORIGIN_M, START_NS

DAY_NS = 86_400_000_000_000
PARAMS = ReconcileParams()
RTK, NO_FIX = 0.03, 0.45


def track(index: int, east: float, north: float, *, sigma_m: float = RTK, height_m: float = 0.7, day: int = 1) -> Track:
    here = records.standing_at(ORIGIN_M + np.array([east, north, 0.0]), height_m, records.cov_of(sigma_m))
    seen_ns = START_NS + day * DAY_NS
    return records.track(
        index, 12, seen_ns=seen_ns, relative_cov_m2=records.cov_of(0.02), members=((10 * index, 0),), **here
    )


def feature(number: int, east: float, north: float, *, sigma_m: float = RTK, height_m: float = 0.7) -> MapFeature:
    here = records.standing_at(ORIGIN_M + np.array([east, north, 0.0]), height_m, records.cov_of(sigma_m))
    return records.feature(number, seen_ns=START_NS, observation_count=12, **here)


def changes(
    tracks: Sequence[Track],
    features: Sequence[MapFeature],
    *,
    frames_empty: int = 20,
    ratio: float = -3.5,
    hidden: Sequence[int] = (),
) -> dict[DeltaKind, list[Delta]]:
    def check(unseen: MapFeature, _offset: object, _others: object) -> NotObserved | None:
        return None if unseen.feature_id.int in hidden else NotObserved(frames_empty, START_NS + DAY_NS, ratio)

    deltas = reconcile(tracks, features, check, ReconcileContext(PARAMS, "d"))
    return {kind: [d for d in deltas if d.kind == kind] for kind in DeltaKind}


ROW = [(0.0, 3.0), (5.0, 2.6), (10.0, 2.2), (15.0, 1.8), (20.0, 1.4)]


def test_one_moved_one_removed_and_two_added_are_distinguished() -> None:
    features = [feature(i, *at) for i, at in enumerate(ROW)]
    positions = [ROW[0], (5.0, 4.1), ROW[2], ROW[4], (25.0, 1.0), (30.0, 0.6)]
    found = changes([track(i, *at) for i, at in enumerate(positions)], features)
    assert {d.feature_id.int for d in found[DeltaKind.CONFIRMED]} == {0, 2, 4}
    (moved,) = found[DeltaKind.MOVED]
    assert moved.feature_id.int == 1
    assert moved.shift_m == pytest.approx(1.5, abs=0.05)
    assert [d.feature_id.int for d in found[DeltaKind.REMOVED]] == [3]
    assert len(found[DeltaKind.ADDED]) == 2


def test_drums_beside_cones_are_not_the_cones_of_a_shifted_drive() -> None:
    features = [feature(i, *at, sigma_m=NO_FIX) for i, at in enumerate(ROW)]
    tracks = [track(i, east, north + 0.4, sigma_m=NO_FIX) for i, (east, north) in enumerate(ROW)]
    drums = [one.model_copy(update={"category": "drum"}) for one in tracks]
    offset, weight = common_offset(tracks, features, PARAMS)
    assert (offset[1], weight) == (pytest.approx(0.4, abs=0.01), pytest.approx(0.5))
    assert not common_offset(drums, features, PARAMS)[0].any()
    found = changes(drums, features)
    assert (len(found[DeltaKind.ADDED]), len(found[DeltaKind.CONFIRMED])) == (5, 0)


def test_a_cone_out_of_view_stays() -> None:
    found = changes([track(0, *ROW[0])], [feature(i, *at) for i, at in enumerate(ROW)], hidden=[1, 2, 3, 4])
    assert not found[DeltaKind.REMOVED]
    assert len(found[DeltaKind.CONFIRMED]) == 1


@pytest.mark.parametrize("evidence", [{"frames_empty": PARAMS.removal_min_frames - 1}, {"ratio": -2.0}])
def test_weak_evidence_of_absence_is_a_miss_and_no_removal(evidence: dict[str, Any]) -> None:
    found = changes([], [feature(0, *ROW[0])], **evidence)
    assert {kind for kind, deltas in found.items() if deltas} == {DeltaKind.MISSED}
    (miss,) = found[DeltaKind.MISSED]
    assert not miss.is_change
    assert miss.old is not None
    assert miss.new is not None
    assert miss.evidence is not None
    after = {
        "existence_probability": miss.evidence.existence_probability,
        "missed_count": 1,
        "first_missed_ns": miss.changed_at_ns,
    }
    assert miss.new == miss.old.model_copy(update=after)
    assert miss.evidence.existence_probability < 0.97


def test_one_moved_cone_does_not_shift_a_good_drive() -> None:
    tracks, features = [track(0, 1.2, 3.0), track(1, 6.2, 2.6)], [feature(0, 0.0, 3.0), feature(1, 5.0, 2.6)]
    offset, weight = common_offset(tracks, features, PARAMS)
    assert (offset.tolist(), weight) == ([0.0, 0.0, 0.0], 0.0)
    assert len(changes(tracks, features)[DeltaKind.MOVED]) == 2


def test_confirmation_reduces_the_covariance_and_adds_the_counts() -> None:
    (delta,) = changes([track(0, 0.04, 3.0)], [feature(0, 0.0, 3.0)])[DeltaKind.CONFIRMED]
    assert delta.old is not None
    assert delta.new is not None
    assert delta.new.xyz_m[0] - ORIGIN_M[0] == pytest.approx(0.02, abs=1e-3)
    assert delta.new.cov_m2[0] < delta.old.cov_m2[0]
    assert delta.new.observation_count == 24
    assert delta.new.version == 2


@pytest.mark.parametrize("shift_m", [(0.0, 0.0, 0.05), (0.0, 0.0, 0.16), (0.11, 0.09, 0.0), (0.06, 0.0, 0.04)])
def test_a_shift_that_all_cones_share_beyond_the_sigmas_widens_those_of_the_map(shift_m: tuple[float, ...]) -> None:
    """Drive or map is wrong, and nothing says which: the map must allow for both."""
    known = [feature(k, 5.0 * k, 3.0) for k in range(9)]
    tracks = [track(k, 5.0 * k, 3.0) for k in range(9)]
    tracks = [t.model_copy(update={"xyz_m": tuple(np.add(t.xyz_m, shift_m).tolist())}) for t in tracks]
    beyond = np.hypot(*shift_m[:2]) > 0.1, shift_m[2] > 0.1
    found = changes(tracks, known)[DeltaKind.CONFIRMED]
    assert len(found) == 9
    for delta in found:
        assert delta.new is not None and delta.old is not None
        sigma_m = np.sqrt(np.diag(cov_matrix(delta.new.cov_m2)))
        off_m = np.abs(np.subtract(delta.new.xyz_m, delta.old.xyz_m))
        assert (off_m < 1.5 * sigma_m).all()
        assert ((sigma_m[0] > RTK), (sigma_m[2] > RTK)) == beyond


def absent(_feature: MapFeature, _offset: object, _others: object) -> NotObserved:
    return NotObserved(20, START_NS + DAY_NS, -3.5)


def test_an_offset_below_that_of_a_hold_is_not_left_in_new_cones() -> None:
    features, east_m = [feature(i, *at) for i, at in enumerate(ROW[:4])], 4.6 * np.sqrt(2) * RTK
    tracks = [track(i, east + east_m, north) for i, (east, north) in enumerate(ROW)]
    deltas = changes(tracks, features)
    assert check_agreement(tracks, features, [d for some in deltas.values() for d in some], PARAMS) is None
    (added,) = deltas[DeltaKind.ADDED]
    assert added.new is not None
    assert added.new.xyz_m[0] - ORIGIN_M[0] - ROW[4][0] == pytest.approx(east_m / 2, abs=0.001)


def test_a_pinned_cone_is_neither_removed_nor_moved() -> None:
    features = [feature(0, *ROW[0]), feature(1, *ROW[1])]
    tracks = [track(0, ROW[1][0], ROW[1][1] + 1.5)]
    free = reconcile(tracks, features, absent, ReconcileContext(PARAMS, "d"))
    pinned = reconcile(tracks, features, absent, ReconcileContext(PARAMS, "d", pinned={UUID(int=0), UUID(int=1)}))
    assert {d.kind for d in free} == {DeltaKind.REMOVED, DeltaKind.MOVED}
    assert {d.kind for d in pinned} == {DeltaKind.ADDED, DeltaKind.MISSED}


def test_the_order_of_tracks_and_features_does_not_matter() -> None:
    features = [feature(i, *at) for i, at in enumerate(ROW)]
    tracks = [track(i, x + 0.05, y) for i, (x, y) in enumerate(ROW[1:])]
    one = reconcile(tracks, features, absent, ReconcileContext(PARAMS, "d"))
    assert one == reconcile(tracks[::-1], features[::-1], absent, ReconcileContext(PARAMS, "d"))


def test_a_moved_cone_that_was_founded_again_is_merged() -> None:
    """An earlier drive, to which only the new position was visible, founded a feature there."""
    day = START_NS + DAY_NS // 2
    founded_since = feature(9, 5.0, 4.1).model_copy(update={"first_seen_ns": day, "last_seen_ns": day})
    features = [*(feature(i, *at) for i, at in enumerate(ROW)), founded_since]
    tracks = [track(i, *at) for i, at in enumerate([ROW[0], (5.0, 4.1), *ROW[2:]])]
    found = changes(tracks, features)
    (moved,), (merged,) = found[DeltaKind.MOVED], found[DeltaKind.MERGED]
    assert (moved.feature_id.int, merged.feature_id.int, merged.other_feature_id) == (1, 9, moved.feature_id)
    assert moved.shift_m == pytest.approx(1.5, abs=0.05)
    assert moved.new is not None
    assert moved.new.version == 2
    assert moved.new.first_seen_ns == START_NS
    assert not found[DeltaKind.REMOVED]
    assert not found[DeltaKind.ADDED]
    assert len(found[DeltaKind.CONFIRMED]) == 4


def test_cones_observed_at_the_same_time_are_two() -> None:
    features = [*(feature(i, *at) for i, at in enumerate(ROW)), feature(9, 5.0, 4.1)]
    found = changes([track(i, *at) for i, at in enumerate([ROW[0], (5.0, 4.1), *ROW[2:]])], features)
    assert [d.feature_id.int for d in found[DeltaKind.REMOVED]] == [1]
    assert not found[DeltaKind.MOVED]
    assert not found[DeltaKind.MERGED]


def test_a_weak_track_confirms_a_feature_but_founds_none() -> None:
    weak = {"existence_probability": 0.54}
    tracks = [track(i, *at).model_copy(update=weak) for i, at in enumerate([ROW[0], ROW[1], (30.0, 0.6)])]
    found = changes(tracks, [feature(i, *at) for i, at in enumerate(ROW[:2])])
    assert {kind: len(deltas) for kind, deltas in found.items() if deltas} == {DeltaKind.CONFIRMED: 2}


@pytest.mark.parametrize(("along_sigma_m", "cones"), [(0.3, 1), (0.02, 2)])
def test_an_uncertain_track_beside_a_far_cone_founds_no_feature(along_sigma_m: float, cones: int) -> None:
    """Half a metre behind the other one, with a sigma of 0.3 m along the line of sight."""
    behind = {"relative_cov_m2": (along_sigma_m**2, 0.0, 0.0, 0.02**2, 0.0, 0.02**2), "observation_count": 6}
    found = changes([track(0, 40.0, 3.0), track(1, 40.5, 3.1).model_copy(update=behind)], [])
    assert len(found[DeltaKind.ADDED]) == cones


@pytest.mark.filterwarnings("ignore:invalid value encountered in matmul")
def test_covariances_that_cannot_be_fused_are_refused() -> None:
    broken = feature(0, *ROW[0]).model_copy(update={"cov_m2": (float("inf"), 0.0, 0.0, 1.0, 0.0, 1.0)})
    with pytest.raises(ValueError, match="cannot be fused"):
        confirm_features(
            {0: 0},
            [broken],
            [track(0, *ROW[0])],
            {0: sighting_evidence(broken, track(0, *ROW[0]))},
        )
