"""A map of others as a beginning: whole and right, or refused by row with nothing written."""

from __future__ import annotations

import csv
import json
import math
import struct
from datetime import UTC, datetime
from itertools import permutations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from conetl.errors import InputError
from conetl.io.db import connect, execute
from conetl.io.exports import FORMATS
from conetl.io.exports.export import export_map
from conetl.io.exports.source import ExportRequest
from conetl.io.imports.statements import read_map_file
from conetl.io.stores.audits import run_audits
from conetl.io.stores.map_store import list_changesets, read_current_features, read_features_as_of
from conetl.map_records import DeltaKind
from conetl.params import ImportParams
from flows.import_map import import_map
from tests.conftest import cloned_database
from tests.integration.drives_of_days import DAY_NS, DAYS, START_NS, merge, survey, valid_time_map

IMPORTABLE = [name for name in FORMATS if name not in ("mcap", "lanelet2", "wzdx")]
PARAMS = ImportParams()


def audited(conn):
    return [result for result in run_audits(conn) if not result.passed]


def take(conn, path, *, params=PARAMS, map_name="default", **options):
    read = read_map_file(path, params, **({"map_srid": 32632} | options))
    return import_map(conn, read, params, map_name=map_name)


@pytest.fixture(scope="module")
def surveyed(cluster_url, template_database, tmp_path_factory):
    """Files of a map of two drives, one a format, and its features."""
    folder = tmp_path_factory.mktemp("exports")
    with cloned_database(cluster_url, template_database) as url:
        conn = connect(url)
        for day in range(2):
            merge(conn, survey(day))
        for name in IMPORTABLE:
            export_map(conn, folder / f"map{FORMATS[name].suffix}", name, ExportRequest())
        features = read_current_features(conn)
        conn.close()
    return folder, features


@pytest.mark.parametrize("name", IMPORTABLE)
def test_an_exported_map_comes_back(conn, surveyed, name):
    folder, features = surveyed
    done = take(conn, folder / f"map{FORMATS[name].suffix}")
    assert (done.committed, done.counts[DeltaKind.ADDED], done.replayed) == (True, len(features), 0)
    back = read_current_features(conn)
    assert [f.feature_id for f in back] == [f.feature_id for f in features]
    for one, other in zip(back, features, strict=True):
        assert one.xyz_m == pytest.approx(other.xyz_m, abs=0.001)
        assert np.sqrt([one.cov_m2[i] for i in (0, 3, 5)]) == pytest.approx(
            np.sqrt([other.cov_m2[i] for i in (0, 3, 5)]), abs=1e-4
        )
        assert one.existence_probability == pytest.approx(other.existence_probability, abs=1e-6)
        assert (one.cone_height_m, one.observation_count) == (
            pytest.approx(other.cone_height_m, abs=1e-4),
            other.observation_count,
        )
        assert abs(one.last_seen_ns - other.last_seen_ns) < 1000
        if name not in ("geojson", "csv"):  # which round, and have no correlations
            assert one.cov_m2 == pytest.approx(other.cov_m2, rel=1e-12)
    assert audited(conn) == []
    assert not take(conn, folder / f"map{FORMATS[name].suffix}").committed
    assert len(list_changesets(conn)) == 1


def test_drives_confirm_move_and_remove_imported_cones(conn, tmp_path):
    """A cone list of the first day, the drive of the second: as if a drive had been there."""
    path = tmp_path / "plan.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["easting_m", "northing_m", "ellipsoidal_height_m", "height_m", "sigma_e_m", "sigma_n_m", "sigma_u_m"]
        )
        for cone in DAYS[0]:
            writer.writerow([*place_of(cone), cone.height_m, 0.05, 0.05, 0.05])
    day = datetime.fromtimestamp(START_NS / 1e9, UTC)
    with pytest.raises(InputError, match="--surveyed-at"):
        take(conn, path, crs="EPSG:32632")
    take(conn, path, crs="EPSG:32632", stated_at=day)
    merged = merge(conn, survey(1))
    kinds = {kind: sum(d.kind is kind for d in merged.changeset.deltas) for kind in DeltaKind}
    assert kinds[DeltaKind.CONFIRMED] >= 4
    assert (kinds[DeltaKind.MOVED], kinds[DeltaKind.REMOVED], kinds[DeltaKind.ADDED]) == (1, 1, 0)
    assert audited(conn) == []


def test_an_import_saw_no_cone(conn, surveyed):
    """`conetl map show` counts drives, as the web view, OGC API and exports do."""
    take(conn, surveyed[0] / "map.parquet")
    shown = list(read_features_as_of(conn))
    conn.rollback()
    assert {v.seen_count for v in shown} == {0}
    merge(conn, survey(2))
    shown = list(read_features_as_of(conn))
    evidence = execute(
        conn,
        "select f.feature_id, e.seen_count from conetl.current_feature f, conetl.feature_evidence(f.feature_id, f.version) e",
    )
    assert {v.feature.feature_id: v.seen_count for v in shown} == {
        row["feature_id"]: row["seen_count"] for row in evidence
    }
    assert 1 in {v.seen_count for v in shown}


def place_of(cone):
    from tests.synthetic.world import ORIGIN_M

    return [round(a + b, 4) for a, b in zip(ORIGIN_M, cone.foot_m, strict=True)]


def test_an_import_has_its_place_in_time_whatever_comes_first(cluster_url, template_database, tmp_path):
    """Two drives and an import between them, in all orders: one map."""
    path = tmp_path / "between.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["feature_id", "easting_m", "northing_m", "ellipsoidal_height_m", "sigma_e_m", "sigma_n_m", "sigma_u_m"]
        )
        for number, cone in enumerate([*DAYS[0][:5], *DAYS[2][-1:]]):
            writer.writerow([f"00000000-0000-4000-8000-00000000000{number}", *place_of(cone), 0.1, 0.1, 0.1])
    stated_at = datetime.fromtimestamp((START_NS + DAY_NS // 2) / 1e9, UTC)
    events = {
        "a": lambda conn: merge(conn, survey(0)),
        "b": lambda conn: merge(conn, survey(1)),
        "import": lambda conn: take(conn, path, crs="EPSG:32632", stated_at=stated_at),
    }
    maps = []
    for order in permutations(events):
        with cloned_database(cluster_url, template_database) as url:
            conn = connect(url)
            for name in order:
                events[name](conn)
            assert audited(conn) == []
            maps.append(valid_time_map(conn))
            conn.close()
    assert maps[0]["versions"]
    assert all(found == maps[0] for found in maps)


def test_an_import_is_reverted_and_brought_back(conn, surveyed):
    from flows.decide import revert

    folder, features = surveyed
    take(conn, folder / "map.parquet")
    before = valid_time_map(conn)
    decision = revert(conn, "1", map_name="default")
    assert read_current_features(conn) == []
    conn.rollback()
    revert(conn, str(decision.decision_id), map_name="default")
    assert valid_time_map(conn) == before
    assert len(read_current_features(conn)) == len(features)
    assert audited(conn) == []


def test_ids_are_unique_in_a_database(conn, surveyed):
    folder, features = surveyed
    take(conn, folder / "map.parquet")
    with pytest.raises(InputError, match=r"row 1: feature .* belongs to the map default .*--new-ids"):
        take(conn, folder / "map.parquet", map_name="copy")
    assert take(conn, folder / "map.parquet", map_name="copy", params=ImportParams(new_ids=True)).committed
    assert len(read_current_features(conn, map_name="copy")) == len(features)


# --------------------------------------------------------------------------- bad files


def geojson(path, rows, **members):
    features = [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": place}, "properties": properties}
        for place, properties in rows
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features} | members))
    return path


GOOD = ([8.43, 49.01, 115.0], {"last_seen_at": "2026-03-01T08:00:00Z"})
OTHER = [8.431, 49.01, 115.0]
SEEN = GOOD[1]
ID = "7d0f4a53-29c9-4f3b-8f0e-0c1f3e0f2d11"
BAD = {
    "not a number": ([math.nan, 49.01, 115.0], SEEN, "row 2: no numbers where a point is expected"),
    "swapped": ([49.01, 8.431, 115.0], SEEN, r"row 2: .*swapped"),
    "swapped, out of range": ([-33.0, 151.2, 20.0], SEEN, r"row 2: .*swapped"),
    "no degrees": ([458000.0, 5428000.0, 115.0], SEEN, r"row 2: .*--crs wrong"),
    "elsewhere": ([120.0, 49.01, 115.0], SEEN, r"row 2: .*outside the area of the map's CRS EPSG:32632"),
    "no height": (OTHER[:2], SEEN, r"row 2: .*--ground-height-m"),
    "existence": (OTHER, SEEN | {"existence_probability": 1.2}, r"row 2: existence_probability is 1.2"),
    "negative sigma": (OTHER, SEEN | {"sigma_e_m": -0.1}, r"row 2: sigma_e_m is -0.1"),
    "no sigma": (OTHER, SEEN | {"sigma_u_m": 0.0}, r"row 2: sigma_u_m is 0"),
    "no time": (OTHER, SEEN | {"first_seen_at": "yesterday"}, r"row 2: first_seen_at is 'yesterday'"),
    "times crossed": (OTHER, SEEN | {"first_seen_at": "2026-03-02T08:00:00Z"}, "row 2: first_seen_at, last_seen_at"),
    "same place": (GOOD[0], SEEN, "row 2: the same place as row 1"),
    "no uuid": (OTHER, SEEN | {"feature_id": "cone 7"}, "row 1: feature_id is None|row 2: feature_id is 'cone 7'"),
}


def nothing_written(conn):
    tables = ("map", "drive", "feature", "statement")
    counts = f"select {' + '.join(f'(select count(*) from conetl.{table})' for table in tables)} as n"
    written = execute(conn, counts)[0]["n"]
    conn.rollback()
    return written == 0


@pytest.mark.parametrize("name", BAD)
def test_a_bad_row_is_named_and_nothing_written(conn, tmp_path, name):
    place, properties, message = BAD[name]
    path = geojson(tmp_path / "bad.geojson", [GOOD, (place, properties)])
    with pytest.raises(InputError, match=message):
        take(conn, path)
    assert nothing_written(conn)
    assert take(conn, geojson(tmp_path / "good.geojson", [GOOD, (OTHER, SEEN)])).committed


def test_ids_that_come_twice_are_named(conn, tmp_path):
    path = geojson(tmp_path / "bad.geojson", [(GOOD[0], SEEN | {"feature_id": ID}), (OTHER, SEEN | {"feature_id": ID})])
    with pytest.raises(InputError, match=f"row 2: feature_id {ID} stands in row 1 already"):
        take(conn, path)
    assert nothing_written(conn)


def test_files_that_are_none(conn, tmp_path, surveyed):
    folder, _ = surveyed

    def refused(name, content, message, **options):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=message):
            take(conn, path, **options)

    refused("empty.geojson", b"", "is empty")
    refused("none.geojson", b'{"type": "FeatureCollection", "features": []}', "no features|cannot be read")
    refused("cut.gpkg", (folder / "map.gpkg").read_bytes()[:3000], "cannot be read")
    refused("cut.parquet", (folder / "map.parquet").read_bytes()[:-100], "cannot be read as GeoParquet")
    refused("text.fgb", b"no FlatGeobuf at all", "no FlatGeobuf")
    header = (folder / "map.fgb").read_bytes()
    refused(
        "claim.fgb", header[:8] + struct.pack("<I", 0xFFFFFFF0) + header[12:], "claims a header of 4294967280 bytes"
    )
    refused("noheader.csv", b"a,b\n1,2\n", "no columns lon_deg")
    refused("two.csv", b"lon;lat\n8.4;49\n", "height of the ground .* and for which time it speaks")
    refused("comma.csv", b"Longitude;Latitude\n8,4;49\n", "row 1: lon_deg is '8,4', which is no number")
    refused("ragged.csv", b"lon_deg,lat_deg\n8.4,49\n8.4\n", "row 2: 1 values where the header has 2")
    refused("crs.csv", b"easting_m,northing_m\n458000,5428000\n", "state it")
    refused("map.kml", b"<kml/>", "can be imported from")
    refused("other.gpkg", (folder / "map.gpkg").read_bytes(), "which is right", crs="EPSG:32633")
    pq.write_table(pa.table({"a": [1]}), tmp_path / "plain.parquet")
    refused("plain2.parquet", (tmp_path / "plain.parquet").read_bytes(), "no `geo` metadata")
    assert nothing_written(conn)


def test_a_file_that_claims_gigabytes_is_not_believed(tmp_path):
    """A geometry column of equal bytes: 3 GB of them are a few kB of Parquet."""
    geo = {"primary_column": "geometry", "columns": {"geometry": {"encoding": "WKB"}}}
    schema = pa.schema({"geometry": pa.large_binary()}, {"geo": json.dumps(geo)})
    with pq.ParquetWriter(tmp_path / "bomb.parquet", schema, compression="zstd", use_dictionary=False) as writer:
        page = pa.table([pa.array([b"\0" * (64 << 20)], pa.large_binary())], schema=schema)
        for _ in range(40):
            writer.write_table(page)
    assert (tmp_path / "bomb.parquet").stat().st_size < 1 << 20
    with pytest.raises(InputError, match="claims to hold more than 2 GiB"):
        read_map_file(tmp_path / "bomb.parquet", PARAMS, map_srid=32632)


def test_a_new_map_wants_its_crs_stated(tmp_path):
    path = geojson(tmp_path / "good.geojson", [GOOD])
    with pytest.raises(InputError, match=r"--map-srid.*longitude 8\.4300, latitude 49\.0100, would be in EPSG:32632"):
        read_map_file(path, PARAMS)


def test_the_browser_shows_a_map_that_began_with_an_import(conn, database_url, surveyed):
    from fastapi.testclient import TestClient

    from conetl.web.app import create_app

    folder, features = surveyed
    take(conn, folder / "map.parquet")
    [changeset] = list_changesets(conn)
    conn.rollback()
    with TestClient(create_app(database_url, "default"), base_url="http://127.0.0.1") as client:
        timeline = client.get("/api/maps/default/timeline").json()
        assert [item["drive_id"] for item in timeline["changesets"]] == ["map.parquet"]
        way = client.get(f"/api/maps/default/drives/{changeset.drive_uuid}/trajectory").json()
        assert way["frame_index"] == []
        answer = client.get("/api/maps/default/features", params={"valid_at": "infinity"})
        answer = answer if answer.status_code == 200 else client.get("/api/maps/default/features")
        assert len(answer.json()["features"]) == len(features)


def test_the_command_line(database_url, tmp_path, surveyed):
    import os
    import subprocess
    import sys

    folder, features = surveyed
    environment = {**os.environ, "CONETL_DATABASE_URL": database_url, "CONETL_HOME": str(tmp_path / "home")}

    def conetl(*arguments, code=0):
        command = [sys.executable, "-c", "from conetl.cli import main; main()", *map(str, arguments)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stderr
        return done.stderr if code else done.stdout

    assert "row 2: longitude" not in conetl("map", "import", geojson(tmp_path / "a.geojson", [GOOD]), code=2)
    done = json.loads(conetl("map", "import", folder / "map.gpkg", "--json"))
    assert (done["counts"]["added"], done["srid"], done["committed"]) == (len(features), 32632, True)
    assert "CC0" in conetl("map", "licence", "CC0")
    written = json.loads(conetl("map", "export", "--format", "geoparquet", "--out", tmp_path / "a.parquet", "--json"))
    assert (written["features"], written["manifest"]["licence"]) == (len(features), "CC0")
