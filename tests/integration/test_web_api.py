"""The API of `conetl view` over a real PostGIS."""

from __future__ import annotations

import asyncio
import shutil
from contextlib import closing
from datetime import timedelta

import cv2
import numpy as np
import psycopg2
import pytest

from conetl.db.connection import connect, execute
from conetl.db.reader_pool import ReaderPool, open_reader
from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.model.base import utc_from_ns
from conetl.model.map_records import Delta, DeltaKind
from conetl.web.live import MAX_STREAMS, HeadWatcher
from conetl.web.models import ChangesInView, FeatureTile
from tests.view_map import commit, cone, missed, shown, view_of

DAY = timedelta(days=1)
MAP = "/api/maps/default"
NOBODY = "00000000-0000-4000-8000-00000000dead"


def get(client, path, status=200, **parameters):
    answer = client.get(path, params=parameters or None)
    assert answer.status_code == status, answer.text
    return answer.json()


def kinds(client, features, path, **parameters):
    names = {str(f.feature_id): name for name, f in features.items()}
    return {names[c["feature_id"]]: c["kind"] for c in get(client, path, **parameters)["changes"]}


def names_at(client, features, **parameters):
    names = {str(f.feature_id): name for name, f in features.items()}
    return {names[f["feature_id"]] for f in shown(client, **parameters)["features"]}


def test_maps_and_timeline(client, samples):
    answer = get(client, "/api/maps")
    assert answer["chosen"] == "default"
    assert [(m["map_name"], m["changeset_count"], m["feature_count"]) for m in answer["maps"]] == [("default", 2, 3)]
    timeline = get(client, f"{MAP}/timeline")
    assert timeline["srid"] == samples.SRID
    assert timeline["origin_m"] == [458_000.0, 5_428_000.0, 100.0]
    second = {"added": 1, "confirmed": 1, "moved": 1, "removed": 1}
    counts = [c["change_counts"] for c in timeline["changesets"]]
    assert counts == [{"points": {"added": 3}, "lines": {}}, {"points": second, "lines": {}}]


def test_features_of_every_instant(client, features, samples):
    start = utc_from_ns(samples.START_NS)
    everything_first = {"stays", "goes", "wanders"}
    assert names_at(client, features) == {"stays", "wanders", "comes"}
    assert names_at(client, features, valid_at=(start - DAY).isoformat()) == set()
    assert names_at(client, features, valid_at=(start + DAY / 2).isoformat()) == everything_first
    # the second drive was committed at noon
    knew = (start + DAY + timedelta(hours=3)).isoformat()
    assert names_at(client, features, valid_at=(start + DAY * 2).isoformat(), known_at=knew) == everything_first


def test_places_are_offsets_that_a_float32_holds(client, features):
    answer = shown(client)
    for sent in answer["features"]:
        feature = next(f for f in features.values() if str(f.feature_id) == sent["feature_id"])
        place = np.add(np.array(sent["xyz_m"], np.float32).astype(float), answer["origin_m"])
        wanted = np.add(feature.xyz_m, (1.5 if feature is features["wanders"] else 0, 0, 0))
        assert np.abs(place - wanted).max() < 1e-4


def test_before_and_after_of_a_changeset_are_what_it_changed(client, features):
    second = get(client, f"{MAP}/timeline")["changesets"][1]
    at = {"valid_at": second["valid_at"]}
    assert names_at(client, features, **at, known_at=second["known_before"]) == {"stays", "goes", "wanders"}
    assert names_at(client, features, **at, known_at=second["committed_at"]) == {"stays", "wanders", "comes"}
    wanted = {"stays": "confirmed", "goes": "removed", "wanders": "moved", "comes": "added"}
    assert kinds(client, features, f"{MAP}/changes/view?changeset_no={second['changeset_no']}") == wanted


def test_changes_between_two_instants_and_back(client, features, samples):
    start = utc_from_ns(samples.START_NS)
    early, late = (start + DAY / 2).isoformat(), (start + DAY * 2).isoformat()
    there = kinds(client, features, f"{MAP}/changes/view", from_valid_at=early, to_valid_at=late)
    assert there == {"stays": "confirmed", "goes": "removed", "wanders": "moved", "comes": "added"}
    back = kinds(client, features, f"{MAP}/changes/view", from_valid_at=late, to_valid_at=early)
    assert back == {"stays": "confirmed", "goes": "added", "wanders": "moved", "comes": "removed"}
    assert kinds(client, features, f"{MAP}/changes/view", from_valid_at=late, to_valid_at=late) == {}
    [moved] = [c for c in get(client, f"{MAP}/changes/view", from_valid_at=early)["changes"] if c["kind"] == "moved"]
    assert moved["shift_m"] == pytest.approx(1.5)
    assert np.subtract(moved["xyz_m"], moved["old_xyz_m"]) == pytest.approx([1.5, 0, 0])


def test_history_and_sightings(client, features, module_conn):
    wanders = features["wanders"].feature_id
    history = get(client, f"{MAP}/features/{wanders}")["history"]
    assert [(h["kind"], h["version"], h["sighting_count"]) for h in history] == [("added", 1, 3), ("moved", 2, 3)]
    assert history[1]["map_xyz_m"] == [458_006.5, 5_428_010.0, 114.5]
    sightings = get(client, f"{MAP}/features/{wanders}/sightings")["sightings"]
    assert len(sightings) == 6
    first = sightings[0]
    assert first["camera_xyz_m"] == [0.5, 0.25, 15.125]
    assert (first["left"]["x_px"], first["left"]["score"], first["range_m"]) == (600.5, 0.9, 12.0)
    camera = execute(module_conn, "select rig -> 'left' as camera from conetl.drive limit 1")[0]["camera"]
    scale, middle = ([camera[f"{name}{axis}_px"] for axis in "xy"] for name in "fc")
    rays = np.array(first["corners"]) * [*scale, 1.0] + [*middle, 0.0]
    right, bottom = camera["width_px"] - 0.5, camera["height_px"] - 0.5
    edges = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)]
    assert rays == pytest.approx(np.column_stack([edges, np.ones(4)])), "through the corners of the left image"
    left, right = sightings[1]["left"], sightings[1]["right"]  # the network found it in the left image only
    assert (left["x_px"] - right["x_px"], left["w_px"] - right["w_px"]) == (30.0, 0.0)
    assert (left["score"], right["score"]) == (0.9, None)
    removed = get(client, f"{MAP}/features/{features['goes'].feature_id}")["history"][-1]
    assert (removed["kind"], removed["sighting_count"]) == ("removed", 0)


def test_missed_split_and_merged_features_keep_their_kind(conn, own_view, samples, tmp_path):
    """Day 2 misses one cone, splits one, merges one into another, and finds another height."""
    first = {name: cone(samples, name, 3.0 * i) for i, name in enumerate(("doubted", "double", "short", "surplus"))}
    commit(conn, samples, tmp_path, "1", 0, *(samples.added(f) for f in first.values()))
    second = cone(samples, "second half", 3.4, day=2)
    at_ns = samples.START_NS + 2 * samples.DAY_NS + 7
    commit(
        conn, samples, tmp_path, "2", 2,
        missed(first["doubted"], at_ns, 0.8),
        samples.added(second).model_copy(update={"kind": DeltaKind.SPLIT, "other_feature_id": first["double"].feature_id}),
        samples.changed("height_changed", first["short"], at_ns, object_height_m=0.5),
        samples.removed(first["surplus"], at_ns).model_copy(
            update={"kind": DeltaKind.MERGED, "other_feature_id": first["short"].feature_id}
        ),
    )  # fmt: skip
    features = {**first, "second half": second}
    newest = get(own_view, f"{MAP}/timeline")["changesets"][1]
    assert newest["change_counts"]["points"] == dict.fromkeys(("missed", "split", "height_changed", "merged"), 1)
    changes = f"{MAP}/changes/view?changeset_no={newest['changeset_no']}"
    assert kinds(own_view, features, changes) == {
        "doubted": "missed", "second half": "split", "short": "height_changed", "surplus": "merged",
    }  # fmt: skip
    between = f"{MAP}/changes/view?from_valid_at={utc_from_ns(samples.START_NS + samples.DAY_NS):%Y-%m-%dT00:00:00Z}"
    assert kinds(own_view, features, between) == {
        "doubted": "missed", "second half": "added", "short": "height_changed", "surplus": "removed",
    }  # fmt: skip
    for path in (changes, between):
        [doubted] = [c for c in get(own_view, path)["changes"] if c["kind"] == "missed"]
        assert (doubted["existence_probability"], doubted["version"]) == (0.8, 1)

    def history(name, *fields):
        answer = get(own_view, f"{MAP}/features/{features[name].feature_id}")["history"]
        return [tuple(h[field] for field in fields) for h in answer]

    evidence = ("kind", "version", "existence_probability", "frames_empty", "seen_count", "missed_count")
    assert history("doubted", *evidence) == [("added", 1, 0.97, None, 1, 0), ("missed", 1, 0.8, 5, 1, 1)]
    assert history("second half", "kind", "other_feature_id") == [("split", str(first["double"].feature_id))]
    assert history("surplus", "kind", "other_feature_id")[1] == ("merged", str(first["short"].feature_id))
    assert history("short", "kind", "object_height_m") == [("added", 0.7), ("height_changed", 0.5)]


def test_long_answers_are_what_their_models_say(conn, own_view, samples):
    """PostgreSQL writes them; no model validates them."""
    vertices_m = np.add((458_001.0, 5_428_010.0, 114.5), np.linspace((0, 0, 0), (9, 1, 0), 5))
    line, post = samples.line_feature(samples.marking(vertices_m)), samples.feature()
    beside = samples.marking(np.add(vertices_m, (0.0, 0.6, 0.0)), pattern="dashed", dash_m=3.0, gap_m=9.0)
    next_ns = samples.START_NS + samples.DAY_NS
    samples.commit(
        conn, samples.added(line), samples.added(post), key="1", markings=[samples.marking_track(line.marking)]
    )
    moves = (
        samples.changed("moved", line, next_ns, marking=beside),
        samples.changed("moved", post, next_ns, xyz_m=(post.xyz_m[0] + 1.5, *post.xyz_m[1:])),
    )
    samples.commit(conn, *moves, key="2", start_ns=next_ns, markings=[samples.marking_track(beside)])
    for path, model in (
        ("tiles/0/0/5", FeatureTile),
        ("changes/view", ChangesInView),
        ("changes/view?changeset_no=1", ChangesInView),
        ("changes/view?changeset_no=2", ChangesInView),
    ):
        model.model_validate(get(own_view, f"{MAP}/{path}"))  # its models are closed
    changes = ChangesInView.model_validate(get(own_view, f"{MAP}/changes/view?changeset_no=2"))
    [cone], [stretch] = changes.changes, changes.markings
    assert np.subtract(cone.xyz_m, cone.old_xyz_m) == pytest.approx((1.5, 0.0, 0.0))
    assert np.add(stretch.marking.line_m, changes.origin_m) == pytest.approx(np.array(beside.vertices_m), abs=1e-4)
    assert np.add(stretch.old_marking.line_m, changes.origin_m) == pytest.approx(vertices_m, abs=1e-4)
    assert all(
        c.old_xyz_m is None
        for c in ChangesInView.model_validate(get(own_view, f"{MAP}/changes/view?changeset_no=1")).changes
    )


def image_path(client, features, side="left", number=0):
    s = get(client, f"{MAP}/features/{features['comes'].feature_id}/sightings")["sightings"][number]
    return f"{MAP}/drives/{s['drive_uuid']}/pictures/{s['frame_index']}/{s['match_index']}/{side}.jpg"


def test_crop_shows_where_an_image_without_a_box_shows_the_cone(client, features):
    assert client.get(image_path(client, features, "right", 1)).headers["content-type"] == "image/jpeg"


@pytest.mark.parametrize("side", ["left", "right"])
def test_crop_shows_the_cone_in_its_box(client, features, side):
    answer = client.get(image_path(client, features, side))
    assert answer.headers["content-type"] == "image/jpeg"
    crop = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert crop.shape[0] == crop.shape[1] >= 300
    middle = crop[crop.shape[0] // 2, crop.shape[1] // 2].astype(int)
    assert middle[2] > 200  # the orange block
    assert middle[0] < 60
    assert abs(crop[5, 5].astype(int) - 128).max() < 12  # the grey around it
    whole = client.get(image_path(client, features, side), params={"context": 100})
    assert cv2.imdecode(np.frombuffer(whole.content, np.uint8), cv2.IMREAD_COLOR).shape == (375, 1242, 3)


def test_a_missing_image_is_named(client, features, images):
    hidden = images / "hidden"
    shutil.move(images / "drive_2" / "image_03", hidden)
    try:
        answer = get(client, image_path(client, features, "right"), 404)
    finally:
        shutil.move(hidden, images / "drive_2" / "image_03")
    assert "image_03/data/0000000000.png" in answer["detail"]
    assert "restore the drive" in answer["detail"]


@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd", "link.png", "image_02/data/0000000000.txt"])
def test_only_images_inside_the_drive_are_served(client, features, module_database_url, images, name):
    (images / "secret.png").write_bytes(b"\x89PNG")
    link = images / "drive_2" / "link.png"
    link.unlink(missing_ok=True)
    link.symlink_to(images / "secret.png")
    path = image_path(client, features)
    where = (
        "where left_path like '%%' and drive_uuid = (select drive_uuid from conetl.drive where drive_id = 'drive_2')"
    )
    with closing(connect(module_database_url)) as conn:
        [old, *_] = execute(conn, f"select left_path from conetl.frame_pair {where} and frame_index = 0")
        for value in (name, old["left_path"]):
            execute(conn, f"update conetl.frame_pair set left_path = %(p)s {where} and frame_index = 0", {"p": value})
            conn.commit()
            if value == name:
                assert "inside the folder" in get(client, path, 404)["detail"]
    assert client.get(path).status_code == 200


@pytest.mark.parametrize(
    "path",
    [
        "summary?valid_at=yesterday", "summary?valid_at=2026", "summary?known_at=1772352000", "changes?to_valid_at=20260302",
        "changes?changeset_no=0", "changes/view?changeset_no=99999999999999999999999",
        "features/not-an-id", "search?text=", "downloads/exe", "downloads/csv?box=1,2,3",
        "downloads/csv?box=3,2,1,4", "downloads/csv?valid_at=0001-01-01T00:00:00Z", "x';drop table conetl.map--/summary",
        "summary?valid_at=0001-01-01T00:00:00%2B21:55",
        f"drives/{NOBODY}/pictures/-1/0/left.jpg", f"drives/{NOBODY}/pictures/0/0/left.jpg?context=1e9",
        f"drives/{NOBODY}/pictures/0/0/both.jpg",
    ],
)  # fmt: skip
def test_invalid_parameters_are_refused(client, path):
    assert client.get(f"{'/api/maps' if path.startswith('x') else MAP}/{path}").status_code == 422


def test_an_instant_of_any_zone_is_read(client):
    """PostgreSQL itself accepts zones up to 15:59:59."""
    url = "changes?from_known_at=2026-03-02T05:47:54"
    assert get(client, f"{MAP}/{url}%2B21:55") == get(client, f"{MAP}/{url.replace('02T05:47', '01T07:52')}Z")


@pytest.mark.parametrize(
    "path",
    [
        "/api/maps/elsewhere/timeline", "/api/maps/elsewhere/features", f"{MAP}/features/{NOBODY}",
        f"{MAP}/drives/{NOBODY}/trajectory", f"{MAP}/drives/{NOBODY}/pictures/0/0/left.jpg",
    ],
)  # fmt: skip
def test_unknown_things_are_not_found(client, path):
    assert client.get(path).status_code == 404


def test_changes_of_a_drive_are_of_its_changeset_although_the_state_is_not(conn, samples, own_view):
    cone = samples.feature("stays")
    samples.commit(conn, samples.added(cone), key="1")
    same = Delta(
        kind=DeltaKind.CONFIRMED, feature_id=cone.feature_id, old=cone, new=cone, changed_at_ns=samples.START_NS + samples.DAY_NS
    )  # fmt: skip
    samples.commit(conn, same, key="2", start_ns=samples.START_NS + samples.DAY_NS)
    [row] = get(own_view, f"{MAP}/changes", changeset_no=2)["changes"]
    [now] = get(own_view, f"{MAP}/features")["features"]
    assert (row["kind"], row["changeset_no"], now["changeset_no"]) == ("confirmed", 2, 1)


def test_the_search_knows_ids_drives_days_towns_and_coordinates(client, features, samples):
    wanted = str(features["stays"].feature_id)

    def found(text):
        return get(client, f"{MAP}/search", text=text)

    assert found(wanted[:10].upper())["feature_ids"] == [wanted]
    standing = sorted(str(feature.feature_id) for feature in features.values())
    for size in range(1, len(wanted) + 1):
        beginning = wanted[:size]
        assert found(beginning)["feature_ids"] == [one for one in standing if one.startswith(beginning)], beginning
    for text in ("0123456789", "-", wanted[:4] + "-" + wanted[4:9], wanted.replace("-", "")):
        assert found(text)["feature_ids"] == []
    assert [d["drive_id"] for d in found("DRIVE_")["drives"]] == ["drive_2", "drive_1"]
    day = utc_from_ns(samples.START_NS + samples.DAY_NS).date().isoformat()
    assert [d["drive_id"] for d in found(day)["drives"]] == ["drive_2"]
    lat, lon = to_geodetic(samples.SRID, (458_004.0, 5_428_010.0, 0.0))[:2]
    # lon, lat and N E too, where only they are near the map
    for text in (
        f"{lat:.7f}, {lon:.7f}", f"{lat:.7f} {lon:.7f}", f"{lon:.7f};{lat:.7f}", "458004 5428010.0", "458004 E, 5428010 N",
        "5428010,458004",
    ):  # fmt: skip
        [position] = found(text)["positions"]
        assert position["xy_m"] == pytest.approx([4.0, 10.0], abs=0.02), text
        assert position["lat_lon_deg"] == pytest.approx([lat, lon], abs=1e-6)
    for text in ("here", "1 2 3", "2026-03-02", "95, 400"):
        assert [p for p in found(text)["positions"] if abs(p["xy_m"][0]) < 1e5] == [], text
    towns = found("KARLS")["towns"]
    assert [town["label"] for town in towns[:2]] == ["Karlsruhe, Germany", "Karlstadt, Germany"]
    assert to_map(samples.SRID, *towns[0]["lat_lon_deg"], 0.0)[:2] - (458_000.0, 5_428_000.0) == pytest.approx(
        towns[0]["xy_m"], abs=1e-3
    )
    assert np.hypot(*towns[0]["xy_m"]) < 3_000 and found("ka")["towns"] == []


def test_downloads_are_the_state_that_is_shown(client, features, samples):
    early, late = (utc_from_ns(samples.START_NS) + DAY * days for days in (0.5, 2))
    path = f"{MAP}/downloads"

    def ids(**parameters):
        answer = client.get(f"{path}/geojson", params=parameters)
        assert answer.status_code == 200, answer.text
        return {f["properties"]["feature_id"] for f in answer.json()["features"]}, answer.headers

    at_late, headers = ids(valid_at=late.isoformat())
    assert at_late == {str(features[name].feature_id) for name in ("stays", "wanders", "comes")}
    assert f"default_{late:%Y-%m-%dT%H-%M-%SZ}.geojson" in headers["content-disposition"]
    assert int(headers["content-length"]) > 500
    assert len(ids(valid_at=early.isoformat())[0]) == 3
    box = "458000,5428000,458002,5428020"
    assert ids(valid_at=late.isoformat(), box=box)[0] == {str(features["stays"].feature_id)}
    table = client.get(f"{path}/csv", params={"valid_at": late.isoformat(), "from_valid_at": early.isoformat()}).text
    assert sorted(line.split(",").count("moved") for line in table.splitlines()).count(1) == 1
    assert client.get(f"{path}/gpkg").content.startswith(b"SQLite format 3")
    assert "publisher" in get(client, f"{path}/wzdx", 400)["detail"]
    assert "publisher" in get(client, f"{path}/wzdx", 400, publisher=" ", road_name="L 605")["detail"]
    feed = get(client, f"{path}/wzdx", publisher="City", road_name="L 605")
    assert feed["feed_info"]["publisher"] == "City"
    assert "leave out the box" in get(client, f"{path}/csv", 400, from_valid_at=early.isoformat(), box=box)["detail"]
    get(client, "/api/maps/elsewhere/downloads/csv", 404)


def test_the_view_cannot_write(module_database_url):
    conn = open_reader(module_database_url)
    assert execute(conn, "select current_user")[0]["current_user"] == "conetl_reader"
    with pytest.raises(psycopg2.errors.ReadOnlySqlTransaction):
        execute(conn, "delete from conetl.map")
    conn.rollback()
    execute(conn, "set transaction read write")
    with pytest.raises(psycopg2.errors.InsufficientPrivilege):
        execute(conn, "delete from conetl.map")
    conn.close()


def test_a_commit_reaches_the_stream(conn, database_url, samples, tmp_path):
    pool = ReaderPool(database_url)

    async def listen() -> tuple[list[str], float]:
        loop = asyncio.get_running_loop()
        watcher = HeadWatcher(pool, closing=lambda: False)
        stream = watcher.events("default")
        said = [await anext(stream)]
        feature = cone(samples, "one", 0.0)
        await loop.run_in_executor(None, commit, conn, samples, tmp_path, "1", 0, samples.added(feature))
        committed = loop.time()
        said.append(await asyncio.wait_for(anext(stream), 60))
        took = loop.time() - committed
        await stream.aclose()
        return said, took

    said, took = asyncio.run(listen())
    pool.close()
    [row] = execute(conn, "select changeset_no from conetl.changeset")
    beginning = "event: changeset\ndata: 0\n\nevent: decision\ndata: 0\n\nevent: base\ndata: none\n\n"
    assert said == [beginning, f"event: changeset\ndata: {row['changeset_no']}\n\n"]
    print(f"from commit to event: {took:.2f} s")


def test_streams_are_limited_and_released(module_database_url):
    pool = ReaderPool(module_database_url)

    async def crowd() -> None:
        watcher = HeadWatcher(pool, closing=lambda: False)
        streams = [watcher.events("default") for _ in range(MAX_STREAMS)]
        await asyncio.gather(*(anext(stream) for stream in streams))
        assert watcher.full()
        surplus = watcher.events("default")
        assert (await anext(surplus)).startswith("event: trouble")
        assert [event async for event in surplus] == []
        for stream in streams:
            await stream.aclose()
        assert not watcher.full()
        assert (await anext(watcher.events("default"))).startswith("event: changeset")

    asyncio.run(crowd())
    pool.close()


def test_connections_that_the_server_closed_are_replaced(module_database_url):
    pool = ReaderPool(module_database_url)
    with pool.reading() as first, pool.reading() as second:
        pids = [conn.info.backend_pid for conn in (first, second)]
    with closing(connect(module_database_url)) as conn:
        for pid in pids:
            execute(conn, "select pg_terminate_backend(%(pid)s, 10000)", {"pid": pid})
    for _ in range(2):
        with pool.reading() as conn:
            assert execute(conn, "select 1 as one") == [{"one": 1}]
            assert conn.info.backend_pid not in pids
        with pool.exporting() as download:
            pass
        assert download.closed
    pool.close()


def test_without_a_database_the_answer_is_503(tmp_path):
    with view_of(f"postgresql:///nowhere?host={tmp_path}") as test_client:
        answer = test_client.get("/api/maps")
    assert answer.status_code == 503
    assert "cannot be reached" in answer.json()["detail"]
