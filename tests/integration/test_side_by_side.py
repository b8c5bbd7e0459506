"""Drives that are merged at the same time: side by side in different regions, one after the other where they meet."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from conetl.db.connection import connect, execute
from conetl.db.map import replay_store
from conetl.db.map.commit import add_drive, path_wkt
from conetl.db.map.map_store import drive_transaction, list_changesets, map_transaction
from conetl.db.map.replay_store import REGION_M, affected_drives, lock_neighbourhood, regions_of, take_turn
from conetl.model.errors import DatabaseError
from conetl.model.params import IngestParams
from conetl.pipeline.replay import influence_m
from tests.integration.drives_of_days import Survey, failed_audits, key_of, merge, survey_of, valid_time_map
from tests.synthetic.road import HOUR_NS
from tests.synthetic.world import ORIGIN_M, START_NS, Cone

REACH_M = influence_m(IngestParams())
#: East of ORIGIN_M, where a region ends.
BORDER_M = REGION_M - ORIGIN_M[0] % REGION_M


@cache
def drive_at(start_m, hour, name=""):
    """A short drive past two cones, which are there at all hours."""
    cones = [Cone((start_m + 12.0, 3.0, 0.0)), Cone((start_m + 18.0, -3.5, 0.0), height_m=0.5)]
    rng = np.random.default_rng([int(start_m), hour])
    first_ns = START_NS + hour * HOUR_NS
    return survey_of(cones, rng, name or f"{start_m} {hour}", frames=12, start_m=start_m, first_ns=first_ns)


def lock(conn, survey):
    """As `merge_drive` does at its beginning."""
    drive, key = survey.drive, key_of(survey, IngestParams())
    return lock_neighbourhood(
        conn, "default", drive, key, lambda: add_drive(conn, drive, key, influence_m=REACH_M),
        path_wkt=path_wkt(drive), influence_m=REACH_M,
    )  # fmt: skip


@pytest.fixture
def impatient(database_url):
    """A session that waits for nobody for long; `merge` has a timeout of its own."""
    with pytest.MonkeyPatch.context() as patch, closing(connect(database_url)) as conn:
        patch.setattr("tests.integration.drives_of_days.drive_transaction", waits_for_half_a_second)
        yield conn


def waits_for_half_a_second(conn, map_name):
    return drive_transaction(conn, map_name, lock_timeout_s=0.5)


def test_a_drive_elsewhere_is_merged_beside_a_transaction_that_is_open(conn, impatient):
    merge(conn, drive_at(0.0, 0))
    with drive_transaction(conn):
        lock(conn, drive_at(0.0, 1))
        assert merge(impatient, drive_at(3 * REGION_M, 1)) is not None
        with pytest.raises(DatabaseError, match="not free in time"):
            merge(impatient, drive_at(10.0, 2))
        with pytest.raises(DatabaseError, match="not free in time"):  # the same recording, delivered with other poses
            merge(impatient, drive_at(3 * REGION_M, 1, name=drive_at(0.0, 1).drive.drive_id))
        with (
            pytest.raises(DatabaseError, match="not free in time"),
            map_transaction(impatient, lock_timeout_s=0.2),
        ):
            pass
        conn.rollback()  # it only took the locks
    assert merge(impatient, drive_at(10.0, 2)) is not None
    assert failed_audits(conn) == []


def test_a_late_drive_waits_for_what_it_affects_far_away(conn, impatient):
    """A chain of later drives leads over a border: the late drive at its beginning is alone on both sides."""
    for start_m, hour in ((BORDER_M - 240.0, 3), (BORDER_M - 100.0, 4), (BORDER_M + 30.0, 5)):
        merge(conn, drive_at(start_m, hour))
    late = drive_at(BORDER_M - 300.0, 0)
    with drive_transaction(impatient):
        alone = regions_of(impatient, [], path_wkt=path_wkt(late.drive), influence_m=REACH_M)
        assert len(alone) == 1
        near = lock(impatient, late)
        assert len(near.later) == 3
        assert alone < regions_of(impatient, [ref.drive_uuid for ref in near.later])
        with pytest.raises(DatabaseError, match="not free in time"), drive_transaction(conn, lock_timeout_s=0.5):
            lock(conn, drive_at(BORDER_M + 200.0, 9))


def test_a_drive_that_comes_between_the_look_and_the_locks_is_found(conn, database_url, monkeypatch):
    """Drives that a late drive affects are read again under its locks, until these cover them all."""
    merge(conn, drive_at(BORDER_M - 240.0, 3))
    taken, find = [], replay_store.regions_of

    def look(own, drive_uuids, **path):
        found = find(own, drive_uuids, **path)
        taken.append(found)
        if len(taken) == 1:
            with closing(connect(database_url)) as other:
                merge(other, drive_at(BORDER_M - 100.0, 4))
                merge(other, drive_at(BORDER_M + 30.0, 5))
        return found

    monkeypatch.setattr(replay_store, "regions_of", look)
    with drive_transaction(conn):
        near = lock(conn, drive_at(BORDER_M - 300.0, 0))
        assert near.later == affected_drives(conn, [near.drive_uuid])
        assert len(near.later) == 3
        locks = execute(
            conn, "select count(*) as n from pg_locks where locktype = 'advisory' and pid = pg_backend_pid()"
        )
        assert locks[0]["n"] == 1 + 2 + len(find(conn, [ref.drive_uuid for ref in near.later]))


def test_a_drive_near_very_many_regions_takes_the_whole_map(conn, impatient, monkeypatch):
    merge(conn, drive_at(0.0, 0))
    monkeypatch.setattr(replay_store, "MAX_REGIONS", 0)
    with drive_transaction(conn):
        lock(conn, drive_at(0.0, 1))
        monkeypatch.undo()
        with pytest.raises(DatabaseError, match="not free in time"):
            merge(impatient, drive_at(3 * REGION_M, 1))


def test_instants_of_changesets_rise_as_readers_see_them(conn, impatient):
    """Who has the turn commits before anyone else gets an instant of system time."""
    merge(conn, drive_at(0.0, 0))
    with drive_transaction(conn):
        take_turn(conn, "default")
        with pytest.raises(DatabaseError, match="not free in time"):
            merge(impatient, drive_at(3 * REGION_M, 1))
    assert merge(impatient, drive_at(3 * REGION_M, 1)) is not None


def at_once(url: str, surveys: Sequence[Survey]) -> int:
    """Merge each in a session of its own, all at once; how many were new."""

    def one(survey: Survey) -> bool:
        with closing(connect(url)) as conn:
            return merge(conn, survey) is not None

    with ThreadPoolExecutor(len(surveys)) as pool:
        return sum(pool.map(one, surveys))


PLACES = st.integers(-8, 8).map(lambda step: float(round(BORDER_M) + 60 * step))


@settings(
    max_examples=1,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # shrinking would take minutes
)
@given(drives=st.lists(st.tuples(PLACES, st.integers(0, 40)), min_size=4, max_size=8))
@example(drives=[(float(round(BORDER_M)), hour) for hour in (0, 1, 2, 1, 0, 2)])  # of one neighbourhood, each twice
def test_random_drives_at_once_on_both_sides_of_a_border_give_the_map_of_any_order(database_url, drives):
    """Drives of one place and hour are the same recording, which counts once."""
    surveys = [drive_at(*one) for one in drives]
    with closing(connect(database_url)) as conn:
        _empty(conn)
        assert at_once(database_url, surveys) == len(set(drives))
        found = valid_time_map(conn)
        assert failed_audits(conn) == []
        by_number = sorted(list_changesets(conn), key=lambda one: one.changeset_no)
        assert [one.changeset_no for one in by_number] == list(range(1, len(set(drives)) + 1))
        assert by_number == sorted(by_number, key=lambda one: one.committed_at)
        _empty(conn)
        for survey in sorted(surveys, key=lambda one: one.drive.frame_pairs[0].captured_at_ns):
            merge(conn, survey)
        assert found == valid_time_map(conn)


def _empty(conn):
    conn.rollback()
    execute(conn, "truncate conetl.map, conetl.run, conetl.drive, conetl.frame_pair, conetl.detection, conetl.stereo_match, "
        "conetl.position, conetl.feature_version restart identity cascade")  # fmt: skip
    conn.commit()
