"""What goes wrong in the middle of a commit: a lost connection, a full disk, two ingests at once. Nothing is half-written."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from uuid import uuid4

import pytest

from conetl.db.connection import connect, execute
from conetl.db.map.map_store import list_changesets, map_transaction
from conetl.files.atomic import aside, atomic_text_file, sweep
from conetl.files.parquet_store import save_result
from conetl.model.errors import EXIT_SERVICE_MISSING, DatabaseError, StorageError
from conetl.model.records import Detection
from tests.integration.drives_of_days import failed_audits, merge, survey, valid_time_map


def wait_until(reached, *, seconds=30):
    deadline = time.monotonic() + seconds
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_connection_lost_in_the_middle_of_the_commit_writes_nothing(conn, database_url):
    """The deltas are the last of what is merged: whoever waits there has written all versions."""
    merge(conn, survey(1))
    before = valid_time_map(conn)
    holder, victim = connect(database_url), connect(database_url)
    victim_pid = victim.info.backend_pid
    execute(holder, "lock table conetl.delta in share mode")
    failures = []

    def lose():
        try:
            merge(victim, survey(2))
        except DatabaseError as error:
            failures.append(str(error))

    thread = threading.Thread(target=lose)
    thread.start()
    waiting = "select 1 from pg_locks where pid = %(pid)s and not granted and relation = 'conetl.delta'::regclass"

    def waits():
        rows = execute(conn, waiting, {"pid": victim_pid})
        conn.rollback()
        return bool(rows)

    wait_until(waits)
    execute(conn, "select pg_terminate_backend(%(pid)s)", {"pid": victim_pid})
    conn.commit()
    thread.join(timeout=30)
    holder.close()
    assert len(failures) == 1
    assert "is as it was before" in failures[0]
    assert valid_time_map(conn) == before
    with map_transaction(conn, lock_timeout_s=10):  # no lock is left behind
        pass
    assert merge(conn, survey(2)) is not None
    assert failed_audits(conn) == []


def test_drives_of_one_neighbourhood_at_once_give_the_map_of_any_order(conn, database_url, another_database):

    def ingest(day):
        own = connect(database_url)
        try:
            return merge(own, survey(day)) is not None
        finally:
            own.close()

    with ThreadPoolExecutor(4) as pool:  # each twice
        assert sorted(pool.map(ingest, (0, 1, 2, 1, 0, 2))) == [False] * 3 + [True] * 3
    assert len(list_changesets(conn)) == 3
    assert failed_audits(conn) == []
    with another_database() as other:
        for day in range(3):
            merge(other, survey(day))
        assert valid_time_map(other) == valid_time_map(conn)


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


@pytest.fixture
def full_disk():
    """Files cannot grow beyond 100 bytes: what a writer sees of a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


BOX = {"frame_index": 0, "side": "left", "x_px": 1.0, "y_px": 1.0, "w_px": 9.0, "h_px": 9.0, "score": 0.5}


def test_a_full_disk_leaves_no_result_behind(tmp_path, full_disk):
    boxes = [Detection(detection_index=index, **BOX) for index in range(500)]
    with pytest.raises(StorageError, match=r"results cannot be written.*free space") as full:
        save_result(tmp_path / "results", "a" * 64, boxes, [])
    assert full.value.exit_code == EXIT_SERVICE_MISSING
    assert list((tmp_path / "results").iterdir()) == []


def test_a_full_disk_leaves_no_export_behind(tmp_path, full_disk):
    with pytest.raises(StorageError, match="free space"), atomic_text_file(tmp_path / "map.geojson") as file:
        file.write("x" * 100_000)
    assert list(tmp_path.iterdir()) == []


def test_results_cannot_be_written_where_a_file_is_in_the_way(tmp_path):
    (tmp_path / "results").write_text("")
    with pytest.raises(StorageError, match="results cannot be written"):
        save_result(tmp_path / "results", "a" * 64, [Detection(detection_index=0, **BOX)], [])


def test_only_files_of_dead_writers_are_swept(tmp_path):
    mine = aside(tmp_path / "a.parquet")
    mine.write_text("being written")
    dead = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; from pathlib import Path; from conetl.files.atomic import aside\n"
            "path = aside(Path(sys.argv[1])); path.write_text('half'); print(path)\n"
            "folder = aside(Path(sys.argv[1])); folder.mkdir(); (folder / 'part').write_text('half'); print(folder)",
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
    assert sorted(sweep([tmp_path, tmp_path / "missing"])) == sorted(map(Path, dead))
    assert {path.name for path in tmp_path.iterdir()} == {mine.name, foreign.name, ".notes.tmp"}
