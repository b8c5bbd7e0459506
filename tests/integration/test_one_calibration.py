"""Drives of one calibration on a real PostGIS: what they have in common is kept, and plays again like the rest of the map."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from conetl.db.audits import run_audits
from conetl.db.connection import connect, execute
from conetl.db.map.decision_store import read_decisions
from conetl.db.map.drive_store import load_stored_drive
from conetl.db.map.map_store import (
    find_map,
    list_changesets,
    map_transaction,
    read_current_features,
    read_features_as_of,
    system_time,
)
from conetl.db.map.replay_store import affected_drives, write_replay
from conetl.geometry.calibration.covariance import calibration_id, unpack_all, with_covariance
from conetl.geometry.packing import cov_matrix
from conetl.model.map_records import DeltaKind
from conetl.model.records import CalibrationCovariance, SharedErrorJacobian
from conetl.pipeline.maps.decisions import revert
from conetl.pipeline.replay import replay_of
from tests.conftest import cloned_database
from tests.integration.drives_of_days import CALIBRATED, DAYS, RIG, known_maps, merge, survey, valid_time_map

#: Calibrated another time, with more parameters open.
AGAIN = with_covariance(
    RIG,
    CalibrationCovariance(
        names=("left.fx_px", "right.cx_px", "relative.ry_rad", "relative.tx_m"),
        matrix=np.diag([1.0, 0.25, 2.5e-7, 1e-6]).tolist(),
    ),
)
RIGS = (CALIBRATED, CALIBRATED, AGAIN, RIG)


def of_day(day, rigs=RIGS):
    return survey(day, rig=rigs[day])


def failed_audits(conn):
    return [result for result in run_audits(conn) if not result.passed]


def jacobian_of(conn):
    return [feature.shared_jacobian for feature in read_current_features(conn)]


@pytest.fixture(scope="module")
def in_order(cluster_url, template_database):
    with cloned_database(cluster_url, template_database) as url:
        conn = connect(url)
        merged = [merge(conn, of_day(day)) for day in range(3)]
        assert [m.replayed for m in merged] == [0, 0, 0]
        kinds = {delta.kind for m in merged for delta in m.changeset.deltas}
        assert kinds >= {DeltaKind.ADDED, DeltaKind.CONFIRMED, DeltaKind.MOVED, DeltaKind.REMOVED}
        found = jacobian_of(conn)
        assert len(found) == len(DAYS[2])
        ids = {calibration_id(CALIBRATED), calibration_id(AGAIN)}
        assert ids in [set(one.calibrations) for one in found if one], "some cones know both calibrations"
        conn.rollback()
        yield valid_time_map(conn)
        conn.close()


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=lambda order: "".join(map(str, order)))
def test_all_orders_of_three_drives_give_the_same_map(conn, in_order, order):
    believed = {}
    for day in order:
        assert merge(conn, of_day(day)) is not None
        assert failed_audits(conn) == []
        now = known_maps(conn)
        assert {moment: now[moment] for moment in believed} == believed, "an earlier belief was changed"
        believed = now
    assert valid_time_map(conn) == in_order
    assert '"shared_jacobian_m": [[[' in in_order["versions"][0]


def test_levers_come_back_from_the_database_to_the_last_bit(conn):
    merged = [merge(conn, of_day(day)) for day in (0, 1, 2)]
    written = {d.feature_id: d.new.shared_jacobian for m in merged for d in m.changeset.deltas if d.is_change and d.new}
    standing = {feature.feature_id: feature for feature in read_current_features(conn)}
    assert standing
    for feature_id, feature in standing.items():
        assert isinstance(feature.shared_jacobian, SharedErrorJacobian)
        assert feature.shared_jacobian == written[feature_id]
        moved = unpack_all(feature.shared_jacobian.calibrations, [feature.shared_jacobian])[0]
        own = cov_matrix(feature.cov_m2) - sum(a @ a.T for a in moved)
        assert np.linalg.eigvalsh(own).min() > 0
    as_of = {version.feature.feature_id: version.feature for version in read_features_as_of(conn)}
    assert {k: v.shared_jacobian for k, v in as_of.items()} == {k: v.shared_jacobian for k, v in standing.items()}
    for day in range(3):
        [row] = execute(
            conn, "select drive_uuid from conetl.drive where drive_id = %(d)s", {"d": of_day(day).drive.drive_id}
        )
        stored = {
            track.track_index: track.shared_jacobian for track in load_stored_drive(conn, row["drive_uuid"]).tracks
        }
        assert stored == {track.track_index: track.shared_jacobian for track in of_day(day).tracks}
        assert None not in stored.values()


def test_a_second_drive_from_the_same_side_does_not_halve_the_error_of_the_calibration(
    conn, cluster_url, template_database
):
    """The same two drives, once of one calibration and once of two: along the road, which they see along."""
    cones = {}
    for name, rigs in {"one": (CALIBRATED, CALIBRATED), "two": (CALIBRATED, AGAIN)}.items():
        with cloned_database(cluster_url, template_database) as url:
            other = connect(url)
            for day in range(2):
                merge(other, of_day(day, rigs))
            cones[name] = {
                f.feature_id: f
                for f in read_current_features(other)
                if f.first_seen_ns < of_day(1).tracks[0].first_seen_ns
            }
            other.close()
    assert cones["one"].keys() == cones["two"].keys()
    for feature_id, one in cones["one"].items():
        assert np.trace(cov_matrix(one.cov_m2)) > np.trace(cov_matrix(cones["two"][feature_id].cov_m2))


def test_playing_everything_again_writes_nothing(conn):
    for day in (1, 3, 0, 2):
        merge(conn, of_day(day))
    assert failed_audits(conn) == []
    with map_transaction(conn):
        drives = [row["drive_uuid"] for row in execute(conn, "select drive_uuid from conetl.drive")]
        again = affected_drives(conn, drives)
        assert len(again) == 4
        _, replay = replay_of(conn, drives, again, read_decisions(conn))
        info = find_map(conn)
        assert write_replay(conn, info, replay, system_time(conn, info)) == 0


def test_a_reverted_drive_takes_its_calibration_along_and_brings_it_back(conn, cluster_url, template_database):
    for day in range(3):
        merge(conn, of_day(day))
    before = valid_time_map(conn)
    [target] = [c for c in list_changesets(conn) if c.drive_id == of_day(2).drive.drive_id]
    reverted = revert(conn, str(target.changeset_no), map_name="default")
    assert failed_audits(conn) == []
    assert {one for shared_jacobian in jacobian_of(conn) for one in shared_jacobian.calibrations} == {
        calibration_id(CALIBRATED)
    }
    with cloned_database(cluster_url, template_database) as url:
        other = connect(url)
        for day in range(2):
            merge(other, of_day(day))
        assert jacobian_of(conn) == jacobian_of(other)
        other.close()
    revert(conn, str(reverted.decision_id), map_name="default")
    assert valid_time_map(conn) == before
    assert failed_audits(conn) == []
