"""Plans through the command line on PostGIS: import with history, comparison with drives, verdicts, and a map's dump."""

from __future__ import annotations

import csv
import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from conetl.db.connection import execute
from conetl.db.map.plan_store import image_path, read_plans
from conetl.geometry.geodesy import to_geodetic
from conetl.pipeline.maps.planned_zones import compare_with_plans
from tests.integration.drives_of_days import merge, survey
from tests.synthetic.world import ORIGIN_M, START_NS
from tests.unit.exports import test_datex2 as datex2
from tests.unit.readers import test_plans as plans

DAY = datetime.fromtimestamp(START_NS / 1e9, UTC)
LAST = "2030-01-01"


def line(x_m=(10.0, 50.0), y_m=2.0):
    """Along the road of the drives, metres east and north of their origin."""
    places = [to_geodetic(32632, (ORIGIN_M[0] + x, ORIGIN_M[1] + y_m, 0.0)) for x in x_m]
    return {"type": "LineString", "coordinates": [[lon, lat] for lat, lon, _ in places]}


def permit(name, geometry=None, days=(-1.0, 9.0), **more):
    times = {name: (DAY + timedelta(days=n)).isoformat() for name, n in zip(("start", "end"), days, strict=True)}
    return {"type": "Feature", "geometry": geometry or line(), "properties": {"id": name, **times, **more}}


def write(path: Path, *features) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


@pytest.fixture
def two_days(conn):
    for day in (0, 1):
        merge(conn, survey(day))
    conn.commit()


def kinds(found):
    return {row["plan_id"]: row["kind"] for row in found["rows"]}


def test_an_import_keeps_the_history_and_repeats_nothing(conn, two_days, conetl, tmp_path):
    file = write(tmp_path / "permits.geojson", permit("A"), permit("B"), permit("C", version="7"))
    assert "3 new, 0 changed, 0 as before" in conetl("zones", "plan", "import", file)
    before = execute(conn, "select clock_timestamp() as at")[0]["at"]
    conn.rollback()
    assert "0 new, 0 changed, 3 as before" in conetl("zones", "plan", "import", file)
    write(
        file,
        permit("A", lanes="right lane"),
        permit("C", version="6"),
        permit("D", {"type": "Point", "coordinates": ["x", 1]}),
    )
    done = json.loads(conetl("zones", "plan", "import", file, "--json", code=1))
    assert (done["added"], done["changed"], done["older"], done["unchanged"]) == ([], ["A"], ["C"], 0)
    assert [one["record"] for one in done["unused"]] == ["feature 3"]
    assert conetl("zones", "plan", "import", write(file, permit("A")), "--list", "other")

    def known(at=None):
        return [
            (one.list_name, one.plan.plan_id, one.plan.lanes)
            for one in read_plans(conn, map_name="default", known_at=at)
        ]

    assert known(before) == [("permits", name, ()) for name in "ABC"]
    assert known() == [
        ("other", "A", ()),
        ("permits", "A", ("right lane",)),
        ("permits", "B", ()),
        ("permits", "C", ()),
    ]
    conn.rollback()
    assert "4 plans of map default as known now" in conetl("zones", "plan", "list")
    assert "3 plans" in conetl("zones", "plan", "list", "--known-at", before.isoformat())
    assert "no map named east" in conetl("zones", "plan", "import", file, "--map", "east", code=2)
    nothing = conetl("zones", "plan", "import", write(file, permit("A", {"type": "Sphere"})), code=2)
    assert "none of its 1 records is a plan that can be used; feature 1: its geometry is 'Sphere'" in nothing


def test_feeds_are_imported_too_and_what_is_no_work_zone_is_no_fault(two_days, conetl, tmp_path):
    feed = tmp_path / "feed.geojson"
    feed.write_text(json.dumps(plans.feed(plans.event(1), plans.event(2, event_type="detour"))))
    done = json.loads(conetl("zones", "plan", "import", feed, "--list", "state", "--json"))
    assert (done["added"], [one["is_broken"] for one in done["unused"]]) == (["e1"], [False])
    publication = datex2.publication(tmp_path / "situations.xml", {}, {"version": "2"})
    assert "2 new" in conetl("zones", "plan", "import", publication, "--list", "state")
    assert "leave out --crs" in conetl("zones", "plan", "import", feed, "--crs", "EPSG:25832", code=2)


def test_differences_as_table_and_files_with_images_and_verdicts_that_stay(conn, two_days, conetl, tmp_path):
    features = [
        permit("in place"),
        permit("aside", line(y_m=400.0)),
        permit("earlier", line((200.0, 240.0)), days=(-9, -5)),
        permit("empty", line((-5.0, 5.0), y_m=0.0)),
        permit("later", days=(5, 9)),  # at the same place as the first
    ]
    conetl("zones", "plan", "import", write(tmp_path / "permits.geojson", *features))
    found = json.loads(conetl("zones", "compare", "--as-of", LAST, "--json"))
    assert kinds(found) == {
        "in place": "permitted and found", "aside": "not looked", "earlier": "not looked", "empty": "permitted but not found",
        "later": "not looked",
    }  # fmt: skip
    rows = {row["plan_id"]: row for row in found["rows"]}
    row = rows["in place"]
    assert row["coverage"] == 1.0 and row["confidence"] > 0.9 and row["verdict"] == "open"
    assert (row["first_drive"], row["last_drive"]) == (survey(0).drive.drive_id, survey(1).drive.drive_id)
    assert row["images"][0].startswith(survey(0).drive.source_path) and row["images"][0].endswith((".png", ".jpg"))
    assert (
        row["link"].startswith("#map=default&valid=2026-")
        and "&feature=" in row["link"]
        and "&mark=" in rows["empty"]["link"]
    )
    assert json.loads(conetl("zones", "compare", "--as-of", LAST, "--json")) == found

    files = [tmp_path / f"differences.{suffix}" for suffix in ("csv", "html", "geojson")]
    printed = conetl("zones", "compare", "--as-of", LAST, *(word for path in files for word in ("--out", path)))
    assert "permitted but not found: 1, not looked: 3" in printed
    with files[0].open() as file:
        table = list(csv.DictReader(file))
    assert [one["plan_id"] for one in table] == [one["plan_id"] for one in found["rows"]]
    page = files[1].read_text()
    assert "Permitted but not found (1)" in page and page.index("but not found") < page.index("Not looked (3)")
    layer = json.loads(files[2].read_text())
    assert [one["properties"] for one in layer["features"]] == found["rows"]
    assert "expected a name that ends with .csv" in conetl("zones", "compare", "--out", "x.pdf", code=2)

    # A verdict stays when the comparison is repeated, also after later drives, and can be taken back.
    chosen = rows["empty"]["difference_id"]
    assert "accepted" in conetl(
        "zones", "judge", chosen[:8], "accepted", "--note", "agreed by phone", "--by", "Ann", "--as-of", LAST
    )
    merge(conn, survey(2))
    conn.commit()
    judged = {row["plan_id"]: row for row in json.loads(conetl("zones", "compare", "--as-of", LAST, "--json"))["rows"]}
    verdict = [judged["empty"][name] for name in ("verdict", "note", "decided_by")]
    assert verdict == ["accepted", "agreed by phone", "Ann"]
    assert {row["verdict"] for name, row in judged.items() if name != "empty"} == {"open"}
    conetl("zones", "judge", chosen[:8], "open", "--by", "Ann", "--as-of", LAST)
    again = compare_with_plans(conn, map_name="default", as_of=datetime(2030, 1, 1, tzinfo=UTC))
    assert {row.verdict for row in again.rows} == {"open"}
    conn.rollback()
    assert "no difference has an id" in conetl("zones", "judge", "ffffffff", "accepted", code=2)
    assert "expected one of confirmed" in conetl("zones", "judge", chosen, "fine", code=2)


def test_a_zone_without_permit_keeps_its_verdict_although_its_id_changes(conn, conetl):
    merge(conn, survey(1))
    conn.commit()
    [row] = json.loads(conetl("zones", "compare", "--as-of", LAST, "--json"))["rows"]
    assert (row["kind"], row["plan_id"], row["absent_at"]) == ("found without permit", None, None)
    conetl("zones", "judge", row["difference_id"], "confirmed", "--as-of", LAST)
    merge(conn, survey(0))  # it comes late, and found the zone first
    conn.commit()
    [late] = json.loads(conetl("zones", "compare", "--as-of", LAST, "--json"))["rows"]
    assert late["zone_id"] != row["zone_id"] and late["verdict"] == "confirmed"


def test_the_dump_of_a_map_has_its_plans_and_verdicts(conn, two_days, conetl, tmp_path):
    conetl("zones", "plan", "import", write(tmp_path / "permits.geojson", permit("A", days=(5, 9))))
    [row] = json.loads(conetl("zones", "compare", "--as-of", LAST, "--json"))["rows"]
    conetl("zones", "judge", row["difference_id"], "accepted", "--as-of", LAST)
    before = json.loads(conetl("zones", "compare", "--as-of", LAST, "--json"))
    conetl("map", "delete", "default", "--yes", "--dump", tmp_path / "map.zip")
    conetl("map", "restore", tmp_path / "map.zip")
    assert json.loads(conetl("zones", "compare", "--as-of", LAST, "--json")) == before
    assert before["rows"][0]["verdict"] == "accepted"


@pytest.mark.parametrize(
    ("drive", "image", "whole"),
    [
        ("/srv/a", "image_02/1.jpg", "/srv/a/image_02/1.jpg"),
        ("/srv/a", "/srv/a/image_02/1.jpg", "/srv/a/image_02/1.jpg"),
        ("s3://bucket/a", "s3://bucket/a/1.jpg", "s3://bucket/a/1.jpg"),
    ],
)
def test_an_image_has_one_path(drive, image, whole):
    assert image_path(drive, image) == whole
