"""What can be said about one rich map, in every way, compared with what was recorded in `recorded/`, read and checked once.

Renew the files with CONETL_RENEW_RECORDED=1 and read the difference: a recorded wrong value is worse than none. Laws of all maps
are tested beside it, from the tables of the database and in Python alone (`test_one_answer.py`, `test_any_order.py`).
"""

from __future__ import annotations

import csv
import json
import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from unittest.mock import patch
from uuid import UUID

import pyarrow.parquet as pq
import pyogrio
import pytest
import shapely
from fastapi.testclient import TestClient
from matplotlib.figure import Figure
from mcap.reader import make_reader

from conetl.db.connection import Connection, address, connect, execute, query
from conetl.geometry.geodesy import to_geodetic
from tests import recorded_text as text
from tests.conftest import cloned_database
from tests.integration import rich_map
from tests.integration.conftest import command_line, outcome
from tests.integration.drives_of_days import DAY_NS
from tests.integration.map_by_tables import Instant, MapByTables
from tests.integration.test_height_systems import own_geoid
from tests.integration.test_one_answer import Faces
from tests.synthetic.world import START_NS
from tests.view_map import view_of

#: Begin and end of the drives, and between them.
NIGHT = "2026-03-20"
FEED = "--publisher City --road-name 'L 605'"
#: Command lines of commands that read. `{}` stand for ids and instants of the map (`Rich.words`).
COMMANDS = """
map list
map list --json
map show
map show --json
map show --as-of {seen}
map show --as-of {before_seen} --category traffic_cone
map show --as-of {after_seen} --known-at {w3} --category traffic_cone
map show --known-at {before_w3}
map show --known-at then --as-of 2026-03-03
map show --category drum --category traffic_sign
map show --category all
map show --provisional
map show --provisional --json
map show --provisional --as-of 2026-03-03
map show --map nowhere
map show --map west --as-of 2026-03-02T10:00:02
map diff 1 2 --map west
zones history --map west
zones compare --map west --as-of 2026-03-04
drive held --map west
map decisions --map west
map log
map log --json
map log --known-at {w9}
map log --known-at {before_w9}
map log {pin}
map log {pin} --json
map log {pin} --known-at {w3}
map log {pin} --known-at {before_w3}
map log {suppress}
map log {classify}
map log {gone}
map log ffffffff
map log 0000
map diff 2 5
map diff 5 7 --json
map diff 2 5 --known-at then
map diff 1 2
map diff 5 7
map diff 5 5
map diff 5 2
map diff 3 99
map diff 3 4
map diff 4 3
map show --category dromedary
map check-points {folder}/points.csv --crs EPSG:32632 --sigma-m 0.001 --known-at {w5}
map diff {before_seen} {seen}
map diff 2026-03-02 2026-03-03
map diff 2026-03-03 2026-03-05 --known-at {w3}
map diff 2 5 --out {folder}/diff.geojson
map decisions
map decisions --json
map licence
map licence --json
map check-points {folder}/points.csv --crs EPSG:32632 --sigma-m 0.03
map check-points {folder}/points.csv --crs EPSG:32632 --sigma-m 0.03 --json
map check-points {folder}/points.csv --crs EPSG:32632 --as-of {seen} --within-m 0.2 --sigma-m 0.02
map check-points {folder}/far_points.csv --crs EPSG:32632 --sigma-m 0.03
map check-layout
map check-layout --json
map check-layout --speed-kmh 80 --as-of {seen}
map check-layout --standard rsa_21
map check-layout --lanes {folder}/lanes.geojson --speed-kmh 30
map check-layout --as-of 2026-02-01
zones history
zones history --json
zones history {zone}
zones history --known-at {w3}
zones plan list
zones plan list --json
zones plan list --known-at {before_replaced}
zones compare --as-of 2026-03-06
zones compare --as-of 2026-03-06 --json
zones compare --as-of 2026-03-02T10:00 --known-at {w3}
zones compare --as-of 2026-02-01
zones undelivered
zones undelivered --json
drive held
drive held --json
base list
base list --json
db status --json
db audit --json
map create west --crs EPSG:25832
map suppress {suppress} --note again
map pin ffffffff
map classify {pin} cone
map revert 99
drive accept 2
zones judge ffffffff accepted
zones plan import {folder}/points.csv
base drop nowhere
base import {folder}/lanes.geojson
map import {folder}/all_classes.csv
map import {folder}/all_classes.csv --map west
zones history --map zones
zones history --map zones --json
zones compare --map zones --as-of 2026-03-06 --json
map check-layout --map zones --as-of 2026-03-02T20:00
map check-layout --map zones --json
map log --map zones
report drive 99
report night 2026-03-20 --since 2026-03-20
""".strip().splitlines()
CHANGES = " --what changes --from 2026-03-03T12:00 --to 2026-03-05T13:30"
ONE_CLASS = " --category traffic_cone"
#: Commands that write files: the name of the file is the last word.
EXPORTS = [
    *(
        f"map export --format {name}{what} --out {{folder}}/{number}.{suffix}"
        for name, suffix in (
            ("geojson", "geojson"), ("csv", "csv"), ("geoparquet", "parquet"), ("gpkg", "gpkg"), ("flatgeobuf", "fgb"),
            ("mcap", "mcap"), ("lanelet2", "osm"),
        )
        for number, what in enumerate(("", CHANGES + (ONE_CLASS if suffix not in ("csv", "geojson") else "")))
        if not (number and suffix in ("parquet", "osm", "fgb"))
    ),
    "map export --format csv --what history --category traffic_sign --out {folder}/history.csv",
    "map export --format mcap --what history --category traffic_sign --out {folder}/history.mcap",
    "map export --format csv --as-of {seen} --known-at {w3} --out {folder}/then.csv",
    "map export --format geojson --category traffic_cone --as-of {before_seen} --out {folder}/before.geojson",
    "map export --format csv --crs EPSG:3045 --category traffic_cone --out {folder}/northing_first.csv",
    "map export --format csv --crs EPSG:25832+5773 --what changes --out {folder}/heights.csv",
    "map export --format gpkg --crs EPSG:25833 --what changes --from {seen} --out {folder}/turned.gpkg",
    "map export --format geoparquet --crs EPSG:25833 --category traffic_cone --out {folder}/turned.parquet",
    "map export --map west --format csv --crs EPSG:2285 --out {folder}/feet.csv",
    "map export --map west --format geojson --out {folder}/west.geojson",
    "map export --map west --format wzdx " + FEED + " --as-of 2026-03-02 --out {folder}/west_feed.geojson",
    *(
        f"map export --format {name} {FEED}{more} --as-of {at} --out {{folder}}/zones_{number}.{suffix}"
        for name, suffix, more in (
            ("wzdx", "geojson", ""), ("wzdx-devices", "geojson", ""), ("datex2", "xml", " --country de"),
        )
        for number, at in enumerate(("{seen}", "2026-03-20", "2026-03-05T20:00"))
        if name == "wzdx" or number < 2
    ),
    "map export --format wzdx " + FEED + " --as-of 2026-03-05T20:00 --max-age 1h --out {folder}/old.geojson",
    *(
        f"map export --map zones --format {name} {FEED}{more} --as-of {at} --out {{folder}}/joined_{number}.{suffix}"
        for name, suffix, more in (
            ("wzdx", "geojson", ""), ("wzdx-devices", "geojson", ""), ("datex2", "xml", " --country de"),
        )
        for number, at in enumerate(("2026-03-02T20:00", "2026-03-04T20:00"))
    ),
    "map export --map zones --format mcap --what history --out {folder}/joined.mcap",
    "map export --map west --format gpkg --crs EPSG:2285 --what changes --out {folder}/feet.gpkg",
    "map export --map west --format flatgeobuf --crs EPSG:2285 --out {folder}/feet.fgb",
    "map qgis --out {folder}/map.qgs",
    "zones compare --as-of 2026-03-06 --out {folder}/plans.csv",
    "zones compare --as-of 2026-03-06 --out {folder}/plans.geojson",
    "map check-layout --out {folder}/layout.geojson",
    "map diff 2 5 --out {folder}/changes.geojson", "map export --category dromedary --out {folder}/none.geojson",
    "map export --category lane_marking --out {folder}/lines.geojson", "map export --category barricade --out {folder}/one.csv",
]  # fmt: skip
CHECKED = "--as-of 2026-03-05T20:00 --checkpoints {folder}/points.csv --crs EPSG:32632 --sigma-m 0.03"
#: As above, of pages and images, whose figures are read too.
REPORTS = [
    *(f"report drive {number} --out {{folder}}/drive_{number}.html" for number in (2, 3, 5, 8)),
    "report drive 1 --out {folder}/drive_1.html", "report drive nowhere --out {folder}/drive_0.html",
    f"report night {NIGHT} --out {{folder}}/night.html", "report night 2026-03-19 --out {folder}/night_19.html",
    "report night --since {w1} --until {w4} --out {folder}/since.html",
    "report night --since {before_w1} --until {before_w4} --out {folder}/before.html",
    f"report night {NIGHT} --json --out {{folder}}/night_json.html",
    "report quality --as-of {seen} --out {folder}/quality.html",
    *(f"report quality {CHECKED} --out {{folder}}/checked.{suffix}" for suffix in ("html", "xml")),
    f"report quality --json {CHECKED} --within-m 0.1 --out {{folder}}/near.html",
    "zones compare --as-of 2026-03-06 --out {folder}/plans.html",
    "map picture {folder}/map.svg --title Everything", "map picture {folder}/then.svg --as-of {seen} --known-at {w3}",
    "map picture {folder}/changes.svg --changes 2 5", "map picture {folder}/box.svg --bbox {box}",
    "map picture {folder}/west.svg --map west", "map diff 3 4 --image {folder}/diff.svg",
    "map check-layout --map zones --image {folder}/zones_layout.svg", "map picture {folder}/zones.svg --map zones",
    "map picture {folder}/no.svg --changes 5 2", "map check-layout --image {folder}/layout.svg",
]  # fmt: skip
API = "/api/maps/default"
#: GET routes, with parameters.
ROUTES = """
/api/maps
{api}/features
{api}/features?limit=3&sort=sigma-
{api}/features?limit=2&offset=3&sort=existence
{api}/features?valid_at={seen}
{api}/features?valid_at={before_seen}&limit=2
{api}/features?valid_at={seen}&known_at={w3}&limit=2
{api}/features?kinds=confirmed&limit=2
{api}/features?hidden_classes=traffic_cone&least_height_m=1.39&most_height_m=1.71
{api}/features?least_existence=0.88&most_existence=0.9
{api}/features?most_sigma_m=0.072&limit=5
{api}/features?of_changeset=5
{api}/features?seen_from={seen_last}&seen_before={seen_last}
{api}/features?seen_from={seen_last}
{api}/features?{area}
{api}/changes/summary?changeset_no=1&{area}
{api}/features/count
{api}/features/count?kinds=added&feature={pin}
{api}/features/count?valid_at={before_seen}&sort=sigma-&feature={pin}
{api}/changes?changeset_no=3
{api}/changes?from_valid_at={before_seen}&to_valid_at={seen}
{api}/changes?from_valid_at={seen}&to_valid_at=2026-03-05T00:00:00Z&limit=3&sort=shift-
{api}/changes?from_known_at={before_w3}&to_known_at={w3}
{api}/changes?changeset_no=3&kinds=moved,removed
{api}/changes/count?changeset_no=3
{api}/changes/count?changeset_no=3&kinds=moved
{api}/changes/summary?changeset_no=3
{api}/changes/summary?from_valid_at={seen}
{api}/changes/view?changeset_no=7
{api}/changes/view?changeset_no=3
{api}/changes/view?changeset_no=2&cell_zoom=3
{api}/timeline
{api}/features/{pin}
{api}/features/{pin}?known_at={w3}
{api}/features/{gone}
{api}/features/{suppress}
{api}/features/{drum}
/api/maps/west/features/{west}/sightings
{api}/features/{drum}/sightings
{api}/features/{pin}/passes
{api}/features/{gone}/passes
{api}/drives/{drive}/trajectory
{api}/drives/{drive}/frames/7
{api}/drives/{drive}/frames/999
{api}/summary
{api}/summary?valid_at={seen}
{api}/summary?valid_at={before_seen}&known_at={w3}
{api}/tiles/0/0/5
{api}/tiles/3/3/41?valid_at={before_seen}
{api}/search?text=day_
{api}/search?text={pin}
{api}/search?text=2026-03-04
{api}/search?text=49.00,8.4
{api}/projection?x_m=14&y_m=3.5
{api}/base
{api}/base/lines
{api}/provisional
{api}/work-zones
{api}/work-zones?valid_at={seen}
{api}/work-zones?valid_at={before_seen}
{api}/differences?valid_at=2026-03-06T00:00:00Z
{api}/differences?valid_at={seen}&known_at={w3}
{api}/decisions
{api}/review
{api}/review?offset=1&limit=2
{api}/review?offset=99
{api}/downloads/csv?valid_at={seen}&box={box}
/api/basemap/0/0/0
/api/maps/nowhere/summary
/ogc/collections
/ogc/collections/default.features
/ogc/collections/default.features/items?limit=10
/ogc/collections/default.features/items?limit=2&offset=3&sortby=-sigma_e_m
/ogc/collections/default.features/items?at={seen}&category=traffic_sign
/ogc/collections/default.features/items?at={before_seen}&known_at={w3}&limit=1
/ogc/collections/default.features/items?bbox={bbox}
/ogc/collections/default.features/items/{pin}
/ogc/collections/default.features/items/{suppress}
/ogc/collections/default.lane_markings/items?limit=2
/ogc/collections/default.changes/items?from={seen}&limit=4
/ogc/collections/default.changes/items?from={before_seen}&to={seen}&limit=3
/ogc/collections/default.differences/items?at=2026-03-06T00:00:00Z
/ogc/collections/west.features/items
/ogc/collections/default.features/items?limit=2&f=csv
/ogc/collections/default.features/items?limit=2&f=ndjson&properties=version, sigma_e_m
/ogc/collections/default.features/items?limit=2&f=geojsonseq&properties=category
/ogc/collections/default.lane_markings/items?limit=1&f=json
/ogc/collections/default.features/items/{pin}?f=csv
/ogc/collections/default.features/items?drive_id=short&limit=3&properties=sigma_e_m
/ogc/collections/default.features/items?category=lamp
/ogc/collections/default.features/queryables
/ogc/collections?limit=2&offset=3
/ogc/collections?datetime=../{seen}&limit=1
/ogc/conformance
{api}/features?sort=class&limit=2&after=zz
{api}/differences?valid_at=2026-02-01T00:00:00Z
{api}/changes
{api}/timeline?limit=0
/api/maps/west/summary
/api/maps/west/review
/api/maps/west/changes/view?changeset_no=2
/api/maps/zones/work-zones
/api/maps/zones/work-zones?valid_at=2026-03-02T20:00:00Z
/api/maps/zones/differences?valid_at=2026-03-04T20:00:00Z
/api/maps/zones/timeline
/api/maps/zones/changes/view?changeset_no=4&cell_zoom=8
{api}/review?limit=1
/ogc/collections/west.features/items?limit=5
/ogc/collections/west.features/items?limit=4
/ogc/collections/west.features/items?limit=2&offset=5
/ogc/collections/zones.changes/items?from=2026-03-02T20:00:00Z&limit=50
""".strip().splitlines()
#: Named statements that no command or route above asks as sharply: at an instant and just before it, at an edge of a box.
_DAY_2, _SECONDS = START_NS + 2 * DAY_NS, 10**9
_RECORDED = {
    "map_name": "default",
    "drive_id": "day_2_0",
    "captured_from_ns": _DAY_2,
    "captured_to_ns": _DAY_2 + 3_900_000_000,
}
_PATH = {"path_wkt": "LINESTRING(456000 5428000, 456030 5428000)", "srid": 32632}
_POINTS = {"map_id": 1, "eastings_m": [456_000.0, 455_500.0], "northings_m": [5_428_000.0] * 2}
_AT = {"map_name": "default", "northing_m": 5_428_000.0, "radius_m": 20.0}
STATEMENTS: list[tuple[str, dict[str, Any]]] = [
    ("drives.statements", {"drive_uuid": "{import}"}),
    ("drives.other_deliveries", _RECORDED | {"content_sha256": "f" * 64}),
    ("drives.other_deliveries", _RECORDED | {"content_sha256": "f" * 64, "captured_from_ns": 1}),
    ("drives.other_deliveries", _RECORDED | {"content_sha256": "f" * 64, "captured_from_ns": 1, "captured_to_ns": 2}),
    *(
        ("drives.same_rig_elsewhere", _RECORDED | _PATH | {
            "rig_id": "synthetic", "drive_id": "another", "most_m_s": 100.0, "apart_m": 50.0,
            "captured_from_ns": at, "captured_to_ns": at + 1,
            "path_wkt": f"LINESTRING({456_000 + east_m} 5428000, {456_009 + east_m} 5428000)",
        })
        for at, east_m in ((_DAY_2, 60.0), (_DAY_2, 500.0), (_DAY_2 + 20 * _SECONDS, 1500.0), (_DAY_2 + 20 * _SECONDS, 2500.0))
    ),
    *(
        ("drives.adjoining_drives", {"drive_uuids": ["{drive}"], "within_ns": ns, "check": "[]"})
        for ns in (DAY_NS - 3_900_000_001, DAY_NS)
    ),
    ("drives.frame_pairs_at_ends", {"drive_uuids": ["{drive}"], "count": 2}),
    *(("map.far_from_all", _POINTS | {"far_m": m}) for m in (400.0, 600.0)),
    ("map.versions_of_ids", {"map_id": 1, "feature_ids": ["{pin}", "{gone}"]}),
    ("commit.pending_changesets", {"map_name": "default", "quiet_s": 0.0}),
    ("commit.removed_features", {"changeset_id": "{changeset}"}),
    ("commit.is_published", {"changeset_id": "{changeset}"}),
    ("receipts.under_way", {"map_name": "default"}),
    ("receipts.receipt_ends", {"attempt_ids": [f"00000000-0000-0000-0000-{1000 + k:012x}" for k in range(5)]}),
    ("receipts.pairs_per_second", {"map_name": "default"}),
    ("receipts.headers_by_changeset", {"map_name": "default"}),
    ("receipts.latest_receipts", {"map_name": "default", "headers": [f"{7 * len(one):064x}" for one in ("broken", "repaired")]}),
    *(("retention.prunable_drives", {"before": at}) for at in ("2026-03-03T10:00:03.9Z", "{w2}", "{before_w2}", "2030-01-01")),
    *(("replay.affected_drives", {"drive_uuids": [one]}) for one in ("{drive}", "{import}")),
    ("replay.superseded_drives", {"drive_uuid": "{drive}"}),
    *(("replay.drives_at", _AT | {"easting_m": 456_000.0 - m}) for m in (60.0, 160.0)),
    ("replay.standing_around", {"drive_uuid": "{drive}"}),
    ("replay.misses_around", {"drive_uuids": ["{drive}"]}),
    ("replay.current_deltas", {"drive_uuids": ["{drive}"]}),
    ("holds.replaced_by", {"changeset_id": "{changeset}"}),
    ("holds.earlier_deliveries", {"changeset_id": "{changeset}"}),
]  # fmt: skip


@dataclass(frozen=True)
class Rich:
    """The map, ready to be asked."""

    url: str
    folder: Path
    words: dict[str, str]
    names: text.Names
    client: TestClient
    environment: dict[str, str]


def iso(instant: datetime) -> str:
    return instant.astimezone(UTC).isoformat().replace("+00:00", "Z")


TICK = timedelta(microseconds=1)


def words_of(conn: Connection, made: rich_map.Written, folder: Path) -> dict[str, str]:
    """Ids and instants for the `{}` of the tables, from the tables of the database."""
    tables = MapByTables(conn, "default")
    seen = min(row["valid_from"] for row in tables.versions[made.features["pin"]] if row["version"] == 3)
    words = {"folder": str(folder), "api": API, "seen": iso(seen), **made.features}
    words |= {"before_seen": iso(seen - TICK), "after_seen": iso(seen + TICK)}
    for number in range(made.writes):
        at = rich_map.written(number)
        words |= {f"w{number}": iso(at), f"before_w{number}": iso(at - TICK)}
    now = tables.standing(Instant())
    cone = now[made.features["pin"]]
    words["seen_last"] = iso(datetime.fromtimestamp(cone.last_seen_ns // 1000 / 1e6, UTC))
    gone = sorted(key for key in tables.versions if key not in now and key != made.features["suppress"])
    words["gone"] = gone[0]
    words["west"] = max(MapByTables(conn, "west").versions)
    west, south, east, north = (
        456_105.25,
        5_428_002.125,
        456_114.25,
        5_428_003.25,
    )  # imported objects are at two of its corners
    words["box"] = f"{west},{south},{east},{north}"
    corners = ((west, south), (east, south), (east, north), (west, north))
    words["area"] = "&".join(f"area={value}" for corner in corners for value in corner)
    lat, lon, _ = to_geodetic(32632, cone.xyz_m)
    words["bbox"] = f"{lon - 1e-9:.9f},{lat - 1e-6:.7f},{lon + 4e-4:.7f},{lat + 4e-5:.7f}"
    [row] = execute(conn, "select drive_uuid::text as id from conetl.drive where drive_id = 'day_2_0'")
    words["drive"] = row["id"]
    for name, drive in (("import", "all_classes.csv"), ("changeset", "day_2_0")):
        [row] = execute(
            conn,
            "select drive_uuid::text as import, changeset_id::text as changeset from conetl.changeset "
            "join conetl.drive using (drive_uuid) where drive_id = %(drive)s",
            {"drive": drive},
        )
        words[name] = row[name]
    [row] = execute(conn, "select min(upper(system_period)) as at from conetl.plan where not upper_inf(system_period)")
    words["before_replaced"] = iso(row["at"] - TICK)
    [row] = execute(
        conn,
        "select subject_id::text as id from conetl.notice join conetl.map using (map_id) "
        "where topic = 'work_zone' and map_name = 'default' order by notice_no desc limit 1",
    )
    words["zone"] = row["id"]
    conn.rollback()
    return words


def names_of(conn: Connection, folders: Sequence[Path], since: datetime) -> text.Names:
    """Of all that a run draws."""
    rows = execute(
        conn,
        "select drive_uuid::text as id, 'drive ' || drive_id as name from conetl.drive "
        "union all select content_sha256, 'content of ' || drive_id from conetl.drive "
        "union all select changeset_id::text, 'changeset ' || map_id || '.' || changeset_no from conetl.changeset "
        "union all select idempotency_key, 'key of changeset ' || map_id || '.' || changeset_no from conetl.changeset "
        "union all select decision_id::text, 'decision ' || row_number() over (order by decided_at) from conetl.decision "
        "union all select hold_id::text, 'hold ' || row_number() over (order by lower(system_period)) from conetl.hold "
        "union all select source_id::text, 'source ' || layer_name from conetl.base_source",
    )
    [here] = execute(conn, "select current_database() as name")
    classes = {str(one["feature_id"]): f"the {one['category']}" for one in rich_map.imported_rows()}
    conn.rollback()
    places = {str(Path.cwd()): "<here>", here["name"]: "<database>", address(conn)["host"]: "<socket>"}
    names = {row["id"]: row["name"] for row in rows} | classes | {"cd" * 32: "the parameters", "ef" * 32: "the model"}
    return text.Names(names, dict.fromkeys(map(str, folders), "<folder>") | places, since)


@pytest.fixture(scope="module")
def rich(cluster_url: str, template_database: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rich]:
    """The map, made once."""
    since = datetime.now(UTC)
    folder, home = tmp_path_factory.mktemp("rich"), tmp_path_factory.mktemp("rich-home")
    with cloned_database(cluster_url, template_database) as url, closing(connect(url)) as conn:
        made = rich_map.make(conn, command_line(home, url), folder)
        words, names = words_of(conn, made, folder), names_of(conn, (folder, home), since)
        environment = {"CONETL_HOME": str(home), "CONETL_DATABASE_URL": url, "CONETL_MAP_NAME": "default"}
        with view_of(url) as client:
            yield Rich(url, folder, words, names, client, environment)


def file_of(group: str) -> Path:
    return Path(__file__).with_name("recorded") / f"{group}.txt"


def compare(group: str, name: str, rich: Rich, found: Sequence[str]) -> None:
    """Fails with what differs from the record, or renews it."""
    lines = [rich.names.apply(line) for line in found]
    if "CONETL_RENEW_RECORDED" in os.environ:
        order = {one: number for number, one in enumerate(TABLES[group])}
        entries = {one: kept for one, kept in text.recorded(file_of(group)).items() if one in order} | {name: lines}
        text.write(file_of(group), dict(sorted(entries.items(), key=lambda item: order[item[0]])))
        return
    assert name in text.recorded(file_of(group)), "not recorded yet: CONETL_RENEW_RECORDED=1"
    if told := text.differences(text.recorded(file_of(group))[name], lines):
        pytest.fail(f"{name}\n" + "\n".join(told), pytrace=False)


def run(rich: Rich, line: str) -> tuple[list[str], list[str]]:
    """The arguments of a command line, and what it ends with and prints."""
    arguments = [word.format_map(rich.words) for word in shlex.split(line)]
    code, printed, message = outcome(arguments, rich.environment)
    is_json = "--json" in arguments and printed.strip() and not message
    said = text.json_lines(printed) if is_json else [*text.text_lines(printed), *text.text_lines(message)]
    return arguments, [f"exit {code}", *said]


@pytest.mark.parametrize("line", COMMANDS)
def test_commands(rich: Rich, line: str) -> None:
    compare("commands", line, rich, run(rich, line)[1])


@pytest.mark.parametrize("line", EXPORTS)
def test_exports(rich: Rich, line: str) -> None:
    with own_geoid(rich.folder) if "+5773" in line else nullcontext():
        arguments, said = run(rich, line)
    written = Path(arguments[-1])
    for path in (written, written.with_name(f"{written.stem}_lane_markings{written.suffix}")):
        if path.exists():
            said += [f"-- {path.name}", *READERS[path.suffix](path)]
    manifest = written.with_name(f"{written.name}.manifest.json")
    if manifest.exists() and "--format csv" in line:
        said += ["-- manifest", *text.json_lines(manifest.read_text())]
    compare("exports", line, rich, said)


@contextmanager
def drawn() -> Iterator[list[Figure]]:
    """Figures that are saved."""
    figures: list[Figure] = []
    save = Figure.savefig

    def keep(figure: Figure, *args: Any, **options: Any) -> None:
        figures.append(figure)
        save(figure, *args, **options | {"dpi": 20})

    with patch.object(Figure, "savefig", keep):
        yield figures


@pytest.mark.parametrize("line", REPORTS)
def test_reports(rich: Rich, line: str) -> None:
    with drawn() as figures:
        arguments, said = run(rich, line)
    written = next(
        (Path(word) for word in arguments if word.startswith(str(rich.folder)) and not word.endswith(".csv")), None
    )
    if written is not None and written.exists() and written.suffix in READERS:
        said += READERS[written.suffix](written)
    for figure in figures:
        said += ["-- figure", *text.figure_lines(figure)]
    compare("reports", line, rich, said)


@pytest.mark.parametrize("route", ROUTES)
def test_routes(rich: Rich, route: str) -> None:
    path = route.format_map(rich.words).replace("+", "%2B")
    answer = rich.client.get(path)
    kind = answer.headers["content-type"]
    one = kind.endswith(("json", "+json")) and "ndjson" not in kind and "seq" not in kind
    lines = text.json_lines(answer.text) if one else [*text.text_lines(answer.text)]
    compare("routes", route, rich, [f"status {answer.status_code} {kind}", *lines])


def value_of(value: Any, words: dict[str, str]) -> Any:
    """A parameter of a statement, with ids as the code passes them."""
    if isinstance(value, list):
        return [value_of(one, words) for one in value]
    said = value.format_map(words) if isinstance(value, str) and "{" in value else value
    return UUID(said) if isinstance(said, str) and said.count("-") == 4 and len(said) == 36 else said


@pytest.mark.parametrize("number", range(len(STATEMENTS)), ids=[f"{name} {asked}" for name, asked in STATEMENTS])
def test_statements(rich: Rich, number: int) -> None:
    name, asked = STATEMENTS[number]
    with closing(connect(rich.url)) as conn:
        rows = query(conn, name, **{key: value_of(value, rich.words) for key, value in asked.items()})
    compare("statements", TABLES["statements"][number], rich, [f"{len(rows)} rows", *text.lines_of(rows)])


def _csv(path: Path) -> list[str]:
    with path.open(newline="") as file:
        return [*text.lines_of(list(csv.DictReader(file)))]


def _parquet(path: Path) -> list[str]:
    table, file = pq.read_table(path), pq.ParquetFile(path)
    geo = json.loads(file.metadata.metadata[b"geo"])
    geo["columns"]["geometry"]["crs"] = geo["columns"]["geometry"]["crs"]["name"]
    rows = [row | {"geometry": _place(row["geometry"])} for row in table.to_pylist()]
    return [*text.lines_of(geo, "geo"), *text.lines_of(sorted(rows, key=lambda row: str(row["feature_id"])))]


def _place(wkb: bytes) -> list[list[float]]:
    return [
        [float(value) for value in vertex] for vertex in shapely.get_coordinates(shapely.from_wkb(wkb), include_z=True)
    ]


def _layers(path: Path) -> list[str]:
    lines = []
    for layer in pyogrio.list_layers(path)[:, 0]:
        meta, table = pyogrio.read_arrow(path, layer=layer)
        lines.append(f"layer {layer}: {meta['geometry_type']} {meta['crs'][:12]}")
        rows = table.to_pylist()
        column = meta["geometry_name"] or "wkb_geometry"
        lines += text.lines_of([row | {column: _place(row[column])} for row in rows])
    return lines


def _scene(path: Path) -> list[str]:
    """Messages; what one says as others before it did is left out."""
    with path.open("rb") as file:
        lines = (
            line for _, channel, message in make_reader(file).iter_messages()
            for line in (f"{channel.topic} at {message.log_time}", *text.lines_of(json.loads(message.data)))
        )  # fmt: skip
        return [*dict.fromkeys(lines)]


READERS: dict[str, Callable[[Path], list[str]]] = {
    ".geojson": lambda path: text.json_lines(path.read_text()),
    ".csv": _csv,
    ".parquet": _parquet,
    ".gpkg": _layers,
    ".fgb": _layers,
    ".mcap": _scene,
    ".osm": lambda path: [*text.osm_lines(path.read_text())],
    ".xml": lambda path: [*text.xml_lines(path.read_text())],
    ".qgs": lambda path: [*text.xml_lines(path.read_text(), once=True)],
    ".html": lambda path: text.page_lines(path.read_text()),
}
TABLES: dict[str, list[str]] = {
    "commands": COMMANDS, "exports": EXPORTS, "reports": REPORTS, "routes": ROUTES,
    "statements": [f"{name} {asked}" for name, asked in STATEMENTS],
}  # fmt: skip


def test_the_record_holds_what_the_tables_ask() -> None:
    for group, entries in TABLES.items():
        assert len(set(entries)) == len(entries) and (not entries or [*text.recorded(file_of(group))] == entries), group


def test_what_was_recorded_is_what_the_tables_say(rich: Rich, tmp_path: Path) -> None:
    """States and changes at the instants of the tables above, in every face, as the fold in Python has them."""
    words = {
        name: datetime.fromisoformat(rich.words[name])
        for name in ("seen", "before_seen", "after_seen", "w3", "before_w3")
    }
    end = datetime(2026, 3, 5, 23, 59, tzinfo=UTC)
    with closing(connect(rich.url)) as conn:
        tables = MapByTables(conn, "default")
        faces = Faces(conn, command_line(tmp_path, rich.url), rich.client, "default", tmp_path)
        for at in (
            Instant(),
            Instant(words["seen"]),
            Instant(words["before_seen"]),
            Instant(words["after_seen"], words["w3"]),
        ):
            faces.assert_states(at, tables.standing(at))
        faces.assert_changes(Instant(words["seen"]), Instant(end), tables)
        faces.assert_changes(Instant(words["before_seen"]), Instant(words["seen"]), tables)
        faces.assert_changes(Instant(None, words["before_w3"]), Instant(None, words["w3"]), tables)
