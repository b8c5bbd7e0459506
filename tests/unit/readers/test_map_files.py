"""Tables of points and files of lines as spreadsheets, QGIS, JOSM and road designers write them."""

from __future__ import annotations

import json
import re
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio.raw
import pytest
import shapely
from pyproj import CRS, Transformer

from conetl.model.errors import InputError
from conetl.model.params import ImportParams
from conetl.readers.base_layers import georeferencing as geo
from conetl.readers.base_layers.line_files import read_lane_lines, read_vector_file
from conetl.readers.base_layers.lines import read_lanelet2
from conetl.readers.base_layers.opendrive import read_opendrive
from conetl.readers.maps.csv_text import read_csv_text
from conetl.readers.maps.imported_rows import read_map_file
from conetl.readers.maps.tables import read_table
from conetl.readers.plans import read_plans
from conetl.readers.surveyed_points import read_surveyed_points

UTM = "EPSG:25832"
SURVEYED = datetime(2026, 3, 1, tzinfo=UTC)
EAST_NORTH = np.array(
    [[458300.125, 5427800.5], [458308.253, 5427802.877], [458316.381, 5427805.129], [458324.507, 5427807.771]]
)
HEIGHTS_M = np.array([160.03, 160.11, 160.27, 160.41])
WANTED = np.column_stack([EAST_NORTH, HEIGHTS_M])
LON_LAT = np.column_stack(Transformer.from_crs(25832, "OGC:CRS84", always_xy=True).transform(*EAST_NORTH.T))


def imported(path: Path, **options: Any) -> np.ndarray:
    """Positions (N, 3) that `conetl map import` reads."""
    options = {"crs": UTM, "map_srid": 25832, "stated_at": SURVEYED} | options
    found = read_map_file(path, options.pop("params", ImportParams()), **options)
    return np.array([one.feature.xyz_m for one in found.statements])


def surveyed(path: Path, crs: str = UTM, srid: int = 25832) -> np.ndarray:
    """The same by `conetl map check-points`."""
    return np.array([point.xyz_m for point in read_surveyed_points(path, srid, crs=crs, sigma_m=0.5)])


def same(found: np.ndarray, wanted: np.ndarray = WANTED) -> None:
    """In any order: FlatGeobuf has its own."""
    np.testing.assert_allclose(*(values[np.argsort(values[:, 0])] for values in (found, wanted)), atol=1e-3)


def refused(path: Path, message: str, **options: Any) -> None:
    with pytest.raises(InputError, match=message) as raised:
        imported(path, **options)
    assert str(raised.value).isprintable()


def csv_text(header: str, *columns: np.ndarray, delimiter: str = ",", comma: bool = False) -> str:
    def cell(value: float) -> str:
        text = f"{value:.3f}"
        return text.replace(".", ",") if comma else text

    rows = [delimiter.join(map(cell, row)) for row in zip(*columns, strict=True)]
    return "\n".join([header, *rows]) + "\n"


def geojson(path: Path, coordinates: Any, kind: str = "Point", **members: Any) -> Path:
    features = [
        {"type": "Feature", "properties": {}, "geometry": {"type": kind, "coordinates": np.asarray(one).tolist()}}
        for one in coordinates
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", **members, "features": features}))
    return path


def gpkg(path: Path, xyz: np.ndarray, crs: str, columns: dict[str, np.ndarray] | None = None) -> Path:
    points = np.asarray(shapely.to_wkb(shapely.points(xyz), output_dimension=xyz.shape[1]), object)
    columns = columns or {"k": np.arange(len(xyz))}
    kind = "Point Z" if xyz.shape[1] == 3 else "Point"
    driver = {".gpkg": "GPKG", ".fgb": "FlatGeobuf"}[path.suffix]
    pyogrio.raw.write(path, points, [*columns.values()], [*columns], geometry_type=kind, crs=crs, driver=driver)
    return path


# --------------------------------------------------------------------------- heights


@pytest.mark.parametrize(
    "name",
    [
        "ground_height_m",
        "ellipsoidal_height_m",
        "Height",
        "HEIGHT_M",
        "height [m]",
        "Elevation",
        "ele",
        "Z",
        "h",
        "Höhe",
    ],
)
def test_heights_of_the_ground_are_read_by_any_of_their_names(tmp_path: Path, name: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(csv_text(f"easting,northing,{name}", *WANTED.T))
    same(imported(path))
    same(imported(path, params=ImportParams(ground_height_m=7.0)))  # of points without a height only
    same(surveyed(path))
    for suffix in (".gpkg", ".fgb"):
        plain = re.sub(r"\W.*", "", name.replace("ö", "oe"))
        path = gpkg(tmp_path / f"{plain}{suffix}", EAST_NORTH, UTM, {plain: HEIGHTS_M})
        same(imported(path))
        same(surveyed(path))


@pytest.mark.parametrize(
    ("names", "other_m", "problem"),
    [
        ("Z,H", HEIGHTS_M - 48.0, "'h' may both be the height of the ground"),
        ("elevation,altitude", HEIGHTS_M + 48.0, "may both be"),
        ("z,height", np.array([0.5, 0.7, 0.7, 0.5]), None), ("alt,z", HEIGHTS_M + 0.2, None),
        ("ellipsoidal height,elevation", HEIGHTS_M - 48.0, None), ("ground_height_m,z", HEIGHTS_M - 48.0, None),
    ],
)  # fmt: skip
def test_two_heights_that_differ_by_a_geoid_are_asked_for(
    names: str, other_m: np.ndarray, problem: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "points.csv"
    path.write_text(csv_text(f"easting,northing,{names}", *WANTED.T, other_m))
    if problem is None:
        same(surveyed(path))
        same(imported(path))
    else:
        refused(path, problem)


def test_a_column_fills_heights_that_the_geometry_lacks(tmp_path: Path) -> None:
    flat = np.column_stack([EAST_NORTH, np.zeros(4)])
    same(imported(gpkg(tmp_path / "a.gpkg", flat, UTM, {"ground_height_m": HEIGHTS_M})))
    same(imported(gpkg(tmp_path / "b.gpkg", WANTED, UTM, {"ground_height_m": HEIGHTS_M + 47.0})))
    path = tmp_path / "c.csv"
    path.write_text("easting,northing,z\n458300,5427800,160\n458310,5427803,\n458320,5427806,162\n458331,5427809,163\n")
    heights = imported(path, params=ImportParams(ground_height_m=161.0))[:, 2]
    np.testing.assert_allclose(heights, [160, 161, 162, 163])
    refused(path, "row 2: the cone has no height")


@pytest.mark.parametrize("name", ["height_m", "Height", "h"])
def test_heights_of_objects_are_not_those_of_the_ground(tmp_path: Path, name: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(csv_text(f"easting,northing,{name}", *EAST_NORTH.T, np.array([0.5, 0.75, 0.5, 0.45])))
    refused(path, "has no height; state the ground's")
    found = read_map_file(path, ImportParams(ground_height_m=160.0), crs=UTM, map_srid=25832, stated_at=SURVEYED)
    assert [one.feature.xyz_m[2] for one in found.statements] == [160.0] * 4
    assert found.statements[1].feature.object_height_m == (0.75 if name == "height_m" else 0.5)


def test_heights_of_a_stated_system_are_not_taken_as_ellipsoidal(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    rows = [f"{e},{n},{h},EPSG:7837" for e, n, h in WANTED]
    path.write_text("\n".join(["easting,northing,ground_height_m,height_system", *rows]))
    refused(path, "'ground_height_m' is in the height system 'EPSG:7837': state it with the CRS")
    path.write_text(path.read_text().replace("EPSG:7837", "ellipsoidal"))
    same(imported(path))


# --------------------------------------------------------------------------- feet

#: US survey feet, international feet, and metres.
FEET = {
    "EPSG:6418": (1200 / 3937, 6417, -124.0, 41.0),
    "EPSG:6405": (0.3048, 6404, -110.5, 34.0),
    "EPSG:6417": (1.0, 6417, -124.0, 41.0),
}


@pytest.mark.parametrize("crs", FEET)
def test_a_crs_in_feet_is_converted_in_all_three_axes(tmp_path: Path, crs: str) -> None:
    unit_m, srid, lon, lat = FEET[crs]
    xy = np.column_stack(
        Transformer.from_crs("OGC:CRS84", crs, always_xy=True).transform(lon + LON_LAT[:, 0] / 1e3, np.full(4, lat))
    )
    wanted = np.column_stack([*Transformer.from_crs(crs, srid, always_xy=True).transform(*xy.T), HEIGHTS_M])
    in_feet = np.column_stack([xy, HEIGHTS_M / unit_m])
    options = {"crs": None, "map_srid": srid}
    for path in (gpkg(tmp_path / "a.gpkg", in_feet, crs), gpkg(tmp_path / "a.fgb", in_feet, crs)):
        same(imported(path, **options), wanted)
        same(surveyed(path, crs, srid), wanted)
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["easting,northing,z", *(f"{x!r},{y!r},{z!r}" for x, y, z in in_feet.tolist())]))
    same(imported(path, crs=crs, map_srid=srid), wanted)
    same(surveyed(path, crs, srid), wanted)
    # A name that states a unit is in this unit.
    names = ("ground_height_m", "Height [m]", "elevation (metres)", "Z_ft", "height (feet)")
    for name in names:
        heights = HEIGHTS_M / (0.3048 if "f" in name else 1.0)
        rows = np.column_stack([xy, heights]).tolist()
        path.write_text("\n".join([f"easting,northing,{name}", *(f"{x!r},{y!r},{h!r}" for x, y, h in rows)]))
        same(imported(path, crs=crs, map_srid=srid), wanted)
        same(surveyed(path, crs, srid), wanted)
    layer = geo.layer_crs(CRS(crs), srid)  # as `conetl base import`
    same(geo.to_map(layer, in_feet), wanted)


# --------------------------------------------------------------------------- GeoJSON


@pytest.mark.parametrize("members", [{}, {"crs": None}, {"name": "cones"}])
def test_projected_geojson_takes_the_stated_crs(tmp_path: Path, members: dict[str, Any]) -> None:
    path = geojson(tmp_path / "a.geojson", WANTED, **members)
    same(imported(path))
    same(surveyed(path))
    refused(path, "does not state the CRS of its coordinates: give it with --crs", crs=None)
    refused(path, "outside the area of use", crs="EPSG:25829")


@pytest.mark.parametrize("name", ["EPSG:25832", "urn:ogc:def:crs:EPSG::25832"])
def test_geojson_with_a_projected_crs_is_in_that(name: str, tmp_path: Path) -> None:
    path = geojson(tmp_path / "a.geojson", WANTED, crs={"type": "name", "properties": {"name": name}})
    same(imported(path, crs=None))
    refused(path, "has the CRS .* but --crs is", crs="EPSG:25833")


def test_projected_geojson_one_feature_per_line(tmp_path: Path) -> None:
    content = json.loads(geojson(tmp_path / "a.geojson", WANTED).read_text())
    path = tmp_path / "lines.geojson"
    path.write_text("\n".join(map(json.dumps, content["features"])))
    same(imported(path))


def test_geojson_in_degrees_is_not_read_in_another_crs(tmp_path: Path) -> None:
    path = geojson(tmp_path / "a.geojson", np.column_stack([LON_LAT, HEIGHTS_M]))
    refused(path, "has the CRS WGS 84, but --crs is .*: which is right")
    same(imported(path, crs=None))


def test_multipoints_of_one_are_points(tmp_path: Path) -> None:
    path = geojson(tmp_path / "a.geojson", np.column_stack([LON_LAT, HEIGHTS_M])[:, None], "MultiPoint")
    same(imported(path, crs=None))
    refused(
        geojson(tmp_path / "b.geojson", [LON_LAT[:1], LON_LAT[1:3]], "MultiPoint"),
        "row 2: MultiPoint where a point",
        crs=None,
    )
    refused(geojson(tmp_path / "c.geojson", [LON_LAT[:1], []], "MultiPoint"), "row 2: ", crs=None)
    mixed = json.loads(path.read_text())
    mixed["features"][2]["geometry"] = {"type": "Point", "coordinates": [*LON_LAT[2], HEIGHTS_M[2]]}
    path.write_text(json.dumps(mixed))
    same(imported(path, crs=None))


# --------------------------------------------------------------------------- spreadsheets


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_tables_of_german_spreadsheets(tmp_path: Path, encoding: str, delimiter: str) -> None:
    names = ["Ostwert", "NORDWERT", "Höhe [m]", "sigma_u_m"]
    text = csv_text(delimiter.join(names), *WANTED.T, np.full(4, 0.125), delimiter=delimiter, comma=True)
    path = tmp_path / "points.csv"
    if delimiter == ";" and encoding != "utf-8":
        text = f"sep=;\n{text}"  # as Excel writes
    path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    same(imported(path))
    same(surveyed(path))
    found = read_map_file(path, ImportParams(), crs=UTM, map_srid=25832, stated_at=SURVEYED)
    assert found.statements[0].feature.cov_m2[5] == pytest.approx(0.125**2)


@pytest.mark.parametrize(
    "names", ["X,Y,Z", "Rechtswert,Hochwert,h", "E [m],N [m],Elevation (m)", "EAST,NORTH,altitude"]
)
def test_names_of_positions(tmp_path: Path, names: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(csv_text(names, *WANTED.T))
    same(imported(path))


def test_columns_of_words_keep_their_commas(tmp_path: Path) -> None:
    rows = [f"P {k},{k};{e:.3f};{n:.3f};{h:.2f}".replace(".", ",") for k, (e, n, h) in enumerate(WANTED)]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(["name;easting;northing;z", *rows]))
    points = read_surveyed_points(path, 25832, crs=UTM, sigma_m=0.5)
    assert [point.name for point in points] == ["P 0,0", "P 1,1", "P 2,2", "P 3,3"]
    path.write_text(path.read_text().replace("5427800,50", "5.427.800,50").replace("5427800,500", "5.427.800,500"))
    refused(path, "row 1: northing_m is '5.427.800,500', which is not a number")


def test_a_table_across_180_degrees(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(
        "lon,lat,z\n179.99985,-16.80000001,50\n179.99995,-16.800031,50\n-179.99995,-16.800061,50\n-179.99985,-16.800091,50\n"
    )
    found = imported(path, crs=None, map_srid=32760)
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).max() < 13.0


# --------------------------------------------------------------------------- limits


@pytest.mark.parametrize("name", ["a.csv", "a.geojson", "a.osm", "a.xodr"])
def test_a_sparse_file_is_refused_at_once(tmp_path: Path, name: str) -> None:
    """2 GB that take no space: refused by their size. 500 MB: by their first line or block."""
    path, read = tmp_path / name, {".osm": read_lanelet2, ".xodr": read_opendrive}.get(name[1:], imported)
    for size, words in (
        (2 << 30, "expected at most 536,870,912"),
        (500 << 20, "more than 1,048,576 char|cannot be read|without a tag"),
    ):
        with path.open("wb") as file:
            file.truncate(size)
        with pytest.raises(InputError, match=words):
            read(path)


@pytest.mark.parametrize(
    "text", [f"easting;northing;{'_' * 120_000}\n1;2;3\n", f"easting;northing\n1;2\n1;{'1' * 120_000}x\n"]
)
def test_long_cells_take_no_time(tmp_path: Path, text: str) -> None:
    """Expressions that go back over a text would take minutes."""
    path = tmp_path / "points.csv"
    path.write_text(text)
    refused(path, "row")


@pytest.mark.parametrize("delimiter", [",", ";"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_quotes_change_no_cell(tmp_path: Path, delimiter: str, end: str) -> None:
    """Arrow reads a table without them, Python one with them."""
    rows = [["Lon", "lat ", "note"], ["8.1", " 49", ""], ["", "#", "NULL"], ["8.2", "n/a", "Höhe"], ["", "", ""]]
    for name, quoted in (("a.csv", ""), ("b.csv", '"')):
        lines = [delimiter.join(f"{quoted}{cell}{quoted}" for cell in row) for row in rows]
        (tmp_path / name).write_text(end.join([*lines, "", ""]), newline="")
    plain, other = (read_csv_text(tmp_path / name, 10) for name in ("a.csv", "b.csv"))
    assert plain.equals(other)
    assert plain.to_pydict() == {
        "lon": ["8.1", None, "8.2", None], "lat": ["49", "#", "n/a", None], "note": [None, "NULL", "Höhe", None],
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(12))
def test_covariances_are_accepted_where_they_are_positive_definite(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sigmas, pairs = rng.uniform(0.02, 1.0, 3), [(0, 1), (0, 2), (1, 2)]
    cov = np.diag(sigmas**2)
    for (i, j), share in zip(pairs, rng.uniform(-1, 1, 3), strict=True):
        cov[i, j] = cov[j, i] = share * sigmas[i] * sigmas[j]
    names = "easting,northing,z,sigma_e_m,sigma_n_m,sigma_u_m,cov_en_m2,cov_eu_m2,cov_nu_m2"
    path = tmp_path / "points.csv"
    values = [458300.0, 5427800.0, 160.0, *sigmas.tolist(), *(cov[pair].item() for pair in pairs)]
    path.write_text(f"{names}\n{','.join(map(repr, values))}\n")
    if np.linalg.eigvalsh(cov)[0] > 0:
        found = read_map_file(path, ImportParams(), crs=UTM, map_srid=25832, stated_at=SURVEYED)
        assert found.statements[0].feature.cov_m2 == pytest.approx(cov[np.triu_indices(3)].tolist())
    else:
        refused(path, "not form a covariance matrix")


def test_of_all_errors_the_first_one_of_the_first_row_counts(tmp_path: Path) -> None:
    """Columns are checked one after the other."""
    names = "easting,northing,z,existence_probability,cov_en_m2,first_seen_at,object_height_m"
    good = ["0.9", "0", "2026-02-01", "0.5"]
    bad = {
        "existence_probability is '2', expected at most 1": ["2", "0", "2026-02-01", "0.5"],
        "object_height_m is '-1', expected more than 0": ["2", "0", "soon", "-1"],
        "not form a covariance matrix": ["0.9", "1", "soon", "0.5"],
        "first_seen_at is 'soon', expected a time": ["0.9", "0", "soon", "0.5"],
        "are not in this order": ["0.9", "0", "2026-03-09", "0.5"],
    }
    path = tmp_path / "points.csv"
    for first, (message, cells) in enumerate(bad.items(), 2):
        rows = [good] * (first - 1) + [cells] + [row for row in bad.values() if row is not cells]
        lines = [f"{458300 + 7.123 * k:.3f},{5427800 + k / 3:.3f},160,{','.join(row)}" for k, row in enumerate(rows)]
        path.write_text("\n".join([names, *lines]))
        refused(path, f"row {first}: .*{message}.*; nothing was written")


@pytest.mark.parametrize("beside", ["2026-02-28T10:00:00Z", "2026-02-28T10:00:00", "2026/02/28 10:00"])
@pytest.mark.parametrize(
    ("text", "at"),
    [
        ("2026-03-01T10:00:00Z", 0), ("2026-03-01 10:00:00.25+00:00", 0.25), ("2026-03-01T12:00:00+02:00", 0),
        ("2026-03-01T10:00:00", 0), ("2026-03-01T10:00:00.1234567Z", 0.123456), ("2026-03-01", -36_000), ("20260301T100000Z", 0),
    ],
)  # fmt: skip
def test_times_are_read_one_by_one_as_all_at_once(tmp_path: Path, text: str, at: float, beside: str) -> None:
    """Arrow reads most columns at once, without those of two kinds or a kind that is Python's alone."""
    path = tmp_path / "points.csv"
    lines = [f"{458300 + 7.123 * k:.3f},5427800.1,160,{one}" for k, one in enumerate((text, beside, ""))]
    path.write_text("\n".join(["easting,northing,z,last_seen_at", *lines]))
    found = read_map_file(path, ImportParams(sigma_m=0.1), crs=UTM)
    seen_ns = [one.feature.last_seen_ns for one in found.statements]
    start_ns = 1_772_359_200 * 10**9  # 2026-03-01 10:00
    assert seen_ns[0] == start_ns + round(at * 1e9)
    assert seen_ns[1] == start_ns - 86_400 * 10**9
    assert seen_ns[2] == found.stated_at_ns == max(seen_ns[:2])


def test_messages_have_no_control_characters(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("east\x1b[31m,north\n1,2\n")
    refused(path, "no columns lon_deg and lat_deg, nor easting_m and northing_m; found: ")
    path.write_text("easting,northing,z\n458300,5427800,\x1b[2J\n")
    refused(path, "row 1: z is ")
    path = tmp_path / "a.osm"
    path.write_text('<osm><way id="a&#x85;b"><nd ref="9"/><tag k="type" v="line_thin"/></way></osm>')
    with pytest.raises(InputError) as raised:
        read_lanelet2(path)
    assert str(raised.value).isprintable() and "x85" in str(raised.value)


# --------------------------------------------------------------------------- lines

NODES = "".join(
    f'<node id="{k}" lat="{49 + k * 1e-5:.5f}" lon="8.43"><tag k="ele" v="115"/></node>' for k in range(1, 7)
)


def osm(path: Path, *parts: str, nodes: str = NODES) -> Path:
    path.write_text(f'<?xml version="1.0"?><osm version="0.6" generator="x">{nodes}{"".join(parts)}</osm>')
    return path


def way(number: int, *refs: int, more: str = "") -> str:
    nodes = "".join(f'<nd ref="{ref}"/>' for ref in refs)
    return f'<way id="{number}" {more}>{nodes}<tag k="type" v="line_thin"/></way>'


@pytest.mark.parametrize("mark", ['action="delete"', "action='delete' visible='true'", 'visible="false"'])
def test_objects_that_were_deleted_are_left_out(tmp_path: Path, mark: str) -> None:
    found = read_lanelet2(
        osm(tmp_path / "a.osm", way(100, 1, 2, 3, more=mark), way(101, 4, 5), way(102, 5, 6, more='action="modify"'))
    )
    assert [(line.attributes["way"], len(line.xyz)) for line in found.lines] == [
        ("101", 2),
        ("102", 2),
    ] and not found.refused
    # A deleted lanelet binds no way, and a deleted node breaks its way.
    lanelet = '<relation id="9" {}><member type="way" ref="103" role="left"/><tag k="type" v="lanelet"/></relation>'
    odd = way(103, 1, 2).replace("line_thin", "odd")
    both = osm(tmp_path / "b.osm", odd, way(101, 4, 5), lanelet.format(mark))
    assert [line.attributes["way"] for line in read_lanelet2(both).lines] == ["101"]
    broken = osm(tmp_path / "c.osm", way(100, 1, 2, 3), way(101, 4, 5), nodes=NODES.replace('id="2"', f'id="2" {mark}'))
    found = read_lanelet2(broken)
    assert [line.attributes["way"] for line in found.lines] == ["101"]
    assert found.refused == ["way '100': 1 of its 3 nodes are missing, node '2' first"]


def test_a_way_with_a_missing_node_is_lost_alone(tmp_path: Path) -> None:
    found = read_lanelet2(osm(tmp_path / "a.osm", way(100, 1, 2, 77), way(101, 4, 5), way(102, 88, 99)))
    assert [line.attributes["way"] for line in found.lines] == ["101"]
    assert [text.split(":")[0] for text in found.refused] == ["way '100'", "way '102'"]
    with pytest.raises(
        InputError, match="no whole lane boundaries; way '100': 1 of its 3 nodes are missing, node '77' first"
    ):
        read_lanelet2(osm(tmp_path / "b.osm", way(100, 1, 2, 77)))


def xodr(path: Path, reference: str, x: float = 8.43, y: float = 49.002) -> Path:
    head = f"<header><geoReference><![CDATA[{reference}]]></geoReference></header>" if reference else "<header/>"
    road = (
        f'<road name="r" length="60" id="1"><planView><geometry s="0" x="{x}" y="{y}" hdg="0.62" length="60"><line/></geometry>'
        '</planView><lanes><laneSection s="0"><center><lane id="0" type="none"><roadMark sOffset="0" type="solid"/></lane>'
        "</center></laneSection></lanes></road>"
    )
    path.write_text(f'<?xml version="1.0"?><OpenDRIVE>{head}{road}</OpenDRIVE>')
    return path


GROUND = geo.MapGround(25832, np.empty((0, 3)))


@pytest.mark.parametrize(
    "reference", ["+proj=longlat +datum=WGS84", "EPSG:4326", "+proj=longlat +ellps=GRS80 +no_defs"]
)
def test_opendrive_in_degrees_is_refused(tmp_path: Path, reference: str) -> None:
    found = read_opendrive(xodr(tmp_path / "a.xodr", reference))
    assert found.crs is None
    with pytest.raises(
        InputError, match=r"geoReference: .* is in degrees, but the lengths of OpenDRIVE are metres.*--crs 25832"
    ):
        geo.resolve_crs(tmp_path / "a.xodr", found.crs, None, GROUND, found.why_no_crs)
    with pytest.raises(InputError, match=r"no usable coordinate reference system: geoReference: .* is in degrees"):
        read_lane_lines(tmp_path / "a.xodr", srid=25832)
    # Coordinates in metres under such a name can be used with their CRS.
    found = read_opendrive(xodr(tmp_path / "b.xodr", reference, 458300.0, 5427800.0))
    layer, _ = geo.resolve_crs(tmp_path / "b.xodr", found.crs, UTM, GROUND, found.why_no_crs)
    assert np.ptp(geo.to_map(layer, found.lines[0].xyz), axis=0).max() < 60


@pytest.mark.parametrize(
    ("reference", "why"), [("", "has no geoReference"), ("+proj=nowhere", "geoReference: '.proj=nowhere' is not")]
)
def test_opendrive_without_a_crs_says_why(tmp_path: Path, reference: str, why: str) -> None:
    found = read_opendrive(xodr(tmp_path / "a.xodr", reference))
    with pytest.raises(InputError, match=f"{why}.*--crs 25832"):
        geo.resolve_crs(tmp_path / "a.xodr", found.crs, None, GROUND, found.why_no_crs)


def test_projected_lines_of_geojson_take_the_stated_crs(tmp_path: Path) -> None:
    path = geojson(tmp_path / "a.geojson", [WANTED[:2], WANTED[2:]], "LineString")
    found = read_vector_file(path)
    layer, _ = geo.resolve_crs(path, found.crs, UTM, GROUND, found.why_no_crs)
    same(geo.to_map(layer, np.concatenate([line.xyz for line in found.lines])))
    with pytest.raises(InputError, match=r"not degrees. State the CRS with --crs"):
        geo.check_coordinates(path, geo.resolve_crs(path, found.crs, None, GROUND)[0], WANTED[:, :2], GROUND)


@pytest.mark.parametrize(
    ("names", "crs", "problem"),
    [
        ("easting_ft,northing_ft,elevation_ft", "EPSG:25832", r"units of 0.3048 m, but those of .* are 1 m"),
        ("East (ft),North (ft),Elevation (ft)", "EPSG:25832", r"units of 0.3048 m"),
        ("easting [m],northing [m],elevation [m]", "EPSG:2225", r"units of 1 m, but those of .* are 0.3048"),
    ],
)
def test_units_in_names_that_contradict_the_crs_are_refused(names: str, crs: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(f"{names}\n" + "".join(f"{6_000_000 + 7 * k},{2_000_000 + k},500\n" for k in range(5)))
    with pytest.raises(InputError, match=problem):
        read_surveyed_points(path, 25832, crs=crs, sigma_m=0.02)
    with pytest.raises(InputError, match=problem):
        read_map_file(path, ImportParams(), crs=crs, map_srid=26910, stated_at=SURVEYED)


def test_feet_in_names_with_a_crs_in_feet(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("easting_ft,northing_ft,elevation_ft\n6000000,2000000,500\n")
    found = read_map_file(path, ImportParams(sigma_m=1.0), crs="EPSG:2225", map_srid=26910, stated_at=SURVEYED)
    assert found.statements[0].feature.xyz_m[2] == pytest.approx(152.4, abs=1e-3)


READERS = [lambda path: read_table(path, layer="v"), read_vector_file, read_plans]


def with_view(path: Path, name: str, *, is_layer: bool) -> Path:
    """A GeoPackage with a query that has no end."""
    gpkg(path, EAST_NORTH, UTM)
    with closing(sqlite3.connect(path)) as database:
        endless = "with recursive n(fid) as (select 1 union all select fid + 1 from n)"
        database.execute(
            f"create view {name} as {endless} select n.fid, a.geom from n join {path.stem} a where n.fid < 0"
        )
        if is_layer:
            contents = (
                "insert into gpkg_contents (table_name, data_type, identifier, srs_id) values (?, 'features', ?, 0)"
            )
            database.execute(contents, (name, name))
            database.execute("insert into gpkg_geometry_columns values (?, 'geom', 'POINT', 0, 1, 0)", (name,))
        database.commit()
    return path


@pytest.mark.parametrize("read", READERS)
def test_a_layer_that_is_a_view_is_refused(read: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="layer 'v' is a view"):
        read(with_view(tmp_path / "a.gpkg", "v", is_layer=True))


def test_other_views_of_a_geopackage_are_not_looked_at(tmp_path: Path) -> None:
    path = with_view(tmp_path / "a.gpkg", "st_geometry_columns", is_layer=False)  # as ArcGIS writes them
    assert len(read_table(path)) == len(EAST_NORTH)
    with pytest.raises(InputError, match="there is no line"):
        read_vector_file(path)
