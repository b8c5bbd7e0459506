"""Work zones through the command line on PostGIS: feeds over days, an end, the layout check and its files."""

from __future__ import annotations

import json
import re
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from datetime import timedelta

import geopandas
import numpy as np
import pytest
import shapely
import shapely.ops

from conetl.db import reader_pool
from conetl.db.connection import execute
from conetl.db.map.map_store import read_current_features
from conetl.exports.wzdx import SOURCES, schema_faults
from conetl.model.base import utc_from_ns
from conetl.pipeline.maps.work_zones import export_zones, read_zones
from conetl.readers.plans.datex2 import read_datex2
from conetl.web import zones
from tests.integration.drives_of_days import merge, survey

FEED = ("--publisher", "City", "--road-name", "L 605")


def feed_of(conetl, path, *options, kind="wzdx"):
    conetl("map", "export", "--format", kind, "--out", path, *FEED, *options)
    document = json.loads(path.read_text())
    assert schema_faults(document, "WorkZoneFeed" if kind == "wzdx" else "DeviceFeed") == []
    if kind == "wzdx":  # the documentation is made from SOURCES
        for event in document["features"]:
            named = {*event, *event["properties"], *event["properties"]["core_details"]}
            assert named - {"type", "properties", "core_details"} <= SOURCES.keys()
    return document


def test_a_work_zone_that_is_gone_on_the_third_day_ends(conn, samples, conetl, own_view, tmp_path, monkeypatch):
    cones = [samples.feature(str(k), xyz_m=(458_000.0 + 6.0 * k, 5_428_010.0, 114.5 - 0.1 * k)) for k in range(5)]
    samples.commit(conn, *[samples.added(cone) for cone in cones], key="1")
    day = samples.DAY_NS
    samples.commit(conn, samples.removed(cones[4], samples.START_NS + day), key="2", start_ns=samples.START_NS + day)
    third = samples.START_NS + 2 * day
    samples.commit(conn, *[samples.removed(cone, third) for cone in cones[:4]], key="3", start_ns=third)

    path = tmp_path / "feed.geojson"
    times = ("2026-03-01T20:00", "2026-03-02T20:00", "2026-03-03T20:00")
    first, second, last = (feed_of(conetl, path, "--as-of", time)["features"] for time in times)
    assert [len(features) for features in (first, second, last)] == [1, 1, 1]
    assert first[0]["id"] == second[0]["id"] == last[0]["id"]
    line = first[0]["geometry"]["coordinates"]
    lowest, highest = ([pick(axis) for axis in zip(*line, strict=True)] for pick in (min, max))
    assert first[0]["bbox"] == [*lowest, *highest], "heights too, as the coordinates have them (RFC 7946, 5)"
    assert (lowest[2], highest[2]) == (114.1, 114.5)
    status = [features[0]["properties"] for features in (first, second, last)]
    assert [s["event_status"] for s in status] == ["active", "active", "completed"]
    assert [s["is_end_date_verified"] for s in status] == [False, False, True]
    assert {s["start_date"] for s in status} == {"2026-03-01T08:00:00Z"}
    assert [s["end_date"] for s in status] == ["2026-03-02T20:00:00Z", "2026-03-03T20:00:00Z", "2026-03-03T08:00:00Z"]
    assert [len(features[0]["conetl"]["device_ids"]) for features in (first, second, last)] == [5, 4, 4]
    # Nobody drove along it: the map does not claim to know the direction, nor which end is the start.
    assert status[0]["core_details"]["direction"] == "unknown"
    assert not status[0]["is_start_position_verified"]
    assert feed_of(conetl, path, "--as-of", "2026-03-30")["features"] == []
    assert feed_of(conetl, path, "--as-of", times[2], kind="wzdx-devices")["features"] == []
    devices = feed_of(conetl, path, "--as-of", times[1], kind="wzdx-devices")["features"]
    areas = [own_view.get("/api/maps/default/work-zones", params={"valid_at": f"{time}:00Z"}).json() for time in times]
    assert [[zone["zone_id"] for zone in area["zones"]] for area in areas] == [[first[0]["id"]], [first[0]["id"]], []]
    assert [zone["cone_count"] for area in areas for zone in area["zones"]] == [5, 4]
    monkeypatch.setattr(zones, "MOST_FEATURES", 3)
    large = own_view.get("/api/maps/default/work-zones", params={"valid_at": f"{times[0]}:00Z"}).json()
    assert (large["zones"], large["truncated"]) == ([], True)
    marks = sorted(mark["type"] for d in devices for mark in d["properties"]["marked_locations"])
    assert marks == ["delineator", "delineator", "work-zone-end", "work-zone-start"]
    assert "nothing" not in conetl("map", "check-layout", "--as-of", times[2])


def test_zones_of_one_state_are_computed_once_and_who_waits_has_no_connection(conn, samples, own_view, monkeypatch):
    path, computed, going = "/api/maps/default/work-zones", [], threading.Event()

    def slow(*args, **options):
        computed.append(options["as_of"])
        assert going.wait(60)
        return read_zones(*args, **options)

    def cone_counts(answer):
        return [zone["cone_count"] for zone in answer.json()["zones"]]

    monkeypatch.setattr(zones, "read_zones", slow)
    monkeypatch.setattr(reader_pool, "WAIT_S", 0.5)
    cones = [samples.feature(str(k), xyz_m=(458_000.0 + 6.0 * k, 5_428_010.0, 114.5)) for k in range(6)]
    samples.commit(conn, *[samples.added(cone) for cone in cones[:5]], key="1")
    with ThreadPoolExecutor(2 * reader_pool.MAX_CONNECTIONS) as pool:
        waiting = [pool.submit(own_view.get, path) for _ in range(2 * reader_pool.MAX_CONNECTIONS)]
        wait(waiting, timeout=1.5)  # longer than a request waits for a connection
        meanwhile = own_view.get("/api/maps/default/summary").status_code, any(one.done() for one in waiting)
        going.set()
        assert meanwhile == (200, False)
        assert [cone_counts(one.result()) for one in waiting] == [[5]] * len(waiting)
    assert cone_counts(own_view.get(path)) == [5] and computed == [None]
    samples.commit(conn, samples.added(cones[5]), key="2", start_ns=samples.START_NS + samples.DAY_NS)
    assert cone_counts(own_view.get(path)) == [6] == cone_counts(own_view.get(path)) and computed == [None, None]


def test_a_feed_says_when_it_was_surveyed_and_does_not_outlive_it(conn, samples, conetl, tmp_path):
    """The clock is an argument: nobody has driven there since the first of March."""
    cones = [
        samples.feature(name=f"cone {k}", **samples.standing_at((458_000.0 + 6 * k, 5_428_000.0, 114.5)))
        for k in range(5)
    ]
    samples.commit(conn, *[samples.added(cone) for cone in cones], key="1")
    conn.rollback()
    seen = utc_from_ns(max(cone.last_seen_ns for cone in cones))

    def event(age, kind=False, **options):
        path = tmp_path / "feed.geojson"
        export_zones(
            conn, path, "wzdx-devices" if kind else "wzdx", map_name="default", as_of=None, feed=None, publisher="Road office",
            road_names=["L 605"], lanes=None, now=seen + age, **options,
        )  # fmt: skip
        conn.rollback()
        feed = json.loads(path.read_text())
        [source] = feed["feed_info"]["data_sources"]
        assert source["update_date"] == wzdx_time(seen) and feed["feed_info"]["update_date"] == wzdx_time(seen + age)
        return feed["features"][0]

    fresh, last_day, stale = (event(timedelta(days=days)) for days in (0.5, 6.5, 7.5))
    assert [e["properties"].get("event_status") for e in (fresh, last_day, stale)] == ["active", "active", None]
    assert [e["conetl"]["stale"] for e in (fresh, last_day, stale)] == [False, False, True]
    assert {e["conetl"]["last_surveyed_at"] for e in (fresh, last_day, stale)} == {wzdx_time(seen)}
    # Its assumed end, status and impact changed: a consumer that skips events of a known date would keep the old ones.
    dates = [e["properties"]["core_details"]["update_date"] for e in (fresh, last_day, stale)]
    assert dates == [wzdx_time(seen + timedelta(days=days)) for days in (0.5, 6.5, 7.5)]
    # An end is assumed a day later, but never beyond what the survey is believed for.
    assert fresh["properties"]["end_date"] == wzdx_time(seen + timedelta(days=1.5))
    assert last_day["properties"]["end_date"] == stale["properties"]["end_date"] == wzdx_time(seen + timedelta(days=7))
    properties = stale["properties"]
    assert properties["vehicle_impact"] == "unknown" and not properties["is_end_date_verified"]
    assert not properties["is_start_position_verified"] and not properties["is_end_position_verified"]
    said = properties["core_details"]["description"]
    assert wzdx_time(seen) in said and "more than 7 days ago" in said and "not known" in said
    assert event(timedelta(days=30), max_age=timedelta(days=60))["properties"]["event_status"] == "active"
    assert "event_status" not in event(timedelta(hours=7), max_age=timedelta(hours=6))["properties"]
    marker = event(timedelta(days=30), kind=True)
    assert f"last seen at {wzdx_time(seen)}" in marker["properties"]["core_details"]["description"]
    # From the command line: it is November 2026 or later.
    path = tmp_path / "now.geojson"
    assert "event_status" not in feed_of(conetl, path)["features"][0]["properties"]
    assert feed_of(conetl, path, "--max-age", "9999d")["features"][0]["properties"]["event_status"] == "active"
    publication = tmp_path / "now.xml"
    conetl("map", "export", "--format", "datex2", "--out", publication, *FEED, "--country", "de")
    [plan] = read_datex2(publication).zones
    assert (plan.group_id, plan.ends_at) == (stale["id"], seen.replace(microsecond=0) + timedelta(days=7))
    assert "'soon' is not an age" in conetl(
        "map", "export", "--format", "wzdx", "--out", path, *FEED, "--max-age", "soon", code=2
    )


def wzdx_time(instant):
    return instant.replace(microsecond=0).isoformat().replace("+00:00", "Z")


def test_the_layout_check_writes_table_layer_and_image(conn, conetl, tmp_path):
    for day in (0, 1):
        merge(conn, survey(day))
    layer, image = tmp_path / "layout.geojson", tmp_path / "new" / "layout.png"
    table = conetl("map", "check-layout", "--speed-kmh", 50, "--out", layer, "--picture", image)
    assert "at most 9.5 m between cones in tapers, 18.9 m in tangents" in table
    found = json.loads(conetl("map", "check-layout", "--json"))
    # From the first cone: the road goes east.
    east_m = {str(feature.feature_id): feature.xyz_m[0] for feature in read_current_features(conn)}
    conn.rollback()
    first_m = east_m[found["work_zones"][0]["first"]]
    middles_m = [np.mean([east_m[one] for one in f["feature_ids"]]) - first_m for f in found["findings"]]
    rows = re.findall(r"^\d+ .*? (-?\d+\.\d\d)(?: +\d+\.\d\d){3}  ", table, re.MULTILINE)
    assert [*map(float, rows)] == pytest.approx(middles_m, abs=0.1) and rows
    features = json.loads(layer.read_text())["features"]
    assert [f["properties"]["rule"] for f in features] == [f["rule"] for f in found["findings"]]
    assert image.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    # Stricter rules of one's own, named in a file.
    rules = tmp_path / "rules.yaml"
    rules.write_text("layout: {taper_spacing_ft_per_mph: 0.2, tangent_spacing_ft_per_mph: 0.2}\n")
    strict = json.loads(conetl("map", "check-layout", "--rules", rules, "--json"))["findings"]
    assert not [f for f in strict if f["level"] == "violation"], "rules of one's own are no standard"
    cited = 'sources: {taper_spacing_ft_per_mph: "Plan B, 3", tangent_spacing_ft_per_mph: "Plan B, 4"}'
    rules.write_text(f"layout: {{taper_spacing_ft_per_mph: 0.2, tangent_spacing_ft_per_mph: 0.2, {cited}}}\n")
    named = json.loads(conetl("map", "check-layout", "--rules", rules, "--json"))["findings"]
    assert {f["norm"] for f in named if f["level"] == "violation"} <= {"Plan B, 3", "Plan B, 4"}
    german = conetl("map", "check-layout", "--standard", "rsa_21")
    assert (
        "RSA 21, 50 km/h: no rule of spacing" in german
        and "Not checked: distances" in german
        and "violation" not in german
    )
    assert "mutcd_2023, rsa_21" in conetl("map", "check-layout", "--standard", "din", code=2)
    assert sum(f["rule"] != "cone in open lane" for f in strict) > sum(
        f["rule"] != "cone in open lane" for f in found["findings"]
    )


def test_lane_lines_come_from_a_file_else_base_layers_else_lane_markings(conn, conetl, samples, tmp_path):
    for day in (0, 1):
        merge(conn, survey(day))
    without = json.loads(conetl("map", "check-layout", "--json"))
    assert without["lane_lines_from"] is None
    assert {zone["road_axis_from"] for zone in without["work_zones"]} == {"drives"}
    places = execute(conn, "select ST_X(geom) as x, ST_Y(geom) as y from conetl.frame_pair order by frame_index")
    conn.rollback()
    first, last = np.array([[places[k]["x"], places[k]["y"]] for k in (0, -1)])
    beyond = 100.0 * (last - first) / np.linalg.norm(last - first)
    driven = shapely.LineString([first - beyond, last + beyond])
    sides = [shapely.offset_curve(driven, away) for away in (-5.25, -1.75, 1.75)]
    stretches = [
        samples.marking([(x, y, 115.0) for x, y in shapely.ops.substring(side, start, start + 10.0).coords])
        for side in sides
        for start in np.arange(0.0, side.length - 1.0, 10.0)
    ]
    painted = [samples.added(samples.line_feature(stretch, f"line {k}")) for k, stretch in enumerate(stretches)]
    samples.commit(conn, *painted, key="1", markings=[samples.marking_track(stretches[0])])
    by_marking = json.loads(conetl("map", "check-layout", "--json"))
    assert by_marking["lane_lines_from"] == "lane markings of the map"
    far = shapely.affinity.translate(sides[0], 3000.0)
    files = []
    for name, lines in (("lanes", [*sides, far]), ("elsewhere", [far])):
        files.append(tmp_path / f"{name}.gpkg")
        geopandas.GeoDataFrame(geometry=lines, crs=32632).to_file(files[-1])
    conetl("base", "import", files[0])
    by_layer = json.loads(conetl("map", "check-layout", "--json"))
    assert by_layer["lane_lines_from"] == "base layers lanes"
    assert by_layer | {"lane_lines_from": None} == by_marking | {"lane_lines_from": None}
    assert "lanes" in {zone["road_axis_from"] for zone in by_layer["work_zones"]}
    by_file = json.loads(conetl("map", "check-layout", "--json", "--lanes", files[0]))
    assert by_file | {"lane_lines_from": None} == by_layer | {"lane_lines_from": None}
    assert "none of its lines is beside a work zone" in conetl("map", "check-layout", "--lanes", files[1], code=2)
    at = ("--as-of", "2026-11-01")  # the end of a zone that stands is so many hours from then
    feeds = [feed_of(conetl, tmp_path / "feed.geojson", *at, *lanes) for lanes in ((), ("--lanes", files[0]))]
    assert feeds[0]["features"] == feeds[1]["features"] != []
