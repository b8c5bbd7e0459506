"""Drives that contradict each other by a small displacement: sigmas that cover both, whichever came first."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from uuid import uuid5

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.checks.verdict import judge
from conetl.geometry.packing import cov_matrix
from conetl.mapping.contradiction import Contradiction, find_contradiction
from conetl.mapping.fusion import EXCESS, excess_of, larger_excess, with_excess, without_excess
from conetl.mapping.history import DriveEvidence, MapHistory, replay_drives
from conetl.mapping.visibility import NotObserved
from conetl.model.drive import Track
from conetl.model.health import Verdict
from conetl.model.map_records import Decisions, DeltaKind, MapFeature
from conetl.model.params import ReconcileParams
from tests import records
from tests.synthetic.world import ORIGIN_M, START_NS
from tests.unit.mapping.test_agreement import UNEVEN, features_at, tracks_at, turned
from tests.unit.mapping.test_fusion import CALIBRATIONS, shared_jacobian

Floats = NDArray[np.float64]
PARAMS = ReconcileParams()
SIGMA_M = 0.02
#: A lever arm that is wrong by 0.3 m to the side, driven both ways.
THERE, BACK = np.array([0.0, 0.3, 0.0]), np.array([0.0, -0.3, 0.0])


def found_in(places: Floats, sigma_m: float = SIGMA_M, seed: int = 0) -> Contradiction | None:
    tracks, features = tracks_at(places, sigma_m, seed), features_at(UNEVEN, sigma_m)
    found = find_contradiction(tracks, features, PARAMS)
    again = find_contradiction(tracks[::-1], features[::-1], PARAMS)
    assert (found and found.finding) == (again and again.finding), "the order matters"
    return found


@pytest.mark.parametrize("shift_m", [(0.0, 0.3, 0.0), (0.5, -0.7, 0.0), (0.0, 0.0, 0.25), (0.2, 0.2, -0.4)])
def test_a_displacement_of_the_same_cones_is_found(shift_m: tuple[float, float, float]) -> None:
    for seed in range(3):
        found = found_in(UNEVEN + shift_m, seed=seed)
        assert found is not None
        check = judge(found.finding)
        assert check.verdict is Verdict.WIDENED and "those of the map" in check.detail
        np.testing.assert_allclose(found.offset_m, shift_m, atol=0.03)
        assert check.value is not None and check.limit is not None and abs(check.value) > check.limit


MOVED = UNEVEN.copy()
MOVED[[1, 4]] += np.array((0.4, 0.8, 0.0))


@pytest.mark.parametrize(
    "places",
    [
        UNEVEN,
        UNEVEN + np.array((0.05, 0.04, 0.05)),  # within its sigmas
        UNEVEN + np.array((0.0, 1.2, 0.0)),  # held
        UNEVEN + np.array((0.0, 0.3, 2.0)),
        turned(UNEVEN, 1.5),
        np.vstack([UNEVEN[:5], UNEVEN[5:] + THERE]),  # of a part
        UNEVEN[:2] + THERE,  # too few
        MOVED,
        UNEVEN + np.random.default_rng(3).normal(0, 0.2, UNEVEN.shape),  # set up again
    ],
    ids=("the same", "within", "far", "higher", "turned", "a part", "two", "two moved", "set up again"),
)  # fmt: skip
def test_other_differences_are_none(places: Floats) -> None:
    for seed in range(3):
        assert found_in(places, seed=seed) is None


def test_sigmas_that_cover_it_are_none() -> None:
    assert found_in(UNEVEN + THERE, sigma_m=0.1) is None


def test_cones_that_stand_near_to_each_other_may_be_others() -> None:
    row = np.array([(1.5 * k, 3.0, 0.0) for k in range(9)])
    for shift_m, sure in ((0.3, True), (0.7, False)):
        tracks, features = tracks_at(row + np.array([shift_m, 0.0, 0.0]), SIGMA_M), features_at(row, SIGMA_M)
        assert (find_contradiction(tracks, features, PARAMS) is not None) == sure


def drive(day: int, shift_m: Floats, places: Floats = UNEVEN, sigma_m: float = SIGMA_M) -> DriveEvidence:
    """What a drive on that day shows of cones at `places` (N, 3), displaced by shift_m (3,)."""
    later = {"first_seen_ns": START_NS + day * records.DAY_NS, "last_seen_ns": START_NS + day * records.DAY_NS + 1}
    tracks = [track.model_copy(update=later) for track in tracks_at(places + shift_m, sigma_m, seed=day)]
    key = (later["first_seen_ns"], later["last_seen_ns"], f"{day}")
    return DriveEvidence(
        key=key, changeset_id=uuid5(EXCESS, f"{day} {shift_m} {len(places)}"), founding_key=f"drive {day}", tracks=tracks,
        path_m=(ORIGIN_M + UNEVEN)[:, :2], influence_m=60.0, check_visibility=lambda *_: None, params=PARAMS, judge=judge,
    )  # fmt: skip


def standing(history: MapHistory) -> list[MapFeature]:
    return sorted((chain[-1].feature for chain in history.chains.values() if chain[-1].present), key=lambda f: f.xyz_m)


def off_m(features: Sequence[MapFeature]) -> Floats:
    """(N, 3) from the nearest true cone."""
    xyz_m = np.array([feature.xyz_m for feature in features])
    apart = xyz_m[:, None] - (ORIGIN_M + UNEVEN)
    return np.asarray(apart[np.arange(len(xyz_m)), np.hypot(*np.moveaxis(apart[:, :, :2], 2, 0)).argmin(axis=1)])


def chi2(features: Sequence[MapFeature], offs_m: Floats) -> Floats:
    return np.array([off @ np.linalg.solve(cov_matrix(f.cov_m2), off) for f, off in zip(features, offs_m, strict=True)])


PASSES = [(THERE, BACK), (THERE, BACK, THERE), (THERE, THERE, BACK), (BACK, THERE, THERE, THERE, BACK)]


@pytest.mark.parametrize("shifts", PASSES, ids=lambda shifts: "".join("<>"[int(s[1] > 0)] for s in shifts))
def test_opposite_passes_of_a_wrong_lever_arm_get_sigmas_that_cover_both(shifts: Sequence[Floats]) -> None:
    history = replay_drives([drive(day, shift) for day, shift in enumerate(shifts)])
    assert all(update.hold is None for update in history.updates.values())
    assert any(update.widened is not None for update in history.updates.values())
    features = standing(history)
    assert len(features) == len(UNEVEN)
    off = off_m(features)
    assert chi2(features, off).max() < 4.0
    for shift in (THERE, BACK):
        assert chi2(features, off - shift).max() < 4.0, "neither pass is outside"
    # Weighted means of all passes, and an excess that none of them averaged out.
    np.testing.assert_allclose(off[:, 1], np.mean([shift[1] for shift in shifts]), atol=0.04)
    np.testing.assert_allclose([f.cov_m2[3] ** 0.5 for f in features], 0.6, atol=0.05)
    assert max(f.cov_m2[0] for f in features) < 0.05**2, "along the road they agree"


def test_which_pass_came_first_does_not_matter() -> None:
    states = []
    for shifts in permutations((THERE, THERE, BACK)):
        features = standing(replay_drives([drive(day, shift) for day, shift in enumerate(shifts)]))
        states.append([(*f.xyz_m, *f.cov_m2) for f in features])
    np.testing.assert_allclose(states[1:], [states[0]] * 5, atol=0.05)


def test_the_order_of_ingestion_does_not_matter() -> None:
    drives = [drive(day, shift) for day, shift in enumerate((THERE, BACK, THERE))]
    chains = [replay_drives(order).chains for order in permutations(drives)]
    assert all(other == chains[0] for other in chains[1:])


def test_a_third_drive_is_a_contradiction_only_if_it_is_farther_aside_than_the_others() -> None:
    for third_m, contradictions in ((-0.3, 1), (-0.8, 2)):
        shifts_m = [0.15, -0.15, third_m]
        history = replay_drives([drive(day, np.array([0.0, m, 0.0])) for day, m in enumerate(shifts_m)])
        assert all(update.hold is None for update in history.updates.values())
        assert [update.widened is not None for update in history.updates.values()].count(True) == contradictions
        features = standing(history)
        for shift_m in shifts_m:
            assert chi2(features, off_m(features) - (0.0, shift_m, 0.0)).max() < 4.0


def test_new_cones_of_a_contradicting_drive_have_the_excess_too() -> None:
    more = np.vstack([UNEVEN, UNEVEN[-1:] + np.array((8.0, 0.5, 0.0))])
    history = replay_drives([drive(0, THERE), drive(1, BACK, more)])
    features = standing(history)
    assert len(features) == len(more)
    assert all(excess_of(f.shared_jacobian) is not None for f in features)
    assert features[-1].cov_m2[3] ** 0.5 > 0.5
    assert features[-1].xyz_m[1] == pytest.approx(float((ORIGIN_M + more[-1] + BACK)[1]), abs=0.04), "not moved"


def test_without_the_contradicting_drive_the_sigmas_are_as_before() -> None:
    first, second = drive(0, THERE), drive(1, BACK)
    alone = replay_drives([first])
    assert replay_drives([first]).chains == alone.chains
    widened = standing(replay_drives([first, second]))
    assert min(f.cov_m2[3] for f in widened) > 100 * max(f.cov_m2[3] for f in standing(alone))


def test_a_drive_that_is_held_today_beyond_the_limit_stays_held() -> None:
    history = replay_drives([drive(0, THERE), drive(1, np.array([0.0, 1.6, 0.0]))])
    [hold] = [update.hold for update in history.updates.values() if update.hold is not None]
    assert "m from those of the map" in hold.detail
    accepted = Decisions(accepted=frozenset(key for key, update in history.updates.items() if update.hold))
    again = replay_drives([drive(0, THERE), drive(1, np.array([0.0, 1.6, 0.0]))], accepted)
    assert all(update.hold is None for update in again.updates.values())


def test_a_cone_that_is_gone_is_missed_where_the_drive_would_show_it() -> None:
    seen_at = []

    def check(feature: MapFeature, offset_m: Floats, _: Floats) -> NotObserved | None:
        seen_at.append(offset_m.tolist())
        return NotObserved(20, START_NS + records.DAY_NS, -6.0)

    second = drive(1, BACK, UNEVEN[1:])
    history = replay_drives([drive(0, THERE), type(second)(**{**vars(second), "check_visibility": check})])
    kinds = [delta.kind for update in history.updates.values() for delta in update.deltas]
    assert kinds.count(DeltaKind.REMOVED) == 1 and kinds.count(DeltaKind.CONFIRMED) == len(UNEVEN) - 1
    np.testing.assert_allclose(seen_at[0], BACK - THERE, atol=0.03)


def test_an_excess_is_kept_beside_other_shared_errors() -> None:
    moved = np.arange(15.0).reshape(3, 5) / 1000
    [track] = tracks_at(UNEVEN[:1])
    own = shared_jacobian({CALIBRATIONS[0]: moved})
    excess_m2 = np.outer(BACK, BACK)
    cov, jacobian = with_excess(track.cov_m2, own, excess_m2)
    assert jacobian.calibrations == tuple(sorted({EXCESS, CALIBRATIONS[0]}))
    np.testing.assert_allclose(excess_of(jacobian), excess_m2, atol=1e-6)
    np.testing.assert_allclose(cov_matrix(cov), cov_matrix(track.cov_m2) + excess_m2, atol=1e-6)
    assert without_excess(jacobian) == own and excess_of(own) is None and without_excess(None) is None
    twice, same = with_excess(cov, jacobian, excess_m2)
    np.testing.assert_allclose(twice, cov, atol=1e-9)
    assert same == jacobian
    both = larger_excess(excess_m2, np.diag([0.04, 0.01, 0.0]))
    assert both is not None
    for one in (excess_m2, np.diag([0.04, 0.01, 0.0])):
        assert np.linalg.eigvalsh(both - one).min() > -1e-12
    assert larger_excess(None, None) is None


def test_tracks_of_too_little_existence_are_not_compared() -> None:
    tracks: list[Track] = [
        track.model_copy(update={"existence_probability": 0.4}) for track in tracks_at(UNEVEN + THERE, SIGMA_M)
    ]
    assert find_contradiction(tracks, features_at(UNEVEN, SIGMA_M), PARAMS) is None
