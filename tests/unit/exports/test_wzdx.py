"""Schemas, the feed's description, and lane lines out of files."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from conetl.exports import wzdx
from conetl.exports.wzdx import export_device_feed, export_work_zone_feed, schema_faults
from conetl.exports.zone_feed import FeedContext, direction_of, read_feed_info, state_of, zones_to_publish
from conetl.model.base import ns_from_utc
from conetl.model.errors import InputError
from conetl.readers.base_layers.line_files import read_lane_lines
from tests.folders import SHARED
from tests.unit.exports.test_datex2 import INFO, PARAMS, SEEN, SRID, zones

REFERENCE = SHARED.parent / "reference" / "wzdx"
SHIPPED = Path(wzdx.__file__).with_name("wzdx_schemas")
needs_reference = pytest.mark.skipif(not REFERENCE.is_dir(), reason=f"no WZDx schemas and examples in {REFERENCE}")


@needs_reference
def test_the_shipped_schemas_are_the_published_ones():
    published = sorted((REFERENCE / "schemas" / "4.2").glob("*.json"))
    assert len(published) == 6
    for path in published:
        assert (SHIPPED / "4.2" / path.name).read_bytes() == path.read_bytes()


@needs_reference
@pytest.mark.parametrize("feed", ["WorkZoneFeed", "DeviceFeed"])
def test_the_published_examples_are_valid_and_broken_ones_are_not(feed):
    examples = sorted((REFERENCE / "examples" / feed).glob("*.geojson"))
    assert examples
    for path in examples:
        document = json.loads(path.read_text())
        assert schema_faults(document, feed) == []
        del document["features"][0]["properties"]["core_details"]["data_source_id"]
        assert schema_faults(document, feed) != []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["feed_info"].pop("publisher"), "publisher"),
        (lambda d: d["feed_info"].update(update_date="2026-03-02 10:00"), "date-time"),
        (lambda d: d["feed_info"].update(contact_email="nobody"), "email"),
        (lambda d: d["features"][0]["geometry"].update(coordinates=[[8.4, 49.0]]), "geometry"),
        (lambda d: d["features"][0]["properties"].update(vehicle_impact="closed"), "features/0"),
        (lambda d: d["features"][0]["properties"].pop("end_date"), "features/0"),
    ],
)
def test_faults_are_found(change, words):
    document = {
        "feed_info": {
            "publisher": "p",
            "update_date": "2026-03-02T10:00:00Z",
            "version": "4.2",
            "data_sources": [{"data_source_id": "1", "organization_name": "o"}],
        },
        "type": "FeatureCollection",
        "features": [
            {
                "id": "1",
                "type": "Feature",
                "properties": {
                    "core_details": {
                        "event_type": "work-zone",
                        "data_source_id": "1",
                        "road_names": ["L 605"],
                        "direction": "unknown",
                    },
                    "start_date": "2026-03-02T10:00:00Z",
                    "end_date": "2026-03-03T10:00:00+01:00",
                    "is_start_date_verified": True,
                    "is_end_date_verified": False,
                    "is_start_position_verified": True,
                    "is_end_position_verified": False,
                    "vehicle_impact": "unknown",
                    "location_method": "channel-device-method",
                },
                "geometry": {"type": "LineString", "coordinates": [[8.4, 49.0], [8.5, 49.0]]},
            }
        ],
    }
    assert schema_faults(document, "WorkZoneFeed") == []
    change(document)
    assert words in " ".join(schema_faults(document, "WorkZoneFeed"))


def test_the_description_asks_for_what_is_missing_and_names_what_is_wrong(tmp_path):
    with pytest.raises(InputError, match=r"publisher and road_names.*--publisher and --road-name"):
        read_feed_info(None)
    path = tmp_path / "feed.yaml"
    path.write_text("publisher: City\nroad_names: [L 605]\nlicense: cc0\nupdate_frequency_s: 3600\n")
    info = read_feed_info(path, publisher="", road_names=["B 10"])
    assert (info.publisher, info.road_names, info.license, info.update_frequency_s) == ("City", ("B 10",), "cc0", 3600)
    for line, words in [
        ("contact_email: nobody", "contact_email"),
        ("direction: up", "northbound"),
        ("colour: red", "colour"),
        ("license: MIT", "license"),
    ]:
        path.write_text(f"publisher: City\nroad_names: [L 605]\n{line}\n")
        with pytest.raises(InputError, match=words):
            read_feed_info(path)
    for text in ("[1", "a list", ""):
        path.write_text(text)
        with pytest.raises(InputError, match=r"feed\.yaml"):
            read_feed_info(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_feed_info(tmp_path / "none.yaml")


def geojson(tmp_path: Path, *geometries) -> Path:
    path = tmp_path / "lanes.geojson"
    features = [{"type": "Feature", "properties": {"type": "line_thin"}, "geometry": g} for g in geometries]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def test_lane_lines_of_geojson_come_in_the_maps_crs(tmp_path):
    line = {"type": "LineString", "coordinates": [[8.4, 49.0], [8.401, 49.0]]}
    two = {"type": "MultiLineString", "coordinates": [line["coordinates"], [[8.4, 49.1], [8.4, 49.2]]]}
    point = {"type": "Point", "coordinates": [8.4, 49.0]}
    lines = read_lane_lines(geojson(tmp_path, line, two, point), srid=32632)
    assert [(found.kind, found.xy_m.shape) for found in lines] == [("line_thin", (2, 2))] * 3
    expected = Transformer.from_crs(4326, 32632, always_xy=True).transform(8.401, 49.0)
    assert np.allclose(lines[0].xy_m[1], expected, atol=1e-6)


def test_files_without_lines_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_lane_lines(tmp_path / "none.gpkg", srid=32632)
    with pytest.raises(InputError, match="there is no line"):
        read_lane_lines(geojson(tmp_path, {"type": "Point", "coordinates": [8.4, 49.0]}), srid=32632)
    other = tmp_path / "lanes.gpkg"
    other.write_text("nothing of the kind")
    with pytest.raises(InputError, match="GDAL can read"):
        read_lane_lines(other, srid=32632)


AT = SEEN + timedelta(days=1)
CONTEXT = FeedContext(INFO, "default", SRID, at=AT, made_at=AT, params=PARAMS)


@pytest.mark.parametrize("vague", ["first", "last"])
def test_each_end_is_verified_by_its_own_device(tmp_path, vague):
    zone = next(one for one in zones() if one.layout.direction_known)
    doubtful = getattr(zone, vague).model_copy(update={"cov_m2": (4.0, 0.0, 0.0, 4.0, 0.0, 0.01)})
    export_work_zone_feed([replace(zone, **{vague: doubtful})], (), tmp_path / "feed.geojson", CONTEXT)
    [event] = json.loads((tmp_path / "feed.geojson").read_text())["features"]
    ends = [event["properties"][f"is_{end}_position_verified"] for end in ("start", "end")]
    assert ends == [vague == "last", vague == "first"]


@pytest.mark.parametrize(
    ("bearings_deg", "direction"),
    [((320, 40), "northbound"), ((50, 130), "eastbound"), ((140, 220), "southbound"), ((230, 310), "westbound")],
)
def test_the_direction_is_the_quarter_from_the_first_to_the_last_device(bearings_deg, direction):
    zone = next(one for one in zones() if one.layout.direction_known)
    x, y, z = zone.first.xyz_m
    for bearing in np.radians(bearings_deg):
        last = zone.last.model_copy(update={"xyz_m": (x + 200 * np.sin(bearing), y + 200 * np.cos(bearing), z)})
        assert direction_of(replace(zone, last=last), CONTEXT) == direction


def test_devices_and_their_zone_were_surveyed_when_they_were_last_seen(tmp_path):
    """By different drives: each device has its own time, the zone the latest of them."""
    zone, hour_ns = zones()[0], 3_600_000_000_000
    cones = [
        cone.model_copy(update={"last_seen_ns": (number + 1) * hour_ns})
        for number, cone in enumerate(zone.layout.cones)
    ]
    export_device_feed([], cones, tmp_path / "feed.geojson", CONTEXT)
    devices = json.loads((tmp_path / "feed.geojson").read_text())["features"]
    told = {one["id"]: one["properties"]["core_details"]["update_date"] for one in devices}
    seen = {str(cone.feature_id): SEEN + timedelta(hours=number + 1) for number, cone in enumerate(cones)}
    assert told == {name: at.strftime("%Y-%m-%dT%H:%M:%SZ") for name, at in seen.items()}
    again = replace(zone, layout=replace(zone.layout, cones=tuple(cones[::-1])))
    assert state_of(again, CONTEXT).surveyed == SEEN + timedelta(hours=len(cones))


@pytest.mark.parametrize(("days", "shown"), [(7.5, True), (13.99, True), (14.01, False)])
def test_an_ended_zone_is_published_for_14_days(days, shown):
    zone = zones()[0]
    gone = replace(zone, history=replace(zone.history, end_ns=ns_from_utc(AT - timedelta(days=days))))
    assert zones_to_publish([gone], CONTEXT)[0] == ([gone] if shown else [])
