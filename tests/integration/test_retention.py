"""Raw records that go by policy: the map stays, and nothing is answered from half of the evidence."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import duckdb
import pyarrow.parquet as pq
import pytest

from conetl.db.connection import execute
from conetl.db.map.map_store import list_changesets
from conetl.db.retention import archive_drive, parse_age, prunable_drives, prune_drives, restore_drives
from conetl.files.parquet_store import read_table, write_table
from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.pipeline.maps.decisions import REVERT, SUPPRESS, decide_location, revert
from tests.integration.drives_of_days import failed_audits, merge, survey, valid_time_map

LATER = datetime.now(UTC) + timedelta(days=1)


def raw_rows(conn):
    tables = ("detection", "stereo_match", "position")
    return [execute(conn, f"select count(*) as n from conetl.{table}")[0]["n"] for table in tables]


def test_the_map_outlives_its_raw_records(conn):
    for day in (0, 2):
        merge(conn, survey(day))
    before = valid_time_map(conn)
    drives = prunable_drives(conn, LATER)
    assert [drive.drive_id for drive in drives] == [survey(0).drive.drive_id, survey(2).drive.drive_id]
    expected = sum(d.detection_count + d.match_count + d.position_count for d in drives)
    assert expected == sum(raw_rows(conn)) > 0
    assert prune_drives(conn, drives) == expected
    assert raw_rows(conn) == [0, 0, 0]
    assert prunable_drives(conn, LATER) == []
    assert valid_time_map(conn) == before
    assert failed_audits(conn) == []
    assert merge(conn, survey(0)) is None, "it is known, pruned or not"
    assert merge(conn, survey(3)).replayed == 0, "a newer drive is compared with the map, not with drives"


def test_what_needs_pruned_evidence_is_refused_and_changes_nothing(conn):
    for day in (0, 2):
        merge(conn, survey(day))
    prune_drives(conn, prunable_drives(conn, LATER))
    before, changesets = valid_time_map(conn), list_changesets(conn)
    with pytest.raises(InputError, match=r"would have to be compared with the map again.*pruned on"):
        merge(conn, survey(1))  # recorded before the second one
    with pytest.raises(InputError, match="pruned on"):
        revert(conn, str(changesets[-1].changeset_id), map_name="default")
    assert valid_time_map(conn) == before
    assert list_changesets(conn) == changesets
    # what needs no comparison goes on: the last drive can be taken back, and a place suppressed
    feature = json.loads(before["versions"][0])["feature_id"]
    assert decide_location(conn, SUPPRESS, feature, map_name="default").kind == SUPPRESS
    assert revert(conn, str(changesets[0].changeset_id), map_name="default").kind == REVERT
    assert failed_audits(conn) == []


def test_drives_that_are_not_old_enough_stay(conn):
    merge(conn, survey(0))
    captured = survey(0).drive.captured_to
    assert prunable_drives(conn, captured) == []
    assert prunable_drives(conn, captured + timedelta(days=1)) == [], "committed later than that"
    assert utc_from_ns(survey(0).drive.frame_pairs[-1].captured_at_ns) == captured
    merge(conn, survey(2), hold="GNSS/INS jumps by 5.0 m.")
    assert [drive.drive_id for drive in prunable_drives(conn, LATER)] == [survey(0).drive.drive_id], "one is on hold"


def test_the_command_says_what_would_go_and_does_it_only_when_told(conn, conetl, tmp_path):
    merge(conn, survey(0))
    execute(conn, "update conetl.changeset set committed_at = '2026-03-01'")
    conn.commit()
    results = tmp_path / "home" / "results"
    results.mkdir(parents=True)
    for name, age_days in (("old", 40), ("new", 1)):
        path = results / f"{name}.parquet"
        path.write_bytes(b"x" * 10)
        seconds = datetime.now(UTC).timestamp() - 86400 * age_days
        os.utime(path, (seconds, seconds))

    def run(*arguments):
        return json.loads(conetl("db", "prune", *arguments, "--json"))

    policy = ("--keep-positions", "1h", "--keep-results", "30d")
    told = run(*policy)
    assert (told["deleted"], told["results"], len(told["drives"])) == (False, {"count": 1, "bytes": 10}, 1)
    assert len(list(results.iterdir())) == 2
    rows = sum(raw_rows(conn))
    conn.rollback()
    assert told["rows"] == rows > 0
    done = run(*policy, "--yes")
    assert (done["deleted"], done["rows"], done["results"]) == (True, rows, {"count": 1, "bytes": 10})
    assert [path.name for path in results.iterdir()] == ["new.parquet"]
    assert sum(raw_rows(conn)) == 0


@pytest.mark.parametrize("text", ["", "90", "d", "-3d", "1.5d", "0d", "3y", "9999999w"])
def test_an_age_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="90d"):
        parse_age(text)


def test_ages():
    assert (parse_age("36h"), parse_age("90d"), parse_age("2w")) == (129_600.0, 7_776_000.0, 1_209_600.0)


def archive(conn, folder):
    drives = prunable_drives(conn, LATER)
    return [archive_drive(conn, drive, folder) for drive in drives]


def raw_content(conn):
    found = [
        execute(conn, f"select to_jsonb(r)::text as line from conetl.{table} r order by 1")
        for table in ("detection", "stereo_match", "position")
    ]
    conn.rollback()
    return found


def test_archived_records_come_back_to_the_last_bit_when_a_comparison_needs_them(conn, tmp_path):
    for day in (0, 2):
        merge(conn, survey(day))
    before, map_before = raw_content(conn), valid_time_map(conn)
    assert len(archive(conn, tmp_path / "archive")) == 2
    assert raw_rows(conn) == [0, 0, 0]
    assert valid_time_map(conn) == map_before
    assert failed_audits(conn) == []
    assert prunable_drives(conn, LATER) == []
    assert restore_drives(conn, "default", survey(0).drive.drive_id) == [survey(0).drive.drive_id]
    execute(conn, "set session authorization conetl_writer")
    conn.commit()
    assert merge(conn, survey(1)).replayed == 1, "recorded before the second one, which comes back"
    execute(conn, "reset session authorization")
    conn.commit()
    assert failed_audits(conn) == []
    own = execute(conn, "select drive_uuid from conetl.drive where drive_id = %(d)s", {"d": survey(1).drive.drive_id})
    for table in ("detection", "stereo_match", "position"):
        execute(conn, f"delete from conetl.{table} where drive_uuid = %(u)s", {"u": own[0]["drive_uuid"]})
    conn.commit()
    assert raw_content(conn) == before


def test_an_archive_of_before_0_3_comes_back(conn, tmp_path):
    merge(conn, survey(0))
    before = raw_content(conn)
    archive(conn, tmp_path)
    [path] = tmp_path.glob("*/position.parquet")
    write_table(read_table(path).rename_columns({"object_height_m": "cone_height_m"}), path)
    restore_drives(conn, "default")
    assert raw_content(conn) == before


def test_the_map_does_not_depend_on_what_was_archived(conn, another_database, tmp_path):
    def late_and_reverted(own, *, archived):
        for day in (0, 2):
            merge(own, survey(day))
        if archived:
            archive(own, tmp_path)
        assert merge(own, survey(1)).replayed == 1
        if archived:
            archive(own, tmp_path)
        oldest = list_changesets(own)[-1]
        assert revert(own, str(oldest.changeset_id), map_name="default").replayed == 2
        return valid_time_map(own)

    with another_database() as other:
        expected = late_and_reverted(other, archived=False)
    assert late_and_reverted(conn, archived=True) == expected


def without_column(column):
    return lambda path: write_table(read_table(path).drop_columns([column]), path)


def of_another_drive(path):
    [other] = (folder for folder in path.parents[1].iterdir() if folder != path.parent)
    path.write_bytes((other / path.name).read_bytes())


def a_third(path):
    records = pq.read_table(path)
    pq.write_table(records.slice(0, len(records) // 3), path)


DAMAGES = (
    ("position", Path.unlink, "put the file back"),
    ("position", without_column("easting_m"), "easting_m.*[Nn]othing was written.*put the file back"),
    ("detection", without_column("drive_uuid"), "drive_uuid.*[Nn]othing was written.*put the file back"),
    ("stereo_match", without_column("match_index"), "match_index.*[Nn]othing was written.*put the file back"),
    ("position", of_another_drive, r"it has .*expected \d+ of drive"),
    ("position", a_third, r"it has .*expected \d+ of drive"),
)


def test_a_damaged_file_of_the_archive_is_named_and_nothing_is_written(conn, tmp_path):
    for day in (0, 2):
        merge(conn, survey(day))
    later = prunable_drives(conn, LATER)[-1]
    archive(conn, tmp_path)
    before = valid_time_map(conn)
    for file, damage, said in DAMAGES:
        path = tmp_path / str(later.drive_uuid) / f"{file}.parquet"
        whole = path.read_bytes()
        damage(path)
        for restore in (lambda: merge(conn, survey(1)), lambda: restore_drives(conn, "default")):
            with pytest.raises(InputError, match=rf"{path.parent.name}.*{file}\.parquet.*{said}"):
                restore()
            conn.rollback()
            assert raw_rows(conn) == [0, 0, 0]
            assert valid_time_map(conn) == before
        path.write_bytes(whole)
    assert len(restore_drives(conn, "default")) == 2
    assert failed_audits(conn) == []


def test_two_that_archive_at_once_leave_the_files_of_the_faster_one(conn, tmp_path):
    merge(conn, survey(0))
    before, drives = raw_content(conn), prunable_drives(conn, LATER)
    assert archive_drive(conn, drives[0], tmp_path / "a") > 0
    assert archive_drive(conn, drives[0], tmp_path / "a") == 0  # it listed the drives earlier
    prune_drives(conn, drives)
    restore_drives(conn, "default")
    assert raw_content(conn) == before


def test_other_programs_read_the_archive(conn, conetl, tmp_path):
    merge(conn, survey(0))
    execute(conn, "update conetl.changeset set committed_at = '2026-03-01'")
    conn.commit()
    rows, folder = raw_rows(conn), tmp_path / "cold"
    conn.rollback()
    told = json.loads(conetl("db", "archive", "--keep-positions", "1h", "--to", str(folder), "--json"))
    assert (told["archived"], len(told["drives"]), folder.exists()) == (False, 1, False)
    done = json.loads(conetl("db", "archive", "--keep-positions", "1h", "--to", str(folder), "--yes", "--json"))
    assert done["bytes"] == sum(path.stat().st_size for path in folder.glob("*/*.parquet"))
    assert raw_rows(conn) == [0, 0, 0]
    conn.rollback()
    for table, count in zip(("detection", "stereo_match", "position"), rows, strict=True):
        found = duckdb.sql(f"select count(*), min(drive_id) from '{folder}/*/{table}.parquet'").fetchone()
        assert found == (count, survey(0).drive.drive_id)
    nearest = duckdb.sql(f"select min(range_m), any_value(srid) from '{folder}/*/position.parquet'").fetchone()
    assert nearest == (min(position.range_m for position in survey(0).positions), 32632)
    restored = json.loads(conetl("db", "archive", "--restore", survey(0).drive.drive_id, "--json"))
    assert restored == {"restored": [survey(0).drive.drive_id]}
    assert raw_rows(conn) == rows
