"""Lists of the web view: every order, filter and page says what the whole list says."""

from __future__ import annotations

from collections import Counter
from datetime import datetime
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from benchmarks.made_up_maps import make_closures
from conetl.db.connection import execute
from conetl.db.list_store import ORDERS, Listed, ListOrder
from conetl.model.feature_classes import LANE_MARKING
from conetl.web.app import create_app

COUNT = 900
MAP = "/api/maps/default"
CHANGESET = {"changeset_no": 2}
PERIOD = {"from_valid_at": "2026-03-02T00:00:00Z"}
#: What a row is sorted by, as the page shows it.
SHOWN = {
    "id": "feature_id", "existence": "existence_probability", "sigma": "sigma_m", "height": "object_height_m",
    "drive": "changeset_no", "seen": "last_seen_at", "observations": "observation_count",
}  # fmt: skip


@pytest.fixture(scope="module")
def client(module_database_url: str, module_conn: Any) -> Any:
    make_closures(module_conn, "default", features=COUNT, versions=2)
    execute(module_conn, "update conetl.feature_version set category = 'drum' where first_seen_ns % 2 = 0")
    module_conn.commit()
    with TestClient(create_app(module_database_url, "default"), base_url="http://127.0.0.1") as client:
        yield client


def get(client: TestClient, path: str, **parameters: Any) -> Any:
    answer = client.get(f"{MAP}/{path}", params=parameters)
    assert answer.status_code == 200, answer.text
    return answer.json()


def every(client: TestClient, what: str, **parameters: Any) -> list[dict[str, Any]]:
    """All rows of a list, page after page."""
    rows: list[dict[str, Any]] = []
    after: dict[str, str] = {}
    while True:
        page = get(client, what, limit=250, **parameters, **after)
        rows += [row | {"last_seen_at": datetime.fromisoformat(row["last_seen_at"])} for row in page[what]]
        if page["next"] is None:
            return rows
        after = {"after": page["next"]}


@pytest.mark.parametrize("what, source", [("features", {}), ("changes", CHANGESET)])
@pytest.mark.parametrize("sort", [f"{by}{sign}" for by in ORDERS for sign in ("", "-")])
def test_pages_of_every_order_are_the_whole_list(client, what, source, sort):
    rows = every(client, what, sort=sort, **source)
    ids = [row["feature_id"] for row in rows]
    assert len(ids) == len(set(ids)) == COUNT
    if shown := SHOWN.get(sort.removesuffix("-")):
        keys = [row[shown] for row in rows]
        assert keys == sorted(keys, reverse=sort.endswith("-"))
    page = get(client, what, sort=sort, offset=345, limit=3, **source)[what]
    assert [row["feature_id"] for row in page] == ids[345:348]
    found = get(client, f"{what}/count", sort=sort, feature=ids[345], **source)
    assert found == {"count": COUNT, "index": 345}


@pytest.mark.parametrize("what, source", [("features", {}), ("changes", CHANGESET), ("changes", PERIOD)])
def test_filters_are_those_of_the_rows(client, what, source):
    rows = every(client, what, **source)
    most_sigma_m = float(np.median([row["sigma_m"] for row in rows]))
    east, north = get(client, "timeline")["origin_m"][:2]
    corner = np.add(np.median([row["xyz_m"] for row in rows], axis=0)[:2], (east, north))
    area = [*(corner - 1e6), corner[0], corner[1] - 1e6, *corner, corner[0] - 1e6, corner[1]]
    seen = sorted(row["last_seen_at"] for row in rows)[COUNT // 2]
    for parameters, accepts in (
        ({"hidden_classes": ["drum"]}, lambda row: row["category"] != "drum"),
        ({"least_existence": 0.95}, lambda row: row["existence_probability"] >= 0.95),
        ({"most_existence": 0.93}, lambda row: row["existence_probability"] <= 0.93),
        ({"most_sigma_m": most_sigma_m}, lambda row: row["sigma_m"] <= most_sigma_m),
        ({"least_height_m": 0.6}, lambda row: row["object_height_m"] >= 0.6),
        ({"most_height_m": 0.6}, lambda row: row["object_height_m"] <= 0.6),
        ({"of_changeset": 1}, lambda row: row["changeset_no"] == 1),
        ({"seen_from": seen.isoformat()}, lambda row: row["last_seen_at"] >= seen),
        ({"seen_before": seen.isoformat()}, lambda row: row["last_seen_at"] < seen),
        ({"area": area}, lambda row: (np.add(row["xyz_m"][:2], (east, north)) <= corner).all()),
        ({"kinds": ["moved", "removed"]}, lambda row: row.get("kind") in ("moved", "removed")),
    ):  # fmt: skip
        wanted = {row["feature_id"] for row in rows if accepts(row)}
        found = every(client, what, **parameters, **source)
        assert {row["feature_id"] for row in found} == wanted, parameters
        assert get(client, f"{what}/count", **parameters, **source)["count"] == len(wanted), parameters


def test_the_changes_in_view_are_those_of_the_list(client, monkeypatch):
    monkeypatch.setattr("conetl.web.lists.MAX_IN_VIEW", COUNT // 2)
    rows = every(client, "changes", **CHANGESET)
    numbers = get(client, "changes/summary", **CHANGESET)
    assert numbers["kinds"] == Counter(row["kind"] for row in rows)
    assert numbers["categories"] == Counter(row["category"] for row in rows)
    view = get(client, "changes/view", **CHANGESET)
    assert (
        view["kinds"] == numbers["kinds"] and view["listed"] == [] == view["changes"]
    )  # all are confirmed, and too many
    east, north = get(client, "timeline")["origin_m"][:2]
    total = 0
    for west in np.arange(0.0, 45_000.0, 15_000.0) + 449_000:  # strips over the whole map
        area = [west, 5e6, west + 15_000, 5e6, west + 15_000, 6e6, west, 6e6]
        inside = {row["feature_id"] for row in rows if west <= row["xyz_m"][0] + east < west + 15_000}
        view = get(client, "changes/view", area=area, **CHANGESET)
        assert {row["feature_id"] for row in view["changes"]} == inside and view["listed"]
        assert sum(view["kinds"].values()) == len(inside)
        total += len(inside)
    assert total == COUNT and north > 0


@pytest.mark.parametrize("descending", [False, True])
@pytest.mark.parametrize(("by", "category"), [("height", LANE_MARKING), ("class", "milestone")])
def test_rows_without_a_key_come_last_in_both_directions(client, module_conn, by, category, descending):
    """Lane markings have no height, and classes of other programs no number."""
    change = "update conetl.feature_version set category = %(category)s where first_seen_ns % 7 = 0"
    execute(module_conn, change.replace("% 7", "%% 7"), {"category": category})
    listed = Listed("standing", {"map_name": "default"}, {})
    rows = listed.page(module_conn, ListOrder(by, descending), rows=COUNT, origin_m=[0.0] * 3)
    module_conn.rollback()
    without = [row["category"] == category for row in rows]
    assert 0 < sum(without) < len(rows) == COUNT and without == sorted(without)
