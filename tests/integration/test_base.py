"""`conetl base` on PostGIS: files in, tiles and lines out, nothing written for what is broken; and what the server answers."""

from __future__ import annotations

import gzip
import hashlib
import json
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.db.connection import execute
from conetl.readers.base_layers.point_tiles import decode_points
from tests.unit.readers.test_base_layers import CENTRE, LAT, LON, OSM, geojson, line, write_las
from tests.view_map import two_drives, view_of


@pytest.fixture(scope="module")
def conn(module_conn, samples, tmp_path_factory):
    """A map with two drives, which no test changes."""
    two_drives(module_conn, samples, tmp_path_factory.mktemp("images"))
    return module_conn


@pytest.fixture
def world(conn, module_database_url, tmp_path, monkeypatch):
    """That map without base layers, and `run(*arguments)` for `conetl base`."""
    execute(conn, "delete from conetl.base_source")
    conn.commit()
    monkeypatch.setenv("CONETL_DATABASE_URL", module_database_url)
    monkeypatch.setenv("CONETL_HOME", str(tmp_path / "home"))

    def run(*arguments):
        result = CliRunner().invoke(app, ["base", *map(str, arguments)])
        return SimpleNamespace(
            code=result.exit_code,
            error=result.exception,
            json=json.loads(result.stdout or "null") if "--json" in arguments else None,
        )

    def rows(sql):
        conn.rollback()
        return execute(conn, sql)

    yield SimpleNamespace(run=run, rows=rows, url=module_database_url, folder=tmp_path)
    conn.rollback()


def counts(world):
    tables = ("base_source", "base_tile", "base_line")
    return [world.rows(f"select count(*) as n from conetl.{table}")[0]["n"] for table in tables]


def test_points_come_back_as_tiles_and_again_changes_nothing(world):
    path = write_las(world.folder / "street.laz", 6_000)
    done = world.run("import", path, "--json").json[0]
    assert [done[key] for key in ("layer", "kind", "read", "refused", "warnings")] == ["street", "points", 6_000, 0, []]
    tiles = world.rows("select * from conetl.base_tile")
    back = np.concatenate(
        [decode_points(bytes(t["payload"]))[0] * np.array(t["scale_m"]) + t["origin_m"] for t in tiles]
    )
    assert len(back) == done["kept"] == sum(t["points"] for t in tiles) > 5_900 and len(tiles) > 1
    assert (back.min(axis=0) >= np.array(CENTRE) - 0.1).all() and (back.max(axis=0) <= np.array(CENTRE) + 40.1).all()
    before = world.rows("select source_id, imported_at from conetl.base_source")
    again = world.run("import", path, "--json").json[0]
    assert again["unchanged"] and again["kept"] == done["kept"]
    assert world.rows("select source_id, imported_at from conetl.base_source") == before
    raised = world.run("import", path, "--height-offset", "1", "--json").json[0]
    assert not raised["unchanged"] and len(world.rows("select from conetl.base_source")) == 1
    write_las(path, 500)  # the file changed: it takes the place of its earlier state
    world.run("import", path, "--json")
    assert [row["read_count"] for row in world.rows("select read_count from conetl.base_source")] == [500]
    assert [row["layer_name"] for row in world.run("list", "--json").json] == ["street"]
    assert world.run("drop", "street", "--json").json == {"layer": "street", "files": 1}
    assert counts(world) == [0, 0, 0]
    assert world.run("drop", "street").error is not None


def test_broken_files_write_nothing_and_good_ones_beside_them_count(world):
    bad = write_las(world.folder / "bad.laz", 4_000)
    bad.write_bytes(bad.read_bytes()[:-2_000])
    none = write_las(world.folder / "none.las", 100, crs=None)
    swapped = geojson(world.folder / "swapped.geojson", line([LAT, LON], [LAT + 1e-4, LON]))
    assert world.run("import", bad, none, swapped, world.folder / "missing.las").code == 2
    assert counts(world) == [0, 0, 0]
    good = geojson(world.folder / "good.geojson", line([LON, LAT], [LON, LAT + 1e-4], kind="line_thin"))
    assert world.run("import", bad, good).code == 2
    assert counts(world) == [1, 0, 1]
    assert world.run("import", none, "--crs", "32632").code == 0
    assert world.run("import", good, "--kind", "points").code == 2


def test_lines_without_heights_get_those_of_the_road(world):
    osm = world.folder / "map.osm"
    osm.write_text(OSM)
    done = world.run("import", osm, "--json")
    assert (done.code, done.json[0]["kept"], done.json[0]["refused"]) == (1, 2, 2)  # half of it refused: exit code 1
    rows = world.rows(
        "select ST_Z(ST_StartPoint(geom)) as a, ST_Z(ST_EndPoint(geom)) as b, ST_SRID(geom) as srid"
        " from conetl.base_line order by attributes ->> 'way'"
    )
    assert [row["srid"] for row in rows] == [32632, 32632]
    assert rows[0]["a"] == 110.0 and rows[0]["b"] == pytest.approx(114.5)  # the feet of the cones
    assert world.rows("select heights from conetl.base_source")[0]["heights"] == "drives"


def test_the_server_returns_tiles_lines_and_not_modified(world):
    world.run("import", write_las(world.folder / "street.laz", 3_000))
    lane = line([LON, LAT, 115.0], [LON, LAT + 1e-4, 115.0], kind="line_thin", subtype="dashed")
    world.run("import", geojson(world.folder / "lanes.geojson", lane))
    with view_of(world.url) as client:
        first = client.get("/api/maps/default/base")
        base = first.json()
        assert [(x["layer_name"], x["kind"], x["files"], x["count"]) for x in base["layers"]] == [
            ("lanes", "lines", 1, 1), ("street", "points", 1, sum(t["points"] for t in base["tiles"])),
        ]  # fmt: skip
        assert [t["level"] for t in base["tiles"]] == sorted(t["level"] for t in base["tiles"])
        assert all(max(map(abs, t["origin_m"][:2])) < 10_000 for t in base["tiles"])  # local metres
        lines = client.get("/api/maps/default/base/lines").json()["lines"]
        assert [(x["kind"], x["subtype"], len(x["xyz_m"])) for x in lines] == [("line_thin", "dashed", 6)]
        for path in ("base", "base/lines"):
            tag = client.get(f"/api/maps/default/{path}").headers["etag"]
            assert client.get(f"/api/maps/default/{path}", headers={"If-None-Match": tag}).status_code == 304

        tile = base["tiles"][0]
        url = f"/api/maps/default/base/tiles/{tile['sha256']}.bin"
        answer = client.get(url)
        assert answer.headers["content-encoding"] == "gzip" and "immutable" in answer.headers["cache-control"]
        assert len(answer.content) == 7 * tile["points"]
        plain = client.get(url, headers={"Accept-Encoding": "identity"})
        assert "content-encoding" not in plain.headers and plain.content == answer.content
        stored = world.rows(f"select payload from conetl.base_tile where sha256 = '{tile['sha256']}'")[0]["payload"]
        assert hashlib.sha256(bytes(stored)).hexdigest() == tile["sha256"]
        assert gzip.decompress(bytes(stored)) == plain.content
        assert client.get(url, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
        for wrong in ("0" * 64, "../../etc/passwd", "0" * 63 + "g"):
            assert client.get(f"/api/maps/default/base/tiles/{wrong}.bin").status_code in (404, 422)
        assert client.get(url.replace("default", "other")).status_code == 404
        assert client.get("/api/maps/other/base").status_code == 404
        world.run("drop", "lanes")
        assert client.get("/api/maps/default/base", headers={"If-None-Match": first.headers["etag"]}).status_code == 200


def test_rights_of_the_roles(world):
    world.run("import", write_las(world.folder / "street.laz", 1_000))
    allowed = world.rows(
        "select r, t, has_table_privilege(r, 'conetl.' || t, 'select') as s,"
        " has_table_privilege(r, 'conetl.' || t, 'insert, delete') as w"
        " from unnest(array['conetl_reader', 'conetl_writer']) r, unnest(array['base_source', 'base_tile', 'base_line']) t"
    )
    assert all(row["s"] for row in allowed)
    assert all(row["w"] == (row["r"] == "conetl_writer") for row in allowed)
