"""Differences from plans in the web view and the OGC API: the rows of `conetl zones compare`, the worst first, and verdicts."""

from __future__ import annotations

import json
import random
from datetime import timedelta
from uuid import UUID

import httpx
import jsonschema
import pytest
from pydantic import SecretStr

from conetl.files.people import add_person, people_of
from conetl.model.planned_zones import Difference, Sight
from conetl.model.planned_zones import DifferenceKind as K
from conetl.pipeline.maps import planned_zones
from conetl.pipeline.maps.planned_zones import PlanComparison, PlanRow
from conetl.pipeline.settings import Settings
from conetl.web.decisions import Writer
from tests import ogc_schemas as standard
from tests.integration.drives_of_days import merge, survey
from tests.integration.test_planned_zones import DAY, line, permit, write
from tests.view_map import view_of

TOKEN = "a-token-that-nobody-guesses"
ITEMS = "/ogc/collections/default.differences/items"
WRITE = {"Authorization": f"Bearer {TOKEN}"}


@pytest.fixture
def view(conn, conetl, database_url, tmp_path):
    """Two drives past one zone, and four permits: it agrees with one; another place is empty; nobody looked at two."""
    for day in (0, 1):
        merge(conn, survey(day))
    conn.commit()
    features = [
        permit("in place", lanes="left lane"), permit("aside", line(y_m=400.0)), permit("empty", line((-5.0, 5.0), y_m=0.0)),
        permit("tomorrow", days=(5, 9)),
    ]  # fmt: skip
    conetl("zones", "plan", "import", write(tmp_path / "permits.geojson", *features))
    writer = Writer(SecretStr(TOKEN), database_url, Settings(home=tmp_path))
    with view_of(database_url, writer=writer) as client:
        yield client


def rows_of(view, **asked):
    answer = view.get("/api/maps/default/differences", params=asked)
    assert answer.status_code == 200, answer.text
    return answer.json()


def compared(conetl, *more):
    return json.loads(conetl("zones", "compare", "--json", *more))["rows"]


def test_one_comparison_answers_all_faces(view, conetl):
    table = {row["difference_id"]: row for row in compared(conetl)}
    found = rows_of(view)
    assert found["plan_count"] == 4 and not found["truncated"]
    assert {row["difference_id"] for row in found["rows"]} == table.keys()
    for row in found["rows"]:
        same = {name: row[name] for name in row.keys() & table[row["difference_id"]].keys()}
        assert same == {name: table[row["difference_id"]][name] for name in same} and len(same) > 12
    ranks = [row["rank"] for row in found["rows"]]
    assert ranks[:1] == [1] and sorted(filter(None, ranks)) == [rank for rank in ranks if rank]
    page = view.get(ITEMS, params={"limit": 100, "sortby": "rank"}).json()
    jsonschema.validate(page, standard.ITEMS, cls=jsonschema.Draft202012Validator)
    assert page["numberMatched"] == len(table)
    for item in page["features"]:
        row = table[item["id"]]
        times = [name for name in row if name.endswith("_at") or name.startswith("planned")]
        assert all(item["properties"][n] == row[n] for n in item["properties"] if n not in times)
        assert all(item["properties"][n][:19] == row[n][:19] for n in times if row[n])
        assert item["geometry"]["coordinates"] == [pytest.approx(row["lon_deg"]), pytest.approx(row["lat_deg"])]
    assert [item["properties"]["rank"] for item in page["features"]] == sorted(ranks, key=lambda rank: rank or 99)


def test_a_row_has_its_place_images_and_plan(view):
    rows = {row["plan_id"]: row for row in rows_of(view)["rows"]}
    zone, empty = rows["in place"], rows["empty"]
    assert (
        zone["feature_id"]
        and len(zone["zone_ring_m"]) >= 12
        and [len(ring) >= 8 for ring in zone["plan_rings_m"]] == [True]
    )
    xs, ys = zone["zone_ring_m"][::3], zone["zone_ring_m"][1::3]
    assert min(xs) <= zone["at_m"][0] <= max(xs) and min(ys) <= zone["at_m"][1] <= max(ys)
    assert [zone[name]["drive_id"] for name in ("first", "last")] == [survey(day).drive.drive_id for day in (0, 1)]
    assert (empty["kind"], empty["zone_ring_m"], empty["at_m"][2]) == ("permitted but not found", [], None)
    for row in (zone, empty):
        for one in (row["first"], row["last"]):
            frame = view.get(f"/api/maps/default/drives/{one['drive_uuid']}/frames/{one['frame_index']}").json()
            assert frame["drive_id"] == one["drive_id"]
    assert rows["aside"]["last"] is None and rows["aside"]["text"] == "no drive passed it in its time"


def test_what_is_open_and_of_last_night_comes_first_and_then_the_worst_kinds():
    night = Sight(at=DAY)

    def row(number, kind, verdict="open", hours=0.0, confidence=0.9, amount=1.0):
        sight = night.model_copy(update={"at": DAY - timedelta(hours=hours)})
        one = Difference(difference_id=UUID(int=number), kind=kind, text="", confidence=confidence, amount=amount, last=sight,
            xy_m=(0.0, 0.0), radius_m=0.0)  # fmt: skip
        return PlanRow(difference=one, lon_deg=0.0, lat_deg=0.0, link="", verdict=verdict)

    expected = [
        row(1, K.NO_PERMIT), row(2, K.NO_PERMIT, confidence=0.8), row(3, K.LONGER, amount=30.0), row(4, K.LONGER, amount=2.0),
        row(5, K.NOT_FOUND, hours=23.0), row(6, K.NO_PERMIT, hours=25.0), row(7, K.NO_PERMIT, verdict="accepted"),
    ]  # fmt: skip
    for seed in range(20):
        shuffled = random.Random(seed).sample([*expected, row(8, K.PERMITTED), row(9, K.NOT_LOOKED)], 9)
        ranked = planned_zones._ranked(shuffled)
        assert [one.difference.difference_id.int for one in ranked] == [
            one.difference.difference_id.int for one in shuffled
        ]
        by_rank = PlanComparison(DAY, ranked).worst_first
        assert [(one.difference.difference_id.int, one.rank) for one in by_rank] == [(n, n) for n in range(1, 8)]
        assert [one.last_night for one in by_rank] == [True] * 5 + [False, True]


def test_filters_boxes_times_and_tiles_of_the_collection(view, conetl):
    def found(**asked):
        page = view.get(ITEMS, params=asked)
        assert page.status_code == 200, page.text
        return [item["properties"]["plan_id"] for item in page.json()["features"]]

    assert found(kind="permitted but not found") == ["empty"] and found(rank=1) == [rows_of(view)["rows"][0]["plan_id"]]
    assert view.get(ITEMS, params={"kind": "lost"}).status_code == 400
    assert view.get("/ogc/collections/default.features/items", params={"kind": "x"}).status_code == 400
    lon, lat = next((r["lon_deg"], r["lat_deg"]) for r in compared(conetl) if r["plan_id"] == "aside")
    assert found(bbox=f"{lon - 1e-4},{lat - 1e-4},{lon + 1e-4},{lat + 1e-4}") == ["aside"]
    early = (DAY - timedelta(days=2)).isoformat()
    assert found(at=early) == [], "no plan has begun"
    assert found(known_at=early) == [None], "the zone, as no plan was known"
    assert len(found(limit=1, offset=1)) == 1
    one = view.get(f"{ITEMS}/{rows_of(view)['rows'][0]['difference_id']}").json()
    assert one["properties"]["rank"] == 1
    assert view.get("/ogc/collections/default.differences/queryables").status_code == 200
    assert len(view.get("/ogc/collections/default.differences/tiles/WebMercatorQuad/0/0/0").content) > 50


def test_a_person_judges_and_takes_it_back(view, conetl, tmp_path):
    first = rows_of(view)["rows"][0]
    path = f"/api/maps/default/differences/{first['difference_id']}"
    said = {"verdict": "accepted", "decided_by": "Ann", "note": "agreed by phone"}
    assert view.post(path, json=said).status_code == 401
    assert view.post(path, json=said, headers=WRITE).json()["verdict"] == "accepted"
    [row] = [row for row in compared(conetl) if row["difference_id"] == first["difference_id"]]
    assert [row[name] for name in ("verdict", "note", "decided_by")] == ["accepted", "agreed by phone", "Ann"]
    judged = {row["difference_id"]: row for row in rows_of(view)["rows"]}[first["difference_id"]]
    assert judged["verdict"] == "accepted" and judged["decided_by"] == "Ann"
    assert view.post(path, json=said | {"verdict": "open"}, headers=WRITE).status_code == 201
    assert {row["verdict"] for row in rows_of(view)["rows"]} == {"open"}
    missing = view.post(f"{path[:-4]}ffff", json=said, headers=WRITE)
    assert missing.status_code == 404 and "no difference has an id" in missing.text
    assert view.post(path, json=said | {"verdict": "fine"}, headers=WRITE).status_code == 422


def test_who_is_logged_in_judges_by_name_if_the_role_allows_it(view, database_url, tmp_path):
    first = rows_of(view)["rows"][0]["difference_id"]
    said = {"verdict": "wrong", "decided_by": "somebody else"}
    writer = Writer(SecretStr(TOKEN), database_url, Settings(home=tmp_path))
    tokens = {role: add_person(tmp_path, f"Ada {role}", role).get_secret_value() for role in ("review", "read")}
    options = {"writer": writer, "reader_token": SecretStr("shared-token-of-view"), "find_person": people_of(tmp_path)}
    with view_of(database_url, **options) as client:
        answers = {
            role: client.post(f"/api/maps/default/differences/{first}", json=said, headers={"Authorization": f"Bearer {token}"})
            for role, token in tokens.items()
        }  # fmt: skip
    assert answers["read"].status_code == 403
    assert answers["review"].json()["decided_by"] == "Ada review"


def test_without_plans_nothing_is_compared_and_a_large_map_says_so(conn, view, database_url, monkeypatch):
    from conetl.web import zones

    monkeypatch.setattr(zones, "MOST_FEATURES", 3)
    with view_of(database_url) as client:
        answer = client.get("/api/maps/default/differences").json()
        assert (answer["truncated"], answer["rows"]) == (True, [])
        refused = client.get(ITEMS)
        assert refused.status_code == 503 and "conetl zones compare" in refused.text
    for day in (0, 1):
        merge(conn, survey(day), map_name="bare")
    conn.commit()
    answer = view.get("/api/maps/bare/differences").json()
    assert (answer["plan_count"], answer["rows"], answer["truncated"]) == (0, [], False)


def test_the_nightly_flow_shows_them_as_a_table(
    conn, view, database_url, prefect_here, prefect, conetl, monkeypatch, tmp_path
):
    from flows.scheduled import audit, publish_map

    for name, value in (("DATABASE_URL", database_url), ("HOME", str(tmp_path)), ("VIEW_URL", "http://127.0.0.1:1/")):
        monkeypatch.setenv(f"CONETL_{name}", value)
    publish_map(map_name="default", formats=["csv"], folder=tmp_path / "exports", return_state=True)
    audited = audit(return_state=True)
    assert audited.type == "COMPLETED" and audited.message.endswith("audits passed")
    user, _, password = prefect["PREFECT_API_AUTH_STRING"].partition(":")
    wanted = {"artifacts": {"key": {"any_": ["plan-differences"]}}}
    found = httpx.post(
        f"{prefect['PREFECT_API_URL']}/artifacts/filter", json=wanted, auth=(user, password), timeout=30, trust_env=False
    ).json()  # fmt: skip
    assert [one["description"] for one in found] == ["1 difference of map default from plans, the worst first"]
    [row] = json.loads(found[0]["data"])
    [expected] = [row for row in compared(conetl) if row["rank"]]
    assert (row["rank"], row["text"].replace("\\", ""), row["plan_id"]) == (1, expected["text"], "empty")
    assert row["map"].startswith("http://127.0.0.1:1/#map=default")
