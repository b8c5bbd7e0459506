"""Readers of base layers on good, broken and hostile files. No database."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path

import laspy
import lazrs  # type: ignore[import-untyped]
import numpy as np
import pytest
from pyproj import CRS

from conetl.model.errors import InputError
from conetl.readers.base_layers import georeferencing as geo
from conetl.readers.base_layers.georeferencing import axes_seem_swapped, layer_crs, parse_crs, to_map
from conetl.readers.base_layers.las_file import las_chunks, read_las_header
from conetl.readers.base_layers.line_files import read_vector_file
from conetl.readers.base_layers.lines import read_lanelet2
from conetl.readers.base_layers.opendrive import read_opendrive
from conetl.readers.base_layers.point_tiles import Cloud, read_cells, spill
from tests.folders import SHARED

CENTRE = (458_000.0, 5_428_000.0, 115.0)
GROUND = geo.MapGround(32632, np.array(CENTRE) + np.column_stack([np.arange(50.0), np.zeros(50), np.zeros(50)]))
LON, LAT = 8.4262, 49.0037


def write_las(path, count=5_000, crs=32632, *, classes=None):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, list(CENTRE)
    if crs:
        header.add_crs(CRS.from_epsg(crs))
    las = laspy.LasData(header)
    rng = np.random.default_rng(3)
    las.x, las.y, las.z = (CENTRE + rng.uniform(0, 40, (count, 3)) * [1.0, 1.0, 0.02]).T
    las.intensity = rng.integers(0, 400, count)
    if classes is not None:
        las.classification = classes
    las.write(path)
    return path


def read_all(path):
    count, _ = read_las_header(path)
    return np.concatenate([cloud.xyz_m for cloud in las_chunks(path, count)])


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_points_come_in_chunks_with_their_crs_and_without_noise(tmp_path, suffix, monkeypatch):
    monkeypatch.setattr("conetl.readers.base_layers.las_file.CHUNK_POINTS", 700)
    path = write_las(tmp_path / f"a.{suffix}", 2_000, classes=np.where(np.arange(2_000) % 10 == 0, 7, 2))
    count, crs = read_las_header(path)
    clouds = list(las_chunks(path, count))
    assert [len(c.xyz_m) for c in clouds] == [630, 630, 540]
    assert (count, crs.to_epsg()) == (2_000, 32632)
    shades = np.concatenate([c.shade for c in clouds])
    assert shades.min() < 10 and shades.max() == 255


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda b: b[: len(b) // 2],
        lambda b: b[:-100],
        lambda b: b[:100],
        lambda b: b"",
        lambda b: b"hello world" * 50,
        lambda b: b[:247] + struct.pack("<Q", 2**60) + b[255:],  # point count
        lambda b: b[:247] + struct.pack("<Q", 0) + b[255:],
        lambda b: b[:131] + struct.pack("<d", float("nan")) + b[139:],  # scale
        lambda b: b[:155] + struct.pack("<d", float("inf")) + b[163:],  # offset
        lambda b: b[:96] + struct.pack("<I", 2**31) + b[100:],  # where the points begin
        lambda b: b[:100] + struct.pack("<I", 2**31) + b[104:],  # number of records before them
        lambda b: b[:104] + bytes([99]) + b[105:],  # point format
    ],
)
def test_a_broken_las_file_is_refused_by_name(tmp_path, suffix, damage):
    path = write_las(tmp_path / f"a.{suffix}")
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InputError, match=rf"a\.{suffix}"):
        read_all(path)


def test_invalid_points_are_left_out_and_cells_keep_positions(tmp_path):
    rng = np.random.default_rng(5)
    xyz = np.array(CENTRE) + rng.uniform(-150, 150, (4_000, 3))
    xyz[::100, 1] = np.nan
    xyz[1::100, 0] = np.inf
    clouds = [Cloud(part, np.full(2_000, 9, np.uint8)) for part in (xyz[:2_000], xyz[2_000:])]
    spilled = spill(clouds, tmp_path, 0.01, "x")
    assert (spilled.kept, spilled.refused) == (3_920, 80)
    back = np.concatenate([c.xyz_m for _, _, c in read_cells(tmp_path, spilled.cells)])
    good = xyz[np.isfinite(xyz).all(axis=1)]
    order, wanted = (a[np.argsort(a[:, 2])] for a in (back, good))
    assert np.abs(order - wanted).max() < 1e-4
    with pytest.raises(InputError, match="none of its points"):
        spill([Cloud(np.full((3, 3), np.nan), np.zeros(3, np.uint8))], tmp_path, 0.1, "x")


# --------------------------------------------------------------------------- CRS


def test_feet_become_metres():
    """EPSG:2994 is Oregon in international feet; without a vertical CRS heights have the unit of the plane."""
    layer = layer_crs(parse_crs("2994"), 32610)
    xyz = to_map(layer, np.array([[636_000.0, 849_000.0, 410.0]]))
    assert layer.height_factor == 0.3048
    assert xyz[0, 2] == pytest.approx(124.968)
    back = layer_crs(parse_crs("EPSG:32610"), 32610)
    lon, lat = back.to_lonlat.transform(*xyz[0, :2])
    assert (lon, lat) == pytest.approx((-123.07, 44.05), abs=0.05)
    assert layer_crs(parse_crs("EPSG:26910+6360"), 32610).height_factor == pytest.approx(0.3048006)  # NAVD88 in US feet


def test_a_file_without_crs_is_refused_unless_it_is_stated():
    with pytest.raises(InputError, match=r"has no CRS.*--crs 32632"):
        geo.resolve_crs(Path("a.las"), None, None, GROUND)
    layer, warnings = geo.resolve_crs(Path("a.las"), None, "25832", GROUND)
    assert (layer.name, warnings) == ("ETRS89 / UTM zone 32N", [])
    _, warnings = geo.resolve_crs(Path("a.las"), CRS.from_epsg(4326), "25832", GROUND)
    assert "the file itself states WGS 84" in warnings[0]
    with pytest.raises(InputError, match="is not a coordinate reference system"):
        geo.resolve_crs(Path("a.las"), None, "moon", GROUND)
    _, warnings = geo.resolve_crs(Path("a.las"), parse_crs("EPSG:25832+7837"), None, GROUND)
    assert "--height-offset" in warnings[0]


def test_swapped_axes_are_found():
    wgs84 = layer_crs(parse_crs("4326"), 32632)
    right, wrong = np.array([[LON, LAT]]), np.array([[LAT, LON]])
    assert not axes_seem_swapped(wgs84, right, GROUND.lonlat())
    assert axes_seem_swapped(wgs84, wrong, GROUND.lonlat())
    assert axes_seem_swapped(wgs84, np.array([[30.0, 120.0]]), None)  # no such latitude
    assert not axes_seem_swapped(wgs84, np.array([[-122.0, 37.0]]), GROUND.lonlat())  # far away, but right
    utm = layer_crs(parse_crs("32632"), 32632)
    assert axes_seem_swapped(utm, np.array([[5_428_000.0, 458_000.0]]), GROUND.lonlat())
    with pytest.raises(InputError, match="longitude and latitude are swapped"):
        geo.check_coordinates(Path("a.geojson"), wgs84, wrong, GROUND)
    metres, feet = (layer_crs(parse_crs(srid), 32610) for srid in ("2993", "2994"))
    nowhere, oregon = geo.MapGround(32610, np.empty((0, 3))), np.array([[636_000.0, 849_000.0]])
    assert "area of use" in geo.check_coordinates(Path("a.las"), metres, oregon, nowhere)[0]  # feet for metres
    assert geo.check_coordinates(Path("a.las"), feet, oregon, nowhere) == []


def test_warnings_of_a_layer_far_away_or_at_other_heights():
    low, high = np.array(CENTRE[:2]), np.array(CENTRE[:2]) + 50
    assert geo.check_near("a", low, high, GROUND) == []
    assert "is 8,965 m" in geo.check_near("a", low + 9_000 / 2**0.5, high + 9_000, GROUND)[0]
    assert "is 200 m" in geo.check_near("a", low + np.array([0.0, 200.0]), high + 9_000, GROUND)[0]  # ED50
    road = GROUND.ground_m + np.array([0.0, 1.0, 0.02])
    assert geo.check_heights("a", road, GROUND) == []
    assert "1.2 m above" in geo.check_heights("a", road - [0.0, 0.0, -1.2], GROUND)[0]
    assert "--height-offset 47.6" in geo.check_heights("a", road - [0.0, 0.0, 47.62], GROUND)[0]


def test_the_road_is_as_far_below_the_poses_as_the_feet_of_cones():
    poses = np.column_stack([np.arange(20.0), np.zeros(20), np.full(20, 10.0)])
    feet = np.array([[3.0, 2.0, 9.1], [8.0, -2.0, 9.0], [12.0, 2.0, 9.05]])
    assert geo.ground_under(poses, feet)[:, 2] == pytest.approx([9.05] * 20)
    assert geo.drape(np.array([[5.0, 30.0]]), geo.MapGround(32632, geo.ground_under(poses, feet))) == pytest.approx(
        [9.05]
    )


# --------------------------------------------------------------------------- lines


def geojson(path, *features, crs=None):
    document = {"type": "FeatureCollection", "features": list(features)}
    if crs:
        document["crs"] = {"type": "name", "properties": {"name": crs}}
    path.write_text(json.dumps(document))
    return path


def line(*places, **properties):
    geometry = {"type": "LineString", "coordinates": list(places)}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def test_geojson_lines_with_kind_heights_and_refusals(tmp_path):
    path = geojson(
        tmp_path / "a.geojson",
        line([LON, LAT, 115.0], [LON, LAT + 1e-4, 115.5], kind="line_thin", width=0.12),
        line([LON, LAT], [LON, LAT + 1e-4]),
        line([LON, LAT], [LON, LAT], kind="no length"),
        {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [LON, LAT]}},
        {"type": "Feature", "properties": {}, "geometry": None},
        {"type": "Feature", "properties": {"type": "kerb"}, "geometry": {"type": "MultiLineString", "coordinates": [
            [[LON, LAT], [LON + 1e-4, LAT]], [[LON, LAT], [LON - 1e-4, LAT]]]}},
    )  # fmt: skip
    found = read_vector_file(path)
    assert [item.kind for item in found.lines] == ["line_thin", "line", "kerb", "kerb"]
    assert found.lines[0].xyz[:, 2].tolist() == [115.0, 115.5] and np.isnan(found.lines[1].xyz[:, 2]).all()
    assert found.lines[0].attributes["width"] == 0.12
    assert found.crs.to_epsg() == 4326
    assert len(found.refused) == 3 and "not a line" in " ".join(found.refused)


@pytest.mark.parametrize(
    "text", ["", "{", '{"type": "FeatureCollection", "features": []}', "[1, 2", '{"a": 1}', "<osm>"]
)
@pytest.mark.parametrize("name", ["a.geojson", "a.gpkg", "a.osm", "a.xodr"])
def test_other_files_are_rejected_by_name(tmp_path, text, name):
    path = tmp_path / name
    path.write_text(text)
    reader = {".osm": read_lanelet2, ".xodr": read_opendrive}.get(path.suffix, read_vector_file)
    with pytest.raises(InputError, match=name):
        reader(path)


@pytest.mark.parametrize("start", [b'<ROOT a="', b"<ROOT><!--", b""])
@pytest.mark.parametrize("name", ["a.osm", "a.xodr"])
def test_a_tag_without_an_end_is_refused_before_it_is_read_again_and_again(tmp_path, name, start):
    """Expat reads an unfinished tag again with every block: 20 MB took ten seconds."""
    path = tmp_path / name
    root = {".osm": b"osm", ".xodr": b"OpenDRIVE"}[path.suffix]
    path.write_bytes(start.replace(b"ROOT", root) + b"a" * 20_000_000)
    with pytest.raises(InputError, match=rf"{name}: .*without a tag"):
        (read_lanelet2 if path.suffix == ".osm" else read_opendrive)(path)


def test_geopackage_with_its_crs(tmp_path):
    geopandas = pytest.importorskip("geopandas")
    from shapely import LineString

    path = tmp_path / "a.gpkg"
    shapes = [LineString([CENTRE, (458_010.0, 5_428_000.0, 115.0)])]
    geopandas.GeoDataFrame({"subtype": ["dashed"]}, geometry=shapes, crs=25832).to_file(path, layer="lines")
    found = read_vector_file(path)
    assert (found.lines[0].kind, found.crs.to_epsg()) == ("dashed", 25832)
    assert found.lines[0].xyz[0].tolist() == list(CENTRE)


OSM = """<osm><node id="1" lat="49.0" lon="8.4"><tag k="ele" v="110"/></node><node id="2" lat="49.001" lon="8.4"/>
<node id="3" lat="x" lon="8.4"/>
<way id="10"><nd ref="1"/><nd ref="2"/><tag k="type" v="line_thin"/><tag k="subtype" v="dashed"/></way>
<way id="11"><nd ref="2"/><nd ref="1"/><tag k="type" v="odd"/></way>
<way id="12"><nd ref="2"/><nd ref="9"/><tag k="type" v="curbstone"/></way>
<way id="13"><nd ref="2"/><nd ref="1"/><tag k="type" v="stop_line"/></way>
<relation id="20"><member type="way" ref="11" role="left"/><member type="way" ref="10" role="right"/>
<tag k="type" v="lanelet"/></relation>
</osm>"""


def test_lanelet2_bounds_and_markings(tmp_path):
    path = tmp_path / "a.osm"
    path.write_text(OSM)
    found = read_lanelet2(path)
    assert [(item.kind, item.attributes["way"], item.attributes["bounds_a_lanelet"]) for item in found.lines] == [
        ("line_thin", "10", True), ("odd", "11", True),
    ]  # fmt: skip
    assert found.lines[0].xyz[0].tolist() == [8.4, 49.0, 110.0]
    of_way = "way '12': 1 of its 2 nodes are missing, node '9' first"
    assert of_way in found.refused and any("node '3'" in text for text in found.refused)
    path.write_text(re.sub(r'lat="49[.0-9]*"', 'lat="nan"', OSM))
    with pytest.raises(InputError, match=r"there are no whole lane boundaries; way .*2 of its 2 nodes are missing"):
        read_lanelet2(path)


@pytest.mark.skipif(not (SHARED / "lanelet2").is_dir(), reason=f"no real Lanelet2 map in {SHARED}")
def test_a_real_lanelet2_map():
    found = read_lanelet2(SHARED / "lanelet2" / "mapping_example.osm")
    assert len(found.lines) > 1_000 and not found.refused
    assert {"line_thin", "curbstone", "road_border", "virtual"} <= {item.kind for item in found.lines}
    layer = layer_crs(found.crs, 32632)
    length_m = max(np.ptp(to_map(layer, item.xyz)[:, :2], axis=0).max() for item in found.lines)
    assert 50 < length_m < 2_000


XODR = """<OpenDRIVE><header><geoReference><![CDATA[+proj=utm +zone=32 +ellps=WGS84]]></geoReference>
<offset x="458000" y="5428000" z="100" hdg="0"/></header>
<road id="1" length="40" name="a"><planView>
<geometry s="0" x="0" y="0" hdg="0" length="20"><line/></geometry>
<geometry s="20" x="20" y="0" hdg="0" length="20"><arc curvature="0.05"/></geometry></planView>
<elevationProfile><elevation s="0" a="1" b="0" c="0" d="0"/></elevationProfile>
<lanes><laneSection s="0"><left><lane id="1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/>
<roadMark sOffset="0" type="solid"/></lane>
</left><center><lane id="0" type="none"><roadMark sOffset="0" type="broken"/></lane></center>

<right><lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes></road>
<road id="2" length="10"><planView><geometry s="0" x="0" y="nan" hdg="0" length="10"><line/></geometry></planView></road>
<road id="3" length="10"><planView><geometry s="0" x="0" y="0" hdg="0" length="10"><wave/></geometry></planView></road>
</OpenDRIVE>"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('x="20" y="0"', 'x="1e308" y="0"', "coordinates beyond"),
        ('<laneSection s="0">', '<laneSection s="-1e15">', "lane sections begin"),
        ('length="40"', 'length="900000"', "its length is 900000 m"),
        ('offset x="458000"', 'offset x="nan"', "has x='nan'"),
    ],
)
def test_opendrive_numbers_that_would_not_end_are_refused(tmp_path, old, new, words):
    path = tmp_path / "a.xodr"
    path.write_text(XODR.replace(old, new))
    try:
        said = read_opendrive(path).refused
    except InputError as error:
        said = [str(error)]
    assert any(words in text for text in said)


def test_an_opendrive_road_longer_than_its_geometry_stays_at_its_end(tmp_path):
    """Thousands of equal points, which GEOS compares each with each where it keeps the topology."""
    path = tmp_path / "a.xodr"
    path.write_text(XODR.replace('length="40"', 'length="40000"'))
    lines = read_opendrive(path).lines
    assert all(len(line.xyz) < 60 for line in lines)


def test_opendrive_roads_that_are_too_many_together_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.xodr"
    start, rest = XODR.split("<road", 1)
    road = "<road" + rest.split("</road>", 1)[0] + "</road>"
    path.write_text(start + road * 50 + "</OpenDRIVE>")
    assert len(read_opendrive(path).lines) == 200
    monkeypatch.setattr("conetl.readers.base_layers.opendrive.MAX_POINTS", 40_000)
    with pytest.raises(
        InputError, match=r"a\.xodr: road '1': .* more than 40,000 points, .*; import the file in parts"
    ):
        read_opendrive(path)


def test_an_opendrive_road_of_too_many_points_costs_itself(tmp_path, monkeypatch):
    path = tmp_path / "a.xodr"
    short = '<road id="9" length="10"><planView><geometry s="0" x="1" y="2" hdg="0" length="10"/></planView></road>'
    path.write_text(XODR.replace("</OpenDRIVE>", f"{short}</OpenDRIVE>"))
    monkeypatch.setattr("conetl.readers.base_layers.opendrive._MOST_ROAD_POINTS", 300)
    found = read_opendrive(path)
    assert [line.attributes["road"] for line in found.lines] == ["9"]
    assert "road '1': its lines have more than 300 points, one each 1 m: split it" in found.refused


def test_las_records_after_the_points_must_fit(tmp_path):
    path = write_las(tmp_path / "a.las", 10)
    data = bytearray(path.read_bytes())
    data[243:247] = b"\xff" * 4
    path.write_bytes(data)
    with pytest.raises(InputError, match="records after the points"):
        read_las_header(path)


def test_laz_chunks_must_fit(tmp_path):
    """The decoder ends the process where it cannot allocate as many as are stated."""
    path = write_las(tmp_path / "a.laz")
    data = path.read_bytes()
    (points_at,) = struct.unpack_from("<I", data, 96)
    (table_at,) = struct.unpack_from("<q", data, points_at)
    wrong = data[: table_at + 4] + struct.pack("<I", 2**32 - 1) + data[table_at + 8 :]
    streamed = wrong[:points_at] + struct.pack("<q", -1) + wrong[points_at + 8 :] + struct.pack("<q", table_at)
    for content in (wrong, streamed):
        path.write_bytes(content)
        with pytest.raises(InputError, match="4,294,967,295 chunks"):
            read_all(path)


@pytest.mark.parametrize("form", range(11))
@pytest.mark.parametrize("extra", [[], ["u1", "f8"]])
def test_laz_layers_must_fit(tmp_path, form, extra):
    """As chunks, whose decoder holds all of their points."""
    path = tmp_path / "a.laz"
    las = laspy.create(point_format=form, file_version="1.4")
    las.add_extra_dims([laspy.ExtraBytesParams(f"e{i}", kind) for i, kind in enumerate(extra)])
    las.x, las.y, las.z = np.random.default_rng(0).uniform(0, 9, (3, 60_000))
    las.write(path)
    assert len(read_all(path)) == 60_000
    data = path.read_bytes()
    (points_at,) = struct.unpack_from("<I", data, 96)
    at = points_at + 8 + las.point_format.size + 4
    path.write_bytes(data[:at] + struct.pack("<I", 2**31) + data[at + 4 :])
    if form > 5:
        with pytest.raises(InputError, match=r"chunk 1 of 2 states 50,000 points .* bytes of layers; expected"):
            read_all(path)
    vlr = lazrs.LazVlr(laspy.open(path).header.vlrs.get("LasZipVlr")[0].record_data).record_data()
    at = data.index(vlr) + 12  # the size of chunks
    path.write_bytes(data[:at] + struct.pack("<I", 2**30) + data[at + 4 :])
    with pytest.raises(InputError, match=r"chunk 1 of 2 states 1,073,741,824 points"):
        read_all(path)


def test_opendrive_lines_and_refused_roads(tmp_path):
    path = tmp_path / "a.xodr"
    path.write_text(XODR)
    found = read_opendrive(path)
    kinds = {item.attributes["border"]: item for item in found.lines}
    assert {name: item.kind for name, item in kinds.items()} == {
        "reference line": "reference_line", "lane 0": "broken", "lane 1": "solid", "lane -1": "lane_border",
    }  # fmt: skip
    left = kinds["lane 1"].xyz
    assert left[0] == pytest.approx([458_000.0, 5_428_003.0, 101.0])
    assert left[-1] == pytest.approx([458_020.0 + 17 * np.sin(1.0), 5_428_020.0 - 17 * np.cos(1.0), 101.0])
    assert 4 < len(left) < 41  # the straight needs its ends only
    path.write_text(XODR.replace('z="100" hdg="0"', 'z="100" hdg="0.5"'))
    turned = {item.attributes["border"]: item for item in read_opendrive(path).lines}["lane 1"].xyz
    east, north = (left - [458_000.0, 5_428_000.0, 0.0])[:, :2].T
    about = np.column_stack([east * np.cos(0.5) - north * np.sin(0.5), east * np.sin(0.5) + north * np.cos(0.5)])
    assert turned[:, :2] == pytest.approx(np.add(about, [458_000.0, 5_428_000.0]))
    assert found.crs is not None and found.crs.is_projected
    assert [text[:8] for text in found.refused] == ["road '2'", "road '3'"] and "<wave>" in found.refused[1]
