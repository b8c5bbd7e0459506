"""kill -9 of an ingest at random instants, again and again: the tables must become those of one clean run every time.

A drive of a few frame pairs with cached detections is ingested in a process group of its own, which is killed at a random
instant of the time that a whole ingest takes: by the flow's own functions, file by file and into PostGIS, without Prefect
around them, which costs seconds a trial and writes nothing of ours; with --prefect by the real command's function. The same
ingest then runs to its end, and the final tables (hash of every row, but for what a clock or a sequence says), advisory locks,
audits (every tenth trial) and leftover files are looked at. In every second trial the drive comes late: another one over the
same place is on the map already, and is compared again.

    python benchmarks/bench_kills.py [--kills 200] [--seed 1] [--prefect] [--folder /tmp]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import cv2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.whole_job import params_with
from conetl.db.audits import run_audits
from conetl.db.cluster.cluster import cluster_remove, cluster_up
from conetl.db.connection import Connection, connect, execute, migrate
from conetl.files.partial_files import sweep
from conetl.model.params import IngestParams
from conetl.pipeline.ingest import ingest as pipeline_ingest
from conetl.pipeline.settings import Settings, prefect_environment
from tests.integration.test_ingest import DRIVES, FINAL_TABLES, part_of

FRAMES = 4
EMPTY = (
    "truncate conetl.map, conetl.run, conetl.drive, conetl.frame_pair, conetl.detection, conetl.stereo_match, conetl.position, "
    "conetl.track_member, conetl.feature_version restart identity cascade"
)


def with_prefect(drives: list[Path], settings: Settings) -> int:
    """What `conetl ingest` does."""
    from conetl.cli.ingest import ingest_drives

    return ingest_drives(drives, settings, IngestParams(), map_srid=None, show=lambda _: None)[1]


def without_prefect(drives: list[Path], settings: Settings) -> int:
    """The pipeline, without poses refined."""
    params = params_with(False)
    sweep((settings.results_folder, settings.exports_folder))
    for folder in drives:
        pipeline_ingest(folder, params, settings)
    return 0


JOB = without_prefect


def ingest(drives: list[Path], home: Path, *, kill_after_s: float | None = None) -> tuple[bool, float]:
    """Ingest in a forked process group; whether it ended by itself, and after how long. Raises SystemExit where it failed."""
    start = time.monotonic()
    pid = os.fork()
    if pid == 0:
        os.setpgid(0, 0)
        code = 70
        try:
            log = os.open(home / "ingest.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(log, 1)
            os.dup2(log, 2)
            code = JOB(drives, Settings(home=home))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    with suppress(ProcessLookupError, PermissionError):
        os.setpgid(pid, pid)  # whoever is first, so that there is a group to kill at once
    if kill_after_s is not None:
        while time.monotonic() - start < kill_after_s:
            if os.waitpid(pid, os.WNOHANG)[0]:
                return True, time.monotonic() - start
            time.sleep(0.002)
        os.killpg(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        return False, time.monotonic() - start
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if status != 0:
        log = (home / "ingest.log").read_text()[-3000:]
        raise SystemExit(f"{log}\nthe ingest of {drives} failed with exit code {status}")
    return True, time.monotonic() - start


def tables_hash(conn: Connection) -> str:
    """Of all final tables; map_id comes from a sequence, which a transaction that was killed has moved on."""
    digest = hashlib.sha256()
    for table, content in FINAL_TABLES.items():
        for row in execute(conn, f"select ({content} - 'map_id')::text as line from conetl.{table} t order by 1"):
            digest.update(f"{table} {row['line']}\n".encode())
    conn.rollback()
    return digest.hexdigest()


def leftovers(home: Path) -> list[str]:
    """Files that no finished ingest leaves."""
    return [str(path) for folder in ("results", "exports") for path in (home / folder).glob(".*")]


def refill(home: Path, cached: Path) -> None:
    """Results as after detection only: all later steps are computed, and written, again."""
    for folder in ("results", "exports"):
        shutil.rmtree(home / folder, ignore_errors=True)
    shutil.copytree(cached, home / "results", copy_function=os.link)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--prefect", action="store_true", help="the whole command instead of the flow's functions")
    parser.add_argument("--folder", type=Path, help="where the temporary home folder lies")
    options = parser.parse_args()
    home = Path(tempfile.mkdtemp(prefix="conetl-bench-kills-", dir=options.folder))
    os.environ |= prefect_environment(home) | {"CONETL_HOME": str(home)}
    try:
        url = cluster_up(home)
        os.environ["CONETL_DATABASE_URL"] = url
        with closing(connect(url)) as conn, ExitStack() as running:
            migrate(conn)
            if options.prefect:
                global JOB  # noqa: PLW0603 -- what all forks do, chosen once
                from flows.server import prefect_server

                JOB = with_prefect
                os.environ["PREFECT_API_URL"] = running.enter_context(prefect_server(home))
            trials(conn, home, options.kills, random.Random(options.seed))
    finally:
        cluster_remove(home)
        shutil.rmtree(home)


def trials(conn: Connection, home: Path, kills: int, chance: random.Random) -> None:
    """All trials; exits with 1 where one failed."""
    early = part_of(DRIVES[0], home / "early", FRAMES, skip=8)
    late = part_of(DRIVES[1], home / "later", FRAMES, skip=8)
    expected, seconds = {}, {}
    for name, order in (("new drive", [early]), ("late drive", [late, early])):
        execute(conn, EMPTY)
        conn.commit()
        for drive in order[:-1]:
            ingest([drive], home)
        ingest([order[-1]], home)  # detects
        if name == "new drive":
            cached = _detections(home)
        _, seconds[name] = ingest([order[-1]], home)
        expected[name] = tables_hash(conn)
    cached = _detections(home)
    if JOB is without_prefect:  # once in this process, so that the forks need not import everything again
        cv2.setNumThreads(0)
        _prepare(conn, home, cached, "new drive", late)
        JOB([early], Settings(home=home))
    for name in expected:  # timed with cached detections
        _prepare(conn, home, cached, name, late)
        _, seconds[name] = ingest([early], home)
    print(
        f"a whole ingest takes {seconds['new drive']:.1f} s, of a late drive {seconds['late drive']:.1f} s", flush=True
    )
    outcome: Counter[str] = Counter()
    faults = []
    for trial in range(kills):
        name = ("new drive", "late drive")[trial % 2]
        _prepare(conn, home, cached, name, late)
        instant_s = chance.uniform(0.0, 1.1 * seconds[name])
        ended, _ = ingest([early], home, kill_after_s=instant_s)
        on_map = execute(conn, "select count(*) as n from conetl.changeset")[0]["n"] == 1 + trial % 2
        conn.rollback()
        outcome[
            "was over before" if ended else ("killed after its commit" if on_map else "killed before its commit")
        ] += 1
        again_s = ingest([early], home)[1]
        if not on_map:  # the machine may do other work than a minute ago
            seconds[name] = again_s
        problems = []
        if tables_hash(conn) != expected[name]:
            problems.append("other tables")
        locks = execute(conn, "select count(*) as n from pg_locks where locktype = 'advisory'")[0]["n"]
        conn.rollback()
        problems += [f"{locks} locks"] if locks else []
        problems += [f"left {path}" for path in leftovers(home)]
        problems += (
            [f"audit {result.name}" for result in run_audits(conn) if not result.passed] if trial % 10 == 0 else []
        )
        if problems:
            faults.append((trial, name, instant_s, problems))
        if (trial + 1) % 10 == 0:
            print(json.dumps({"trials": trial + 1, **outcome, "faults": faults}), flush=True)
    print(
        f"{kills} trials, {sum(outcome.values()) - outcome['was over before']} killed, {len(faults)} with a fault",
        flush=True,
    )
    if faults:
        raise SystemExit(1)


def _prepare(conn: Connection, home: Path, cached: Path, name: str, late: Path) -> None:
    """An empty map, or one with the later drive on it, and cached detections."""
    execute(conn, EMPTY)
    conn.commit()
    refill(home, cached)
    if name == "late drive":
        ingest([late], home)
        refill(home, cached)


def _detections(home: Path) -> Path:
    """A copy of the results that are detections."""
    import pyarrow.parquet as pq

    cached = home / "cached"
    cached.mkdir(exist_ok=True)
    for path in (home / "results").glob("*.parquet"):
        columns = set(pq.read_schema(path).names)
        if {"x_px", "detection_index"} <= columns and not (cached / path.name).exists():
            os.link(path, cached / path.name)
    return cached


if __name__ == "__main__":
    main()
