"""What goes wrong in the middle of a commit: a lost connection, a full disk, two ingests at once. Nothing is half-written.

Random worlds too, with random drives in any order and any number of times, killed at random statements: the map is that of a
clean run. Everything is real but the instant: a connection counts its statements and is cut at the drawn one, in one of the
ways in which an ingest loses its database. Whole ingests that are killed by signal 9 at random instants are `make bench-kills`.
"""

from __future__ import annotations

import os
import resource
import socket
import subprocess
import sys
from contextlib import closing, contextmanager
from functools import cache, partial
from pathlib import Path
from uuid import uuid4

import numpy as np
import psycopg2
import pytest
from hypothesis import HealthCheck, Phase, event, example, given, settings
from hypothesis import strategies as st

from conetl.db import connection as db
from conetl.db.connection import connect, execute
from conetl.db.map.map_store import list_changesets, map_transaction
from conetl.files.atomic import atomic_text_file, remove_leftovers, temporary_path
from conetl.files.home import make_secret
from conetl.files.parquet_store import save_result
from conetl.model.drive import Detection
from conetl.model.errors import EXIT_SERVICE_MISSING, DatabaseError, StorageError
from tests.integration.drives_of_days import failed_audits, merge, survey, survey_of, valid_time_map
from tests.integration.test_ingest import FINAL_TABLES
from tests.synthetic.road import HOUR_NS, random_world
from tests.synthetic.world import START_NS, Cone


def test_two_maps_are_changed_at_the_same_time(conn, database_url):
    """One map's transaction is open, with all its rows written; the other's goes through beside it, in another CRS even."""
    other = connect(database_url)
    execute(other, "set lock_timeout = '5s'")
    other.commit()
    merge(conn, survey(0))
    with map_transaction(conn, "default"):
        execute(conn, "update conetl.feature_version set system_period = system_period")
        assert merge(other, survey(0), map_name="other") is not None
        assert merge(other, survey(1), map_name="other") is not None
    assert failed_audits(conn) == []
    assert len(list_changesets(conn, map_name="other")) == 2
    other.close()


@contextmanager
def full_disk():
    """Files cannot grow beyond 100 bytes: what a writer sees of a full disk. No fixture: pytest reports before those end."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


BOX = {"frame_index": 0, "side": "left", "x_px": 1.0, "y_px": 1.0, "w_px": 9.0, "h_px": 9.0, "score": 0.5}


def save_boxes(folder):
    save_result(folder / "results", "a" * 64, [Detection(detection_index=index, **BOX) for index in range(500)], [])


def write_export(folder):
    with atomic_text_file(folder / "map.geojson") as file:
        file.write("x" * 100_000)


def write_secret(folder):
    make_secret(folder / "token", "x" * 200)


@pytest.mark.parametrize("write", [save_boxes, write_export, write_secret])
def test_a_full_disk_leaves_nothing_behind(tmp_path, write):
    with full_disk(), pytest.raises(StorageError, match=r"cannot be written.*free space") as full:
        write(tmp_path)
    assert full.value.exit_code == EXIT_SERVICE_MISSING
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_results_cannot_be_written_where_a_file_is_in_the_way(tmp_path):
    (tmp_path / "results").write_text("")
    with pytest.raises(StorageError, match="results cannot be written"):
        save_boxes(tmp_path)


def test_only_files_of_dead_writers_are_removed(tmp_path):
    mine = temporary_path(tmp_path / "a.parquet")
    mine.write_text("being written")
    dead = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; from pathlib import Path; from conetl.files.atomic import temporary_path\n"
            "path = temporary_path(Path(sys.argv[1])); path.write_text('half'); print(path)\n"
            "folder = temporary_path(Path(sys.argv[1])); folder.mkdir(); (folder / 'part').write_text('half'); print(folder)",
            str(tmp_path / "b.parquet"),
        ],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2] / "src")},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    foreign = tmp_path / f".c.parquet.elsewhere.1.{uuid4().hex}.tmp"
    foreign.write_text("of another machine")
    (tmp_path / ".notes.tmp").write_text("not ours")
    assert sorted(remove_leftovers([tmp_path, tmp_path / "missing"])) == sorted(map(Path, dead))
    assert {path.name for path in tmp_path.iterdir()} == {mine.name, foreign.name, ".notes.tmp"}


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
    except DatabaseError as error:
        assert "is unchanged" in str(error) or "cannot be read" in str(error)
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
    max_examples=1,
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
@example(seed=0, order=[1, 0], repeats=[0, 0, 0], kills=[[(30, way) for way in WAYS[:3]], [(50, WAYS[0])], []])
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
