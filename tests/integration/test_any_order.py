"""Drives in any order, any number of times, on a real PostGIS: one map, and every earlier belief kept."""

from __future__ import annotations

from datetime import timedelta
from itertools import permutations

import pytest

from conetl.db.connection import execute
from conetl.db.map.decision_store import read_decisions
from conetl.db.map.map_store import (
    feature_log,
    find_map,
    list_changesets,
    map_transaction,
    read_current_features,
    read_features_as_of,
    system_time,
)
from conetl.db.map.replay_store import affected_drives, write_replay
from conetl.geometry.calibration.covariance import calibration_id
from conetl.model.map_records import DeltaKind
from conetl.model.params import IngestParams, ReconcileParams
from conetl.pipeline.replay import replay_of
from tests.integration.drives_of_days import (
    AGAIN,
    CALIBRATED,
    DAY_NS,
    DAYS,
    RIG,
    RIGS,
    failed_audits,
    known_maps,
    merge,
    survey,
    valid_time_map,
)


@pytest.fixture(scope="module")
def in_order(another_database):
    """The map of the first three days, ingested in order: each drive extends the fold by one, nothing is replayed."""
    with another_database() as conn:
        merged = [merge(conn, survey(day)) for day in range(3)]
        assert [m.replayed for m in merged] == [0, 0, 0]
        kinds = [sorted({delta.kind for delta in m.changeset.deltas}) for m in merged]
        assert kinds == [
            [DeltaKind.ADDED],
            [DeltaKind.CONFIRMED, DeltaKind.MOVED, DeltaKind.REMOVED],
            [DeltaKind.ADDED, DeltaKind.CONFIRMED, DeltaKind.MOVED],
        ]
        assert failed_audits(conn) == []
        assert len(read_current_features(conn)) == len(DAYS[2])
        conn.rollback()
        yield valid_time_map(conn)


@pytest.fixture(scope="module")
def calibrated_in_order(another_database):
    """The same of drives of two calibrations, whose errors they share."""
    with another_database() as conn:
        assert [merge(conn, survey(day, rig=RIGS[day])).replayed for day in range(3)] == [0, 0, 0]
        found = [feature.shared_jacobian for feature in read_current_features(conn)]
        assert len(found) == len(DAYS[2])
        ids = {calibration_id(CALIBRATED), calibration_id(AGAIN)}
        assert ids in [set(one.calibrations) for one in found if one], "some cones know both calibrations"
        conn.rollback()
        yield valid_time_map(conn)


@pytest.mark.parametrize(("expected", "rigs"), [("in_order", (RIG,) * 4), ("calibrated_in_order", RIGS)])
@pytest.mark.parametrize("order", list(permutations(range(3))), ids=lambda order: "".join(map(str, order)))
def test_all_orders_of_three_drives_give_the_same_map(conn, request, order, expected, rigs):
    in_order = request.getfixturevalue(expected)
    assert ('"shared_jacobian_m": [[[' in in_order["versions"][0]) == (rigs is RIGS)
    believed = {}
    for day in order:
        assert merge(conn, survey(day, rig=rigs[day])) is not None
        assert failed_audits(conn) == []
        for earlier in order[: order.index(day) + 1]:  # again: nothing happens
            assert merge(conn, survey(earlier, rig=rigs[earlier])) is None
        now = known_maps(conn)
        assert {moment: now[moment] for moment in believed} == believed, "an earlier belief was changed"
        believed = now
    assert valid_time_map(conn) == in_order
    assert len(list_changesets(conn)) == 3


def test_short_looks_in_vain_add_up_in_any_order_and_are_known_at_any_time(conn, another_database):
    """Two drives that came too near the spot for too short a time: evidence, counts and belief, but no version."""
    glimpses = [survey(1, frames=20), survey(1, frames=21, after_ns=3_600_000_000_000)]
    for one in (survey(0), *glimpses):
        merge(conn, one)
    missed = {v.feature.feature_id: v for v in read_features_as_of(conn) if v.missed_count == 2}
    assert missed
    before = {
        v.feature.feature_id: v for v in read_features_as_of(conn, glimpses[0].drive.captured_from - timedelta(hours=1))
    }
    for feature_id, version in missed.items():
        then = before[feature_id]
        assert (then.seen_count, then.missed_count) == (1, 0)
        assert version.feature.existence_probability < then.feature.existence_probability
        assert version.feature.version == then.feature.version
        kinds = [entry.kind for entry in feature_log(conn, feature_id)]
        assert kinds == [DeltaKind.ADDED, DeltaKind.MISSED, DeltaKind.MISSED]
    assert failed_audits(conn) == []
    in_order = valid_time_map(conn)
    for order in ((2, 0, 1), (2, 1, 0), (1, 0, 2)):
        with another_database() as other:
            for number in order:
                merge(other, [survey(0), *glimpses][number])
            assert valid_time_map(other) == in_order
            assert failed_audits(other) == []


def test_history_is_only_ever_closed(conn):
    """No row is changed but for its system period; what comes out as it was is not written again."""
    for day in (2, 1):
        merge(conn, survey(day))
    columns = "to_jsonb(t) - 'system_period'"
    tables = ("feature_version", "delta", "feature", "changeset", "drive", "track", "position", "detection")
    before = {
        table: {row["line"] for row in execute(conn, f"select ({columns})::text as line from conetl.{table} t")}
        for table in tables
    }
    merge(conn, survey(0))
    for table in tables:
        after = {row["line"] for row in execute(conn, f"select ({columns})::text as line from conetl.{table} t")}
        assert before[table] <= after
    open_before = "select count(*) as n from conetl.feature_version where lower(system_period) > upper(system_period)"
    assert execute(conn, open_before) == [{"n": 0}]


@pytest.mark.parametrize("rigs", [(RIG,) * 4, RIGS], ids=["one rig", "two calibrations"])
def test_playing_everything_again_writes_nothing(conn, rigs):
    for day in (1, 3, 0, 2):
        merge(conn, survey(day, rig=rigs[day]))
    with map_transaction(conn):
        drives = [row["drive_uuid"] for row in execute(conn, "select drive_uuid from conetl.drive")]
        again = affected_drives(conn, drives)
        assert len(again) == 4
        _, replay = replay_of(conn, drives, again, read_decisions(conn))
        info = find_map(conn)
        assert write_replay(conn, info, replay, system_time(conn, info)) == 0
        closed = execute(conn, "select max(upper(system_period)) as t from conetl.feature_version")[0]["t"]
        assert closed <= info.last_committed_at


def test_a_drive_elsewhere_comes_late_and_nobody_minds(conn):
    for day in (1, 2):
        merge(conn, survey(day))
    before = valid_time_map(conn)
    far = survey(0, start_m=-900.0)
    assert merge(conn, far).replayed == 0
    after = valid_time_map(conn)
    assert set(before["versions"]) <= set(after["versions"])
    assert set(before["deltas"]) <= set(after["deltas"])


def test_drives_that_overlap_in_time_or_start_together(conn, another_database):
    surveys = [survey(0), survey(1, name="a"), survey(1, after_ns=1_000_000_000), survey(1, frames=39)]
    assert surveys[1].drive.captured_from == surveys[3].drive.captured_from
    for one in surveys:
        merge(conn, one)
    assert failed_audits(conn) == []
    expected = valid_time_map(conn)
    with another_database() as other:
        for number in (3, 2, 0, 1):
            merge(other, surveys[number])
        assert failed_audits(other) == []
        assert valid_time_map(other) == expected


def test_two_maps_in_one_database_do_not_touch_each_other(conn, in_order):
    for day in (2, 0):
        merge(conn, survey(day))
    merge(conn, survey(1), map_name="other")
    other = valid_time_map(conn, "other")
    merge(conn, survey(1))
    assert valid_time_map(conn) == in_order
    assert valid_time_map(conn, "other") == other
    ids = [{f.feature_id for f in read_current_features(conn, map_name=name)} for name in ("default", "other")]
    assert not ids[0] & ids[1]


def test_the_same_recording_analysed_again_takes_the_place_of_the_first_analysis(conn, another_database):
    """One recording is one piece of evidence: it is not counted twice because it was analysed twice."""
    strict = IngestParams(reconcile=ReconcileParams(removal_min_frames=30))
    for day in range(3):
        merge(conn, survey(day))
    again = merge(conn, survey(1), params=strict)
    assert again.replayed == 1
    assert failed_audits(conn) == []
    with another_database() as other:
        for day in (1, 2, 0):
            merge(other, survey(day), params=strict if day == 1 else None)
        assert valid_time_map(other) == valid_time_map(conn)
    assert merge(conn, survey(1)) is None  # the first analysis is known, and superseded


def test_a_drive_of_a_later_day_does_not_replay_the_earlier_ones(conn):
    for day in (1, 0):
        merge(conn, survey(day))
    assert merge(conn, survey(3)).replayed == 0
    merged = merge(conn, survey(2))
    assert merged.replayed == 1
    assert merged.changeset.deltas[0].changed_at_ns >= 2 * DAY_NS


def test_a_late_drive_replays_what_it_touches_directly_or_through_others_and_nothing_else(conn):
    """Areas reach some 68 m beyond the path: drives 120 m apart meet, drives 240 m apart do not."""
    for day, start_m in ((1, 120.0), (2, 240.0), (3, 900.0)):
        assert merge(conn, survey(day, frames=10, start_m=start_m)).replayed == 0
    assert merge(conn, survey(0, frames=10, start_m=0.0)).replayed == 2  # the second through the first
    # Influence goes forwards in time only: what the drive of day 1 at 120 m left does not reach one recorded before it.
    assert merge(conn, survey(1, frames=10, start_m=360.0, after_ns=-3_600_000_000_000)).replayed == 1
    assert failed_audits(conn) == []
