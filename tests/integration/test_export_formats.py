"""Every format in the programs that read it: equal counts, positions within a millimetre, times to the microsecond."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

import duckdb
import geopandas
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import shapely
from jsonschema import validate
from mcap.reader import make_reader
from pyproj import Transformer

from conetl.db.connection import execute
from conetl.db.map.import_store import set_licence
from conetl.db.map.map_store import read_features_as_of, require_map
from conetl.exports import FORMATS, text_files
from conetl.exports.export import export_map
from conetl.exports.source import ExportContent, ExportRequest
from conetl.exports.text_files import iso_utc
from conetl.model.errors import InputError
from conetl.model.params import ImportParams
from conetl.pipeline.nightly_publication import write_publication
from conetl.readers.maps.imported_rows import read_map_file
from tests.integration.drives_of_days import DAY_NS, START_NS, merge, survey
from tests.integration.test_reports import assert_loads_nothing

NOON = [datetime.fromtimestamp((START_NS + day * DAY_NS) / 1e9 + 7200, UTC) for day in range(4)]
TO_MAP = Transformer.from_crs(4326, 32632, always_xy=True)
WHATS = {
    ExportContent.FEATURES: ExportRequest(),
    ExportContent.HISTORY: ExportRequest(what=ExportContent.HISTORY),
    ExportContent.CHANGES: ExportRequest(what=ExportContent.CHANGES, since=NOON[0], until=NOON[2]),
}


@pytest.fixture(scope="module")
def conn(another_database):
    """A map of three drives, the second one late: some versions were replaced."""
    with another_database() as connection:
        for day in (0, 2, 1):
            merge(connection, survey(day))
        set_licence(connection, "default", "CC BY 4.0, Roads of Nowhere")
        yield connection


def export_all(conn, folder):
    """Manifests of exports of everything in every format."""
    return {
        (what, name): export_map(conn, folder / f"{what}{FORMATS[name].suffix}", name, request)
        for what, request in WHATS.items()
        for name in FORMATS
    }


@pytest.fixture(scope="module")
def files(conn, tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    manifests = export_all(conn, folder)
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]
    return folder, manifests


def rows_of(conn, what):
    """(position, valid_from) of the expected rows, from the tables, sorted."""
    where = (
        "upper_inf(system_period) and upper_inf(valid_period) and present" if what is ExportContent.FEATURES else "true"
    )
    rows = execute(
        conn,
        f"select ST_X(geom) x, ST_Y(geom) y, ST_Z(geom) z, lower(valid_period) t from conetl.feature_version where {where}",
    )
    conn.rollback()
    return np.array(sorted((row["x"], row["y"], row["z"], microseconds(row["t"])) for row in rows))


def microseconds(instant):
    return (instant - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1)


def same(found, wanted):
    found = np.array(sorted(found))
    assert found.shape == wanted.shape
    assert np.abs(found[:, :3] - wanted[:, :3]).max() < 0.001
    assert (found[:, 3] == wanted[:, 3]).all()


def duckdb_spatial():
    """DuckDB with its spatial extension from the package that contains it."""
    connection = duckdb.connect()
    [extension] = resources.files("duckdb_extension_spatial").joinpath("extensions").glob("*/spatial.duckdb_extension")
    connection.execute(f"load '{extension}'")
    return connection


@pytest.mark.parametrize("what", [ExportContent.FEATURES, ExportContent.HISTORY])
def test_geoparquet_in_geopandas_and_duckdb(conn, files, what):
    path = files[0] / f"{what}.parquet"
    wanted = rows_of(conn, what)
    frame = geopandas.read_parquet(path)
    assert frame.crs.to_epsg() == 32632
    times = [microseconds(t.to_pydatetime()) for t in frame["valid_from"]]
    same([(p.x, p.y, p.z, t) for p, t in zip(frame.geometry, times, strict=True)], wanted)
    duck = duckdb_spatial().execute(
        "select ST_X(geometry), ST_Y(geometry), ST_Z(geometry), epoch_us(valid_from), bbox.xmin, bbox.ymax, typeof(geometry) "
        f"from '{path}'"
    )
    rows = duck.fetchall()
    same([row[:4] for row in rows], wanted)
    assert all(row[:2] == row[4:6] for row in rows)
    assert {row[6] for row in rows} == {"GEOMETRY('EPSG:32632')"}
    west, south = wanted[:, 0].min(), wanted[:, 1].min()
    one = geopandas.read_parquet(path, bbox=(west - 0.01, south - 1e3, west + 0.01, south + 1e3))
    assert 1 <= len(one) < len(wanted)


def test_geoparquet_metadata_follows_the_standard(files):
    file = pq.ParquetFile(files[0] / "features.parquet")
    geo = json.loads(file.metadata.metadata[b"geo"])
    assert (geo["version"], geo["primary_column"]) == ("1.1.0", "geometry")
    column = geo["columns"]["geometry"]
    assert (column["encoding"], column["geometry_types"]) == ("WKB", ["Point Z"])
    assert column["crs"]["id"] == {"authority": "EPSG", "code": 32632}
    assert column["covering"]["bbox"]["xmax"] == ["bbox", "xmax"]
    assert len(column["bbox"]) == 6
    assert str(file.schema_arrow.field("last_seen_at").type) == "timestamp[us, tz=UTC]"


@pytest.mark.parametrize("what", [ExportContent.FEATURES, ExportContent.HISTORY])
@pytest.mark.parametrize("suffix", ["gpkg", "fgb"])
def test_geopackage_and_flatgeobuf_in_gdal(conn, files, what, suffix):
    path = files[0] / f"{what}.{suffix}"
    info = pyogrio.read_info(path)
    assert info["crs"] == "EPSG:32632" and info["geometry_type"] == "Point Z" and info["layer_name"] == "default"
    frame = pyogrio.read_dataframe(path)
    same([(p.x, p.y, p.z, t) for p, t in zip(frame.geometry, frame["valid_from_us"], strict=True)], rows_of(conn, what))
    shown = [microseconds(t.to_pydatetime()) for t in frame["valid_from"]]
    assert np.abs(np.array(shown) - frame["valid_from_us"]).max() < 1000  # GDAL's own times hold milliseconds


def test_a_geopackage_follows_the_standard(files):
    """OGC 12-128r19: requirements 2, 6, 7 and 15, and the spatial index."""
    with closing(sqlite3.connect(files[0] / "features.gpkg")) as file:
        one = [file.execute(f"pragma {name}").fetchone()[0] for name in ("application_id", "integrity_check")]
        assert one == [0x47504B47, "ok"] and file.execute("pragma foreign_key_check").fetchall() == []
        [(changed, srs)] = file.execute("select last_change, srs_id from gpkg_contents where table_name = 'default'")
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", changed) and srs == 32632
        extensions = [name for (name,) in file.execute("select extension_name from gpkg_extensions")]
        assert extensions == ["gpkg_rtree_index"]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("file_format", "suffix"), [("gpkg", ".gpkg"), ("flatgeobuf", ".fgb")])
def test_a_file_of_any_name_is_the_same_file(conn, files, tmp_path, file_format, suffix):
    """GDAL makes a folder of a FlatGeobuf with another suffix, and warns of such a GeoPackage."""
    manifest = export_map(conn, tmp_path / "map.dat", file_format, WHATS[ExportContent.FEATURES])
    assert (tmp_path / "map.dat").read_bytes() == (files[0] / f"features{suffix}").read_bytes()
    assert manifest["sha256"] == files[1][ExportContent.FEATURES, file_format]["sha256"]


def test_text_formats(conn, files):
    folder, _ = files
    for what in (ExportContent.FEATURES, ExportContent.HISTORY):
        wanted = rows_of(conn, what)
        features = json.loads((folder / f"{what}.geojson").read_text())["features"]
        places = [(*f["geometry"]["coordinates"], f["properties"]["valid_from"]) for f in features]
        same([(*TO_MAP.transform(lon, lat), z, parsed(t)) for lon, lat, z, t in places], wanted)
        with (folder / f"{what}.csv").open(newline="") as file:
            lines = list(csv.DictReader(file))
        names = ("easting_m", "northing_m", "ellipsoidal_height_m")
        same([(*(float(line[name]) for name in names), parsed(line["valid_from"])) for line in lines], wanted)
        nodes = ElementTree.parse(folder / f"{what}.osm").getroot().findall("node")
        found = []
        for node in nodes:
            tags = {tag.get("k"): tag.get("v") for tag in node.findall("tag")}
            xy = TO_MAP.transform(float(node.get("lon")), float(node.get("lat")))
            found.append((*xy, float(tags["ele"]), parsed(tags["valid_from"])))
        same(found, wanted)
        assert len({node.get("id") for node in nodes}) == len(nodes)
        assert all(int(node.get("id")) < 0 for node in nodes)


def parsed(text):
    return microseconds(datetime.fromisoformat(text))


def scene(path):
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            value = json.loads(message.data)
            validate(value, json.loads(schema.data))
            yield channel.topic, message.log_time, value


def test_the_scene_in_mcap(conn, files):
    messages = list(scene(files[0] / "features.mcap"))
    [origin] = [value["translation"] for topic, _, value in messages if topic == "/tf"]
    [fix] = [value for topic, _, value in messages if topic == "/origin"]
    assert TO_MAP.transform(fix["longitude"], fix["latitude"]) == pytest.approx((origin["x"], origin["y"]), abs=0.001)
    entities = [entity for topic, _, value in messages if topic == "/cones" for entity in value["entities"]]
    found = []
    for entity in entities:
        [cylinder] = entity["cylinders"]
        position, size = cylinder["pose"]["position"], cylinder["size"]
        known = {pair["key"]: pair["value"] for pair in entity["metadata"]}
        assert size["z"] == float(known["object_height_m"])
        place = (position["x"] + origin["x"], position["y"] + origin["y"], position["z"] - size["z"] / 2 + origin["z"])
        found.append((*place, parsed(known["valid_from"])))
    same(found, rows_of(conn, ExportContent.FEATURES))
    colours = {tuple(round(e["cylinders"][0]["color"][c], 2) for c in "rgb") for e in entities}
    assert len(colours) >= 2  # some are new, some confirmed


def test_moves_are_arrows_to_the_new_position_in_mcap(conn, tmp_path):
    asked = ExportRequest(what=ExportContent.CHANGES, since=NOON[0], until=NOON[1])
    for name in ("mcap", "geoparquet"):
        export_map(conn, tmp_path / f"changes.{name}", name, asked)
    [(log_time, value)] = [(at, value) for topic, at, value in scene(tmp_path / "changes.mcap") if topic == "/cones"]
    assert log_time == microseconds(NOON[1]) * 1000
    rows = geopandas.read_parquet(tmp_path / "changes.geoparquet").set_index("feature_id")
    moved = rows[rows["change"] == "moved"]
    arrows = {
        entity["id"]: (entity["arrows"], entity["cylinders"][0]) for entity in value["entities"] if entity["arrows"]
    }
    assert arrows.keys() == set(moved.index) != set()
    for feature_id, ([arrow], cone) in arrows.items():
        row, start, turn = moved.loc[feature_id], arrow["pose"]["position"], arrow["pose"]["orientation"]
        length_m, heading = arrow["shaft_length"] + arrow["head_length"], 2 * math.atan2(turn["z"], turn["w"])
        end = (start["x"] + length_m * math.cos(heading), start["y"] + length_m * math.sin(heading))
        assert end == pytest.approx([cone["pose"]["position"][axis] for axis in "xy"], abs=1e-6)
        old_m = (row["old_easting_m"], row["old_northing_m"])
        assert length_m == pytest.approx(math.dist(old_m, (row.geometry.x, row.geometry.y)), abs=1e-6)


def test_a_history_plays_in_mcap(conn, files):
    """At the end the scene equals the current map."""
    standing = {}
    last = 0
    for topic, log_time, value in scene(files[0] / "history.mcap"):
        assert log_time >= last
        last = log_time
        if topic == "/cones":
            for deletion in value["deletions"]:
                del standing[deletion["id"]]
            standing |= {entity["id"]: entity for entity in value["entities"]}
    now = execute(conn, "select feature_id::text as id from conetl.current_feature")
    conn.rollback()
    assert set(standing) == {row["id"] for row in now}


def test_an_earlier_database_state_can_be_exported(conn, tmp_path):
    [first] = execute(conn, "select min(committed_at) as at from conetl.changeset")
    conn.rollback()
    manifest = export_map(conn, tmp_path / "old.parquet", "geoparquet", ExportRequest(known_at=first["at"]))
    assert manifest["rows"] == len(list(read_features_as_of(conn, known_at=first["at"]))) != 0
    assert (manifest["known_at"], manifest["as_of"]) == (iso_utc(first["at"]), None)
    conn.rollback()
    history = ExportRequest(what=ExportContent.HISTORY, known_at=first["at"])
    assert export_map(conn, tmp_path / "h.csv", "csv", history)["rows"] == manifest["rows"]


def test_the_manifest(files):
    folder, manifests = files
    for (what, name), manifest in manifests.items():
        path = folder / f"{what}{FORMATS[name].suffix}"
        assert json.loads(Path(f"{path}.manifest.json").read_text()) == manifest
        assert manifest["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        assert manifest["licence"] == "CC BY 4.0, Roads of Nowhere"
        assert manifest["crs"] == ("OGC:CRS84" if FORMATS[name].geographic else "EPSG:32632")
        assert manifest["map"] == "default" and manifest["what"] == what and manifest["rows"] > 0


def test_contradicting_requests_are_refused(conn, tmp_path):
    for request, message in (
        (ExportRequest("nowhere"), "no map named nowhere"),
        (ExportRequest(since=NOON[0]), "--what changes"),
        (ExportRequest(what=ExportContent.HISTORY, as_of=NOON[0]), "--as-of"),
        (ExportRequest(what=ExportContent.CHANGES, since=NOON[1], until=NOON[0]), "the end is before the beginning"),
    ):
        with pytest.raises(InputError, match=message):
            export_map(conn, tmp_path / "out.parquet", "geoparquet", request)
    with pytest.raises(InputError, match="unknown format kml"):
        export_map(conn, tmp_path / "out.kml", "kml", ExportRequest())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["gpkg", "geoparquet", "geojson", "mcap"])
def test_a_failing_export_leaves_the_old_files(conn, tmp_path, monkeypatch, name):
    path = tmp_path / f"map{FORMATS[name].suffix}"
    export_map(conn, path, name, ExportRequest())
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def broken(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("conetl.db.arrow_rows.csv.open_csv", broken)
    with pytest.raises(KeyboardInterrupt):
        export_map(conn, path, name, ExportRequest())
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_a_publication_is_whole_or_not_at_all(conn, tmp_path, monkeypatch):
    info = require_map(conn, "default")
    published, manifests, _ = write_publication(conn, info, ["geojson", "geoparquet"], tmp_path)
    latest = tmp_path / "latest"
    assert latest.resolve() == published
    maps = {f"default.{suffix}{more}" for suffix in ("geojson", "parquet") for more in ("", ".manifest.json")}
    assert {p.name for p in latest.iterdir()} == maps | {"publication.json", "report.html"}
    assert json.loads((latest / "publication.json").read_text())["report"] == "report.html"
    assert_loads_nothing((latest / "report.html").read_text())
    assert [m["rows"] for m in manifests] == [manifests[0]["rows"]] * 2
    assert [m["known_at"] for m in manifests] == [iso_utc(info.last_committed_at)] * 2, "one state of the map"
    monkeypatch.setattr(text_files, "write_features", lambda source, path: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_publication(conn, info, ["geoparquet", "geojson"], tmp_path)
    with pytest.raises(InputError, match="kml"):
        write_publication(conn, info, ["kml"], tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([published.name, "latest"])
    assert latest.resolve() == published


@pytest.fixture(scope="module")
def lined(another_database, samples, tmp_path_factory):
    """A map of a cone, a solid line that moves and a dashed one that ends, in every format; the standing line and the files."""
    at_m, day = (458_001.0, 5_428_010.0, 114.5), START_NS + DAY_NS

    def line(name, off_m, **paint):
        return samples.line_feature(
            samples.marking(np.add(at_m, np.linspace((0, off_m, 0), (8, off_m + 6, 0.2), 5)), **paint), name
        )

    solid, moved = line("solid", 0.0), line("solid", 0.7, colour="yellow")
    dashed = line("dashed", 3.5, pattern="dashed", dash_m=3.0, gap_m=9.0)
    shapes = [samples.marking_track(solid.marking)]
    changes = {name: getattr(moved, name) for name in ("marking", "xyz_m", "centre_xyz_m", "last_seen_ns")}
    folder = tmp_path_factory.mktemp("lined")
    with another_database() as conn:
        first = [samples.added(one) for one in (samples.feature(), solid, dashed)]
        samples.commit(conn, *first, key="1", start_ns=START_NS, markings=shapes)
        later = [samples.changed("moved", solid, day, **changes), samples.removed(dashed, day)]
        samples.commit(conn, *later, key="2", start_ns=day, markings=shapes)
        manifests = export_all(conn, folder)
        only = ExportRequest(category="lane_marking", crs=(32633, None))
        assert export_map(conn, folder / "only.parquet", "geoparquet", only)["rows"] == 1
        assert export_map(conn, folder / "cones.gpkg", "gpkg", ExportRequest(category="traffic_cone"))["rows"] == 1
    return moved.marking, folder, manifests


@pytest.mark.parametrize("what", list(ExportContent))
def test_lane_markings_are_lines_beside_the_points(lined, what):
    """One layer or file per type of geometry; the same lines in all of them."""
    shape, folder, manifests = lined
    rows = {ExportContent.FEATURES: 1, ExportContent.HISTORY: 6, ExportContent.CHANGES: 2}[what]
    beside = {"geoparquet", "csv", "flatgeobuf"}
    for name in FORMATS:
        manifest = manifests[what, name]
        lines = manifest["lane_markings"]
        suffix = FORMATS[name].suffix
        replaced = 2 if (what, name) == (ExportContent.HISTORY, "mcap") else 0  # which plays one state of the database
        assert lines["rows"] == rows - replaced
        assert lines["file"] == (f"{what}_lane_markings{suffix}" if name in beside else f"{what}{suffix}")
        columns = set(lines["columns"])
        assert {"width_m", "pattern", "sigma_lateral_m"} <= columns and "object_height_m" not in columns
        assert {"width_m", "line"}.isdisjoint(manifest["columns"])

    frames = {
        "parquet": geopandas.read_parquet(folder / f"{what}_lane_markings.parquet"),
        "fgb": pyogrio.read_dataframe(folder / f"{what}_lane_markings.fgb"),
        "gpkg": pyogrio.read_dataframe(folder / f"{what}.gpkg", layer="lane_markings"),
    }
    wanted = np.array(shape.vertices_m)
    for frame in frames.values():
        assert len(frame) == rows and set(frame.geom_type) == {"LineString"}
        [line] = frame.geometry[frame["colour"] == "yellow"]
        assert np.abs(shapely.get_coordinates(line, include_z=True) - wanted).max() < 1e-6
    assert (
        len(pyogrio.read_dataframe(folder / f"{what}.gpkg", layer="default")) == manifests[what, "gpkg"]["rows"] - rows
    )

    features = json.loads((folder / f"{what}.geojson").read_text())["features"]
    found = [f for f in features if f["geometry"]["type"] == "LineString"]
    [yellow] = [f for f in found if f["properties"]["colour"] == "yellow"]
    lon_lat = np.array(yellow["geometry"]["coordinates"])
    assert np.abs(np.stack(TO_MAP.transform(*lon_lat[:, :2].T), axis=1) - wanted[:, :2]).max() < 0.001
    assert len(found) == rows and "object_height_m" not in yellow["properties"]
    assert yellow["properties"]["length_m"] == pytest.approx(np.linalg.norm(np.ptp(wanted, axis=0)), abs=1e-4)
    with (folder / f"{what}_lane_markings.csv").open(newline="") as file:
        lines = [shapely.from_wkt(row["WKT"]) for row in csv.DictReader(file)]
    assert len(lines) == rows and any(np.allclose(shapely.get_coordinates(g, include_z=True), lon_lat) for g in lines)

    ways = ElementTree.parse(folder / f"{what}.osm").getroot().findall("way")
    kinds = [{tag.get("k"): tag.get("v") for tag in way.findall("tag")} for way in ways]
    assert len(ways) == rows and {kind["type"] for kind in kinds} == {"line_thin"}
    assert {(kind["subtype"], kind["width"]) for kind in kinds} <= {("solid", "0.12"), ("dashed", "0.12")}
    assert all(len(way.findall("nd")) == 5 for way in ways)


def test_lane_markings_in_mcap_have_their_width_and_dashes(lined):
    shape, folder, _ = lined
    messages = list(scene(folder / "history.mcap"))
    [origin] = [value["translation"] for topic, _, value in messages if topic == "/tf"]
    entities = [e for topic, _, value in messages if topic == "/lane_markings" for e in value["entities"]]
    lines = [[(part["thickness"], len(part["points"])) for part in e["lines"]] for e in entities]
    assert sorted(lines) == sorted([[(0.12, 5)], [(0.12, 5)], [(0.12, 3)]])  # one dash of 3 m about the middle of 10 m
    last = entities[-1]["lines"][0]["points"]
    at = np.array([[p[axis] + origin[axis] for axis in "xyz"] for p in last])
    assert np.abs(at - np.array(shape.vertices_m)).max() < 1e-6
    gone = [d for topic, _, value in messages if topic == "/lane_markings" for d in value["deletions"]]
    assert len(gone) == 1


def test_one_class_alone_and_in_another_crs(lined):
    shape, folder, _ = lined
    frame = geopandas.read_parquet(folder / "only.parquet")
    assert frame.crs.to_epsg() == 32633
    [line] = frame.geometry
    to_map = Transformer.from_crs(32633, 32632, always_xy=True)
    xyz_m = np.stack(to_map.transform(*shapely.get_coordinates(line, include_z=True).T), axis=1)
    assert np.abs(xyz_m - np.array(shape.vertices_m)).max() < 0.001
    assert list(pyogrio.list_layers(folder / "cones.gpkg")[:, 0]) == ["default"]
    assert not (folder / "only_lane_markings.parquet").exists()


def test_an_import_leaves_lane_markings_out(lined):
    _, folder, manifests = lined
    found = read_map_file(folder / "features.geojson", ImportParams(), map_srid=32632)
    assert (len(found.statements), found.lines_left_out) == (
        manifests[ExportContent.FEATURES, "geojson"]["rows"] - 1,
        1,
    )
    assert read_map_file(folder / "features.parquet", ImportParams()).lines_left_out == 0
