"""Files of planned work zones: what is read, and that a broken record is named and costs only itself."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pyogrio.raw
import pytest
import shapely

from conetl.exports.wzdx import schema_faults
from conetl.model.errors import InputError
from conetl.readers.plans import read_plans

LINE = {"type": "LineString", "coordinates": [[8.43, 49.0], [8.431, 49.0]]}
TIMES = {"start": "2026-03-01T22:00:00+01:00", "end": "2026-03-05T05:00:00Z"}


def permits_file(path: Path, *features: object) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def permit(geometry: object = LINE, **properties: object) -> dict[str, object]:
    return {"type": "Feature", "geometry": geometry, "properties": {"permit_id": "A", **TIMES, **properties}}


def event(number: int = 1, geometry: object = LINE, **changes: object) -> dict[str, object]:
    core = {
        "event_type": "work-zone", "data_source_id": "s", "road_names": ["I 80"], "direction": "eastbound",
        "update_date": "2026-02-01T00:00:00Z",
        **{key: changes.pop(key) for key in ("event_type", "update_date") if key in changes},
    }  # fmt: skip
    lanes = [{"order": 1, "type": "general", "status": "open"}, {"order": 2, "type": "general", "status": "closed"}]
    lanes += [{"order": 3, "type": "shoulder", "status": "closed"}]
    properties = {
        "core_details": core, "start_date": "2026-03-01T22:00:00Z", "end_date": "2026-03-05T05:00:00Z",
        "is_start_date_verified": True, "is_end_date_verified": False, "is_start_position_verified": True,
        "is_end_position_verified": True, "vehicle_impact": "some-lanes-closed", "location_method": "other", "lanes": lanes,
    }  # fmt: skip
    return {"id": f"e{number}", "type": "Feature", "geometry": geometry, "properties": properties | changes}


def feed(*events: object) -> dict[str, object]:
    source = {"data_source_id": "s", "organization_name": "State roads"}
    info = {"publisher": "State", "version": "4.2", "update_date": "2026-03-01T00:00:00Z", "data_sources": [source]}
    return {"feed_info": info, "type": "FeatureCollection", "features": list(events)}


def test_a_wzdx_feed_is_read_event_by_event(tmp_path: Path) -> None:
    points = {"type": "MultiPoint", "coordinates": LINE["coordinates"]}
    events = [event(1), event(2, points, vehicle_impact="all-lanes-closed"), event(3, event_type="detour")]
    assert schema_faults(feed(*events[:2]), "WorkZoneFeed") == []
    broken = [
        event(4, start_date="soon"),
        event(5, end_date="2026-01-01T00:00:00Z"),
        {"id": "e6"},
        event(7, {"type": "Point", "coordinates": [8]}),
        "x",
    ]
    newer = event(1, update_date="2026-02-02T00:00:00Z", event_status="cancelled")
    path = tmp_path / "feed.geojson"
    path.write_text(json.dumps(feed(*events, *broken, newer, event(1))))
    found = read_plans(path)
    assert [zone.plan_id for zone in found.zones] == ["e2", "e1"]
    rough, first = found.zones
    assert rough.approximate and rough.lanes == ("all lanes",) and len(rough.parts) == 1
    assert (first.lanes, first.closed_lane_count, first.source, first.is_void) == (
        ("right lane",),
        1,
        "State roads",
        True,
    )
    assert first.starts_at == datetime(2026, 3, 1, 22, tzinfo=UTC) and first.road_names == ("I 80",)
    assert [(one.record, one.is_broken) for one in found.unused] == [
        ("feature 3", False), ("feature 4", True), ("feature 5", True), ("feature 6", True), ("feature 7", True),
        ("feature 8", True),
        ("feature 9 (e1)", False), ("feature 10 (e1)", False),
    ]  # fmt: skip
    assert found.unused[0].reason == "its event_type is 'detour', not work-zone"
    assert "start" in found.unused[1].reason and "2026-03-02T10:00:00Z" in found.unused[1].reason
    assert found.unused[3].reason == "'properties' is missing"


def test_permits_are_the_same_in_three_formats(tmp_path: Path) -> None:
    rows = [{"Permit_ID": "A", **TIMES, "road": "L 605", "lanes": "right lane, hard shoulder", "lane_count": 1}]
    rows += [
        {"Permit_ID": "B", "start": "2026-03-01", "end": "2026-03-02", "road": "", "lanes": "", "lane_count": None}
    ]
    shapes = [shapely.LineString([[8.43, 49.0], [8.431, 49.0]]), shapely.box(8.4, 49.0, 8.401, 49.001)]
    files = [tmp_path / f"permits.{suffix}" for suffix in ("geojson", "csv", "gpkg")]
    features = [
        {"type": "Feature", "properties": row, "geometry": shapely.geometry.mapping(shape)}
        for row, shape in zip(rows, shapes, strict=True)
    ]
    permits_file(files[0], *features)
    names = list(rows[0])
    lines = [";".join([*names, "WKT"])]
    lines += [
        ";".join([*(str(row[name] or "") for name in names), shape.wkt])
        for row, shape in zip(rows, shapes, strict=True)
    ]
    files[1].write_text("\n".join(lines))
    import geopandas

    geopandas.GeoDataFrame(rows, geometry=shapes, crs=4326).to_crs(25832).to_file(files[2], layer="permits")
    found = [read_plans(path, time_zone="Europe/Berlin") for path in files]
    for file in found:
        assert file.unused == () and [zone.plan_id for zone in file.zones] == ["A", "B"]
        first, second = file.zones
        assert (first.lanes, first.road_names, first.closed_lane_count) == (
            ("right lane", "hard shoulder"),
            ("L 605",),
            1,
        )
        assert (first.starts_at, second.ends_at) == (
            datetime(2026, 3, 1, 21, tzinfo=UTC),
            datetime(2026, 3, 2, 23, tzinfo=UTC),
        )
        assert second.parts[0][0] == second.parts[0][-1] and len(second.parts[0]) == 5
        for zone, of_first in zip(file.zones, found[0].zones, strict=True):
            for part, other in zip(zone.parts, of_first.parts, strict=True):
                assert sum(part, ()) == pytest.approx(sum(other, ()), abs=1e-8)


def test_a_broken_permit_is_named_and_costs_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "permits.csv"
    path.write_text(
        "permit,from,until,lon,lat\n"
        "A,2026-03-01T00:00Z,2026-03-03T00:00Z,8.43,49\n"
        "B,soon,2026-03-03T00:00Z,8.43,49\n"
        "C,2026-03-01T00:00,2026-03-03T00:00Z,8.43,49\n"
        "D,2026-03-04T00:00Z,2026-03-03T00:00Z,8.43,49\n"
        "E,2026-03-01T00:00Z,2026-03-03T00:00Z,eight,49\n"
        ",2026-03-01T00:00Z,2026-03-03T00:00Z,8.43,49\n"
        "G,2026-03-01T00:00Z,2026-03-03T00:00Z,49,188.43\n"
        "H,2026-03-01T00:00Z,,8.43,49\n"
    )
    found = read_plans(path)
    assert [(zone.plan_id, zone.approximate) for zone in found.zones] == [("A", False), ("H", False)]
    wanted = {
        "row 2": "from: expected a time like", "row 3": "states no time zone, expected one, or --time-zone",
        "row 4": "before it starts",
        "row 5": "it has no geometry, or a broken one", "row 6": "it has no plan_id: expected a column",
        "row 7": "expected at most 90, found 188.43",
    }  # fmt: skip
    assert [one.record for one in found.unused] == list(wanted)
    assert all(words in one.reason and one.is_broken for one, words in zip(found.unused, wanted.values(), strict=True))


def test_columns_of_other_names_and_crs(tmp_path: Path) -> None:
    path = tmp_path / "permits.csv"
    path.write_text("Nr;Beginn;x;y\n7;2026-03-01T00:00Z;458000;5428000\n")
    named = {"plan_id": "Nr", "starts_at": "Beginn"}
    with pytest.raises(InputError, match="'EPSG:0' is not a coordinate reference system"):
        read_plans(path, crs="EPSG:0", columns=named)
    assert "state their CRS with --crs" in read_plans(path, columns=named).unused[0].reason
    [zone] = read_plans(path, crs="EPSG:25832", columns=named).zones
    assert zone.parts[0][0] == pytest.approx((8.4264, 49.0033), abs=1e-3)
    with pytest.raises(InputError, match=r"--column lane=\.\.\.: expected one of plan_id"):
        read_plans(path, crs="EPSG:25832", columns={"lane": "x"})
    with pytest.raises(InputError, match="--time-zone 'Mars': expected a name like Europe/Berlin"):
        read_plans(path, time_zone="Mars")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.txt", "", r"plans are read from \.xml"),
        ("a.geojson", "[]", "expected a GeoJSON FeatureCollection"),
        ("a.csv", "a,b\n1,2\n", "no column wkt, nor lon and lat"),
        ("a.csv", "", "GDAL|no column wkt"),
        ("a.gpkg", "none", "not a file that GDAL can read"),
        ("a.xml", "<a/>", "expected DATEX II"),
    ],
)
def test_a_file_without_plans_is_refused(name: str, text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_plans(tmp_path / name)


def test_a_row_without_geometry_of_a_geopackage(tmp_path: Path) -> None:
    shapes = shapely.to_wkb([shapely.Point(8.4, 49.0), None])
    path = tmp_path / "permits.gpkg"
    fields = [["A", "B"], ["2026-03-01T00:00Z"] * 2]
    import numpy as np

    pyogrio.raw.write(
        path, shapes, [np.array(one, object) for one in fields], ["id", "start"], geometry_type="Point", crs="EPSG:4326"
    )
    found = read_plans(path)
    assert [zone.plan_id for zone in found.zones] == ["A"] and "no geometry" in found.unused[0].reason
