"""Tiles of the view: the numbers of clusters and features over any set of tiles are those of the database."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.made_up_maps import make_closures
from conetl.db.connection import connect, execute, load_sql
from conetl.web.tiles import MAX_IN_TILE
from tests.conftest import cloned_database
from tests.view_map import view_of

EVERYTHING, VERSIONS = 30_000, 3
#: Instants of `make_closures` at which one, two and three versions exist, and the map of now.
INSTANTS = [None, "2026-03-01T12:00:00Z", "2026-03-02T12:00:00Z", "2026-02-01T00:00:00Z"]


@pytest.fixture(scope="module")
def closures(cluster_url, template_database):
    with cloned_database(cluster_url, template_database) as url, closing(connect(url)) as conn:
        make_closures(conn, "default", features=EVERYTHING, versions=VERSIONS)
        with view_of(url) as client:
            yield conn, client


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_tile_has_what_the_database_has(closures, data):
    conn, client = closures
    zoom = data.draw(st.integers(0, 14), label="zoom")
    east = data.draw(st.integers(450_000, 495_000), label="east")
    north = data.draw(st.integers(5_420_000, 5_465_000), label="north")
    valid_at = data.draw(st.sampled_from(INSTANTS), label="valid_at")
    side = 2 ** (20 - zoom)
    x, y = east // side, north // side
    asked = {"valid_at": valid_at} if valid_at else {}
    tile = client.get(f"/api/maps/default/tiles/{zoom}/{x}/{y}", params=asked).json()
    [row] = execute(
        conn,
        """
        select count(*) as n from conetl.feature_states('default', coalesce(%(at)s::timestamptz, 'infinity')) s
        where floor(s.easting_m / %(side)s) = %(x)s and floor(s.northing_m / %(side)s) = %(y)s
        """,
        {"at": valid_at, "side": side, "x": x, "y": y},
    )
    assert tile["count"] == row["n"]
    assert sum(c["count"] for c in tile["clusters"]) + len(tile["features"]) == row["n"]
    assert all(sum(c["categories"].values()) == c["count"] for c in tile["clusters"])
    assert bool(tile["clusters"]) == (row["n"] > MAX_IN_TILE)
    for thing in (*tile["clusters"], *tile["features"]):  # each where it belongs
        for axis, index in ((0, x), (1, y)):
            value = thing["xyz_m"][axis] + tile["origin_m"][axis]
            assert index * side - 0.01 <= value <= (index + 1) * side + 0.01


def test_the_tiles_of_every_zoom_add_up_to_the_summary(closures):
    _, client = closures
    found = client.get("/api/maps/default/summary").json()
    assert sum(found["categories"].values()) == EVERYTHING
    for zoom in (2, 4, 5):
        side = 2 ** (20 - zoom)
        west, south, east, north = (edge + found["origin_m"][i % 2] for i, edge in enumerate(found["box_m"]))
        tiles = [
            client.get(f"/api/maps/default/tiles/{zoom}/{x}/{y}").json()
            for x in range(int(west // side), int(east // side) + 1)
            for y in range(int(south // side), int(north // side) + 1)
        ]
        assert sum(tile["count"] for tile in tiles) == EVERYTHING


@pytest.mark.parametrize(("valid_at", "beyond_m"), [(None, 256.0), (INSTANTS[2], 0.001)])
def test_the_box_of_the_summary_contains_every_feature_and_little_more(closures, valid_at, beyond_m):
    """To 256 m where the cells are stored."""
    conn, client = closures
    found = client.get("/api/maps/default/summary", params={"valid_at": valid_at} if valid_at else {}).json()
    [row] = execute(
        conn,
        """
        select array[min(easting_m), min(northing_m), max(easting_m), max(northing_m)] as box_m
        from conetl.feature_states('default', coalesce(%(at)s::timestamptz, 'infinity'))
        """,
        {"at": valid_at},
    )
    outward_m = (np.add(found["box_m"], found["origin_m"][:2] * 2) - row["box_m"]) * [-1, -1, 1, 1]
    assert (outward_m > -0.001).all() and (outward_m < beyond_m).all()


def test_the_overview_follows_every_change_of_the_map(closures):
    conn, _ = closures
    gone = """
        update conetl.feature_version set system_period = tstzrange(lower(system_period), now())
        where version_row_id in (
            select version_row_id from conetl.current_feature order by feature_id limit %(n)s
        )"""
    execute(conn, "alter table conetl.feature_version disable trigger no_overlap_of_changed")
    for n in (1, 500):
        execute(conn, gone, {"n": n})
        assert execute(conn, load_sql("audits.feature_cells")) == []
    conn.rollback()
