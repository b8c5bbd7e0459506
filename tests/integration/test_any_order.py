"""Drives in any order, any number of times, on a real PostGIS: one map, and every earlier state kept."""

from __future__ import annotations

from functools import cache
from itertools import islice, permutations

import numpy as np
import pytest

from conetl.db.connection import execute
from conetl.db.map.decision_store import held_drives, hold_events, list_decisions, read_decisions
from conetl.db.map.map_store import find_map, list_changesets, map_transaction, read_current_features, system_time
from conetl.db.map.replay_store import affected_drives, other_deliveries, write_replay
from conetl.db.map.results import ChangeCounts
from conetl.geometry.calibration.covariance import calibration_id
from conetl.geometry.packing import cov3, cov_matrix, vec3
from conetl.model.errors import ConflictError, InputError
from conetl.model.feature_classes import CONE, LANE_MARKING
from conetl.model.map_records import DeltaKind
from conetl.model.params import IngestParams, ReconcileParams
from conetl.pipeline.maps.decisions import accept_drive, decide_location, revert
from conetl.pipeline.replay import replay_of
from tests.cases import cases
from tests.integration import drives_of_days as world
from tests.synthetic.painted_road import Paint, markings_of
from tests.synthetic.world import ORIGIN_M, START_NS, Cone


def of_day(day, rigs=world.RIGS):
    return world.survey(day, rig=rigs[day])


def jacobian_of(conn):
    return [feature.shared_jacobian for feature in read_current_features(conn)]


@pytest.fixture(scope="module")
def in_order(another_database):
    """The map of the first three days, ingested in order: each drive is merged after the one before, nothing is replayed."""
    with another_database() as conn:
        merged = [world.merge(conn, of_day(day)) for day in range(3)]
        assert [m.replayed for m in merged] == [0, 0, 0]
        kinds = [sorted({delta.kind for delta in m.changeset.deltas}) for m in merged]
        assert kinds == [
            [DeltaKind.ADDED],
            [DeltaKind.CONFIRMED, DeltaKind.MOVED, DeltaKind.REMOVED],
            [DeltaKind.ADDED, DeltaKind.CONFIRMED, DeltaKind.MOVED],
        ]
        assert world.failed_audits(conn) == []
        found = jacobian_of(conn)
        assert len(found) == len(world.DAYS[2])
        both = {calibration_id(world.CALIBRATED), calibration_id(world.AGAIN)}
        assert both in [set(one.calibrations) for one in found if one], "some cones know both calibrations"
        conn.rollback()
        yield world.valid_time_map(conn)


@pytest.mark.parametrize("order", cases(((2, 1, 0),), release=[((1, 2, 0),)]), ids=str)
def test_other_orders_of_three_drives_give_the_same_map(conn, in_order, order):
    """Random ones: `test_exactly_once.py`."""
    expected = {}
    for day in order:
        assert world.merge(conn, of_day(day)) is not None
        assert world.failed_audits(conn) == []
        for earlier in order[: order.index(day) + 1]:  # again: nothing happens
            assert world.merge(conn, of_day(earlier)) is None
        now = world.known_maps(conn)
        assert {moment: now[moment] for moment in expected} == expected, "an earlier state was changed"
        expected = now
    assert world.valid_time_map(conn) == in_order
    assert len(list_changesets(conn)) == 3
    assert_nothing_to_replay(conn, 3)


@cache
def painted(day):
    """The drive of a day past a row of cones and lane markings, of which one is removed and one moved by 0.5 m on the second day,
    when a sign is set up."""
    aside_m = ((4.5, 1.5, -2.0, -5.0), (4.5, -2.5, -5.0), (4.5, -2.5, -5.0))[day]
    signs, rng = [Cone((30.0, 5.0, 1.6), height_m=0.6, base_m=0.6)] * (day > 0), np.random.default_rng(day)
    first_ns = START_NS + day * world.DAY_NS
    one = world.survey_of(world.ROW, rng, f"painted_{day}", frames=40, start_m=0.0, first_ns=first_ns, signs=signs)
    first, last = (
        pair.pose.map_t_body_m[0] - ORIGIN_M[0] for pair in (one.drive.frame_pairs[0], one.drive.frame_pairs[-1])
    )
    offset_m = np.subtract(one.drive.frame_pairs[0].pose.map_t_body_m, (ORIGIN_M[0] + round(first), *ORIGIN_M[1:]))
    seen = markings_of(
        [Paint(aside) for aside in aside_m], rng, (first + 5.0, last + 10.0), offset_m=offset_m, offset_sigma_m=0.3,
        seen_ns=one.drive.frame_pairs[0].captured_at_ns,
    )  # fmt: skip
    return one._replace(markings=seen)


@cache
def aside(day, shift_m):
    """The drive of a day past a row of cones, all of them `shift_m` to the north, with a stated sigma of 2 cm."""
    first_ns = START_NS + day * world.DAY_NS
    one = world.survey_of(
        world.ROW, np.random.default_rng(day), f"aside_{day}", frames=40, start_m=0.0, first_ns=first_ns
    )
    feet = np.array([np.add(ORIGIN_M, cone.foot_m) for cone in world.ROW])
    xyz = np.array([track.xyz_m for track in one.tracks])
    apart = xyz[:, None] - feet
    gnss = np.median(apart[np.arange(len(xyz)), np.linalg.norm(apart, axis=2).argmin(axis=1)], axis=0)
    offset = np.array([0.0, shift_m, 0.0]) - gnss
    tracks = [
        track.model_copy(
            update={
                "xyz_m": vec3(track.xyz_m + offset),
                "centre_xyz_m": vec3(track.centre_xyz_m + offset),
                "cov_m2": cov3(cov_matrix(track.relative_cov_m2) + 0.02**2 * np.eye(3)),
            }
        )
        for track in one.tracks
    ]
    return one._replace(tracks=tracks)


def test_drives_that_contradict_each_other_widen_the_same_sigmas_in_every_order(conn):
    """A lever arm that is wrong by 0.3 m: there, back and there again."""
    maps = []
    for order in islice(permutations(range(3)), 0, None, 2):
        name = "aside_" + "".join(map(str, order))
        for day in order:
            world.merge(conn, aside(day, -0.3 if day == 1 else 0.3), map_name=name)
        assert held_drives(conn, map_name=name) == []
        features = read_current_features(conn, map_name=name)
        assert len(features) == len(world.ROW)
        maps.append(sorted((f.version, f.first_seen_ns, *f.xyz_m, *f.cov_m2) for f in features))
        assert all(0.5 < f.cov_m2[3] ** 0.5 < 0.7 and f.cov_m2[0] ** 0.5 < 0.2 for f in features)
    assert world.failed_audits(conn) == []
    np.testing.assert_allclose(maps[1:], maps[:1] * 2, rtol=1e-9)


def changes_of(conn, map_name):
    """By drive, then by (class, kind): how many changes hold now, after all replays."""
    found = {}
    for row in execute(
        conn,
        "select c.drive_uuid, v.category, x.kind, count(*) as n from conetl.delta x "
        "join conetl.changeset c using (changeset_id) join conetl.map m using (map_id) join conetl.feature_version v "
        "on (v.feature_id, v.version) = (x.feature_id, x.new_version) and upper_inf(v.system_period) "
        "where upper_inf(x.system_period) and m.map_name = %(map_name)s group by 1, 2, 3",
        {"map_name": map_name},
    ):
        found.setdefault(row["drive_uuid"], {})[row["category"], DeltaKind(row["kind"])] = row["n"]
    drives = sorted(list_changesets(conn, map_name=map_name), key=lambda one: one.drive_id)
    return [found[one.drive_uuid] for one in drives]


@pytest.mark.release
def test_a_marking_removed_one_moved_and_a_sign_set_up_are_exactly_these_changes_in_every_order(conn):
    maps = []
    for order in permutations(range(3)):
        name = "".join(map(str, order))
        for day in order:
            world.merge(conn, painted(day), map_name=name)
        features = read_current_features(conn, map_name=name, lines=True)
        maps.append(sorted((f.version, f.first_seen_ns, *f.xyz_m, *f.cov_m2) for f in features))
        asides_m = [round(2 * (f.xyz_m[1] - ORIGIN_M[1])) / 2 for f in features if f.marking]
        edges, moved = (sum(asides_m.count(aside_m) for aside_m in some) for some in ((4.5, -5.0), (-2.5,)))
        assert edges + moved == len(asides_m)
        changes = changes_of(conn, name)
        removed = changes[0][LANE_MARKING, DeltaKind.ADDED] - len(asides_m)
        assert removed > 0
        cones, sign = len(world.ROW), world.SIGN
        assert changes == [
            {(CONE, DeltaKind.ADDED): cones, (LANE_MARKING, DeltaKind.ADDED): len(asides_m) + removed},
            {
                (CONE, DeltaKind.CONFIRMED): cones, (sign, DeltaKind.ADDED): 1,
                (LANE_MARKING, DeltaKind.CONFIRMED): edges, (LANE_MARKING, DeltaKind.MOVED): moved,
                (LANE_MARKING, DeltaKind.REMOVED): removed,
            },
            {
                (CONE, DeltaKind.CONFIRMED): cones, (sign, DeltaKind.CONFIRMED): 1,
                (LANE_MARKING, DeltaKind.CONFIRMED): len(asides_m),
            },
        ]  # fmt: skip
    assert world.failed_audits(conn) == []
    # Ids differ from map to map, and with them the order of sums.
    np.testing.assert_allclose(maps[1:], maps[:1] * 5, rtol=1e-9)


def test_people_decide_about_stretches_as_about_cones(conn):
    world.merge(conn, painted(0))
    before = {f.feature_id: f for f in read_current_features(conn, lines=True) if f.marking}
    cones = read_current_features(conn)
    gone, kept = sorted(f.feature_id for f in before.values() if abs(f.xyz_m[1] - ORIGIN_M[1] - 1.5) < 0.4)[:2]
    decide_location(conn, "pin", str(kept), map_name="default", radius_m=1.0)
    suppressed = decide_location(conn, "suppress", str(gone), map_name="default", radius_m=1.0)
    assert {f.feature_id for f in read_current_features(conn, lines=True) if f.marking} == before.keys() - {gone}
    assert read_current_features(conn) == cones
    world.merge(conn, painted(1))  # which does not show this marking any more
    left = {f.feature_id for f in read_current_features(conn, lines=True) if f.marking}
    assert [key for key in left if abs(before[key].xyz_m[1] - ORIGIN_M[1] - 1.5) < 0.4] == [kept]
    assert world.failed_audits(conn) == []
    revert(conn, "2", map_name="default")
    revert(conn, str(suppressed.decision_id), map_name="default")
    assert {f.feature_id: f for f in read_current_features(conn, lines=True) if f.marking} == before
    assert world.failed_audits(conn) == []


def test_a_drive_that_was_on_hold_states_what_it_did_to_lane_markings(conn):
    for map_name, hold in (("default", None), ("other", "GNSS/INS jumps.")):
        world.merge(conn, painted(0), map_name=map_name)
        world.merge(conn, painted(1), map_name=map_name, hold=hold)
    [at_once, _] = list_changesets(conn)
    assert list_changesets(conn, map_name="other")[0].change_counts == ChangeCounts(points={}, lines={})
    conn.commit()
    accept_drive(conn, "2", map_name="other")
    [released, first] = list_changesets(conn, map_name="other")
    assert released.change_counts == at_once.change_counts and set(first.change_counts.lines) == {DeltaKind.ADDED}
    assert set(at_once.change_counts.lines) == {DeltaKind.REMOVED, DeltaKind.MOVED, DeltaKind.CONFIRMED}


@pytest.mark.parametrize("order", cases(((2, 0, 1),), release=[((1, 2, 0),), ((0, 1, 2),)]), ids=str)
def test_a_drive_that_contradicts_the_map_is_on_hold_in_every_order(conn, order):
    """The last drive's heights are of another datum. Alone it stands; with an earlier one it is on hold until it is accepted."""
    good = of_day(2)
    drives = [of_day(0), of_day(1), lowered(good)]
    for count, day in enumerate(order, start=1):
        world.merge(conn, drives[day])
        states = {known.drive_id: known for known in list_changesets(conn)}
        wrong = states.get(good.drive.drive_id)
        held = wrong is not None and count > 1
        assert wrong is None or (wrong.counts, bool(wrong.hold)) == (not held, held)
        assert world.failed_audits(conn) == []
    assert "48.0 m lower" in wrong.hold
    heights = [feature.xyz_m[2] for feature in read_current_features(conn)]
    assert np.ptp(heights) < 5.0
    conn.commit()
    decided = accept_drive(conn, good.drive.drive_id, map_name="default")
    assert decided.versions_written and not any(known.hold for known in list_changesets(conn))
    accepted = world.valid_time_map(conn)
    assert world.failed_audits(conn) == []
    conn.commit()
    revert(conn, str(decided.decision_id), map_name="default")
    assert [bool(known.hold) for known in list_changesets(conn)].count(True) == 1
    assert [feature.xyz_m[2] for feature in read_current_features(conn)] == heights
    assert world.failed_audits(conn) == []
    conn.commit()
    accept_drive(conn, good.drive.drive_id, map_name="default")
    assert world.valid_time_map(conn) == accepted


def test_what_others_do_to_drives_on_hold_is_said_and_kept_in_order(conn):
    """A drive goes on hold because an earlier one arrives, is accepted, put on hold again, and released by a revert."""
    good, lower = of_day(0), lowered(of_day(2))
    world.merge(conn, lower)
    assert [(c.drive_id, c.state) for c in world.merge(conn, good).hold_changes] == [(lower.drive.drive_id, "on hold")]
    [held] = held_drives(conn, map_name="default")
    [check] = held.checks
    assert check.name == "agreement with the map: heights" and check.value == pytest.approx(-48.0, abs=0.1)
    assert check.sigma and check.limit and check.unit == "m" and "48.0 m lower" in held.reason
    conn.commit()
    accepted = accept_drive(conn, lower.drive.drive_id, map_name="default", note="known", decided_by="Ada")
    for drive, error in (
        (lower.drive.drive_id, "is already in effect"),
        ("2", "is already in effect"),
        ("nobody", "drive held"),
    ):
        with pytest.raises(ConflictError, match=error):
            accept_drive(conn, drive, map_name="default")
    again = revert(conn, str(accepted.decision_id), map_name="default")
    released = revert(conn, "2", map_name="default")
    states = [[change.state for change in one.hold_changes] for one in (accepted, again, released)]
    assert states == [["released"], ["on hold"], ["released"]]
    events = hold_events(conn, map_name="default")
    kinds = ["on hold", "accepted", "acceptance withdrawn", "on hold", "released"]
    assert [event.what for event in events] == kinds
    assert events[1].sentence == "accepted by Ada: known" and "heights -48" in events[0].sentence
    assert hold_events(conn, map_name="default", since=events[1].at, until=events[2].at) == events[1:2]
    conn.commit()
    assert world.failed_audits(conn) == []


@pytest.mark.parametrize("at", cases(-1, release=[0]))
def test_a_delivery_with_one_end_of_another_time_replaces_the_first(conn, at):
    """The same recording: its id, and its first or its last time stamp."""
    world.merge(conn, of_day(0))
    first = of_day(2)
    pairs = list(first.drive.frame_pairs)
    pairs[at] = pairs[at].model_copy(update={"captured_at_ns": pairs[at].captured_at_ns + (10**6 if at else -(10**6))})
    longer = first.drive.model_copy(update={"content_sha256": "ab" * 32, "frame_pairs": tuple(pairs)})
    world.merge(conn, first)
    world.merge(conn, first._replace(drive=longer))
    conn.commit()
    assert counting(conn) == [1, 3]
    assert world.failed_audits(conn) == []
    assert_nothing_to_replay(conn)


def test_of_two_deliveries_only_the_later_one_counts_whatever_releases_them(conn):
    world.merge(conn, of_day(0))
    first = of_day(2)
    corrected = first._replace(drive=first.drive.model_copy(update={"content_sha256": "ab" * 32}))
    world.merge(conn, lowered(first))  # changeset 2, on hold against the map
    [change] = world.merge(conn, corrected).hold_changes
    assert (change.changeset_no, change.state) == (2, "replaced")
    conn.commit()
    with pytest.raises(ConflictError, match="conetl map revert 3 --map default"):
        accept_drive(conn, "2", map_name="default")
    before = world.valid_time_map(conn)
    revert(conn, "1", map_name="default")  # nothing is left that the first delivery contradicts
    assert counting(conn) == [3]
    conn.commit()
    revert(conn, "3", map_name="default")
    assert counting(conn) == [2], "the earlier one stands for the recording again"
    conn.commit()
    [withdrawn] = [d for d in list_decisions(conn) if d.kind == "revert" and d.changeset_id != changeset(conn, 1)]
    revert(conn, str(withdrawn.decision_id), map_name="default")
    assert counting(conn) == [3]
    conn.commit()
    reverted = revert(conn, "2", map_name="default")
    brought_back = revert(conn, str(reverted.decision_id), map_name="default")
    assert brought_back.replaced_by == 3 and counting(conn) == [3]
    conn.commit()
    [first_revert] = [d for d in list_decisions(conn) if d.kind == "revert"]
    revert(conn, str(first_revert.decision_id), map_name="default")
    assert counting(conn) == [1, 3] and world.valid_time_map(conn) == before
    conn.commit()
    world.merge(conn, first._replace(drive=first.drive.model_copy(update={"content_sha256": "cd" * 32})))
    conn.commit()
    reverted = revert(conn, "2", map_name="default")
    assert revert(conn, str(reverted.decision_id), map_name="default").replaced_by == 4, "by the newest one"
    assert world.failed_audits(conn) == []


@pytest.mark.parametrize("seed", cases(0, release=[1]))
def test_random_decisions_and_deliveries_leave_one_delivery_of_each_and_nothing_to_replay(conn, seed):
    rng = np.random.default_rng(seed)
    for _ in range(12):
        known = [str(one.changeset_no) for one in list_changesets(conn)]
        decided = [str(one.decision_id) for one in list_decisions(conn)]
        held = held_drives(conn, map_name="default")
        conn.rollback()
        try:
            match int(rng.integers(4)):
                case 0 | 1:
                    one = of_day(int(rng.integers(3)))
                    drive = one.drive.model_copy(
                        update={"content_sha256": f"{one.drive.drive_id[4]}{rng.integers(2)}" * 32}
                    )
                    one = (lowered(one) if rng.random() < 0.4 else one)._replace(drive=drive)
                    instants = [pair.captured_at_ns for pair in drive.frame_pairs]
                    span = min(instants), max(instants)
                    counts = other_deliveries(conn, drive.drive_id, span, drive.content_sha256, map_name="default")
                    conn.rollback()
                    if not counts:
                        world.merge(conn, one, hold="GNSS/INS jumps." if rng.random() < 0.3 else None)
                case 2:
                    accept_drive(conn, str(held[0].changeset_no) if held else "1", map_name="default")
                case 3:
                    revert(conn, str(rng.choice([*known, *decided] or ["1"])), map_name="default")
        except InputError:
            conn.rollback()
    names = [one.drive_id for one in list_changesets(conn) if one.counts]
    assert len(names) == len(set(names))
    assert world.failed_audits(conn) == []
    assert_nothing_to_replay(conn)


def test_a_map_that_was_set_aside_twice_keeps_its_history(conn):
    """Drives on hold in two zones take turns: each starts the map anew, and each is stored once per map."""
    one, other = of_day(0), of_day(1)
    other = other._replace(drive=other.drive.model_copy(update={"map_srid": 32633}))
    for drive in (one, other, one, other):
        world.merge(conn, drive, hold="GNSS/INS jumps.")
    maps = execute(conn, "select map_name, srid from conetl.map order by map_id")
    assert [row["srid"] for row in maps] == [32632, 32633, 32632, 32633] and maps[-1]["map_name"] == "default"
    conn.commit()
    for row in maps:
        [held] = held_drives(conn, map_name=row["map_name"])
        conn.commit()
        assert accept_drive(conn, held.drive_id, map_name=row["map_name"]).versions_written
        assert read_current_features(conn, map_name=row["map_name"])
        conn.commit()
    assert world.failed_audits(conn) == []


def lowered(one):
    """Its heights are of another datum."""
    tracks = [t.model_copy(update={"xyz_m": (*t.xyz_m[:2], t.xyz_m[2] - 48.0)}) for t in one.tracks]
    return one._replace(tracks=tracks)


def counting(conn):
    return sorted(one.changeset_no for one in list_changesets(conn) if one.counts)


def changeset(conn, number):
    return next(one.changeset_id for one in list_changesets(conn) if one.changeset_no == number)


def assert_nothing_to_replay(conn, drives_expected=None):
    """All drives that count, compared again, make the map and the holds that are stored."""
    conn.rollback()
    with map_transaction(conn):
        drives = [row["drive_uuid"] for row in execute(conn, "select drive_uuid from conetl.drive")]
        again = affected_drives(conn, drives)
        assert drives_expected in (None, len(again))
        _, replay = replay_of(conn, drives, again, read_decisions(conn))
        info, held = find_map(conn), held_drives(conn, map_name="default")
        assert write_replay(conn, info, replay, system_time(conn, info)) == 0
        closed = execute(conn, "select max(upper(system_period)) as t from conetl.feature_version")[0]["t"]
        assert closed is None or closed <= info.last_committed_at
        assert held_drives(conn, map_name="default") == held


def test_the_same_recording_analysed_again_takes_the_place_of_the_first_analysis(conn, another_database):
    """One recording is one piece of evidence: it is not counted twice because it was analysed twice."""
    strict = IngestParams(reconcile=ReconcileParams(removal_min_frames=30))
    for day in range(3):
        world.merge(conn, world.survey(day))
    again = world.merge(conn, world.survey(1), params=strict)
    assert again.replayed == 1
    assert world.failed_audits(conn) == []
    with another_database() as other:
        for day in (1, 2, 0):
            world.merge(other, world.survey(day), params=strict if day == 1 else None)
        assert world.valid_time_map(other) == world.valid_time_map(conn)
    assert world.merge(conn, world.survey(1)) is None  # the first analysis is known, and superseded


def test_a_late_drive_replays_what_it_touches_directly_or_through_others_and_nothing_else(conn):
    """Areas reach some 68 m beyond the path: drives 120 m apart meet, drives 240 m apart do not."""
    for day, start_m in ((1, 120.0), (2, 240.0), (3, 900.0)):
        assert world.merge(conn, world.survey(day, frames=10, start_m=start_m)).replayed == 0
    assert world.merge(conn, world.survey(0, frames=10, start_m=0.0)).replayed == 2  # the second through the first
    # Influence goes forwards in time only: what the drive of day 1 at 120 m left does not reach one recorded before it.
    assert world.merge(conn, world.survey(1, frames=10, start_m=360.0, after_ns=-3_600_000_000_000)).replayed == 1
    assert world.failed_audits(conn) == []
