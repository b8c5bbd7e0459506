"""`conetl map ...` over a real map: decisions, differences, history, pictures."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from conetl.db.map.map_store import list_changesets
from conetl.reports.map_picture import drive_paths
from tests.integration.drives_of_days import merge, survey
from tests.view_map import commit, cone, missed, two_drives


@pytest.fixture
def surveyed(conn):
    """A map of three drives, the second one late."""
    for day in (0, 2, 1):
        merge(conn, survey(day))
    conn.rollback()


def test_check_points_at_cones_pass_and_others_need_attention(conetl, surveyed, tmp_path):
    [x, y, z] = json.loads(conetl("map", "show", "--json"))["features"][0]["xyz_m"]
    points = tmp_path / "points.csv"
    for shift_m, code, said in ((0.01, 0, "1 of 1 point"), (1.5, 1, "1 of 1 point"), (500.0, 1, "No cone of the map")):
        points.write_text(f"name,easting_m,northing_m,ellipsoidal_height_m\nP1,{x + shift_m},{y},{z}\n")
        words = ("--crs", "EPSG:32632", "--heights", "ellipsoidal", "--sigma-m", 0.01, "--within-m", 2)
        assert said in conetl("map", "check-points", points, *words, code=code)


def test_a_miss_is_reported_as_one(conetl, surveyed, conn, samples, tmp_path):
    """In the table, the GeoJSON and JSON; the image has a mark of its own for it."""
    there = cone(samples, "there", 0.0, day=10)
    commit(conn, samples, tmp_path, "a", 10, samples.added(there))
    commit(conn, samples, tmp_path, "b", 11, missed(there, there.first_seen_ns + samples.DAY_NS, 0.6))
    written = tmp_path / "diff.geojson"
    said = conetl("map", "diff", 4, 5, "--out", written, "--picture", tmp_path / "diff.png").splitlines()
    assert said[0] == "From changeset 4 to changeset 5, as known now: 1 not observed."
    assert [f["properties"]["change"] for f in json.loads(written.read_text())["features"]] == ["missed"]
    [change] = json.loads(conetl("map", "diff", "4", "5", "--json"))
    assert (change["kind"], change["new"]["existence_probability"]) == ("missed", 0.6)


def test_decisions_through_the_command_line(conetl, surveyed):
    before = json.loads(conetl("map", "show", "--json"))
    features = before["features"]
    first = features[0]["feature_id"]
    entries = json.loads(conetl("map", "log", first, "--json"))
    latest = max(entry["known_from"] for entry in entries)
    known = json.loads(conetl("map", "log", first, "--known-at", latest, "--json"))
    assert known == [entry for entry in entries if entry["known_to"] is None] != entries
    decided = json.loads(conetl("map", "suppress", first[:8], "--note", "a bollard", "--json"))
    assert decided["kind"] == "suppress"
    shown = json.loads(conetl("map", "show", "--json"))
    standing = [f["feature_id"] for f in shown["features"]]
    assert first not in standing and shown["map"]["removed_count"] == before["map"]["removed_count"]
    assert len(standing) == len(features) - 1
    assert "a bollard" in conetl("map", "decisions")
    assert "suppressed" in conetl("map", "log", first)
    assert "pin" in conetl("map", "pin", standing[0])
    assert "already" in conetl("map", "pin", standing[0], code=2)
    conetl("map", "revert", decided["decision_id"])
    assert len(json.loads(conetl("map", "show", "--json"))["features"]) == len(features)

    assert "drum" not in conetl("map", "log", first)
    conetl("map", "classify", first, "drum", "--note", "seen on site", "--by", "Ann")
    log = conetl("map", "log", first)
    assert "traffic_cone" in log and "drum" in log  # superseded and current
    assert "Class corrected by a decision: drum instead of cone" in log

    reverted = conetl("map", "revert", 3, "--note", "wrong GNSS")
    assert "their changes are kept" in reverted
    xyz_m = {f["feature_id"][:8]: f["xyz_m"] for f in json.loads(conetl("map", "show", "--json"))["features"]}
    standing = {feature: f"{x:.2f} {y:.2f}" for feature, (x, y, _) in xyz_m.items()}
    rows = [re.split(" {2,}", line) for line in reverted.splitlines() if re.match("[0-9a-f]{8} ", line)]
    assert [row[4] for row in rows] == [standing.get(row[0], "removed") for row in rows]
    assert any(row[4] != row[3] for row in rows), "by the drive of the day after"
    assert "not in effect" in conetl("map", "log")
    assert "already" in conetl("map", "revert", 3, code=2)
    conetl("db", "audit")


def test_the_picture_of_a_time_of_changes_and_of_a_place_in_degrees(conetl, conn, samples, tmp_path):
    two_drives(conn, samples, tmp_path / "images")
    out = tmp_path / "map.png"

    def said(*words):
        answer = json.loads(conetl("map", "picture", out, "--json", *words))
        assert out.read_bytes().startswith(b"\x89PNG")
        return answer

    assert said()["objects_by_class"] == {"traffic_cone": 3}
    assert (said("--changes", "1", "2")["changes"], said("--at", "2026-03-02T12:00")["changes"]) == (4, None)
    west, south, east, north = said("--bbox", "8.426,48.998,8.428,49.005", "--size", "200x150", "--title", "L 605")[
        "bbox"
    ]
    assert 457_900 < west < east < 458_300 and 5_427_000 < south < north < 5_429_000
    for words, text in (
        (("--bbox", "99,0,99.001,0.001"), "does not exist in the map's CRS"),
        (("--size", "9x9"), "millimetres"),
        (("--changes", "1", "2", "--at", "2026-03-02"), "omit --as-of"),
        (("--at", "2020-01-01"), "the map has no cones"),
    ):
        out.unlink(missing_ok=True)
        assert text in conetl("map", "picture", out, *words, code=2)
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


def test_lane_markings_are_told_apart_from_cones_and_are_on_pictures(conn, conetl, samples, tmp_path):
    day = samples.START_NS + samples.DAY_NS
    shape = samples.marking([(458_000.0 + 2.5 * k, 5_428_010.0, 114.5) for k in range(5)])
    wider = shape.model_copy(update={"width_m": 0.15})
    cone, line = samples.feature(), samples.line_feature(shape)
    track = samples.marking_track(shape)
    samples.commit(conn, samples.added(cone), samples.added(line), key="1", markings=[track])
    other = samples.added(samples.feature("other", seen_ns=day))
    second = samples.changed("confirmed", line, day, marking=wider)
    samples.commit(conn, second, other, key="2", start_ns=day, markings=[track])
    line_only = samples.commit(
        conn,
        samples.changed("confirmed", second.new, day + samples.DAY_NS),
        key="3",
        start_ns=day + samples.DAY_NS,
        markings=[track],
    )
    conn.commit()

    out = tmp_path / "changes.geojson"
    said = conetl("map", "diff", "1", "2", "--out", out, "--picture", tmp_path / "diff.png")
    assert said.splitlines()[:2] == [
        "From changeset 1 to changeset 2, as known now: 1 added.",
        "Stretches of lane markings: 1 confirmed.",
    ]
    assert "This file does not contain lane markings" in said and len(json.loads(out.read_text())["features"]) == 1
    for words in ((), ("--changes", "1", "2")):
        facts = json.loads(conetl("map", "picture", tmp_path / "map.png", "--json", *words))
        assert facts["objects_by_class"] == {"traffic_cone": 2, "lane_marking": 1}
    assert facts["bbox"][0] < 458_000 and facts["bbox"][2] > 458_010
    assert "no other class" in conetl("map", "classify", str(line.feature_id), "drum", code=2)
    page = next(w for w in conetl("report", "drive", str(line_only.drive_id)).split() if w.endswith(".html"))
    assert "this drive did not change any cone" in Path(page).read_text()
