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


def test_closed_lanes_are_counted_from_the_left(tmp_path: Path) -> None:
    states = {4: "open", 3: "closed", 2: "open", 1: "closed"}
    lanes = [{"order": order, "type": "general", "status": status} for order, status in states.items()]
    path = tmp_path / "feed.geojson"
    path.write_text(json.dumps(feed(event(lanes=lanes))))
    assert read_plans(path).zones[0].lanes == ("left lane", "lane 3 from the left")


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


def test_a_column_of_positions_may_be_there_twice(tmp_path: Path) -> None:
    """GDAL 3.12 died where it was to drop both."""
    path = tmp_path / "permits.csv"
    path.write_text("id,start,lon,lon,lat\nA,2026-03-01T00:00Z,8.43,8.5,49\n")
    assert read_plans(path).zones[0].parts in [(((lon, 49.0),),) for lon in (8.43, 8.5)]


def test_a_coordinate_of_a_thousand_digits_costs_its_permit(tmp_path: Path) -> None:
    far = {"type": "Point", "coordinates": [10**1000, 49]}
    found = read_plans(permits_file(tmp_path / "permits.geojson", permit(far), permit(permit_id="B")))
    assert [zone.plan_id for zone in found.zones] == ["B"] and [one.record for one in found.unused] == ["feature 1"]


def test_parts_of_collections_and_outlines_of_areas(tmp_path: Path) -> None:
    """All geometries are cut into parts at once, so each must get its own."""
    area, inner = "(8 49, 8.1 49, 8.1 49.1, 8 49)", "(8.02 49.01, 8.03 49.01, 8.03 49.02, 8.02 49.01)"
    shapes = {
        f"POLYGON ({area}, {inner})": [4],
        "": None,
        f"GEOMETRYCOLLECTION (POINT (8 49), GEOMETRYCOLLECTION (MULTIPOINT ((8 49), (8 48)), MULTIPOLYGON (({area}))))": [
            1,
            1,
            1,
            4,
        ],
        "POINT (8": None,
        "MULTILINESTRING ((8 49, 8.2 49), (8 48, 8 47, 8 46))": [2, 3],
    }
    path = tmp_path / "permits.csv"
    path.write_text("id;start;wkt\n" + "".join(f"P{k};2026-03-01T00:00Z;{shape}\n" for k, shape in enumerate(shapes)))
    found = read_plans(path)
    assert [[len(part) for part in zone.parts] for zone in found.zones] == [
        counts for counts in shapes.values() if counts
    ]
    assert [one.record for one in found.unused] == ["row 2", "row 4"]


def test_a_table_of_permits_has_a_limit_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "permits.csv"
    with path.open("wb") as file:
        file.truncate(2 << 30)
    with pytest.raises(InputError, match="2,147,483,648 bytes, expected at most 5,000,000"):
        read_plans(path)


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


OLD = """<?xml version="1.0" encoding="utf-8"?>
<ha_planned_roadworks>
{records}
</ha_planned_roadworks>"""
NEW = """<?xml version="1.0" encoding="utf-8"?>
<Report xmlns="WebTeam" Name="HE_PLANNED_ROADWORKS"><HE_PLANNED_ROADWORKS><HE_PLANNED_WORKS_Collection>
{records}
</HE_PLANNED_WORKS_Collection></HE_PLANNED_ROADWORKS></Report>"""


def old_works(number: object = 1535041, **changes: str) -> str:
    """As published until 2017."""
    fields = {
        "reference_number": str(number), "road": "M1", "location": "Jct 24 to Jct 27",
        "start_date": "2016-03-21T20:00:00", "end_date": "2016-03-31T06:00:00", "expected_delay": "Slight (less than 10 mins)",
        "description": "Lane closures north and\nsouthbound.", "traffic_management": "Lane Closure",
        "closure_type": "Planned Works",
        "centre_easting": "448783", "centre_northing": "339999", "status": "Firm", "published_date": "2016-02-29T09:00:00",
    } | changes  # fmt: skip
    inside = "".join(f"<{name}>{value}</{name}>" for name, value in fields.items() if value)
    return f"<ha_planned_works>{inside}</ha_planned_works>"


def new_works(
    number: object = "00012345-001", start: str = "21-SEP-2026 21:00", place: str = "448783", roads: str = "A417 M5"
) -> str:
    """As published since 2018."""
    listed = "".join(f'<ROAD ROAD_NUMBER="{road}"/>' for road in ("A417", "M5"))
    east_north = f'<EASTNORTH CENTRE_EASTING="{place}" CENTRE_NORTHING="339999"/>' if place else ""
    return (
        f'<HE_PLANNED_WORKS NEW_EVENT_NUMBER="{number}" SDATE="{start}" EDATE="22-SEP-2026 06:00" EXPDEL="Slight" '
        'DESCRIPTION="Carriageway closure&#xD;&#xA;with diversion" CLOSURE_TYPE="Planned Works" STATUS="Published">'
        f"<EASTNORTH><Report><EASTINGNORTHING><EASTNORTH_Collection>{east_north}</EASTNORTH_Collection></EASTINGNORTHING></Report>"
        f"</EASTNORTH><ROADS><Report><ROADS><ROAD_Collection>{listed}</ROAD_Collection></ROADS></Report></ROADS></HE_PLANNED_WORKS>"
    )


def works_file(path: Path, form: str, *records: str) -> Path:
    path.write_text(form.format(records="\n".join(records)), encoding="utf-8")
    return path


def test_planned_works_of_national_highways_are_rough_places_at_times_of_london(tmp_path: Path) -> None:
    [old] = read_plans(works_file(tmp_path / "old.xml", OLD, old_works())).zones
    assert (old.plan_id, old.kind, old.status, old.road_names) == ("1535041", "Planned Works", "Firm", ("M1",))
    assert old.starts_at == datetime(2016, 3, 21, 20, tzinfo=UTC) and old.ends_at == datetime(
        2016, 3, 31, 5, tzinfo=UTC
    )
    assert old.description == "Jct 24 to Jct 27. Lane Closure. Lane closures north and southbound"
    assert old.approximate and old.version == "2016-02-29T09:00:00+00:00"
    [[(lon, lat)]] = old.parts
    assert (round(lon, 2), round(lat, 2)) == (-1.28, 52.96), "near junction 25 of the M1"
    [new] = read_plans(works_file(tmp_path / "new.xml", NEW, new_works())).zones
    assert (new.plan_id, new.road_names, new.status) == ("00012345-001", ("A417", "M5"), "Published")
    assert (new.starts_at, new.ends_at) == (datetime(2026, 9, 21, 20, tzinfo=UTC), datetime(2026, 9, 22, 5, tzinfo=UTC))
    assert new.parts == old.parts and new.approximate and new.description == "Carriageway closure with diversion"


def test_a_broken_record_of_planned_works_costs_only_itself(tmp_path: Path) -> None:
    broken = [
        old_works(2, start_date="soon"), old_works(3, centre_easting=""), old_works(4, centre_northing="north"),
        old_works(5, end_date="2016-01-01T00:00:00"), old_works(""),
        old_works(1, published_date="2016-01-01T00:00:00"),
    ]  # fmt: skip
    found = read_plans(works_file(tmp_path / "works.xml", OLD, old_works(1), *broken, old_works(9)))
    assert [zone.plan_id for zone in found.zones] == ["1", "9"]
    assert found.zones[0].version == "2016-02-29T09:00:00+00:00", "the newest"
    assert [(one.record, one.is_broken) for one in found.unused] == [
        ("works 2", True), ("works 3", True), ("works 4", True), ("works 5", True), ("works 6", True), ("works 7 (1)", False),
    ]  # fmt: skip
    reasons = [one.reason for one in found.unused]
    assert (
        "expected a time like" in reasons[0]
        and "no centre_easting" in reasons[1]
        and "British National Grid" in reasons[2]
    )
    news = read_plans(
        works_file(tmp_path / "new.xml", NEW, new_works("A"), new_works("B", place=""), new_works("C", start=""))
    )
    assert [zone.plan_id for zone in news.zones] == ["A"] and len(news.unused) == 2
    with pytest.raises(InputError, match="holds no planned works"):
        read_plans(works_file(tmp_path / "none.xml", OLD))
    with pytest.raises(InputError, match="is not XML"):
        read_plans(works_file(tmp_path / "cut.xml", OLD.replace("</ha_planned_roadworks>", ""), old_works()))
    with pytest.raises(InputError, match="expected DATEX II"):
        read_plans(works_file(tmp_path / "other.xml", "<other>{records}</other>"))
