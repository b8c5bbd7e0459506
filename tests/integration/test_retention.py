"""Raw records that go by policy: the map stays, and nothing is answered from half of the evidence."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime, timedelta

import pytest

from conetl.db.connection import execute
from conetl.db.map.map_store import list_changesets
from conetl.db.retention import parse_age, prunable_drives, prune_drives
from conetl.model.errors import InputError
from conetl.model.records import utc_from_ns
from conetl.pipeline.maps.decisions import REVERT, SUPPRESS, decide_place, revert
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
    assert decide_place(conn, SUPPRESS, feature, map_name="default").kind == SUPPRESS
    assert revert(conn, str(changesets[0].changeset_id), map_name="default").kind == REVERT
    assert failed_audits(conn) == []


def test_drives_that_are_not_old_enough_stay(conn):
    merge(conn, survey(0))
    captured = survey(0).drive.captured_to
    assert prunable_drives(conn, captured) == []
    assert prunable_drives(conn, captured + timedelta(days=1)) == [], "committed later than that"
    assert utc_from_ns(survey(0).drive.frame_pairs[-1].captured_at_ns) == captured


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
