"""The map is a function of the set of drives: in any order, with repeats, late and withdrawn drives."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, pairwise, permutations
from random import Random
from uuid import UUID

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.geometry.packing import vec3
from conetl.mapping.history import Doubt, DriveEvidence, MapHistory, replay_drives
from conetl.mapping.visibility import NotObserved
from conetl.model.health import ADJOINING, Finding
from conetl.model.map_records import Decisions, DeltaKind, DriveOrder, FeatureVersion, Location, Miss
from tests.records import DAY_NS, standing_at, track
from tests.synthetic.painted_road import random_painted_drives
from tests.synthetic.road import HOUR_NS, SECOND_NS, random_drive, random_world
from tests.synthetic.world import ORIGIN_M, START_NS, evidence_of

Chains = dict[UUID, list[FeatureVersion]]
Misses = dict[UUID, list[Miss]]
State = tuple[Chains, Misses, dict[UUID, str]]
DAYS = 5
EVERYTHING = {DeltaKind.ADDED, DeltaKind.CONFIRMED, DeltaKind.MOVED, DeltaKind.REMOVED, DeltaKind.MISSED}


def random_case(seed: int, count: int) -> list[DriveEvidence]:
    """Drives of one world: some over the same stretch, some at the same instant or overlapping in time, some far away."""
    rng = np.random.default_rng(seed)
    world = random_world(rng, 400.0, DAYS)
    drives: list[DriveEvidence] = []
    for number in range(count):
        west = float(rng.choice([0.0, 0.0, 60.0, 250.0]))
        start_ns = START_NS + int(rng.integers(0, DAYS * 24)) * HOUR_NS
        if drives and rng.random() < 0.3:  # at the same time as another one, or a few seconds after its start
            start_ns = drives[-1].key[0] + int(rng.choice([0, 3])) * SECOND_NS
        length = float(rng.choice([100.0, 180.0]))
        drives.append(random_drive(rng, world, number, start_ns=start_ns, span_m=(west, west + length)))
    return drives


def with_wrong_ones(rng: np.random.Generator, drives: list[DriveEvidence]) -> list[DriveEvidence]:
    """Some of the drives see nothing, or everything 0.4 or 3 m aside or 48 m lower."""
    shifts: tuple[tuple[float, float, float] | None, ...] = (None, (0.0, 3.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, -48.0))
    wrong = []
    for drive in drives:
        if rng.random() < 0.5:
            wrong.append(drive)
        elif (shift := shifts[int(rng.integers(4))]) is None:
            wrong.append(
                replace(drive, tracks=[], check_visibility=lambda f, *_, d=drive: NotObserved(9, d.key[0], -6.0))
            )
        else:
            tracks = [t.model_copy(update={"xyz_m": vec3(np.array(t.xyz_m) + shift)}) for t in drive.tracks]
            wrong.append(replace(drive, tracks=tracks))
    return wrong


def meet(a: DriveEvidence, b: DriveEvidence) -> bool:
    """Whether the areas of influence meet; cautious."""
    gap = max(a.path_m[:, 0].min() - b.path_m[:, 0].max(), b.path_m[:, 0].min() - a.path_m[:, 0].max())
    return bool(gap <= a.influence_m + b.influence_m)


class Ingest:
    """The work of the database, in memory: drives come in any order, only the affected ones are compared again."""

    def __init__(self, decisions: Decisions = Decisions()) -> None:  # noqa: B008 -- frozen
        self.decisions = decisions
        self.drives: dict[DriveOrder, DriveEvidence] = {}
        self.chains: Chains = {}
        self.misses: Misses = {}
        self.holds: dict[UUID, str] = {}
        self.compared = 0

    @property
    def state(self) -> State:
        """The map, the misses by drive, and the drives on hold."""
        return self.chains, self.misses, self.holds

    def copy(self) -> Ingest:
        """An independent copy."""
        twin = Ingest(self.decisions)
        twin.drives, twin.compared = dict(self.drives), self.compared
        twin.chains, twin.misses, twin.holds = dict(self.chains), dict(self.misses), dict(self.holds)
        return twin

    def add(self, drive: DriveEvidence) -> None:
        if drive.key not in self.drives:
            self.drives[drive.key] = drive
            self.replay([drive])

    def withdraw(self, drive: DriveEvidence) -> None:
        del self.drives[drive.key]
        self.replay([drive])

    def replay(self, seeds: list[DriveEvidence]) -> None:
        affected = {seed.key: seed for seed in seeds}
        for key in sorted(self.drives):
            if any(key > earlier and meet(self.drives[key], drive) for earlier, drive in affected.items()):
                affected[key] = self.drives[key]
        keys = {drive.changeset_id: drive.key for drive in [*self.drives.values(), *seeds]}
        states: list[FeatureVersion | Miss] = [miss for own in self.misses.values() for miss in own]
        states += [row for chain in self.chains.values() for row in chain if not row.is_missed]
        rest = [(keys[one.changeset_id], one) for one in states if keys[one.changeset_id] not in affected]
        again = [drive for key, drive in affected.items() if key in self.drives]
        self.compared += len(again)
        history = replay_drives(again, self.decisions, given=rest)
        self.chains = history.chains
        affected_ids = {drive.changeset_id for drive in affected.values()}
        self.misses = {key: own for key, own in self.misses.items() if key not in affected_ids} | misses(history)
        self.holds = {key: why for key, why in self.holds.items() if key not in affected_ids} | holds(history)


def holds(history: MapHistory) -> dict[UUID, str]:
    return {key: update.hold.detail for key, update in history.updates.items() if update.hold is not None}


def misses(history: MapHistory) -> Misses:
    """By changeset, of the drives that missed anything."""
    found = {
        key: [
            Miss(
                feature_id=delta.feature_id, changeset_id=key, missed_ns=delta.changed_at_ns,
                existence_probability=delta.state_after.existence_probability,
            )
            for delta in update.deltas
            if delta.kind is DeltaKind.MISSED
        ]
        for key, update in history.updates.items()
    }  # fmt: skip
    return {key: own for key, own in found.items() if own}


def state(history: MapHistory) -> State:
    return history.chains, misses(history), holds(history)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 5), chance=st.randoms(use_true_random=False))
def test_every_order_and_any_repeats_give_the_same_map(seed: int, count: int, chance: Random) -> None:
    """Up to five drives, good, held and accepted ones: 80 steps instead of 600."""
    drives = with_wrong_ones(np.random.default_rng(seed), random_case(seed, count))
    decisions = Decisions(accepted=frozenset(drive.changeset_id for drive in drives[::3]))
    assert_one_map(drives, decisions, chance)


@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), chance=st.randoms(use_true_random=False))
def test_lane_markings_are_the_same_in_every_order(seed: int, chance: Random) -> None:
    """Markings that are painted, removed, moved by 0.5 m and shortened from day to day, and cones beside them."""
    drives = random_painted_drives(np.random.default_rng(seed), random_case(seed, 3))
    assert_one_map(drives, Decisions(accepted=frozenset(drive.changeset_id for drive in drives[::2])), chance)


def assert_one_map(drives: list[DriveEvidence], decisions: Decisions, chance: Random) -> None:
    """All orders of the drives as paths through the maps of all their subsets."""
    count = len(drives)
    maps = {frozenset[DriveOrder](): Ingest(decisions)}
    for size in range(count):
        for some in combinations(drives, size):
            keys = frozenset(drive.key for drive in some)
            for drive in drives:
                if drive.key in keys:
                    continue
                ingest = maps[keys].copy()
                ingest.add(drive)
                ingest.add(chance.choice([*some, drive]))  # a repeat
                known = maps.setdefault(keys | {drive.key}, ingest)
                assert ingest.state == known.state
    assert len(maps) == 2**count
    for keys, ingest in maps.items():
        assert ingest.state == state(replay_drives([drive for drive in drives if drive.key in keys], decisions))


def test_drives_in_order_are_compared_once_and_in_reverse_again() -> None:
    drives = sorted(random_case(20260303, 5), key=lambda drive: drive.key)
    history = replay_drives(drives)
    kinds = {delta.kind for update in history.updates.values() for delta in update.deltas}
    assert kinds >= EVERYTHING, "a world with all kinds of changes"
    forwards, backwards = Ingest(), Ingest()
    for drive in drives:
        forwards.add(drive)
    for drive in drives[::-1]:
        backwards.add(drive)
    assert forwards.state == backwards.state == state(history)
    assert forwards.compared == len(drives) < backwards.compared


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_chains_have_no_gaps_and_one_open_row(seed: int) -> None:
    """Rows follow each other without gap or overlap, and only the last one is open; versions are numbered from one."""
    for chain in replay_drives(random_case(seed, 4)).chains.values():
        versions = [row.feature.version for row in chain if not row.is_missed]
        assert versions == list(range(1, len(versions) + 1))
        for before, row in pairwise(chain):
            assert not row.is_missed or row.feature.version == before.feature.version
        starts = {row.feature.version: row.valid_from_ns for row in chain if not row.is_missed}
        assert all(row.version_from_ns == starts[row.feature.version] for row in chain)
        assert all(a.valid_to_ns == b.valid_from_ns for a, b in pairwise(chain))
        assert all(a.valid_from_ns // 1000 < b.valid_from_ns // 1000 for a, b in pairwise(chain))
        assert chain[-1].valid_to_ns is None
        assert all(version.present for version in chain[:-1])


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), painted=st.booleans())
def test_the_evidence_of_a_row_is_that_of_all_drives_until_then(seed: int, painted: bool) -> None:
    drives = random_case(seed, 4)
    if painted:
        drives = random_painted_drives(np.random.default_rng(seed), drives)
    drives = sorted(drives, key=lambda drive: drive.key)
    history = replay_drives(drives)
    number = {drive.changeset_id: n for n, drive in enumerate(drives)}
    judged = [(number[key], delta) for key, update in history.updates.items() for delta in update.deltas]
    for feature_id, chain in history.chains.items():
        own = sorted((n, delta) for n, delta in judged if delta.feature_id == feature_id)
        for row in chain:
            until = [delta for n, delta in own if n <= number[row.changeset_id]]
            absent = [delta.kind in (DeltaKind.MISSED, DeltaKind.REMOVED) for delta in until]
            seen = [not delta.kind.ends and not missed for delta, missed in zip(until, absent, strict=True)]
            assert (row.feature.seen_count, row.feature.missed_count) == (sum(seen), sum(absent))
            evidence = [delta.evidence for delta in until if delta.evidence is not None]
            assert row.feature.existence_probability == evidence[-1].existence_probability
            since = [
                delta.changed_at_ns
                for delta in until
                if delta.kind is DeltaKind.MISSED and delta.state_after.version == row.feature.version
            ]
            assert row.feature.first_missed_ns == min(since, default=None)


def past_a_cone(day: int, *, seen: bool) -> DriveEvidence:
    """A drive that observes the cone, or misses it with evidence that is enough together with that of two others."""
    at_ns = START_NS + day * DAY_NS
    here = [track(**standing_at(ORIGIN_M.tolist()), seen_ns=at_ns)] if seen else []

    def check_visibility(*_: object) -> NotObserved:
        return NotObserved(9, at_ns, -0.9)

    return evidence_of(str(day), at_ns, here, np.array([ORIGIN_M[:2]]), check_visibility=check_visibility)


def rows_of(history: MapHistory) -> list[tuple[int, int | None, int, int, int, bool]]:
    """Of the only feature: days from and until which, version, drives that observed and that missed it, present."""
    [chain] = history.chains.values()
    return [
        (
            (row.valid_from_ns - START_NS) // DAY_NS,
            None if row.valid_to_ns is None else (row.valid_to_ns - START_NS) // DAY_NS,
            row.feature.version, row.feature.seen_count, row.feature.missed_count, row.present,
        )
        for row in chain
    ]  # fmt: skip


def test_a_miss_begins_a_row_of_the_same_version_and_a_removal_replaces_the_misses() -> None:
    drives = [past_a_cone(0, seen=True), *(past_a_cone(day, seen=False) for day in (1, 2, 3))]
    missed = [(0, 1, 1, 1, 0, True), (1, 2, 1, 1, 1, True)]
    assert rows_of(replay_drives(drives[:3])) == [*missed, (2, None, 1, 1, 2, True)]
    back = replay_drives([*drives[:3], past_a_cone(4, seen=True)])
    assert rows_of(back) == [*missed, (2, 4, 1, 1, 2, True), (4, None, 2, 2, 2, True)]
    gone = replay_drives(drives)
    assert rows_of(gone) == [(0, 1, 1, 1, 0, True), (1, None, 2, 1, 3, False)]
    [chain] = gone.chains.values()
    removing = gone.updates[drives[3].changeset_id].deltas[0].evidence
    assert removing is not None
    assert chain[-1].feature.existence_probability == removing.existence_probability < 0.5
    assert chain[-1].feature.first_missed_ns is None


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), which=st.integers(0, 3))
def test_a_withdrawn_drive_leaves_no_trace_and_may_come_again(seed: int, which: int) -> None:
    drives = random_case(seed, 4)
    ingest = Ingest()
    for drive in drives:
        ingest.add(drive)
    everything = ingest.state
    ingest.withdraw(drives[which])
    assert ingest.state == state(replay_drives(drives[:which] + drives[which + 1 :]))
    ingest.add(drives[which])
    assert ingest.state == everything


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), chance=st.randoms(use_true_random=False))
def test_decisions_apply_in_every_order(seed: int, chance: np.random.Generator) -> None:
    drives = random_case(seed, 3)
    chains = list(replay_drives(drives).chains.values())
    locations = (
        [Location(xy_m=chains[i % len(chains)][0].feature.xyz_m[:2], radius_m=1.0) for i in (0, 5)] if chains else []
    )
    decisions = Decisions(suppressed=tuple(locations[:1]), pinned=tuple(locations[1:]))
    expected = replay_drives(drives, decisions).chains
    for order in permutations(drives):
        ingest = Ingest(decisions)
        for drive in order:
            ingest.add(drive)
        assert ingest.chains == expected
    for location in locations[:1]:
        for chain in expected.values():
            for version in chain:
                x, y, _ = version.feature.xyz_m
                there = float(np.hypot(x - location.xy_m[0], y - location.xy_m[1])) <= 1.0
                assert version.suppressed == (version.present and there)
    # Suppression hides features; drives are compared with them all the same.
    hidden = {key: [v.model_copy(update={"suppressed": False}) for v in chain] for key, chain in expected.items()}
    assert hidden == replay_drives(drives, Decisions(pinned=decisions.pinned)).chains


def test_a_cone_set_up_during_overlapping_drives_is_not_removed() -> None:
    rng = np.random.default_rng(3)
    world = random_world(rng, 60.0, 1)
    for cone in world:
        cone.states = cone.states[:1]
    late = random_drive(rng, world, 1, start_ns=START_NS + 100 * SECOND_NS, span_m=(0.0, 100.0))
    early = random_drive(rng, [], 2, start_ns=START_NS + 103 * SECOND_NS, span_m=(90.0, 100.0))
    chains = replay_drives([late, early]).chains
    assert chains
    assert all(chain[-1].present for chain in chains.values())


def test_drives_in_doubt_do_not_confirm_each_other() -> None:
    """Parts of one recording, two hours apart: the first would count if the second did, which finds the cones of the first."""

    def part(name: str, hour: int, off_m: float = 0.0) -> DriveEvidence:
        at_ns, seen = START_NS + hour * HOUR_NS, []
        for k in range(4):
            there = standing_at((ORIGIN_M + np.array([10.0 * k + off_m, 3.0 + k, 0.0])).tolist())
            members = tuple((frame, k) for frame in range(3))
            seen.append(track(**there, seen_ns=at_ns).model_copy(update={"members": members}))
        return evidence_of(name, at_ns, seen, ORIGIN_M[None, :2], check_visibility=lambda *_: None)

    first, second = part("first", 24), part("second", 26)
    finding = Finding(check=ADJOINING, found=True, says=("continues",), facts={"drive_id": "other"})
    in_doubt = [
        replace(one, doubt=Doubt(finding, frozenset({other.changeset_id})))
        for one, other in ((first, second), (second, first))
    ]
    both = {first.changeset_id, second.changeset_id}
    for drives in permutations(in_doubt):
        assert set(holds(replay_drives(drives))) == both
        assert set(holds(replay_drives([*drives, part("elsewhere", 0, 60.0)]))) == both
        assert not holds(replay_drives([*drives, part("day before", 0)]))
