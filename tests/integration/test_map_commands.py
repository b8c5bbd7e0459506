"""`conetl map ...` over a real map: decisions, differences, history, pictures."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from pyproj import Transformer

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


def test_differences_between_changesets_and_times(conetl, surveyed, tmp_path):
    # Changeset 3 is the late drive of day 1, between those of changesets 1 and 2 on the road.
    changes = json.loads(conetl("map", "diff", 3, 2, "--json"))
    assert changes == json.loads(conetl("map", "diff", "2026-03-03T23:00", "2026-03-04T23:00", "--json")) != []
    then = json.loads(conetl("map", "diff", 1, 2, "--known-at", "then", "--json"))
    now = json.loads(conetl("map", "diff", 1, 2, "--json"))
    seen = [{c["feature_id"]: c["new"]["seen_count"] for c in some if c["new"]} for some in (then, now)]
    assert seen[0].keys() == seen[1].keys()
    assert {seen[1][key] - count for key, count in seen[0].items()} == {0, 1}, "without the drive that came later"
    assert conetl("map", "diff", 3, 3).strip() == "From changeset 3 to changeset 3, as known now: no differences."
    of_days = conetl("map", "diff", "2026-03-02", "2026-03-04").splitlines()[0]
    assert of_days.startswith("From the beginning of 2026-03-02 to the end of 2026-03-04, as known now: "), (
        "as --help says"
    )
    for states in ((2, 3), ("2026-03-04", "2026-03-03")):
        assert "exchange them" in conetl("map", "diff", *states, code=2)
        assert "exchange them" in conetl("map", "picture", tmp_path / "no.png", "--changes", *states, code=2)
    drawn = tmp_path / "diff.png"
    assert str(drawn) in conetl("map", "diff", 3, 2, "--picture", drawn).replace("\n", "")
    assert cv2.imread(str(drawn)).std() > 5
    written = tmp_path / "diff.geojson"
    table = conetl("map", "diff", "2026-03-02T23:00", "2026-03-03T23:00", "--out", written)
    collection = json.loads(written.read_text())
    changes = [feature["properties"]["change"] for feature in collection["features"]]
    assert {"moved", "removed"} <= set(changes)
    assert all(change in table for change in changes)
    lines = [f for f in collection["features"] if f["geometry"]["type"] == "LineString"]
    assert len(lines) == changes.count("moved")
    to_map = Transformer.from_crs(4326, 32632, always_xy=True)
    for change in json.loads(conetl("map", "diff", "2026-03-02T23:00", "2026-03-03T23:00", "--json")):
        [feature] = (f for f in collection["features"] if f["id"] == change["feature_id"])
        drawn, cov_m2 = feature["geometry"]["coordinates"], (change["new"] or change["old"])["cov_m2"]
        told = [feature["properties"][f"sigma_{axis}_m"] for axis in "enu"]
        assert told == pytest.approx(np.sqrt([cov_m2[0], cov_m2[3], cov_m2[5]]), abs=5.1e-5)
        shown = [to_map.transform(*at[:2]) for at in (drawn if isinstance(drawn[0], list) else [drawn])]
        sides = [side["xyz_m"][:2] for side in (change["old"], change["new"]) if side]
        assert shown == pytest.approx(np.array(sides[-len(shown) :]), abs=0.001), (
            "a line from old to new, or the newest place"
        )
    assert "has no changeset 9" in conetl("map", "diff", 9, 3, code=2)


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


def test_exports_and_pictures_name_what_stands_on_the_map(conn, conetl, samples, tmp_path):
    def written(*words):
        return conetl("map", "export", "--out", tmp_path / "map.geojson", *words).replace("\n", " ")

    def drawn():
        out = tmp_path / "map.svg"
        return conetl("map", "picture", out).replace("\n", " "), out.read_text()

    samples.commit(conn, samples.added(samples.feature("a")), samples.added(samples.feature("b")), key="1")
    conn.commit()
    assert written().startswith("2 cones ->")
    said, image = drawn()
    assert said.startswith("2 cones, 0 lane boundaries") and "Traffic cones, map default" in image

    day = samples.START_NS + samples.DAY_NS
    drum = samples.feature("c", seen_ns=day, category="drum")
    line = samples.line_feature(samples.marking([(458_000.0 + k, 5_428_010.0, 114.5) for k in range(5)]), seen_ns=day)
    samples.commit(conn, samples.added(drum), samples.added(line), key="2", start_ns=day)
    conn.commit()
    assert written().startswith("1 drum, 2 cones ->") and "1 stretch of lane markings ->" in written()
    assert all(text in drawn()[1] for text in ("drum, standing (1)", "cone, standing (2)"))
    assert written("--category", "drum").startswith("1 drum ->")
    assert written("--category", "all").startswith("1 drum, 2 cones ->")
    assert written("--category", "barricade").startswith("0 barricades ->")
    assert written("--category", "lane_marking").startswith("1 stretch of lane markings ->")
    nowhere = tmp_path / "nowhere.geojson"
    said = conetl("map", "export", "--out", nowhere, "--category", "dromedary", code=2)
    assert "there is no class dromedary; give traffic_cone" in said and not nowhere.exists()
    assert written("--what", "history").startswith("3 versions ->")
    assert "1 drum" in conetl("map", "show", "--category", "all")
    assert "there is no class dromedary; give traffic_cone" in conetl("map", "show", "--category", "dromedary", code=2)
    assert conetl("map", "export", "--out", tmp_path / "map.csv").startswith("1 drum, 2 cones ->")
    said, image = drawn()
    assert said.startswith("1 drum, 2 cones, 1 stretch of lane markings, 0 lane boundaries") and "Map default" in image
    assert "Traffic cones" not in image
