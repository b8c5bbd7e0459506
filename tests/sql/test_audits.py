"""Every audit passes on a good map and finds the bad row that is planted for it."""

from __future__ import annotations

import pytest

from conetl.db.connection import connect, execute, load_sql, statements
from conetl.db.schema import run_audits
from tests.integration.conftest import command_line

AUDITS = statements("audits").keys()
#: audit -> statements that plant one fault, past the constraints that would refuse it.
DROP_EXCLUDE = "alter table feature_version disable trigger no_overlap_of_changed"
DROP_BELIEVED = "drop index feature_version_current"
DROP_DELTA_KEY = "alter table delta drop constraint feature_of_delta"
DROP_FEATURE_KEY = "alter table feature_version drop constraint feature_of_version"
DROP_CHECKS = """
do $$
declare name text;
begin
    for name in select conname from pg_constraint where conrelid = 'conetl.feature_version'::regclass and contype = 'c' loop
        execute format('alter table conetl.feature_version drop constraint %I', name);
    end loop;
end $$"""
INSERT_DECISION = (
    "insert into decision (decision_id, map_id, srid, kind, geom, radius_m, feature_id, changeset_id, withdraws, note, "
    "decided_at)"
)
#: A pin and a revert as people make them; the faults of the audit of decisions spoil them.
PIN = (
    f"{INSERT_DECISION} select gen_random_uuid(), f.map_id, f.srid, 'pin', ST_Force2D(v.geom), 1, f.feature_id, null, null, "
    "'', now() "
    "from feature f join feature_version v using (feature_id) limit 1"
)
SUPPRESS = (
    f"{INSERT_DECISION} select gen_random_uuid(), f.map_id, f.srid, 'suppress', ST_Force2D(v.geom), 1, f.feature_id, null, null, "
    "'', now() from feature f join feature_version v using (feature_id) where v.version = 2 limit 1"
)
#: Everything within a metre of the place, as `pipeline/maps/decisions.py` writes it down.
HIDE = (
    "update feature_version v set suppressed = present, present = false from decision d where d.kind = 'suppress' "
    "and ST_DWithin(v.geom, d.geom, 1)"
)
REVERT = (
    f"{INSERT_DECISION} select gen_random_uuid(), map_id, 32632, 'revert', null, null, null, changeset_id, null, '', now() "
    "from changeset where change_counts #> '{points,moved}' = '1'"
)
WITHDRAW = (
    f"{INSERT_DECISION} select gen_random_uuid(), map_id, srid, 'withdraw', null, null, null, null, decision_id, '', "
    "decided_at + interval '1 s' from decision order by decision_no desc limit 1"
)
OTHER_MAP = "insert into map (map_name, srid, created_at) values ('other', 32632, now())"
TO_OTHER_MAP = "update decision set map_id = (select map_id from map where map_name = 'other') where kind = "
OF_ONE, ONE_LEVER = "calibrations = array[gen_random_uuid()]", "array[[[0.001::real], [0], [0]]]"
A_UUID = "(select gen_random_uuid() as some_id) one"
UNCHECKED = "set local session_replication_role = replica"
FAULTS = {
    "decisions": [
        (PIN, "update decision set feature_id = gen_random_uuid()"),
        (PIN, OTHER_MAP, f"{TO_OTHER_MAP}'pin'"),
        (REVERT, OTHER_MAP, f"{TO_OTHER_MAP}'revert'"),
        (REVERT, UNCHECKED, "update decision set changeset_id = gen_random_uuid()"),
        (REVERT, "update decision set decided_at = '2000-01-01'"),
        (REVERT, REVERT),
        (PIN, WITHDRAW, UNCHECKED, "delete from decision where kind = 'pin'"),
        (PIN, OTHER_MAP, WITHDRAW, f"{TO_OTHER_MAP}'withdraw'"),
        (PIN, WITHDRAW, "update decision set decided_at = '2000-01-01' where kind = 'withdraw'"),
        (PIN, WITHDRAW, WITHDRAW),
    ],
    "suppressed_locations": [
        (SUPPRESS,),
        ("update feature_version set suppressed = true, present = false where version = 2",),
        (SUPPRESS, HIDE, WITHDRAW),
        (SUPPRESS, HIDE, "update decision set geom = ST_Translate(geom, 1.5, 0)"),
        (SUPPRESS, HIDE, OTHER_MAP, f"{TO_OTHER_MAP}'suppress'"),
        # a version that was valid once is hidden like the one that is open
        (SUPPRESS, HIDE, "update decision set radius_m = 20"),
    ],
    "lines": [
        ("update feature_version set line_cov = line_cov[1:4] where line is not null",),
        ("update feature_version set line = ST_Translate(line, 2.5, 0) where line is not null",),
        ("update feature_version set line_cov[3][4] = 2 * cov_yy where line is not null",),
        ("update feature_version set pattern = 'dashed' where line is not null",),
        ("update marking_track set relative_cov = relative_cov[1:2]",),
        ("update delta set of_line = not of_line",),
    ],
    "evidence": [
        ("update feature_version set seen_count = seen_count + 1 where version = 2",),
        ("update feature_version set missed_count = 1 where version = 2",),
        ("update feature_version set missed_count = 0 where first_missed_ns is not null",),
        ("update feature_version set existence_probability = 0.61 where first_missed_ns is not null",),
        ("update feature_version set first_missed_ns = first_missed_ns - 1 where first_missed_ns is not null",),
        ("update feature_version set first_missed_ns = null where first_missed_ns is not null",),
        ("update feature_version set first_missed_ns = first_seen_ns where version = 2",),
        ("delete from feature_version where first_missed_ns is not null",),
    ],
    "feature_cells": [("update feature_cell set feature_count = feature_count + 1 where zoom = 12",)],
    "overlapping_periods": [
        (
            DROP_EXCLUDE,
            "update feature_version set valid_period = tstzrange('2020-01-01', upper(valid_period)) where version = 2",
        ),
    ],
    "gaps_in_valid_periods": [
        (
            "update feature_version set valid_period = tstzrange(lower(valid_period) + interval '1 hour', null) "
            "where upper_inf(system_period) and upper_inf(valid_period) and version > 1",
        ),
    ],
    "open_versions": [
        (
            DROP_EXCLUDE,
            DROP_BELIEVED,
            "update feature_version set valid_period = tstzrange(lower(valid_period), null), version = 99 "
            "where upper_inf(system_period) and not upper_inf(valid_period)",
        ),
        (
            "update feature_version set system_period = tstzrange(lower(system_period), '2100-01-01') "
            "where version = 2 and upper_inf(valid_period)",
        ),
        ("delete from feature_version",),
    ],
    "orphan_versions": [
        (DROP_FEATURE_KEY, "update feature_version set feature_id = gen_random_uuid() where version = 2"),
        (DROP_FEATURE_KEY, "update feature_version set cell = cell + 1 where version = 2"),
        ("update feature_version set changeset_id = gen_random_uuid() where version = 2",),
        (
            "insert into map (map_name, srid, created_at) values ('other', 32632, now())",
            DROP_FEATURE_KEY,
            "update feature_version set map_id = (select map_id from map where map_name = 'other') where version = 2",
        ),
    ],
    "orphan_records": [
        ("delete from frame_pair where frame_index = 0",),
        ("delete from detection where frame_index = 2 and side = 'right'",),
        ("update stereo_match set left_detection_index = null where frame_index = 1",),
        ("delete from position where frame_index = 1",),
        ("update track set members = array[[1, 0], [1, 7]]",),
        ("update frame_pair set drive_uuid = gen_random_uuid()",),
        ("set local session_replication_role = replica", "delete from changeset"),
    ],
    "orphan_deltas": [
        ("update delta set changeset_id = gen_random_uuid() where kind = 'moved'",),
        (DROP_DELTA_KEY, "update delta set feature_id = gen_random_uuid()"),
        (DROP_DELTA_KEY, "update delta set cell = cell + 1 where kind = 'moved'"),
        ("update delta set new_version = 7 where kind = 'moved'",),
        ("update delta set old_version = 7 where kind = 'moved'",),
        ("update delta set track_index = 7 where kind = 'moved'",),
    ],
    "changeset_counts": [
        ("update changeset set change_counts = jsonb_set(change_counts, '{points,added}', '7')",),
        ("update changeset set change_counts = jsonb_set(change_counts, '{points,removed}', '7')",),
        ("update changeset set change_counts = change_counts - 'lines'",),
        ("update changeset set change_counts = '{}'",),
        ("update changeset set rejection_count = 5",),
        ("delete from detection where frame_index = 1",),
        ("delete from delta where kind = 'moved'",),
        ("update changeset set change_counts = jsonb_set(change_counts, '{points,split}', '1')",),
    ],
    "invalid_geometry": [
        (DROP_CHECKS, "update feature_version set geom = ST_SetSRID(geom, 32633) where version = 2"),
        (DROP_CHECKS, "update feature_version set centre_geom = ST_SetSRID(ST_MakePoint(1, 'nan', 3), 32632)"),
        ("update position set geom = ST_SetSRID(ST_MakePoint(1, 2, 'infinity'), 32632) where frame_index = 0",),
        ("update track set geom = ST_SetSRID(geom, 4326)",),
        ("update frame_pair set geom = ST_GeomFromText('POINT Z EMPTY', 32632)",),
    ],
    "invalid_covariance": [
        (DROP_CHECKS, "update feature_version set cov_yy = 0 where version = 2"),
        ("update track set cov_xy = sqrt(cov_xx * cov_yy)",),
        ("update position set cov_zz = 'nan' where frame_index = 0",),
        # every correlation possible by itself, but not the three together
        ("update track set cov_xx = 1, cov_yy = 1, cov_zz = 1, cov_xy = 0.9, cov_xz = 0.9, cov_yz = -0.9",),
        ("update position set cov_yz = 'nan' where frame_index = 0",),
    ],
    "shared_jacobian": [
        (f"update track set {OF_ONE}",),
        (f"update feature_version set shared_jacobian_m = {ONE_LEVER} where version = 2",),
        (
            f"update feature_version set shared_jacobian_m = {ONE_LEVER}, calibrations = array[null]::uuid[] where version = 2",
        ),
        (
            f"update feature_version set shared_jacobian_m = {ONE_LEVER}, calibrations = array[some_id, some_id] from {A_UUID}",
        ),
        (f"update track set {OF_ONE}, shared_jacobian_m = array[[[0.001::real], [0]]]",),
        (f"update track set {OF_ONE}, shared_jacobian_m = array[[[0::real], [0], ['nan'::real]]]",),
        # by two errors that are less, each by itself
        (
            f"update track set {OF_ONE}, shared_jacobian_m = "
            "array[[[0, 0], [0.8 * sqrt(cov_yy), -0.8 * sqrt(cov_yy)], [0, 0]]]::real[]",
        ),
    ],
    "replay": [
        ("delete from delta where kind = 'moved'",),
        ("update feature_version set present = false where version = 2",),
        ("update delta set old_version = 2 where kind = 'moved'",),
        ("update delta set kind = 'removed' where kind = 'moved'",),
        ("update delta set kind = 'merged' where kind = 'moved'",),
        ("update delta set kind = 'split' where kind = 'moved'",),
        ("update delta set system_period = tstzrange(lower(system_period), '2100-01-01') where kind = 'moved'",),
        (
            "insert into decision (decision_id, map_id, srid, kind, changeset_id, note, decided_at) "
            "select gen_random_uuid(), map_id, 32632, 'revert', changeset_id, '', now() from changeset "
            "where change_counts #> '{points,moved}' = '1'",
        ),
    ],
}


@pytest.fixture(scope="module")
def good_map(module_database_url, samples):
    """A map with history; each test rolls back what it does to it."""
    conn = connect(module_database_url)
    a, b, c, day = samples.feature("a"), samples.feature("b"), samples.feature("c"), samples.DAY_NS
    samples.commit(conn, samples.added(a), samples.added(b), samples.added(c), key="1")
    moved = samples.changed("moved", a, samples.START_NS + day, xyz_m=(458_003.0, 5_428_010.0, 114.5))
    confirmed = samples.changed("confirmed", b, samples.START_NS + day, observation_count=6)
    line = samples.marking([(458_300.0 + 2.5 * k, 5_428_010.0, 114.5) for k in range(5)])
    of_line = samples.added(samples.line_feature(line), track_index=None)
    missed = samples.not_seen(c, samples.START_NS + day)
    samples.commit(conn, moved, confirmed, missed, of_line, key="2", markings=[samples.marking_track(line)])
    yield conn
    conn.close()


def test_every_audit_passes_on_a_good_map(good_map):
    results = run_audits(good_map)
    assert [result for result in results if not result.passed] == []
    assert all(result.purpose.endswith(".") and len(result.purpose) > 30 for result in results)


def failed_after(conn, planted, audits=AUDITS):
    """Rows of the audits that fail after these statements, by name; nothing of them stays."""
    try:
        for statement in planted:
            execute(conn, "savepoint s")
            execute(conn, statement)
        found = {name: execute(conn, load_sql(f"audits.{name}")) for name in audits}
        return {name: rows for name, rows in found.items() if rows}
    finally:
        conn.rollback()


WITHIN_COVARIANCE = (
    f"update track set {OF_ONE}, shared_jacobian_m = array[[[0.8 * sqrt(cov_xx)], [0], [0.1 * sqrt(cov_zz)]]]::real[]"
)


@pytest.mark.parametrize(
    ("made", "audits"),
    [
        ((PIN, WITHDRAW, PIN, REVERT, WITHDRAW), ["decisions"]),  # the rows of the map are not written again here
        ((WITHIN_COVARIANCE,), AUDITS),
        ((SUPPRESS, HIDE), AUDITS),
    ],
)
def test_what_people_and_drives_make_passes(good_map, made, audits):
    assert failed_after(good_map, made, audits) == {}


def test_every_audit_has_faults_to_find():
    assert FAULTS.keys() == AUDITS


@pytest.mark.parametrize(
    ("audit", "number"), [(audit, number) for audit, faults in FAULTS.items() for number in range(len(faults))]
)
def test_an_audit_finds_its_planted_fault(good_map, audit, number):
    rows = failed_after(good_map, FAULTS[audit][number], [audit]).get(audit, [])
    assert rows and all(row["problem"] for row in rows)


def test_a_fault_that_stays_is_reported_with_its_rows(conn, database_url, samples, tmp_path):
    conetl = command_line(tmp_path, database_url)
    samples.commit(conn, samples.added(samples.feature()), key="1")
    assert "changeset_counts" in conetl("db", "audit", code=0)
    execute(conn, "update changeset set rejection_count = 5")
    conn.commit()
    [failed] = [result for result in run_audits(conn) if not result.passed]
    assert (failed.name, failed.row_count, len(failed.rows)) == ("changeset_counts", 1, 1)
    conn.rollback()
    assert f"changeset_counts: {failed.rows[0]}" in conetl("db", "audit", code=1).replace("\n", "")
