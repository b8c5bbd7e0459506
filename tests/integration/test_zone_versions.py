"""Work zones as versioned features: one id over drives, late drives, pauses, parts; split and merged ones keep their history."""

from __future__ import annotations

import json
from uuid import UUID

import numpy as np

from conetl.db.connection import execute
from conetl.db.map.notice_store import read_zone_aliases
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import ZoneHistory
from conetl.pipeline.maps.notices import record_notices
from conetl.pipeline.maps.work_zones import read_zones
from conetl.workzones.work_zones import Stood, same_zones, with_kept_ids
from tests.integration.drives_of_days import DAY_NS, merge, survey, survey_of
from tests.synthetic.world import START_NS, Cone


def stored(conetl, *more):
    return json.loads(conetl("zones", "history", "--json", *more))


def standing(conn):
    found = read_zones(conn, map_name="default", as_of=None, lanes=None, params=WorkZoneParams())
    conn.rollback()
    return {zone.history.zone_id for zone in found.zones if zone.history.end_ns is None}


def drive(conn, day, cones, name=""):
    rng = np.random.default_rng(day)
    made = survey_of(cones, rng, name or f"day {day}", frames=90, start_m=0.0, first_ns=START_NS + day * DAY_NS)
    merge(conn, made)
    conn.commit()
    record_notices(conn, map_name="default")
    conn.rollback()


def row(start, count, y=3.6):
    return [Cone((start + 4.0 * k, y, 0.0), height_m=0.7) for k in range(count)]


def test_a_late_drive_changes_no_id(conn, conetl):
    merge(conn, survey(1))
    conn.commit()
    assert record_notices(conn, map_name="default") == 1
    conn.rollback()
    [first] = standing(conn)
    merge(conn, survey(0))  # it comes late, and found the zone first
    conn.commit()
    assert standing(conn) != {first}, "as computed from the devices alone"
    assert record_notices(conn, map_name="default") == 1
    conn.rollback()
    assert standing(conn) == {first}
    assert record_notices(conn, map_name="default") == 0
    versions = stored(conetl)
    assert [(one["zone_id"], one["version"], one["event"]) for one in versions] == [
        (str(first), 1, "began"), (str(first), 2, "changed")]  # fmt: skip
    assert versions[1]["state"]["start"] < versions[0]["state"]["start"]
    assert {one["state"]["work_zone_id"] for one in versions} == {str(first)}
    merge(conn, survey(2))
    conn.commit()
    record_notices(conn, map_name="default")
    conn.rollback()
    assert standing(conn) == {first}
    conetl("map", "rename", "default", "renamed")
    assert {one["zone_id"] for one in stored(conetl, "--map", "renamed")} == {str(first)}


def test_parts_and_a_pause_keep_the_id_and_what_was_known_then_is_shown(conn, conetl):
    cones = row(14.0, 12)
    drive(conn, 0, cones[:7])
    before = execute(conn, "select clock_timestamp() as at")[0]["at"]
    conn.rollback()
    [zone] = standing(conn)
    drive(conn, 1, cones)  # the other part
    drive(conn, 30, cones)  # after a pause
    assert standing(conn) == {zone}
    versions = stored(conetl, str(zone)[:8])
    assert [one["event"] for one in versions][:2] == ["began", "changed"]
    assert [len(one["state"]["devices"]) for one in versions][:2] == [7, 12]
    known = stored(conetl, "--known-at", before.isoformat())
    assert [(one["event"], len(one["state"]["devices"])) for one in known] == [("began", 7)]
    assert "1 version of 1 work zone of map default as known at" in conetl(
        "zones", "history", "--known-at", before.isoformat()
    )
    printed = conetl("zones", "history")
    assert str(zone)[:8] in printed and "began" in printed and "changed" in printed
    assert stored(conetl, "ffffffff") == []


def test_split_and_merged_zones_keep_their_history(conn, conetl):
    whole = row(10.0, 16)
    drive(conn, 0, whole)
    [zone] = standing(conn)
    for day in (1, 2):
        drive(conn, day, [*whole[:8], *whole[12:]])
    assert zone in standing(conn)
    [part] = standing(conn) - {zone}
    [began] = [one for one in stored(conetl, str(part)) if one["event"] == "began"]
    assert began["state"]["split_from"] == str(zone) and len(began["state"]["devices"]) == 4
    for day in (3, 4):
        drive(conn, day, whole)
    assert standing(conn) == {zone}
    last = stored(conetl, str(part))[-1]
    assert (last["event"], last["state"]["merged_into"]) == ("ended", str(zone))
    assert [len(one["state"]["devices"]) for one in stored(conetl, str(zone))] == [16, 8, 16]
    assert f"{str(zone)[:8]}" in conetl("zones", "history", str(part))


def test_versions_are_stored_after_a_merge_of_a_small_map_and_in_rounds_up_to_a_limit(
    conn, database_url, tmp_path, monkeypatch
):
    from conetl.pipeline.database import MapDatabase
    from conetl.pipeline.settings import Settings
    from flows.notices import notify_map_receivers

    merge(conn, survey(0))
    conn.commit()
    assert record_notices(conn, map_name="default", most_features=3) == 0
    conn.rollback()
    settings = Settings(home=tmp_path, database_url=database_url)
    with MapDatabase(settings) as database:
        assert notify_map_receivers(settings, database) == (1, 0, 0), "without receivers, too"
        assert notify_map_receivers(settings, database) == (0, 0, 0)


def test_the_dump_of_a_map_keeps_ids(conn, conetl, tmp_path):
    merge(conn, survey(1))
    conn.commit()
    record_notices(conn, map_name="default")
    merge(conn, survey(0))
    conn.commit()
    record_notices(conn, map_name="default")
    conn.rollback()
    before, aliases = standing(conn), read_zone_aliases(conn, map_name="default")
    conn.rollback()
    assert len(aliases) == 1
    conetl("map", "delete", "default", "--yes", "--dump", tmp_path / "map.zip")
    conetl("map", "restore", tmp_path / "map.zip")
    assert standing(conn) == before and read_zone_aliases(conn, map_name="default") == aliases
    conn.rollback()


def test_no_two_zones_get_one_id_and_a_zone_is_known_by_most_of_its_devices():
    a, b, c, d = (UUID(int=k) for k in range(1, 5))

    def zone(zone_id, merged_into=None):
        return ZoneHistory(zone_id, 0, None, merged_into, ())

    kept = with_kept_ids([zone(a), zone(b), zone(c, merged_into=a)], {a: d, b: d, c: a})
    assert [one.zone_id for one in kept] == [d, b, c] and kept[2].merged_into == d
    place = [(float(k), 0.0, 0.0) for k in range(0, 40, 4)]
    aside = [(x, y + 30.0, z) for x, y, z in place]

    def stood(devices, start="2026-03-01", end=None):
        return Stood(start, end, devices)

    before, now = {a: stood(place), b: stood(aside)}, {c: stood(aside[:4]), d: stood(place)}
    assert same_zones(before, now, 1.0) == {d: a, c: b}
    assert same_zones({a: stood(place)}, {c: stood([*place[:2], *aside])}, 1.0) == {}
    assert same_zones({}, now, 1.0) == same_zones(before, {}, 1.0) == {}
    ended = {a: stood(place, end="2026-03-02")}
    later, same = stood(place, "2026-05-01"), stood(place[:8], "2026-02-28", "2026-03-02")
    assert same_zones(ended, {c: later, d: same}, 1.0) == {d: a}, "works at the same place in May are others"
