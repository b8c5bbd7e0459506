"""kill -9 of an ingest at random instants, many times: the tables must be equal to those of one clean run every time.

A drive of a few frame pairs with cached detections is ingested in a process group of its own, which is killed at a random
instant of the duration of an ingest: by the pipeline's own functions, file by file and into PostGIS, without Prefect, which
costs seconds per trial and writes nothing of conetl. The same ingest then runs to its end,
and the final tables (hash of every row, except values of a clock or a sequence), advisory locks, audits (every tenth trial) and
leftover files are checked. In every second trial the drive comes late: a newer one over the same area is already on the map,
and is evaluated again.

    python benchmarks/bench_kills.py [--kills 200] [--seed 1] [--folder /tmp]
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import time
import traceback
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path

import cv2
import pyarrow.parquet as pq

from benchmarks.harness import arguments_of, own_cluster, write_json
from benchmarks.whole_job import params_with
from conetl.db.connection import Connection, connect, execute
from conetl.db.schema import run_audits
from conetl.files.atomic import remove_leftovers
from conetl.pipeline.ingest import ingest as pipeline_ingest
from conetl.pipeline.settings import Settings, prefect_environment
from tests.integration.small_drives import SAMPLES, cut_drive
from tests.integration.test_ingest import FINAL_TABLES

FRAMES = range(8, 12)
EMPTY = (
    "truncate conetl.map, conetl.run, conetl.drive, conetl.frame_pair, conetl.detection, conetl.stereo_match, conetl.position, "
    "conetl.feature_version restart identity cascade"
)


def run_job(drives: list[Path], settings: Settings) -> None:
    """The work of the pipeline, without refinement of poses."""
    params = params_with(False)
    remove_leftovers((settings.results_folder, settings.exports_folder))
    for folder in drives:
        pipeline_ingest(folder, params, settings)


def ingest(drives: list[Path], home: Path, *, kill_after_s: float | None = None) -> tuple[bool, float]:
    """Ingest in a forked process group; whether it ended before the kill, and its seconds. Raises SystemExit where it failed."""
    start = time.monotonic()
    pid = os.fork()
    if pid == 0:
        os.setpgid(0, 0)
        code = 70
        try:
            log = os.open(home / "ingest.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(log, 1)
            os.dup2(log, 2)
            run_job(drives, Settings(home=home))
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    with suppress(ProcessLookupError, PermissionError):
        os.setpgid(pid, pid)  # in both processes, so that the group exists before the kill
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
        said = (home / "ingest.log").read_text()[-3000:]
        raise SystemExit(f"{said}\nthe ingest of {drives} failed with exit code {status}")
    return True, time.monotonic() - start


def tables_hash(conn: Connection) -> str:
    """Hash of all final tables, without map_id: killed transactions advance its sequence."""
    digest = hashlib.sha256()
    for table, content in FINAL_TABLES.items():
        for row in execute(conn, f"select ({content} - 'map_id')::text as line from conetl.{table} t order by 1"):
            digest.update(f"{table} {row['line']}\n".encode())
    conn.rollback()
    return digest.hexdigest()


def leftovers(home: Path) -> list[str]:
    """Unfinished files."""
    return [str(path) for folder in ("results", "exports") for path in (home / folder).glob(".*")]


def refill(home: Path, cached: Path) -> None:
    """Restore the results of detection only, so that all later steps are computed and written again."""
    for folder in ("results", "exports"):
        shutil.rmtree(home / folder, ignore_errors=True)
    shutil.copytree(cached, home / "results", copy_function=os.link)


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="folder of the temporary home")
    options = parser.parse_args()
    with own_cluster(folder=options.folder) as (home, url), closing(connect(url)) as conn:
        os.environ |= prefect_environment(home) | {"CONETL_HOME": str(home), "CONETL_DATABASE_URL": url}
        outcome, faults = trials(conn, home, options.kills, random.Random(options.seed))
    killed = sum(outcome.values()) - outcome["ended before"]
    print(f"{options.kills} trials, {killed} killed, {len(faults)} with a fault")
    write_json(options.json, {"outcome": outcome, "faults": faults})
    if faults:
        raise SystemExit(1)


def trials(conn: Connection, home: Path, kills: int, chance: random.Random) -> tuple[Counter[str], list[object]]:
    """Number of trials by outcome, and their faults."""
    early, late = (cut_drive(SAMPLES[k], home / name, frames=FRAMES) for k, name in enumerate(("early", "later")))
    expected, seconds = {}, {}
    for name, order in (("new drive", [early]), ("late drive", [late, early])):
        execute(conn, EMPTY)
        conn.commit()
        for drive in [*order, order[-1]]:  # the last one again, with cached detections
            ingest([drive], home)
        expected[name] = tables_hash(conn)
        cached = _detections(home)
    # Once in this process, so that the forks need not import everything again.
    cv2.setNumThreads(0)
    _prepare(conn, home, cached, "new drive", late)
    run_job([early], Settings(home=home))
    for name in expected:
        _prepare(conn, home, cached, name, late)
        seconds[name] = ingest([early], home)[1]
        print(f"an ingest of a {name} takes {seconds[name]:.1f} s", flush=True)
    outcome: Counter[str] = Counter()
    faults: list[object] = []
    for trial in range(kills):
        name = ("new drive", "late drive")[trial % 2]
        _prepare(conn, home, cached, name, late)
        instant_s = chance.uniform(0.0, 1.1 * seconds[name])
        ended, _ = ingest([early], home, kill_after_s=instant_s)
        on_map = _count(conn, "conetl.changeset") == 1 + trial % 2
        outcome["ended before" if ended else "killed after its commit" if on_map else "killed before its commit"] += 1
        again_s = ingest([early], home)[1]
        if not on_map:  # the load of the machine changes
            seconds[name] = again_s
        problems = [f"left {path}" for path in leftovers(home)]
        if tables_hash(conn) != expected[name]:
            problems.append("other tables")
        if locks := _count(conn, "pg_locks where locktype = 'advisory'"):
            problems.append(f"{locks} locks")
        if trial % 10 == 0:
            problems += [f"audit {result.name}" for result in run_audits(conn) if not result.passed]
        if problems:
            faults.append((trial, name, instant_s, problems))
        if (trial + 1) % 10 == 0:
            print(json.dumps({"trials": trial + 1, **outcome, "faults": faults}), flush=True)
    return outcome, faults


def _count(conn: Connection, rows: str) -> int:
    found = execute(conn, f"select count(*) as n from {rows}")[0]["n"]
    conn.rollback()
    return int(found)


def _prepare(conn: Connection, home: Path, cached: Path, name: str, late: Path) -> None:
    """An empty map, or one with the newer drive, and cached detections."""
    execute(conn, EMPTY)
    conn.commit()
    refill(home, cached)
    if name == "late drive":
        ingest([late], home)
        refill(home, cached)


def _detections(home: Path) -> Path:
    """A folder with links to the results of detection."""
    cached = home / "cached"
    cached.mkdir(exist_ok=True)
    for path in (home / "results").glob("*.parquet"):
        columns = set(pq.read_schema(path).names)
        if {"x_px", "detection_index"} <= columns and not (cached / path.name).exists():
            os.link(path, cached / path.name)
    return cached


if __name__ == "__main__":
    main()
