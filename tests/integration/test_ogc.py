"""OGC API Features and vector tiles at /ogc, over a real PostGIS: what the standards require, and the map as of an instant."""

from __future__ import annotations

import json
import re
import subprocess
from datetime import datetime, timedelta
from itertools import product
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import jsonschema
import morecantile
import numpy as np
import pytest
from fastapi.testclient import TestClient

from conetl.geometry.geodesy import to_geodetic
from conetl.model.base import utc_from_ns
from conetl.model.columns import BY_NAME
from conetl.pipeline.maps.decisions import SUPPRESS, decide_location, revert
from conetl.web.app import create_app
from conetl.web.ogc import collections
from tests import ogc_schemas as standard
from tests.integration.drives_of_days import merge, survey
from tests.integration.test_exports import OFFSCREEN, PYTHON, has_qgis
from tests.view_map import OWN, commit, cone, missed, serving, view_of

OGC = "/ogc"
FEATURES = f"{OGC}/collections/default.features"
CHANGES = f"{OGC}/collections/default.changes"
DAY = timedelta(days=1)
TICK = timedelta(microseconds=1)
#: What the second drive did.
KINDS = {"stays": "confirmed", "goes": "removed", "wanders": "moved", "comes": "added"}


@pytest.fixture(scope="module")
def start(samples):
    return utc_from_ns(samples.START_NS)


def get(client, path, status=200, schema=None, **parameters):
    answer = client.get(path, params=parameters or None)
    assert answer.status_code == status, answer.text
    body = answer.json()
    jsonschema.validate(
        body, schema or ({} if status == 200 else standard.PROBLEM), cls=jsonschema.Draft202012Validator
    )
    return body


def names(features, page):
    known = {str(f.feature_id): name for name, f in features.items()}
    return [known[item["id"]] for item in page["features"]]


def names_at(client, features, **parameters):
    return set(names(features, get(client, f"{FEATURES}/items", schema=standard.ITEMS, **parameters)))


def kinds(client, features, **parameters):
    page = get(client, f"{CHANGES}/items", schema=standard.ITEMS, **parameters)
    return {
        name: item["properties"]["change"] for name, item in zip(names(features, page), page["features"], strict=True)
    }


@pytest.mark.parametrize(
    ("path", "schema"),
    [
        (f"{OGC}/", standard.LANDING),
        (f"{OGC}", standard.LANDING),
        (f"{OGC}/conformance", standard.CONFORMANCE),
        (f"{OGC}/collections", standard.COLLECTIONS),
        (FEATURES, standard.COLLECTION),
        (CHANGES, standard.COLLECTION),
        (f"{FEATURES}/items", standard.ITEMS),
        (f"{CHANGES}/items", standard.ITEMS),
        (f"{FEATURES}/queryables", standard.QUERYABLES),
        (f"{FEATURES}/tiles", standard.TILESETS),
        (f"{FEATURES}/tiles/WebMercatorQuad", standard.TILESET),
        (f"{FEATURES}/tiles/WebMercatorQuad/tilejson.json", standard.TILEJSON),
        (f"{OGC}/tileMatrixSets", standard.TILE_MATRIX_SETS),
    ],
)
def test_answers_are_what_the_standards_require(client, path, schema):
    get(client, path, schema=schema)


def links_of(body):
    if isinstance(body, dict):
        yield from (v for k, v in body.items() if k in ("href", "$id") and isinstance(v, str))
        yield from (v for k, v in body.items() if k == "tiles" and isinstance(v, list) for v in v if isinstance(v, str))
        for value in body.values():
            yield from links_of(value)
    elif isinstance(body, list):
        for value in body:
            yield from links_of(value)


def test_every_link_leads_somewhere(client, features):
    values = {"collectionId": "default.features", "tileMatrixSetId": "WebMercatorQuad", "z": "0", "x": "0", "y": "0"}
    waiting, seen = (
        [f"{OWN}{OGC}/", f"{OWN}{FEATURES}/items?limit=2", f"{OWN}{CHANGES}/items?at=2026-03-01T00:00Z"],
        set(),
    )
    waiting += [
        f"{OWN}{FEATURES}/tiles/WebMercatorQuad/{name}" for name in ("tilejson.json?at=2026-03-01T00:00Z", "style.json")
    ]
    while waiting:
        link = re.sub(r"\{(\w+)\}", lambda found: values[found[1]], waiting.pop())
        if link in seen or not link.startswith(OWN):  # others name standards
            assert link in seen or link.startswith(
                ("https://json-schema.org/", "https://geojson.org/", "http://www.opengis.net/")
            )
            continue
        seen.add(link)
        answer = client.get(link)
        assert answer.status_code == 200, (link, answer.text[:300])
        assert urlsplit(link).path.startswith(f"{OGC}/")
        if "json" in answer.headers["content-type"] and not ("&f=" in link or "?f=" in link or link.endswith("/api")):
            waiting += links_of(answer.json())
    assert len(seen) > 20


def test_the_map_as_of_an_instant(client, features, start):
    first = {"stays", "goes", "wanders"}
    assert names_at(client, features) == {"stays", "wanders", "comes"}
    assert names_at(client, features, at=(start - DAY).isoformat()) == set()
    assert names_at(client, features, at=(start + DAY / 2).isoformat()) == first
    knew = (start + DAY + timedelta(hours=3)).isoformat()  # before the second drive was committed
    assert names_at(client, features, at=(start + DAY * 2).isoformat(), known_at=knew) == first
    assert names_at(client, features, datetime=(start + DAY / 2).isoformat()) == first


def test_the_beginning_of_a_period_is_part_of_it_and_its_end_is_not(client, features, start):
    [goes] = [
        item for item in get(client, f"{FEATURES}/items", at=(start + DAY / 2).isoformat())["features"]
        if item["id"] == str(features["goes"].feature_id)
    ]  # fmt: skip
    begin, end = (utc(goes["properties"][name]) for name in ("valid_from", "valid_to"))
    for ask in ("at", "datetime"):
        found = [
            "goes" in names_at(client, features, **{ask: time.isoformat()})
            for time in (begin - TICK, begin, end - TICK, end)
        ]
        assert found == [False, True, True, False], ask
    for interval, wanted in {
        f"../{iso(begin - TICK)}": False, f"../{iso(begin)}": True, f"{iso(end - TICK)}/..": True, f"{iso(end)}/..": False,
        f"{iso(begin - DAY)}/{iso(end + DAY)}": True, f"{iso(end)}/{iso(end + DAY)}": False,
    }.items():  # fmt: skip
        assert ("goes" in names_at(client, features, datetime=interval)) is wanted, interval


def test_an_interval_holds_each_feature_once_as_it_was_last(client, features, start):
    page = get(client, f"{FEATURES}/items", datetime=f"{iso(start)}/..")
    assert sorted(names(features, page)) == ["comes", "goes", "stays", "wanders"]
    versions = {
        name: item["properties"]["version"] for name, item in zip(names(features, page), page["features"], strict=True)
    }
    assert versions == {"comes": 1, "goes": 1, "stays": 2, "wanders": 2}


def utc(text):
    return datetime.fromisoformat(text)


def iso(time):
    return time.isoformat().replace("+00:00", "Z")


def test_changes_between_two_instants(client, features, start):
    early, late = iso(start + DAY / 2), iso(start + DAY * 2)
    assert kinds(client, features, **{"from": early, "to": late}) == KINDS
    assert kinds(client, features, datetime=f"{early}/{late}") == KINDS
    assert kinds(client, features, **{"from": late, "to": late}) == {}
    refused = get(client, f"{CHANGES}/items", 400, **{"from": late, "to": early})["detail"]
    assert "is later than to=" in refused
    assert set(kinds(client, features).values()) == {"added"}
    [moved] = [
        i
        for i in get(client, f"{CHANGES}/items", **{"from": early})["features"]
        if i["properties"]["change"] == "moved"
    ]
    assert moved["properties"]["shift_m"] == pytest.approx(1.5)
    at = iso(utc(moved["properties"]["changed_at"]))
    assert kinds(client, features, datetime=f"{at}/{at}")["wanders"] == "moved"  # both ends are part of an interval
    assert "wanders" not in kinds(client, features, datetime=f"{iso(utc(at) + TICK)}/..")
    assert "wanders" not in kinds(client, features, datetime=f"{early}/{iso(utc(at) - TICK)}")


def test_a_change_has_its_own_instant_whatever_confirmed_the_cone_in_between(conn, own_view, samples, start, tmp_path):
    """Each confirmation makes a version, and none of them is the change. Days 1, 5, 15: seen; 3, 8: added, moved, removed."""
    old, gone, new = (cone(samples, f"cone {k}", 2.0 * k, day=day) for k, day in enumerate((0, 0, 3)))
    far_m = (old.xyz_m[0] + 1.5, *old.xyz_m[1:])
    moved, seen = (old.model_copy(update={"version": version, "xyz_m": far_m}) for version in (2, 3))

    def at_ns(day):
        return samples.START_NS + day * samples.DAY_NS + 7

    def confirmed(feature, day):
        return samples.changed("confirmed", feature, at_ns(day), observation_count=feature.version + 5)

    def next_version(feature):
        return feature.model_copy(update={"version": feature.version + 1})

    commit(conn, samples, tmp_path, "1", 0, samples.added(old), samples.added(gone))
    commit(conn, samples, tmp_path, "2", 3, samples.changed("moved", old, at_ns(3), xyz_m=far_m), samples.added(new))
    commit(conn, samples, tmp_path, "3", 5, confirmed(moved, 5), confirmed(gone, 5), confirmed(new, 5))
    commit(conn, samples, tmp_path, "4", 8, samples.removed(next_version(gone), at_ns(8)))
    commit(conn, samples, tmp_path, "5", 15, confirmed(seen, 15), confirmed(next_version(new), 15))
    days = {old: 3, new: 3, gone: 8}
    for begin, end in ((2, 20), (2, 9), (0.5, 9)):
        asked = {"from": iso(start + begin * DAY), "to": iso(start + end * DAY)}
        found = {
            item["id"]: utc(item["properties"]["changed_at"])
            for item in get(own_view, f"{CHANGES}/items", schema=standard.ITEMS, **asked)["features"]
        }
        assert found == {str(feature.feature_id): utc_from_ns(at_ns(day)) for feature, day in days.items()}
    seen_last = get(own_view, f"{CHANGES}/items", **{"from": iso(start + 6 * DAY)}, change="confirmed")["features"]
    assert {utc(item["properties"]["changed_at"]) for item in seen_last} == {utc_from_ns(at_ns(15))}
    assert len(seen_last) == 2


def test_values_are_those_of_the_map(client, features, samples, start):
    drives = {"stays": 2, "wanders": 2, "comes": 1}
    page = get(client, f"{FEATURES}/items", at=iso(start + DAY * 2))
    for item in page["features"]:
        [name] = names(features, {"features": [item]})
        feature, values = features[name], item["properties"]
        place = (values["easting_m"], values["northing_m"], values["ellipsoidal_height_m"])
        lat, lon, height = to_geodetic(samples.SRID, place)
        assert item["geometry"]["coordinates"] == pytest.approx([lon, lat, height], abs=1e-9)
        assert (values["seen_count"], values["missed_count"]) == (drives[name], 0)
        assert (values["change"], values["drive_id"]) == (KINDS[name], "drive_2")
        assert values["sigma_e_m"] == pytest.approx(feature.cov_m2[0] ** 0.5)


def test_a_box_includes_its_edges(client, features):
    everything = get(client, f"{FEATURES}/items")["features"]
    lons, lats = (sorted(item["geometry"]["coordinates"][axis] for item in everything) for axis in (0, 1))
    tight = [lons[0], lats[0], lons[-1], lats[-1]]

    def count(box):
        return get(client, f"{FEATURES}/items", bbox=",".join(map(repr, box)))["numberMatched"]

    assert count(tight) == 3
    assert count([*tight[:2], -1000.0, *tight[2:], 9000.0]) == 3
    assert count([-180.0, -90.0, 180.0, 90.0]) == 3
    assert count([170.0, -90.0, -170.0, 90.0]) == 0  # across 180 degrees
    assert count([lons[0], lats[0], -170.0, lats[-1]]) == 3
    assert count([170.0, lats[0], lons[0], lats[-1]]) == 1


def test_pages_hold_each_item_once_also_while_a_drive_is_committed(conn, own_view, samples, tmp_path):
    cones = [cone(samples, f"cone {k}", 2.0 * k) for k in range(7)]
    commit(conn, samples, tmp_path, "1", 0, *(samples.added(f) for f in cones))
    link, seen, sizes = f"{OWN}{FEATURES}/items?limit=3", [], []
    while link:
        page = get(own_view, link, schema=standard.ITEMS)
        assert page["numberMatched"] == 7
        assert page["numberReturned"] == len(page["features"])
        seen += [item["id"] for item in page["features"]]
        sizes.append(len(page["features"]))
        found = [link["href"] for link in page["links"] if link["rel"] == "next"]
        link = found[0] if found else None
        if len(sizes) == 1:  # another drive comes
            late = [cone(samples, f"late {k}", 40.0 + k, day=1) for k in range(5)]
            commit(conn, samples, tmp_path, "2", 1, *(samples.added(f) for f in late))
    assert sizes == [3, 3, 1]
    assert sorted(seen) == sorted(str(f.feature_id) for f in cones)
    assert get(own_view, f"{FEATURES}/items", limit=1)["numberMatched"] == 12


def test_decisions_are_served_at_once(conn, own_view):
    """Decisions close system periods like drives do, without a changeset."""
    merge(conn, survey(0))
    before = get(own_view, f"{FEATURES}/items", limit=3, schema=standard.ITEMS)
    [link] = [link["href"] for link in before["links"] if link["rel"] == "next"]
    cone_id, (lon, lat, _) = before["features"][0]["id"], before["features"][0]["geometry"]["coordinates"]
    tile = morecantile.tms.get("WebMercatorQuad").tile(lon, lat, 22)

    def is_served():
        everything = (f"{path}/items" for path in (FEATURES, CHANGES))
        there = {cone_id in [item["id"] for item in get(own_view, path)["features"]] for path in everything}
        there.add(own_view.get(f"{FEATURES}/items/{cone_id}").status_code == 200)
        path = f"{FEATURES}/tiles/WebMercatorQuad/{tile.z}/{tile.x}/{tile.y}"
        there.add(cone_id.encode() in own_view.get(path).content)
        [answer] = there
        return answer

    assert is_served()
    decided = decide_location(conn, SUPPRESS, cone_id, map_name="default")
    assert not is_served()
    assert get(own_view, link)["numberMatched"] == before["numberMatched"], "a page that was begun goes on"
    taken_back = revert(conn, str(decided.decision_id), map_name="default")
    assert is_served()
    page = get(own_view, f"{FEATURES}/items")
    [own] = [link["href"] for link in page["links"] if link["rel"] == "self"]
    assert utc(parse_qs(urlsplit(own).query)["known_at"][0]) == taken_back.decided_at


def test_existence_probability_is_that_after_the_last_drive_that_could_see_the_cone(
    conn, own_view, samples, start, tmp_path
):
    there, beside = (cone(samples, name, 2.0 * k) for k, name in enumerate(("there", "beside")))
    commit(conn, samples, tmp_path, "1", 0, samples.added(there), samples.added(beside))
    state = there
    for day, existence in ((1, 0.6), (2, 0.3)):
        miss = missed(state, samples.START_NS + day * samples.DAY_NS + 7, existence)
        commit(conn, samples, tmp_path, f"{day + 1}", day, miss)
        state = miss.new
    for day, existence in ((0, there.existence_probability), (1, 0.6), (2, 0.3)):
        asked = {"at": iso(start + (day + 0.5) * DAY)}
        pages = [get(own_view, f"{FEATURES}/items", schema=standard.ITEMS, **asked)["features"]]
        pages.append(text_sequence(own_view.get(f"{FEATURES}/items", params=asked | {"f": "geojsonseq"})))
        for items in pages:
            found = {item["id"]: item["properties"] for item in items}
            names = ("existence_probability", "seen_count", "missed_count", "version", "change", "drive_id")
            change = "missed" if day else "added"
            assert [found[str(there.feature_id)][name] for name in names] == [
                existence,
                1,
                day,
                1,
                change,
                f"drive_{day + 1}",
            ]
            assert [found[str(beside.feature_id)][name] for name in names] == [0.97, 1, 0, 1, "added", "drive_1"]
            since = found[str(there.feature_id)]["first_missed_at"]
            assert (since and utc(since)) == (start + DAY if day else None)
        low = get(own_view, f"{FEATURES}/items", limit=1, sortby="existence_probability", **asked)["features"]
        assert low[0]["properties"]["existence_probability"] == min(existence, beside.existence_probability)


def test_a_new_map_appears_without_a_restart(conn, database_url, samples):
    with TestClient(create_app(database_url, "second"), base_url=OWN) as client:
        assert get(client, f"{OGC}/collections", schema=standard.COLLECTIONS)["collections"] == []
        get(client, f"{OGC}/collections/first.features/items", 404)
        for key, name in enumerate(("first", "second")):
            samples.commit(conn, samples.added(samples.feature(name)), key=f"{key}", map_name=name)
        ids = [c["id"] for c in get(client, f"{OGC}/collections")["collections"]]
        kinds = ("features", "lane_markings", "changes", "differences")
        assert ids == [f"{name}.{kind}" for name in ("second", "first") for kind in kinds]
        for name in ("first", "second"):
            [item] = get(client, f"{OGC}/collections/{name}.features/items")["features"]
            assert item["id"] == str(samples.feature(name).feature_id)
        samples.commit(conn, key="f", start_ns=samples.START_NS - samples.DAY_NS, map_name="first")
        [[since, _]] = get(client, f"{OGC}/collections/first.features")["extent"]["temporal"]["interval"]
        assert datetime.fromisoformat(since) == utc_from_ns(samples.START_NS - samples.DAY_NS), "of the new drive"


def test_the_number_of_all_items_is_right_on_every_page(client):
    for start, returned in ((0, 2), (1, 2), (2, 1), (3, 0), (99, 0)):
        page = get(client, f"{FEATURES}/items", schema=standard.ITEMS, limit=2, offset=start)
        assert (page["numberMatched"], page["numberReturned"]) == (3, returned)
        rels = [link["rel"] for link in page["links"]]
        assert ("next" in rels, "prev" in rels) == (0 < returned < 3 - start, start > 0)
        for link in (link for link in page["links"] if link["rel"] in ("next", "prev")):
            beginning = start + 2 if link["rel"] == "next" else max(start - 2, 0)
            assert parse_qs(urlsplit(link["href"]).query)["offset"] == [str(beginning)]
    assert get(client, f"{FEATURES}/items", limit=1_000_000)["numberReturned"] == 3  # more than the maximum is allowed


@pytest.mark.parametrize(
    "query",
    ["", "limit=2", "sortby=-existence_probability", "seen_count=1", "properties=seen_count,category", "properties=",
     "bbox=8,48,9,50", "sortby=-northing_m&limit=2&offset=1", "version=1"],
)  # fmt: skip
def test_items_of_geojson_are_those_of_the_other_forms(client, start, query):
    """All forms are made from one page of PostgreSQL's GeoJSON."""
    for path, at in product((FEATURES, CHANGES), (start + DAY / 2, start + DAY * 2)):
        if path == CHANGES and "seen_count" in query:
            continue
        address = f"{path}/items?{query}&{'at' if path == FEATURES else 'to'}={iso(at).replace('+', '%2B')}"
        page = get(client, address, schema=standard.ITEMS)
        others = text_sequence(client.get(f"{address}&f=geojsonseq"))
        assert [plain(item) for item in page["features"]] == [plain(item) for item in others]


def plain(item):
    """Instants without their trailing zeros, which not everybody writes."""
    values = {k: utc(v) if k.endswith(("_at", "_from", "_to")) and v else v for k, v in item["properties"].items()}
    return item | {"properties": values}


def test_one_item_also_as_of_an_instant(client, features, start):
    goes = features["goes"].feature_id
    get(client, f"{FEATURES}/items/{goes}", 404)
    early = iso(start + DAY / 2)
    assert get(client, f"{FEATURES}/items/{goes}", schema=standard.ITEM, at=early)["id"] == str(goes)
    [link] = [
        link["href"] for item in get(client, f"{FEATURES}/items", at=early)["features"] if item["id"] == str(goes)
        for link in item["links"] if link["rel"] == "item"
    ]  # fmt: skip
    assert parse_qs(urlsplit(link).query)["at"] == [early]
    get(client, f"{FEATURES}/items/not-an-id", 404)
    both = [str(features[name].feature_id) for name in ("comes", "stays")]
    assert sorted(names(features, get(client, f"{FEATURES}/items", ids=",".join(both)))) == ["comes", "stays"]
    assert names(features, get(client, f"{FEATURES}/items", ids=both[0], category="traffic_cone")) == ["comes"]
    get(client, f"{FEATURES}/items", 404, ids="not-an-id")


def test_a_layer_of_tiles_is_of_the_instant_asked_for_and_stays_live(client):
    path = f"{FEATURES}/tiles/WebMercatorQuad/tilejson.json"
    [template] = get(client, path)["tiles"]
    assert template.endswith("{z}/{x}/{y}")
    [template] = get(client, path, at="2026-03-01T12:00:00Z")["tiles"]
    assert parse_qs(urlsplit(template).query) == {"at": ["2026-03-01T12:00:00Z"]}


def test_filters_by_property_order_and_choice_of_properties(client, features):
    assert names(features, get(client, f"{CHANGES}/items", change="added", **{"from": "2026-03-01T20:00Z"})) == [
        "comes"
    ]
    assert get(client, f"{FEATURES}/items", category="{{order}}{{box}}'")["features"] == []
    low_first = names(features, get(client, f"{FEATURES}/items", sortby="existence_probability,-easting_m"))
    assert low_first == ["comes", "wanders", "stays"]
    page = get(client, f"{FEATURES}/items", properties="category,version")
    assert set(page["features"][0]["properties"]) == {"category", "version"}


FORMS = {
    "csv": "text/csv", "geojsonseq": "application/geo+json-seq", "json": "application/json", "ndjson": "application/ndjson",
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_one_item_in_other_forms_is_that_of_the_page(client, features, form):
    asked = {"f": form, "properties": "version"}
    [page, one] = [
        client.get(f"{FEATURES}/items{path}", params=asked | more)
        for path, more in (("", {"ids": features["stays"].feature_id}), (f"/{features['stays'].feature_id}", {}))
    ]
    assert one.headers["content-type"].startswith(FORMS[form])
    if form == "json":
        assert [one.json()] == page.json()
    elif form == "geojsonseq":
        page, one = (text_sequence(answer) for answer in (page, one))
        assert [item | {"links": []} for item in one] == [item | {"links": []} for item in page]
    else:
        assert one.text == page.text


def text_sequence(answer):
    """The records of a GeoJSON text sequence: each begins with a record separator and ends with a line feed (RFC 8142, 2.1)."""
    before, *records = answer.text.split("\x1e")
    assert before == "" and all(record.endswith("\n") for record in records)
    return [json.loads(record) for record in records]


def test_answers_link_to_their_other_forms(client, features):
    """Requirements fc-links and f-links of 17-069r4."""
    for path in (
        "items?limit=1&at=2026-03-05T00:00:00Z",
        f"items/{features['stays'].feature_id}?at=2026-03-05T00:00:00Z",
    ):
        links = {
            link["type"]: link["href"]
            for link in get(client, f"{FEATURES}/{path}")["links"]
            if link["rel"] == "alternate"
        }
        assert set(links) == set(FORMS.values())
        for kind, link in links.items():
            answer = client.get(link)
            assert answer.status_code == 200 and answer.headers["content-type"].startswith(kind)
            assert parse_qs(urlsplit(link).query)["at"] == ["2026-03-05T00:00:00Z"]


@pytest.mark.parametrize("form", FORMS)
def test_a_page_without_links_names_the_next_one_in_its_header(client, form):
    answer, pages = client.get(f"{FEATURES}/items", params={"f": form, "limit": 2}), 1
    while found := answer.links.get("next"):
        answer, pages = client.get(found["url"]), pages + 1
        assert answer.headers["content-type"].startswith(FORMS[form])
    assert pages == 2


@pytest.mark.parametrize("form", FORMS)
def test_other_forms(client, form):
    for at in ("2026-03-05", "2026-02-01"):  # three items, and none
        answer = client.get(f"{FEATURES}/items", params={"f": form, "at": f"{at}T00:00:00Z"})
        assert answer.status_code == 200
        lines = answer.text.split("\n")[:-1]  # a record separator is no end of a line
        count = {"csv": len(lines) - 1, "json": len(answer.json()) if form == "json" else None}.get(form, len(lines))
        assert count == (3 if at == "2026-03-05" else 0)


def test_vector_tiles(client, features):
    page = get(client, f"{FEATURES}/items")
    lon, lat, _ = page["features"][0]["geometry"]["coordinates"]
    grid = morecantile.tms.get("WebMercatorQuad")
    for zoom in (0, 12, 22):
        tile = grid.tile(lon, lat, zoom)
        answer = client.get(f"{FEATURES}/tiles/WebMercatorQuad/{tile.z}/{tile.x}/{tile.y}")
        assert answer.headers["content-type"] == "application/vnd.mapbox-vector-tile"
        assert page["features"][0]["id"].encode() in answer.content
        past = client.get(
            f"{FEATURES}/tiles/WebMercatorQuad/{tile.z}/{tile.x}/{tile.y}", params={"at": "2026-02-01T00:00Z"}
        )
        assert (past.status_code, past.content) == (200, b"")
    for place in ("25/0/0", "-1/0/0", "2/4/0", "2/0/-1"):
        get(client, f"{FEATURES}/tiles/WebMercatorQuad/{place}", 404)
    get(client, f"{FEATURES}/tiles/NoSuchTiling/0/0/0", 400)


def test_lane_markings_are_lines_of_a_collection_of_their_own(conn, own_view, samples, start):
    vertices_m = np.add((458_001.0, 5_428_010.0, 114.5), np.linspace((0, 0, 0), (9, 1, 0), 5))
    line = samples.line_feature(samples.marking(vertices_m, pattern="dashed", dash_m=3.0, gap_m=9.0))
    gone_ns = samples.START_NS + samples.DAY_NS
    lines = f"{OGC}/collections/default.lane_markings"
    shape = [samples.marking_track(line.marking)]
    samples.commit(conn, samples.added(line), samples.added(samples.feature()), key="1", markings=shape)
    samples.commit(conn, samples.removed(line, gone_ns), key="2", start_ns=gone_ns)
    cones = get(own_view, f"{FEATURES}/items", at=start.isoformat())["features"]
    changed = get(own_view, f"{CHANGES}/items", to=start.isoformat())["features"]
    assert [item["id"] for item in cones] == [item["id"] for item in changed] == [str(samples.feature().feature_id)]
    assert get(own_view, f"{lines}/items", schema=standard.ITEMS)["features"] == []
    [item] = get(own_view, f"{lines}/items", schema=standard.ITEMS, at=start.isoformat())["features"]
    assert item["id"] == str(line.feature_id) and item["geometry"]["type"] == "LineString"
    lat_lon = to_geodetic(samples.SRID, vertices_m)
    assert np.abs(np.array(item["geometry"]["coordinates"]) - lat_lon[:, [1, 0, 2]]).max() < 1e-3
    known = item["properties"]
    assert (known["colour"], known["pattern"], known["dash_m"], known["gap_m"]) == ("white", "dashed", 3.0, 9.0)
    assert (known["width_m"], known["seen_count"], known["missed_count"]) == (0.12, 1, 0)
    across = np.array([-1, 9]) / np.hypot(1, 9)  # of the equal covariances of all vertices
    xx, xy, _, yy, *_ = samples.COV_M2
    assert known["sigma_lateral_m"] == pytest.approx(np.sqrt(across @ [[xx, xy], [xy, yy]] @ across))
    assert known["length_m"] == pytest.approx(np.hypot(1, 9))
    # A box that holds no vertex but touches the line.
    west, south = (lat_lon[0, [1, 0]] + lat_lon[1, [1, 0]]) / 2 - 1e-6
    box = f"{west},{south},{west + 2e-6},{south + 2e-6}"
    for query in ({"bbox": box}, {"pattern": "dashed", "sortby": "-seen_count"}):
        assert get(own_view, f"{lines}/items", at=start.isoformat(), **query)["numberMatched"] == 1
    assert get(own_view, f"{lines}/items", at=start.isoformat(), bbox="0,0,1,1")["numberMatched"] == 0
    rows = own_view.get(f"{lines}/items", params={"at": start.isoformat(), "f": "csv"}).text
    assert "SRID=4326;LINESTRING(" in rows
    tile = morecantile.tms.get("WebMercatorQuad").tile(west, south, 18)
    answer = own_view.get(f"{lines}/tiles/WebMercatorQuad/18/{tile.x}/{tile.y}", params={"at": start.isoformat()})
    assert item["id"].encode() in answer.content and b"dashed" in answer.content


@pytest.mark.parametrize(
    "query",
    [
        "bbox=1,2,3", "bbox=a,b,c,d", "bbox=nan,0,1,1", "bbox=0,1,1,0", "bbox=0,0,181,1", "bbox=1e400,0,1,1", "bbox=",
        "datetime=yesterday",
        "datetime=2026-03-01T00:00:00Z/2026-02-01T00:00:00Z", "datetime=a/b/c", "datetime=../..", "datetime=",
        "datetime=0001-01-01T00:00:00Z/..",
        "datetime=2026-03-01T00:00:00Z&at=2026-03-01T00:00:00Z",
        "datetime=2026", "datetime=20260302", "datetime=../1772352000.5", "known_at=1772352000",
        "known_at=-1",
        "at=yesterday", "at=99999-01-01", "no_such=1", "sortby=feature_id;drop", "f=html",
        "filter=version=1",
        "filter=pg_sleep(10)=1", "category=%00", "offset=-1", "limit=0", "limit=-1", "limit=ten",
    ],
)  # fmt: skip
def test_invalid_parameters_are_refused(client, query):
    get(client, f"{FEATURES}/items?{query}", 400)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("offset=99999999999999999999", "offset=99999999999999999999 should be a whole number from 0"),
        ("offset=9223372036854775807", "should be a whole number from 0"),
        ("version=one", "version='one' should be a whole number"),
        ("version=99999999999", "version='99999999999' should be a whole number"),
        ("easting_m=east", "easting_m='east' should be a number"),
        ("easting_m=nan", "easting_m='nan' should be a number"),
        ("existence_probability=inf", "existence_probability='inf' should be a number"),
        ("feature_id=1", "feature_id='1' should be the id of a cone"),
        ("version=1_0", "version='1_0' should be a whole number"),
        ("valid_from=1772352000", "valid_from='1772352000' should be an instant"),
        ("at=2026", "at: '2026' is not an instant such as 2026-03-02T12:00:00Z"),
        ("at=2026-03-02", "at: '2026-03-02' is not an instant such as 2026-03-02T12:00:00Z"),
        ("datetime=2026/2027", "'2026' is not an instant such as 2026-03-02T12:00:00Z"),
        ("valid_from=yesterday", "valid_from='yesterday' should be an instant"),
        ("properties=category,nope", "There is no property 'nope'; there are: feature_id, version"),
        ("properties=nope&f=csv", "There is no property 'nope'"),
        ("sortby=nope", "nope"),
        ("shift_m=1", "Unknown parameter 'shift_m'; known are: at, bbox, category"),
        ("colour=white", "Unknown parameter 'colour'"),
        ("limit=1&limit=5", "limit is given 2 times: expected one value"),
        ("bbox=8,49,9,50&bbox=0,0,1,1", "bbox is given 2 times"),
        ("category=drum&category=traffic_cone", "category is given 2 times"),
    ],
)  # fmt: skip
def test_an_error_names_the_expected_value(client, query, words):
    assert words in get(client, f"{FEATURES}/items?{query}", 400)["detail"]


@pytest.mark.parametrize(
    ("collection", "query", "words"),
    [
        ("changes", "change=foo", "change='foo' should be one of added, confirmed, moved, removed, missed"),
        ("lane_markings", "pattern=dotted", "pattern='dotted' should be one of solid, dashed"),
        ("lane_markings", "colour=", "colour='' should be one of white, yellow, other"),
    ],
)
def test_a_word_that_no_item_can_have_is_an_error(client, collection, query, words):
    assert words in get(client, f"{OGC}/collections/default.{collection}/items?{query}", 400)["detail"]


def test_the_definition_states_the_values_of_filters(client):
    parameters = client.get(f"{OGC}/api").json()["paths"]["/collections/{collectionId}/items"]["get"]["parameters"]
    schemas = {parameter["name"]: parameter["schema"] for parameter in parameters}
    assert schemas["change"] == {"type": "string", "enum": list(BY_NAME["change"].words)}
    assert schemas["version"] == {"type": "integer"} and schemas["shift_m"] == {"type": "number"}
    assert schemas["valid_from"] == {"type": "string", "format": "date-time"}


@pytest.mark.parametrize("asked", [{}, {"category": "traffic_cone"}, {"at": "2026-03-01T12:00:00Z"}])
@pytest.mark.parametrize("collection", [FEATURES, CHANGES])
def test_a_tile_of_many_items_has_their_numbers(client, features, monkeypatch, collection, asked):
    """Nothing is left out: a tile has all of its items, or clusters of them."""
    asked = asked if collection == FEATURES or "at" not in asked else {"from": "2026-03-01T12:00:00Z"}
    page = get(client, f"{collection}/items", limit=1, **asked)
    [first] = page["features"]
    lon, lat, _ = first["geometry"]["coordinates"]
    for zoom in (0, 9, 16):
        tile = morecantile.tms.get("WebMercatorQuad").tile(lon, lat, zoom)
        path = f"{collection}/tiles/WebMercatorQuad/{tile.z}/{tile.x}/{tile.y}"
        monkeypatch.setattr(collections, "MAX_IN_TILE", page["numberMatched"])
        assert first["id"].encode() in client.get(path, params=asked).content
        monkeypatch.setattr(collections, "MAX_IN_TILE", page["numberMatched"] - 1)
        clusters = client.get(path, params=asked).content
        assert first["id"].encode() not in clusters and b"feature_count" in clusters and b"traffic_cone" in clusters
        assert (b"change" in clusters) == (collection == CHANGES)
        one = client.get(path, params={"limit": 1, **asked}).content
        assert b"feature_count" not in one  # as many as were asked for


@pytest.mark.parametrize("query", ["minzoom=45972386495384092934144", "maxzoom=25", "minzoom=-1"])
@pytest.mark.parametrize("name", ["tilejson", "style"])
def test_a_zoom_that_no_tile_has_is_an_error(client, name, query):
    path = f"{FEATURES}/tiles/WebMercatorQuad/{name}.json"
    assert "should be a whole number from 0 to 24" in get(client, f"{path}?{query}", 400)["detail"]


@pytest.mark.parametrize(
    "path",
    [
        "pg_catalog.pg_tables", "conetl.map", "conetl_ogc.features", "default", "default.no_such", "elsewhere.features",
        "DEFAULT.features",
        "default.features'--", "default%00.features", "..%2f..%2fapi%2fmaps", "a.b.features",
    ],
)  # fmt: skip
def test_nothing_else_of_the_database_is_served(client, path):
    get(client, f"{OGC}/collections/{path}/items", 404)


def words_of(body):
    if isinstance(body, dict):
        yield from body
        for value in body.values():
            yield from words_of(value)
    elif isinstance(body, list):
        for value in body:
            yield from words_of(value)
    else:
        yield body


def test_no_page_for_browsers(client):
    for path in ("/", "/collections", "/collections/default.features", "/collections/default.features/items"):
        answer = client.get(f"{OGC}{path}", headers={"Accept": "text/html"})
        assert "json" in answer.headers["content-type"]
    viewer = "/collections/default.features/tiles/WebMercatorQuad/map.html"
    for path in ("/docs", "/api.html", "/openapi.json", "/redoc", viewer):
        get(client, f"{OGC}{path}", 404)
    definition = client.get(f"{OGC}/api").json()
    assert {"text/html", "html"}.isdisjoint(words_of(definition["paths"]))


def test_without_a_database_the_answer_is_503(tmp_path):
    with view_of(f"postgresql:///nowhere?host={tmp_path}") as client:
        assert "cannot be reached" in get(client, f"{FEATURES}/items", 503)["detail"]
        get(client, f"{OGC}/", schema=standard.LANDING)


@pytest.mark.skipif(not has_qgis(), reason="python3-qgis is not installed for the system's Python")
def test_qgis_reads_it_as_of_an_instant_and_by_box(module_database_url, client, features, start):
    early = iso(start + DAY / 2)
    page = get(client, f"{FEATURES}/items", at=early)
    places = {item["id"]: item["geometry"]["coordinates"] for item in page["features"]}
    [lon, lat, _] = places[str(features["goes"].feature_id)]
    box = ",".join(map(str, (lon - 1e-5, lat - 1e-5, lon + 1e-5, lat + 1e-5)))
    with serving(module_database_url, "default") as port:
        for asked, wanted in (("", set(places)), (box, {str(features["goes"].feature_id)})):
            script = Path(__file__).with_name("qgis_ogc.py")
            address = f"http://127.0.0.1:{port}/ogc?at={early}"  # QGIS adds its own parameters to these
            done = subprocess.run(
                [PYTHON, script, address, "default.features", asked],
                capture_output=True, text=True, env=OFFSCREEN, timeout=120, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            read = json.loads(done.stdout)
            assert {f["id"] for f in read["features"]} == wanted
            for feature in read["features"]:
                assert [feature["lon"], feature["lat"], feature["height"]] == pytest.approx(
                    places[feature["id"]], abs=1e-9
                )
            assert read["crs"] == "EPSG:4326"
            assert {"existence_probability", "valid_from", "sigma_e_m"} <= set(read["fields"])
