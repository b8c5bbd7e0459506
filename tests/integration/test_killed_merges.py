"""Random worlds, random drives in any order and any number of times, killed at random statements: the map of a clean run.

Everything is real but the instant: a connection counts its statements and is cut at the drawn one, in one of the ways in which an
ingest loses its database. Whole ingests that are killed by signal 9 at random instants are `make bench-kills`.
"""

from __future__ import annotations

import os
import socket
from contextlib import closing, contextmanager
from functools import cache, partial

import numpy as np
import psycopg2
import pytest
from hypothesis import HealthCheck, Phase, event, example, given, settings
from hypothesis import strategies as st

from conetl.db import connection as db
from conetl.db.connection import connect, execute
from conetl.db.map.map_store import map_transaction
from conetl.model.errors import DatabaseError
from tests.integration.drives_of_days import failed_audits, merge, survey_of, valid_time_map
from tests.integration.test_ingest import FINAL_TABLES
from tests.synthetic.road import HOUR_NS, random_world
from tests.synthetic.world import START_NS, Cone

WORLD_DAYS = 3
WORLD_M = 40.0
#: A merge sends some 60 statements; what is drawn beyond the last one is the commit.
MAX_STATEMENT = 64
WAYS = (
    "the server ends the session",
    "the client vanishes",
    "the session ends after the statement",
    "the answer is lost",
)


class CutConnection(psycopg2.extensions.connection):
    """Is cut off at its statement number `cut_at` (1 is the first; 0: never), in the given `way`: both set once it is prepared.

    Every statement of `conetl.db.connection` has a cursor of its own.
    """

    cut_at = 0
    way = ""
    sent = 0

    def cursor(self, *args, cursor_factory=psycopg2.extensions.cursor, **options):
        """Also counts."""
        self.sent += 1
        if self.sent == self.cut_at and self.way == "the session ends after the statement":

            class Last(cursor_factory):
                def execute(self, *args):
                    super().execute(*args)
                    self.connection.cut()

                def copy_expert(self, *args):
                    super().copy_expert(*args)
                    self.connection.cut()

            cursor_factory = Last
        elif self.sent == self.cut_at and self.way != "the answer is lost":
            self.cut()
        return super().cursor(*args, cursor_factory=cursor_factory, **options)

    def commit(self):
        """Also cut, where the drawn statement comes no more."""
        if self.sent < self.cut_at and self.way != "the answer is lost":
            self.cut()
        super().commit()
        if self.cut_at and self.way == "the answer is lost":
            self.cut()
            raise psycopg2.OperationalError("the answer to the commit was lost")

    def cut(self):
        """Ends the session for good; of a client that vanished the server knows when it wants the next statement."""
        if self.way == "the client vanishes":  # what the kernel does with the socket of a killed client
            with socket.socket(fileno=os.dup(self.fileno())) as line:
                line.shutdown(socket.SHUT_RDWR)
        else:
            with closing(psycopg2.connect(self.dsn)) as other, other.cursor() as cursor:
                cursor.execute("select pg_terminate_backend(%s, 10000)", (self.info.backend_pid,))


@cache
def surveys(seed, count):
    """Drives over one random road, by the time of their recording; some over a part of it, some at the same time."""
    rng = np.random.default_rng(seed)
    world = random_world(rng, WORLD_M, WORLD_DAYS)
    hours = np.sort(rng.choice(24 * WORLD_DAYS, count, replace=False)).tolist()
    made = []
    for number, hour in enumerate(hours):
        first_ns = START_NS + hour * HOUR_NS
        stands = [Cone((*xy, 0.0), height_m=cone.height_m) for cone in world if (xy := cone.at(first_ns)) is not None]
        start_m, frames = rng.choice([0.0, 0.0, 10.0]), int(rng.choice([12, 18]))
        made.append(
            survey_of(stands, rng, f"{seed} {number}", frames=frames, start_m=float(start_m), first_ns=first_ns)
        )
    return made


def killed_merge(url, survey, statement, way):
    """Whether the merge was killed (else it was over before the drawn statement came, or had nothing to do)."""
    with patched_connection():
        conn = connect(url)
    conn.sent, conn.cut_at, conn.way = 0, statement, way
    try:
        merge(conn, survey)
    except DatabaseError:
        return True
    else:
        return False
    finally:
        conn.cut_at = 0
        conn.close()


@contextmanager
def patched_connection():
    """`connect` makes connections that can be cut."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(db.psycopg2, "connect", partial(psycopg2.connect, connection_factory=CutConnection))
        yield


def final_tables(conn):
    found = {
        table: [
            row["line"]
            for row in execute(conn, f"select ({content} - 'map_id')::text as line from conetl.{table} t order by 1")
        ]
        for table, content in FINAL_TABLES.items()
    }
    conn.rollback()
    return found


KILLS = st.lists(st.tuples(st.integers(1, MAX_STATEMENT), st.sampled_from(WAYS)), max_size=2)


@contextmanager
def emptied(url):
    """A connection to the test's database without any drive: deleting is faster than a clone for each run."""
    with closing(connect(url)) as conn:
        for table in reversed(FINAL_TABLES):
            execute(conn, f"delete from conetl.{table}")
        execute(conn, "delete from conetl.map")
        conn.commit()
        yield conn


@settings(
    max_examples=6,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # shrinking would take minutes
)
@given(
    seed=st.integers(0, 2**32 - 1),
    order=st.integers(2, 3).flatmap(lambda count: st.permutations(range(count))),
    repeats=st.lists(st.integers(0, 2), min_size=3, max_size=3),
    kills=st.lists(KILLS, min_size=3, max_size=3),
)
@example(seed=0, order=[0, 1], repeats=[0, 0, 0], kills=[[(1, "the answer is lost")] * 2, [], []])
def test_killed_merges_of_random_drives_leave_the_map_of_a_clean_run(database_url, seed, order, repeats, kills):
    drives = surveys(seed, len(order))
    with emptied(database_url) as conn:
        for drive in drives:
            merge(conn, drive)
        in_order = valid_time_map(conn)
    with emptied(database_url) as conn:
        for number in order:
            merge(conn, drives[number])
        expected = final_tables(conn)
    with emptied(database_url) as conn:
        for place, number in enumerate(order):
            on_map = False  # by an earlier try, which leaves the next one nothing to write
            for statement, way in kills[place]:
                before = final_tables(conn)
                killed = killed_merge(database_url, drives[number], statement, way)
                if killed:
                    event(way)
                    with map_transaction(conn, lock_timeout_s=10):  # no lock is left behind
                        pass
                    writes = way == "the answer is lost" and not on_map
                    assert (final_tables(conn) != before) == writes, "written in part"
                on_map = on_map or not killed or way == "the answer is lost"
            merge(conn, drives[number])
            merge(conn, drives[order[repeats[place] % (place + 1)]])
        assert final_tables(conn) == expected
        assert valid_time_map(conn) == in_order
        assert failed_audits(conn) == []
