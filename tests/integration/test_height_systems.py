"""Height systems of maps and files, and the dictionary of their fields."""

from __future__ import annotations

import csv
import json
import re
import struct
import xml.etree.ElementTree as ET
from contextlib import contextmanager

import geopandas
import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from pyproj import Transformer

from conetl.db.connection import execute
from conetl.db.map.map_store import read_current_features
from conetl.exports import FORMATS
from conetl.exports.export import export_map
from conetl.exports.source import ExportRequest
from conetl.geometry import geodesy
from conetl.model.columns import BY_NAME, as_markdown
from conetl.readers.surveyed_points import read_surveyed_points
from conetl.web.ogc.collections import COLLECTIONS
from tests.conftest import filled_template
from tests.integration.drives_of_days import failed_audits, merge, survey

EGM96 = "EPSG:32632+5773"


@pytest.fixture(scope="module")
def template_database(cluster_url, template_database):
    """Each test has a database with a map of two drives."""
    with filled_template(
        cluster_url, template_database, lambda conn: [merge(conn, survey(day)) for day in (0, 1)]
    ) as name:
        yield name


@pytest.fixture
def mapped(conn):
    """What stands on the map."""
    found = read_current_features(conn)
    conn.rollback()
    return found


@contextmanager
def own_geoid(folder):
    """A geoid of its own in the place of PROJ's grid for EGM96: it slopes."""
    slope = np.fromfunction(lambda row, column: 40 + 0.1 * (column - 189) + 0.05 * (row - 139), (181, 361)).astype(
        ">f4"
    )
    (folder / "egm96_15.gtx").write_bytes(struct.pack(">4d2i", -90, -180, 1, 1, 181, 361) + slope.tobytes())
    before = pyproj.datadir.get_data_dir()
    geodesy._height_transformer.cache_clear()
    pyproj.datadir.append_data_dir(str(folder))
    yield
    pyproj.datadir.set_data_dir(before)
    geodesy._height_transformer.cache_clear()


@pytest.fixture
def grid(tmp_path):
    with own_geoid(tmp_path):
        yield


def test_a_missing_grid_is_named(conetl, mapped, tmp_path):
    said = conetl("map", "export", "--out", tmp_path / "a.gpkg", "--crs", EGM96, code=2)
    assert "us_nga_egm96_15.tif" in said and "EPSG:5773" in said
    assert not (tmp_path / "a.gpkg").exists()


def test_heights_are_those_of_proj_in_every_format(conetl, conn, mapped, tmp_path, grid):
    wanted = np.column_stack(
        Transformer.from_crs(pyproj.CRS(32632).to_3d(), pyproj.CRS(EGM96), always_xy=True).transform(
            *np.array([feature.xyz_m for feature in mapped]).T
        )
    )
    assert np.abs(wanted[:, 2] - [feature.xyz_m[2] for feature in mapped]).min() > 30
    order = [str(feature.feature_id) for feature in mapped]
    for name in ("gpkg", "flatgeobuf", "geoparquet"):
        path = tmp_path / f"cones{FORMATS[name].suffix}"
        manifest = json.loads(conetl("map", "export", "--out", path, "--crs", EGM96, "--json"))["manifest"]
        assert (manifest["crs"], manifest["height_system"]) == (EGM96, "EPSG:5773")
        table = pyogrio.read_dataframe(path) if name != "geoparquet" else geopandas.read_parquet(path)
        table = table.set_index("feature_id").loc[order]
        assert pyproj.CRS(table.crs).is_compound
        found = np.array([(p.x, p.y, p.z) for p in table.geometry])
        assert np.abs(found - wanted).max() < 0.001
        assert np.abs(table["ground_height_m"] - wanted[:, 2]).max() < 0.001
        assert set(table["height_system"]) == {"EPSG:5773"}
        assert table["object_height_m"].tolist() == [feature.object_height_m for feature in mapped]
        # What comes back is ellipsoidal again, and recognised.
        back = np.array([point.xyz_m for point in read_surveyed_points(path, 32632, sigma_m=0.01)])
        apart_m = np.linalg.norm(back[:, None] - [feature.xyz_m for feature in mapped], axis=2)
        assert apart_m.min(axis=0).max() < 0.001
        assert "exported from this map" in conetl("map", "import", path)
    conetl("map", "export", "--out", tmp_path / "cones.csv", "--crs", EGM96)
    rows = {row["feature_id"]: row for row in csv.DictReader((tmp_path / "cones.csv").open())}
    assert [float(rows[i]["ground_height_m"]) for i in order] == pytest.approx(wanted[:, 2].tolist(), abs=0.001)
    assert [float(rows[i]["ellipsoidal_height_m"]) for i in order] == pytest.approx(
        [f.xyz_m[2] for f in mapped], abs=0.001
    )
    changes = tmp_path / "changes.csv"
    conetl("map", "export", "--what", "changes", "--from", "2026-03-02T23:00", "--out", changes, "--crs", EGM96)
    to_egm96 = Transformer.from_crs(pyproj.CRS(32632).to_3d(), pyproj.CRS(EGM96), always_xy=True)
    before = [row for row in csv.DictReader(changes.open()) if row["old_version"]]
    for row in before:
        old_m = [float(row[f"old_{name}_m"]) for name in ("easting", "northing", "ellipsoidal_height")]
        assert float(row["old_ground_height_m"]) == pytest.approx(to_egm96.transform(*old_m)[2], abs=0.001)
    assert before
    conetl("map", "export", "--out", tmp_path / "cones.geojson", "--crs", EGM96)
    point = json.loads((tmp_path / "cones.geojson").read_text())["features"][0]
    assert (
        point["geometry"]["coordinates"][2] - point["properties"]["ground_height_m"] > 30
    )  # RFC 7946: above the ellipsoid
    assert failed_audits(conn) == []


def test_a_map_has_a_height_system(conetl, conn, tmp_path, grid):
    conetl("map", "create", "city", "--crs", EGM96)
    [city] = (one for one in json.loads(conetl("map", "list", "--json")) if one["map_name"] == "city")
    assert (city["srid"], city["vertical_srid"]) == (32632, 5773)
    merge(conn, survey(0), map_name="city")
    conn.commit()
    manifest = json.loads(conetl("map", "export", "--map", "city", "--out", tmp_path / "a.gpkg", "--json"))["manifest"]
    assert manifest["height_system"] == "EPSG:5773"
    other = json.loads(
        conetl("map", "export", "--map", "city", "--out", tmp_path / "b.gpkg", "--crs", "EPSG:32632", "--json")
    )
    assert other["manifest"]["height_system"] == "ellipsoidal"


def test_lane_markings_have_heights_of_the_system(conn, samples, tmp_path, grid):
    vertices = np.add((458_001.0, 5_428_010.0, 114.5), np.linspace((0, 0, 0), (8, 6, 0.2), 5))
    line = samples.line_feature(samples.marking(vertices), "line")
    samples.commit(conn, samples.added(line), key="1", markings=[samples.marking_track(line.marking)])
    export_map(conn, tmp_path / "a.parquet", "geoparquet", ExportRequest(category="lane_marking", crs=(32632, 5773)))
    found = shapely.get_coordinates(geopandas.read_parquet(tmp_path / "a.parquet").geometry, include_z=True)
    wanted = Transformer.from_crs(pyproj.CRS(32632).to_3d(), pyproj.CRS(EGM96), always_xy=True).transform(*vertices.T)
    assert found == pytest.approx(np.column_stack(wanted), abs=0.001)


def test_every_field_is_in_the_dictionary_with_one_meaning(conetl, conn, mapped, tmp_path):
    named = set()
    for what in ("features", "history", "changes"):
        for name in FORMATS:
            path = tmp_path / f"{what}{FORMATS[name].suffix}"
            manifest = json.loads(conetl("map", "export", "--format", name, "--out", path, "--what", what, "--json"))[
                "manifest"
            ]
            named |= set(manifest["columns"])
        named |= set((tmp_path / f"{what}.csv").read_text().splitlines()[0].split(","))
    conetl("map", "diff", 1, 2, "--out", tmp_path / "diff.geojson")
    features = json.loads((tmp_path / "diff.geojson").read_text())["features"]
    named |= set(features[0]["properties"])
    assert all(f["properties"]["drive_id"] and f["properties"]["sigma_e_m"] > 0 for f in features)
    assert all(f["properties"]["changeset_no"] == 2 for f in features)
    conetl("map", "qgis", "--out", tmp_path / "cones.qgs")
    named |= {alias.get("field") for alias in ET.parse(tmp_path / "cones.qgs").iter("alias")} - {"version_row_id"}
    for collection, (_, _, columns, _) in COLLECTIONS.items():
        if collection != "differences":  # from plans: not of features
            named |= set(columns)
    assert named - set(BY_NAME) == set()
    page = as_markdown()
    assert all(f"| `{name}` |" in page for name in BY_NAME)


def test_qgis_shows_standing_cones_only_and_names_its_fields(conetl, conn, mapped, tmp_path):
    conetl("map", "qgis", "--out", tmp_path / "cones.qgs")
    project = ET.parse(tmp_path / "cones.qgs")
    layer = project.find(".//maplayer")
    aliases = {alias.get("field"): alias.get("name") for alias in layer.find("aliases")}
    assert aliases["object_height_m"] == "Height of the object [m]" and all(
        name for field, name in aliases.items() if field != "version_row_id"
    )
    statement = re.search(r'table="\((.*)\)" \(geom\)', layer.find("datasource").text)[1]
    rows = execute(conn, statement)
    conn.rollback()
    assert sorted(row["feature_id"] for row in rows) == sorted(str(f.feature_id) for f in mapped)


def test_changes_without_a_range_are_the_whole_history(conetl, conn, mapped, tmp_path):
    written = json.loads(conetl("map", "export", "--what", "changes", "--out", tmp_path / "a.csv", "--json"))
    rows = list(csv.DictReader((tmp_path / "a.csv").open()))
    assert written["changes"] == len(rows) >= len(mapped) and {row["change"] for row in rows} == {"added"}


def test_a_date_is_its_whole_day(conetl, mapped, tmp_path):
    """The first drive was on the second of March, in the morning."""
    assert f": {len(mapped)} cones" not in conetl("map", "show", "--as-of", "2026-03-01")
    assert len(json.loads(conetl("map", "show", "--as-of", "2026-03-02", "--json"))["features"]) > 0
    assert len(json.loads(conetl("map", "show", "--as-of", "2026-03-02T00:00", "--json"))["features"]) == 0
    changes = (
        "map",
        "export",
        "--what",
        "changes",
        "--out",
        tmp_path / "a.csv",
        "--json",
        "--to",
        "2026-03-02",
        "--from",
    )
    assert json.loads(conetl(*changes, "2026-03-02"))["changes"] > 0
    for day in ("2026-03-02", "2026-W10-1", "20260302"):
        assert {change["kind"] for change in json.loads(conetl("map", "diff", day, day, "--json"))} == {"added"}
