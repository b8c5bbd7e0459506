"""`conetl map picture` over a real map."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.db.map.map_store import list_changesets
from conetl.model.errors import InputError
from conetl.reports.map_picture import drive_paths
from tests.integration.drives_of_days import merge, survey
from tests.view_map import two_drives


@pytest.fixture
def run(database_url, conn, samples, tmp_path):
    two_drives(conn, samples, tmp_path / "images")
    environment = {"CONETL_DATABASE_URL": database_url, "CONETL_HOME": str(tmp_path / "home")}
    return lambda *words: CliRunner().invoke(app, ["map", "picture", *words], env=environment)


def test_the_map_of_a_time_changes_and_a_place_in_degrees(run, tmp_path):
    out = tmp_path / "map.png"

    def said(*words):
        done = run(str(out), "--json", *words)
        assert done.exit_code == 0, done.output
        assert out.read_bytes().startswith(b"\x89PNG")
        return json.loads(done.stdout)

    assert said()["cones"] == 3
    assert (said("--changes", "1", "2")["changes"], said("--at", "2026-03-02T12:00")["changes"]) == (4, None)
    west, south, east, north = said("--bbox", "8.426,48.998,8.428,49.005", "--size", "200x150", "--title", "L 605")[
        "bbox"
    ]
    assert 457_900 < west < east < 458_300 and 5_427_000 < south < north < 5_429_000
    for words, text in (
        (("--bbox", "1,2,3"), "west,south,east,north"),
        (("--bbox", "3,2,1,4"), "less than east"),
        (("--bbox", "99,0,99.001,0.001"), "does not exist in the map's CRS"),
        (("--size", "9x9"), "millimetres"),
        (("--changes", "1", "2", "--at", "2026-03-02"), "leave --at"),
        (("--at", "2020-01-01"), "no cone stands"),
    ):
        out.unlink(missing_ok=True)
        refused = run(str(out), *words)
        assert isinstance(refused.exception, InputError) and text in str(refused.exception)
        assert not out.exists()


def test_a_picture_shows_the_paths_of_its_state(conn):
    for day in (0, 1):
        merge(conn, survey(day))
    changesets = list_changesets(conn)  # newest first
    assert (
        len(drive_paths(conn, "default", None, None))
        == len(drive_paths(conn, "default", None, changesets[0].committed_at))
        == 2
    )
    assert len(drive_paths(conn, "default", None, changesets[1].committed_at)) == 1
    conn.rollback()
