"""Boxes of OGC API Features hold what their definition in degrees says, however the server finds them: random maps, all sizes."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import asyncpg
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from conetl.db.connection import connect, execute, execute_count
from conetl.db.ogc_store import MapDirectory, part_of_map, rows_near, rows_within
from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.web.ogc.collections import Instants, collection_of

FEATURE_COUNT = 300
#: Of each map: its CRS, and around where (lon, lat) its cones lie how far (degrees).
MAPS = {
    "town": (32632, 8.6, 49.1, 0.25, 0.18),
    "edge_of_zone": (32632, 11.7, 49.1, 0.28, 0.18),
    "beyond_zone": (32632, 9.0, 52.0, 7.0, 8.0),
    "south": (32733, 15.0, -33.9, 0.2, 0.2),
    "dateline": (32660, 180.0, -17.0, 0.9, 0.5),
}
#: The index or the whole table, in two statements or in one: what a server takes a map for (share, versions).
WAYS = {"few": (0.0, 0.0), "many": (0.0, 1e12), "most": (1.0, 1e12)}
_MAKE = (
    "set local session_replication_role = replica",
    "insert into map (map_name, srid, created_at) values (%(map)s, %(srid)s, '2026-01-01T00:00Z')",
    """
    insert into drive (drive_uuid, map_id, srid, drive_id, source_path, content_sha256, rig, captured_from_ns, captured_to_ns,
        captured_period, expected_frame_count, reconcile, influence_m, area)
    select md5(%(map)s)::uuid, map_id, srid, 'drive', '', encode(sha256(%(map)s::bytea), 'hex'), '{}', 0, 1,
        tstzrange('2026-03-01T08:00Z', '2026-03-01T08:01Z'), 1, '{}', 60,
        (select ST_SetSRID(ST_Expand(ST_Extent(ST_MakePoint(x, y)), 60)::geometry, srid) from unnest(%(x)s, %(y)s) p (x, y))
    from map where map_name = %(map)s
    """,
    """
    insert into changeset (changeset_id, map_id, changeset_no, drive_uuid, idempotency_key, params_sha256, model_sha256,
        code_version, committed_at, change_counts, frame_pair_count, detection_count, match_count, position_count, track_count,
        marking_count, rejection_count)
    select md5(%(map)s)::uuid, map_id, 1, md5(%(map)s)::uuid, encode(sha256(%(map)s::bytea), 'hex'), '', '', '0',
        '2026-03-01T20:00Z', '{"points": {}, "lines": {}}', 0, 0, 0, 0, 0, 0, 0
    from map where map_name = %(map)s
    """,
    """
    insert into feature (feature_id, map_id, srid, created_by, cell)
    select md5(%(map)s || k)::uuid, map_id, srid, md5(%(map)s)::uuid, cell_at(ST_MakePoint(x, y))
    from map, unnest(%(x)s, %(y)s) with ordinality p (x, y, k) where map_name = %(map)s
    """,
    """
    insert into feature_version (cell, feature_id, version, map_id, srid, changeset_id, present, category, geom, centre_geom,
        cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, object_height_m, object_height_sigma_m, existence_probability,
        observation_count, seen_count, missed_count, first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period)
    select cell_at(ST_MakePoint(x, y)), md5(%(map)s || k)::uuid, 1, map_id, srid, md5(%(map)s)::uuid, true, 'traffic_cone',
        ST_SetSRID(ST_MakePoint(x, y, k), srid), ST_SetSRID(ST_MakePoint(x, y, k), srid), 1, 0, 0, 1, 0, 1, 0.7, 0.02, 0.9,
        3, 1, 0, 0, 1, 0, tstzrange('2026-03-01T08:00Z', null), tstzrange('2026-03-01T20:00Z', null)
    from map, unnest(%(x)s, %(y)s) with ordinality p (x, y, k) where map_name = %(map)s
    """,
)
#: What a box is (migration 0009): longitude and latitude of every cone of the map decide.
_DEFINITION = """
select v.feature_id::text as id, ST_AsGeoJSON(p.place)::json -> 'coordinates' as place
from feature_states(%(map)s) v cross join lateral (select ST_Transform(v.geom, 4326) as place) p
where ST_Y(p.place) between %(south)s - 5e-10 and %(north)s + 5e-10 and case
    when %(west)s <= %(east)s then ST_X(p.place) between %(west)s - 5e-10 and %(east)s + 5e-10
    else ST_X(p.place) >= %(west)s - 5e-10 or ST_X(p.place) <= %(east)s + 5e-10
end
order by v.feature_id
"""


def around(lon: float) -> float:
    return (lon + 180) % 360 - 180


def no_plans(*_):
    raise AssertionError("features are compared with nothing")


class Maps:
    """The maps in a database, and the server's questions to it."""

    def __init__(self, url: str) -> None:
        self.conn = connect(url)
        dice = np.random.default_rng(1)
        for name, (srid, lon, lat, east, north) in MAPS.items():
            lons, lats = (
                centre + half * dice.uniform(-1, 1, FEATURE_COUNT) for centre, half in ((lon, east), (lat, north))
            )
            xy = to_map(srid, lats, [around(x) for x in lons], 0.0)
            for statement in _MAKE:
                execute_count(
                    self.conn, statement, {"map": name, "srid": srid, "x": xy[:, 0].tolist(), "y": xy[:, 1].tolist()}
                )
        self.conn.commit()
        self.loop = asyncio.new_event_loop()
        self.reader = self.run(asyncpg.connect(url))
        self.run(self.reader.execute("set search_path = conetl, public; set plan_cache_mode = force_generic_plan"))
        self.served = {served.map_name: served for served in self.run(MapDirectory().maps(self.reader))}

    def run(self, question):
        return self.loop.run_until_complete(question)

    def close(self):
        self.run(self.reader.close())
        self.loop.close()
        self.conn.close()

    def defined(self, name, box):
        parameters = dict(zip(("west", "south", "east", "north"), box, strict=True)) | {"map": name}
        return [(row["id"], row["place"]) for row in execute(self.conn, _DEFINITION, parameters)]

    def page(self, name, box, way, limit, offset, **asked):
        share, version_count = WAYS[way]
        served = replace(self.served[name], share=share, version_count=version_count)
        asked = {"box": box, "limit": limit, "offset": offset} | asked
        return self.run(collection_of("features", served, Instants(), no_plans).page(self.reader, **asked))


@pytest.fixture(scope="module")
def maps(module_database_url):
    made = Maps(module_database_url)
    yield made
    made.close()


@st.composite
def boxes(draw):
    """A map and a box about as large as the map, much smaller, or larger; some edges go through cones."""
    name = draw(st.sampled_from(sorted(MAPS)))
    _, lon, lat, east, north = MAPS[name]
    size = 10 ** draw(st.floats(-5, 0.3))
    edges = []
    for centre, half in ((lon, east), (lat, north)):
        middle = centre + half * draw(st.floats(-1, 1))
        edges.append(sorted(middle + size * half * draw(st.floats(-2, 2)) for _ in range(2)))
    (west, east_edge), (south, north_edge) = edges
    return name, (around(west), south, around(east_edge), north_edge), draw(st.sampled_from([None, 0, 1, 2, 3]))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@example(("town", (8.36, 48.93, 8.84, 49.27), None), 10, 0)
@example(("town", (8.36, 48.93, 8.84, 49.27), 2), 1000, 0)
@example(("edge_of_zone", (11.43, 48.93, 11.97, 49.27), 0), 1000, 0)
@example(("beyond_zone", (3.0, 45.0, 15.0, 59.0), 3), 7, 5)
@example(("dateline", (179.2, -17.4, -179.2, -16.6), 0), 10, 300)
@example(("dateline", (179.2, -17.4, 180.0, -16.6), None), 1000, 0)
@example(("south", (-180.0, -90.0, 180.0, 90.0), None), 10, 290)
@given(asked=boxes(), limit=st.sampled_from([1, 10, 1000]), offset=st.sampled_from([0, 3, 299]))
def test_a_box_holds_what_its_definition_says_whichever_way_it_is_found(maps, asked, limit, offset):
    name, box, edge = asked
    cones = maps.defined(name, box)
    if edge is not None and cones:  # one edge goes through the last digit of a cone's coordinates
        box = tuple(cones[len(cones) // 2][1][edge % 2] if k == edge else value for k, value in enumerate(box))
        cones = maps.defined(name, box)
    for way in WAYS:
        page = maps.page(name, box, way, limit, offset, properties=["category"], links=('[{"href":"', '"}]'))
        found = [(item["id"], item["geometry"]["coordinates"]) for item in page.parsed()]
        assert (found, page.returned, page.matched) == (cones[offset : offset + limit], len(found), len(cones)), way


def test_the_box_of_a_map_across_180_degrees_has_its_west_beyond_its_east(maps):
    west, south, east, north = maps.served["dateline"].bbox
    assert 178.9 < west < 179.3 and -179.3 < east < -178.9 and -17.6 < south < north < -16.4
    assert maps.served["town"].bbox == maps.served["town"].extent


@pytest.mark.parametrize("name", [name for name in MAPS if name != "dateline"])
def test_most_of_a_large_box_needs_no_degrees(maps, name):
    served = maps.served[name]
    west, south, east, north = served.extent
    box = (west, south + 0.01, east, north - 0.01)
    inner, near = rows_within(box, served), rows_near(box, served)
    assert 0.7 < part_of_map(box, served) < 1
    assert (inner[2] - inner[0]) * (inner[3] - inner[1]) > 0.55 * (near[2] - near[0]) * (near[3] - near[1])


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(asked=boxes())
def test_an_inner_box_lies_in_the_box_in_degrees(maps, asked):
    name, (west, south, east, north), _ = asked
    low_x, low_y, high_x, high_y = rows_within((west, south, east, north), maps.served[name])
    if low_x > high_x:
        return
    x, y = np.meshgrid(np.linspace(low_x, high_x, 50), np.linspace(low_y, high_y, 50))
    lat, lon, _ = np.moveaxis(to_geodetic(MAPS[name][0], np.stack([x, y, 0 * x], axis=-1)), -1, 0)
    assert ((lat >= south) & (lat <= north)).all()
    assert (((lon >= west) & (lon <= east)) if west <= east else (lon >= west) | (lon <= east)).all()


ASKED = (
    {},
    {"sortby": "-easting_m"},
    {"sortby": "category", "properties": ["category", "seen_count", "valid_from"]},
    {"values": [("version", "1")]},
    {"values": [("version", "2")]},
    {"sortby": "-seen_count"},
    {"values": [("missed_count", "0")], "sortby": "northing_m"},
)


@pytest.mark.parametrize("asked", ASKED, ids=str)
@pytest.mark.parametrize(("limit", "offset"), [(7, 0), (7, 5), (1000, 0), (10, 290), (10, 1000)])
def test_a_page_of_a_large_part_of_a_large_map_is_that_of_a_small_one(maps, asked, limit, offset):
    for name in MAPS:
        for box in (None, (MAPS[name][1] - 0.1, -90.0, 179.0, 90.0)):
            few, many, most = (maps.page(name, box, way, limit, offset, **asked) for way in WAYS)
            assert few == many == most


def test_a_page_of_a_large_map_reads_the_evidence_of_its_items_only(maps, monkeypatch):
    """Of a million features it took 4 s, and to sort them all as much again."""
    whole = maps.page("town", None, "few", 10, 0)
    assert (whole.returned, whole.matched) == (10, FEATURE_COUNT)
    item = whole.parsed()[3]
    assert maps.page("town", None, "most", 1, 0, ids=[item["id"]]).parsed() == [item]

    async def read_all(*_, **__):
        raise AssertionError("every feature is read")

    monkeypatch.setattr("conetl.web.ogc.collections._count", read_all)
    assert maps.page("town", None, "most", 10, 0) == whole
