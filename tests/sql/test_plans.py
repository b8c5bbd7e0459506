"""No statement reads a table once per row of another one, also where the planner's statistics are older than the last drive."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np
import pytest

from conetl.db import serve_store as store
from conetl.db.connection import Connection, connect, execute, query
from conetl.db.list_store import Listed, ListOrder
from conetl.db.map.commit import path_wkt
from conetl.db.map.drive_store import drives_at_the_same_time, drives_with_boxes
from conetl.db.map.map_store import feature_log, list_changesets, require_map
from conetl.db.map.results import CommittedChangeset
from conetl.db.retention import archive_drive, prunable_drives, restore_drives
from conetl.db.schema import run_audits
from conetl.exports.export import export_map
from conetl.exports.source import ExportRequest
from conetl.geometry.geodesy import to_geodetic
from conetl.model.planned_zones import PlanFile, PlannedZone
from conetl.pipeline.maps.planned_zones import compare_with_plans, import_plans
from conetl.reports.drive_page import write_drive_page
from conetl.reports.night_page import write_night_page
from conetl.web import frames, maps, tiles
from conetl.web.parameters import origin_of
from tests.integration.drives_of_days import DAY_NS, Survey, merge, survey_of
from tests.synthetic.world import START_NS, Cone

#: Every session of the database receives the plan of each statement that it ran, with the numbers of rows.
EXPLAINED = {
    "session_preload_libraries": "auto_explain", "auto_explain.log_min_duration": "0", "auto_explain.log_analyze": "on",
    "auto_explain.log_timing": "off", "auto_explain.log_format": "json", "auto_explain.log_nested_statements": "on",
    "client_min_messages": "log", "statement_timeout": "60s",
}  # fmt: skip
#: A node may read each row of the largest table of its statement so often. Of few rows any plan is good.
MOST, FEW = 6, 1_000


class Planted(NamedTuple):
    """A map of a short drive, which the statistics know, and a long one, which they do not."""

    conn: Connection
    drive: Survey
    changeset: CommittedChangeset
    feature_id: UUID
    """Observed by both drives."""
    rows: dict[str, int]
    """Of each table."""
    folder: Path


def road(length_m: int, day: int) -> Survey:
    """A drive past a cone every 2 m."""
    cones = [Cone((14.0 + 2.0 * k, 3.6, 0.0), height_m=0.7) for k in range(length_m // 2)]
    at = {"start_m": 0.0, "first_ns": START_NS + day * DAY_NS}
    return survey_of(cones, np.random.default_rng(10 + day), f"day_{day}", frames=length_m, **at)


@pytest.fixture(scope="module")
def planted(module_database_url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Planted]:
    with closing(connect(module_database_url)) as conn:
        tables = "select relname as name from pg_class where relnamespace = 'conetl'::regnamespace and relkind = 'r'"
        names = [row["name"] for row in execute(conn, tables)]
        for name in names:
            execute(conn, f"alter table {name} set (autovacuum_enabled = off)")
        for name, value in EXPLAINED.items():
            execute(conn, f"alter database {conn.info.dbname} set {name} = '{value}'")
        conn.commit()
        merge(conn, road(40, 0))
        execute(conn, "analyze")
        conn.commit()
        drive = road(240, 1)
        merge(conn, drive)
    with closing(connect(module_database_url)) as conn:
        latest = list_changesets(conn)[0]
        changes = query(
            conn, "history.changes_of_changeset", map_name="default", changeset_no=2, origin_m=[0.0, 0.0, 0.0]
        )
        feature_id = next(row["feature_id"] for row in changes if row["kind"] == "confirmed")
        rows = {name: execute(conn, f"select count(*) as n from {name}")[0]["n"] for name in names}
        yield Planted(conn, drive, latest, feature_id, rows, tmp_path_factory.mktemp("plans"))


def write_pages(map_: Planted) -> None:
    write_drive_page(map_.conn, map_.changeset, map_.folder / "drive.html", map_name="default")
    always = {"since": datetime(2000, 1, 1, tzinfo=UTC), "until": datetime(9000, 1, 1, tzinfo=UTC)}
    write_night_page(map_.conn, map_.folder / "night.html", map_name="default", **always)


def compare_with_stored_drives(map_: Planted) -> None:
    """As an ingest does, before it commits."""
    drive = map_.drive.drive.model_copy(update={"content_sha256": "ab" * 32})
    drives_at_the_same_time(map_.conn, drive, path_wkt(drive), 1_000_000, map_name="default")
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs[::40]}
    boxes = [
        (
            pairs[d.frame_index].captured_at_ns,
            *pairs[d.frame_index].pose.map_t_body_m[:2],
            d.x_px,
            d.y_px,
            d.w_px,
            d.h_px,
        )
        for d in map_.drive.detections
        if d.side == "left" and d.frame_index in pairs
    ]
    limits = {"within_m": 1.0, "same_px": 1.0, "same_ns": 1_000_000, "least_images": 3, "least_share": 0.5}
    drives_with_boxes(map_.conn, drive, boxes, map_name="default", **limits)


def serve(map_: Planted) -> None:
    conn, drive_uuid, origin = map_.conn, map_.changeset.drive_uuid, origin_of(map_.conn, "default")
    maps.timeline("default", conn, origin)
    for known_at in (None, datetime(2000, 1, 1, tzinfo=UTC)):  # now: stored; then: counted
        tiles.summary("default", conn, origin, known_at=known_at)
        for zoom in (0, 10):
            x, y = (int(value // 2 ** (20 - zoom)) for value in origin[:2])
            tiles.tile("default", zoom, x, y, conn, origin, known_at=known_at)
    instants = dict.fromkeys(("valid_at", "known_at", "to_valid_at", "to_known_at", "from_known_at"), "infinity")
    state = {"map_name": "default", "changeset_no": 2, "from_valid_at": "-infinity", **instants}
    x, y = origin[:2]
    srid = require_map(conn, "default").srid
    everywhere = f"SRID={srid};POLYGON(({x - 1e4} {y - 1e4}, {x + 1e4} {y}, {x} {y + 1e4}, {x - 1e4} {y - 1e4}))"
    for source in ("standing", "stood", "changed_by", "changed_between"):
        for filters in ({}, {"box": everywhere}):
            rows = Listed(source, state, filters)
            for by in ("id", "existence", "shift", "north"):
                rows.page(conn, ListOrder(by, descending=True), rows=10, origin_m=[*origin])
            rows.count(conn, ListOrder("north"), map_.feature_id)
            rows.read(conn, "summary")
            rows.read(conn, "cells", cell_zoom=10)
            rows.read(conn, "drawn", origin_m=[*origin])
    maps.feature_history("default", map_.feature_id, conn, origin)
    maps.sightings("default", map_.feature_id, conn, origin)
    maps.trajectory("default", drive_uuid, conn, origin)
    frames.passes("default", map_.feature_id, conn, origin)
    page = {"first_row": 0, "max_rows": 100}
    store.review_page(conn, "default", "changes", change="moved", moved_from_m=0.0, **page)
    store.review_page(conn, "default", "doubtful", least=0.1, most=1.0, **page)
    edges = {
        "west_m": 0.0,
        "south_m": 0.0,
        "east_m": 2.0**24,
        "north_m": 2.0**24,
        "srid": require_map(conn, "default").srid,
    }
    standing = store.read_rows(
        conn, "serving.features_in_tile", map_name="default", valid_at="infinity", known_at="infinity", **edges,
        origin_m=[0.0, 0.0, 0.0],
    )  # fmt: skip
    store.last_changes(conn, "default", [row["feature_id"] for row in standing])
    store.track_ranges(conn, [(drive_uuid, track.track_index) for track in map_.drive.tracks[::2]])
    store.read_frame_boxes(conn, drive_uuid, 100)
    store.read_rows(conn, "judging.frame", map_name="default", drive_uuid=drive_uuid, frame_index=100)


def compare_with_permits(map_: Planted) -> None:
    lat, lon, _ = to_geodetic(32632, map_.drive.drive.frame_pairs[20].pose.map_t_body_m).tolist()
    zones = [
        PlannedZone(plan_id=str(k), kind="permit", starts_at=datetime(2020, 1, 1, tzinfo=UTC), parts=(((lon, lat),),))
        for k in range(50)
    ]
    import_plans(map_.conn, Path("permits"), PlanFile(tuple(zones), ()), map_name="default", list_name="permits")
    assert len(compare_with_plans(map_.conn, map_name="default").rows) >= len(zones)


def export(map_: Planted) -> None:
    export_map(map_.conn, map_.folder / "map.geojson", "geojson", ExportRequest("default"))
    feature_log(map_.conn, map_.feature_id)


def archive_and_restore(map_: Planted) -> None:
    [drive] = [d for d in prunable_drives(map_.conn, datetime.now(UTC)) if d.drive_uuid == map_.changeset.drive_uuid]
    archive_drive(map_.conn, drive, map_.folder)
    restore_drives(map_.conn, "default")


def audit(map_: Planted) -> None:
    run_audits(map_.conn)


def ingest_a_later_drive(map_: Planted) -> None:
    merge(map_.conn, road(60, 2))


def ingest_an_earlier_drive(map_: Planted) -> None:
    merge(map_.conn, road(61, -1))


ACTIONS = (
    write_pages, compare_with_stored_drives, compare_with_permits, serve, export, audit, archive_and_restore,
    ingest_a_later_drive, ingest_an_earlier_drive,
)  # fmt: skip


@pytest.mark.parametrize("action", ACTIONS, ids=lambda action: action.__name__)
def test_no_statement_reads_a_table_per_row_of_another(planted: Planted, action: Callable[[Planted], object]) -> None:
    notices: deque[str] = deque()
    planted.conn.notices = notices  # psycopg2 would keep the last fifty in a list of its own
    action(planted)
    planted.conn.rollback()
    plans = [json.loads(notice.partition("plan:\n")[2]) for notice in notices if "plan:\n" in notice]
    assert len(plans) > 1
    assert [found for plan in plans if (found := excess(plan, planted.rows))] == []


def excess(plan: dict[str, Any], rows: dict[str, int]) -> str:
    """The node that reads too many rows, and its statement; empty where none does."""
    every = list(nodes(plan["Plan"]))
    most = MOST * max(FEW, *(rows.get(node.get("Relation Name", ""), 0) for node in every))
    read, worst = max(((rows_read(node), node) for node in every), key=lambda one: one[0])
    what = {name: worst.get(name) for name in ("Node Type", "Relation Name", "Index Cond")}
    return f"{read} rows, at most {most}: {what} in {plan['Query Text']}" if read > most else ""


def rows_read(node: dict[str, Any]) -> float:
    """In all loops of a node."""
    dropped = sum(node.get(f"Rows Removed by {what}", 0) for what in ("Filter", "Join Filter", "Index Recheck"))
    return float((node["Actual Rows"] + dropped) * node["Actual Loops"])


def nodes(plan: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield plan
    for inner in plan.get("Plans", ()):
        yield from nodes(inner)
