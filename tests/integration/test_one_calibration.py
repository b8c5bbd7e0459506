"""Drives of one calibration on a real PostGIS: what they have in common is kept, and plays again like the rest of the map."""

from __future__ import annotations

import numpy as np

from conetl.db.connection import execute
from conetl.db.map.drive_store import load_stored_drive
from conetl.db.map.map_store import list_changesets, read_current_features, read_features_as_of
from conetl.geometry.calibration.covariance import calibration_id, unpack_all
from conetl.geometry.packing import cov_matrix
from conetl.model.records import SharedErrorJacobian
from conetl.pipeline.maps.decisions import revert
from tests.integration.drives_of_days import AGAIN, CALIBRATED, RIGS, failed_audits, merge, survey, valid_time_map


def of_day(day, rigs=RIGS):
    return survey(day, rig=rigs[day])


def jacobian_of(conn):
    return [feature.shared_jacobian for feature in read_current_features(conn)]


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


def test_a_second_drive_from_the_same_side_does_not_halve_the_error_of_the_calibration(conn, another_database):
    """The same two drives, once of one calibration and once of two: along the road, which they see along."""
    cones = {}
    for name, rigs in {"one": (CALIBRATED, CALIBRATED), "two": (CALIBRATED, AGAIN)}.items():
        with another_database() as other:
            for day in range(2):
                merge(other, of_day(day, rigs))
            cones[name] = {
                f.feature_id: f
                for f in read_current_features(other)
                if f.first_seen_ns < of_day(1).tracks[0].first_seen_ns
            }
    assert cones["one"].keys() == cones["two"].keys()
    for feature_id, one in cones["one"].items():
        assert np.trace(cov_matrix(one.cov_m2)) > np.trace(cov_matrix(cones["two"][feature_id].cov_m2))


def test_a_reverted_drive_takes_its_calibration_along_and_brings_it_back(conn, another_database):
    for day in range(3):
        merge(conn, of_day(day))
    before = valid_time_map(conn)
    [target] = [c for c in list_changesets(conn) if c.drive_id == of_day(2).drive.drive_id]
    reverted = revert(conn, str(target.changeset_no), map_name="default")
    assert failed_audits(conn) == []
    assert {one for shared_jacobian in jacobian_of(conn) for one in shared_jacobian.calibrations} == {
        calibration_id(CALIBRATED)
    }
    with another_database() as other:
        for day in range(2):
            merge(other, of_day(day))
        assert jacobian_of(conn) == jacobian_of(other)
    revert(conn, str(reverted.decision_id), map_name="default")
    assert valid_time_map(conn) == before
    assert failed_audits(conn) == []
