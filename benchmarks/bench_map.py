"""How long one drive takes to be merged into maps of 100 thousand, 1 million and 10 million features, and what a look back costs.

"100,000 sightings" is measured in both readings of the word: 100,000 positions, of which a track has about ten (a drive past
10,000 cones), and 100,000 tracks of one position each (a drive past 100,000 cones: 500 km of road works in one go).

A private cluster with fsync on, as `conetl db up` makes it, lies in a temporary folder that is removed at the end. For each size
the map is loaded (see `made_up_map.py`), a drive with its tracks in memory is merged, and the map is asked for boxes of 500 m at
an instant of the past. Processor time is that of this process and of the database's backend; the wall clock is what a user
waits, but tells little on a machine that does other work.

    python benchmarks/bench_map.py [--sizes 100000 1000000] [--sightings 100000] [--audits] [--no-history] [--folder /tmp]
    python benchmarks/bench_map.py --home /tmp/maps --load-only      # keeps the loaded maps ...
    python benchmarks/bench_map.py --home /tmp/maps [--clone]        # ... and measures on them, or on copies of them

10 million features need some 10 GB without history (one row each), 22 GB with it, and half an hour.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.made_up_map import (
    FOUNDED_NS,
    MAP_NAME,
    ROAD_CONES,
    SRID,
    Sightings,
    drive_along,
    index_sizes,
    load_map,
    place_of,
)
from conetl.db.audits import run_audits
from conetl.db.cluster.cluster import cluster_down, cluster_remove, cluster_up
from conetl.db.connection import Connection, connect, execute
from conetl.db.map.commit import commit_changeset, place_drive
from conetl.db.map.map_store import map_transaction, read_features_as_of
from conetl.db.map.replay_store import (
    affected_drives,
    read_doubts_around,
    read_standing_around,
    superseded_drives,
)
from conetl.db.schema import migrate
from conetl.db.statements import load_sql
from conetl.mapping.history import DriveEvidence, apply_drive
from conetl.model.map_records import Changeset, Decisions
from conetl.model.params import ReconcileParams
from conetl.model.records import DriveRecords
from conetl.pipeline.replay import no_cycle_search

LOOKS = 60
BOX_M = 500.0


@dataclass
class Stopwatch:
    """By phase: seconds (wall, processor of this process, of the database's backend), MB that the backend read from disk.

    What lay in the system's cache counts as nothing.
    """

    backend_pid: int
    seconds: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        start = self._now()
        yield
        end = self._now()
        self.seconds[name] = tuple(b - a for a, b in zip(start, end, strict=True))  # type: ignore[assignment]

    def _now(self) -> tuple[float, float, float, float]:
        fields = Path(f"/proc/{self.backend_pid}/stat").read_text().rsplit(")", 1)[1].split()
        server_s = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        io = dict(line.split(": ") for line in Path(f"/proc/{self.backend_pid}/io").read_text().splitlines())
        return time.perf_counter(), time.process_time(), server_s, int(io["read_bytes"]) / 1e6

    @property
    def total(self) -> tuple[float, float, float, float]:
        wall, own, backend, read_mb = zip(*self.seconds.values(), strict=True)
        return sum(wall), sum(own), sum(backend), sum(read_mb)


#: By how many sightings a track has.
Figures = dict[str, Stopwatch]


def merge(conn: Connection, sightings: Sightings) -> Stopwatch:
    """What `pipeline/replay.py` does with a drive that is newer than all others around it, phase by phase, to the commit."""
    watch = Stopwatch(conn.info.backend_pid)
    drive = sightings.drive
    key = hashlib.sha256(f"changeset {drive.drive_id}".encode()).hexdigest()
    changeset_id = uuid5(NAMESPACE_URL, key)
    with watch.phase("lock, commit"):  # noqa: SIM117 -- its own share is what is left after the others
        with no_cycle_search(), map_transaction(conn, MAP_NAME):
            with watch.phase("place the drive"):
                drive_uuid = place_drive(conn, drive, key, map_name=MAP_NAME)
                later = [r for r in affected_drives(conn, [drive_uuid]) if r.drive_uuid != drive_uuid]
                if later or superseded_drives(conn, drive_uuid):
                    raise SystemExit("the drive is not the newest one: this would be a replay")
            with watch.phase("read what stands around"):
                standing, summaries = read_standing_around(conn, drive_uuid), read_doubts_around(conn, drive_uuid)
            evidence = DriveEvidence(
                key=(drive.frame_pairs[0].captured_at_ns, drive.content_sha256, key),
                changeset_id=changeset_id,
                founding_key=f"{MAP_NAME}/{drive.content_sha256}",
                tracks=sightings.tracks,
                path_m=np.array([pair.pose.map_t_body_m[:2] for pair in drive.frame_pairs]),
                influence_m=60.0,
                check_visibility=sightings.check_visibility,
                params=ReconcileParams(),
            )
            with watch.phase("reconcile"):
                extension = apply_drive(standing, evidence, Decisions(), summaries)
            changeset = Changeset.model_construct(
                changeset_id=changeset_id,
                drive_id=drive.drive_id,
                idempotency_key=key,
                params_sha256="",
                model_sha256="",
                code_version="bench",
                deltas=tuple(extension.deltas),
            )
            with watch.phase("write"):
                commit_changeset(
                    conn,
                    DriveRecords(drive, positions=sightings.positions, tracks=sightings.tracks),
                    changeset,
                    map_name=MAP_NAME,
                    suppressed=extension.suppressed,
                )
    rest = np.subtract(watch.seconds["lock, commit"], np.sum(list(watch.seconds.values())[:-1], axis=0))
    watch.seconds["lock, commit"] = tuple(rest.tolist())
    return watch


def look_back(conn: Connection, count: int) -> tuple[np.ndarray, int]:
    """Milliseconds of boxes of 500 m around random cones, 18 hours after the map was founded; and features found in all."""
    rng = np.random.default_rng(3)
    at = datetime.fromtimestamp(FOUNDED_NS / 1e9, UTC) + timedelta(hours=18)
    found, times = 0, []
    for x, y, _ in place_of(rng.integers(0, count, LOOKS)).tolist():
        box = (x - BOX_M / 2, y - BOX_M / 2, x + BOX_M / 2, y + BOX_M / 2)
        start = time.perf_counter()
        found += len(list(read_features_as_of(conn, at, map_name=MAP_NAME, within=box)))
        times.append(1000 * (time.perf_counter() - start))
        conn.rollback()
    return np.array(times), found


def executed_ms(conn: Connection, count: int) -> np.ndarray:
    """The same boxes as the server counts them: planning and execution of the query alone."""
    rng = np.random.default_rng(3)
    at = (datetime.fromtimestamp(FOUNDED_NS / 1e9, UTC) + timedelta(hours=18)).isoformat()
    times = []
    for x, y, _ in place_of(rng.integers(0, count, LOOKS)).tolist():
        box = {"west_m": x - 250, "south_m": y - 250, "east_m": x + 250, "north_m": y + 250, "srid": SRID}
        parameters = box | {"map_name": MAP_NAME, "valid_at": at, "known_at": "infinity", "max_rows": None}
        [plan] = execute(conn, f"explain (analyze, format json) {load_sql('map.features_as_of')}", parameters)
        top = plan["QUERY PLAN"][0]
        times.append(top["Planning Time"] + top["Execution Time"])
    conn.rollback()
    return np.array(times)


def report(title: str, watch: Stopwatch) -> None:
    print(
        f"\n{title}; load {os.getloadavg()[0]:.1f}\n{'phase':28}{'wall s':>9}{'python s':>10}{'server s':>10}{'MB read':>10}"
    )
    for name, seconds in (*watch.seconds.items(), ("all", watch.total)):
        print(f"{name:28}{seconds[0]:9.2f}{seconds[1]:10.2f}{seconds[2]:10.2f}{seconds[3]:10.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[100_000, 1_000_000], help="features, multiples of 100,000"
    )
    parser.add_argument("--sightings", type=int, default=100_000, help="cones that the drive passes")
    parser.add_argument("--no-history", action="store_true", help="one row a feature instead of three")
    parser.add_argument("--audits", action="store_true", help="run all audits on the map after the merge")
    parser.add_argument("--folder", type=Path, help="where the temporary cluster lies")
    parser.add_argument("--home", type=Path, help="home folder of a cluster that is kept, with the maps loaded into it")
    parser.add_argument(
        "--load-only", action="store_true", help="load the maps of --home that are not there yet, and end"
    )
    parser.add_argument(
        "--per-track", type=int, nargs="+", default=[10, 1], help="positions a track: which readings of 'sightings'"
    )
    parser.add_argument(
        "--before-others",
        action="store_true",
        help="let this process and its database session go before other work on the machine (root; Linux with autogroups)",
    )
    parser.add_argument(
        "--clone", action="store_true", help="measure on copies of the maps, which are dropped afterwards"
    )
    parser.add_argument(
        "--cold",
        action="store_true",
        help="nothing in memory: the server starts anew and the system's cache is dropped before each drive and the boxes (root)",
    )
    parser.add_argument(
        "--road", type=int, default=2, help="along which of the map's roads of 10,000 cones the first drive goes"
    )
    parser.add_argument("--reads", action="store_true", help="pages that missed shared buffers, by table and index")
    options = parser.parse_args()
    if options.home is None and (options.load_only or options.clone):
        parser.error("--load-only and --clone need --home")
    home = options.home or Path(tempfile.mkdtemp(prefix="conetl-bench-map-", dir=options.folder))
    try:
        url = cluster_up(home)
        results = {size: bench(home, url, size, options) for size in options.sizes}
        if not options.load_only:
            summary({size: found for size, found in results.items() if found is not None})
    finally:
        if options.home is None:
            cluster_remove(home)
            shutil.rmtree(home)


def summary(results: dict[int, Figures]) -> None:
    """All sizes, and how much longer each takes than the one before it."""
    print("\nprocessor time in s (python + server) and growth from the size before; wall clock in brackets")
    before: Figures | None = None
    for size, found in sorted(results.items()):
        print(f"{size:>12,} features", end="")
        for name, watch in found.items():
            wall, own, server, _ = watch.total
            grown = "" if before is None else f" x {(own + server) / sum(before[name].total[1:3]):.2f}"
            print(f"   {name}: {own + server:.1f}{grown} ({wall:.1f})", end="")
        print()
        before = found
    print(f"load {os.getloadavg()}")


def bench(home: Path, url: str, size: int, options: argparse.Namespace) -> Figures | None:
    """One size of map: loaded unless it is there, and measured."""
    name = f"map_{size}" + ("_now" if options.no_history else "")
    with closing(connect(url)) as conn:
        conn.autocommit = True
        there = execute(conn, "select 1 from pg_database where datname = %(name)s", {"name": name})
        if not there:
            execute(conn, f"create database {name}")
    start = time.perf_counter()
    with closing(connect(_address(url, name))) as conn:
        migrate(conn)
        if not there:
            load_map(conn, size, history=not options.no_history)
    rows = size * (1 if options.no_history else 3)
    loaded = "loaded before" if there else f"loaded in {time.perf_counter() - start:.0f} s"
    print(f"\n=== {size:,} features, {rows:,} version rows, {loaded}; load {os.getloadavg()}", flush=True)
    if options.load_only:
        return None
    with ExitStack() as kept:
        if options.clone:
            name = kept.enter_context(_clone(url, name))
        return measure(home, _address(url, name), size, options)


@contextmanager
def _session(home: Path, address: str, options: argparse.Namespace) -> Iterator[Connection]:
    """A session of the server, which has read nothing yet with --cold."""
    if options.cold:
        cluster_down(home)  # writes its buffers
        os.sync()
        Path("/proc/sys/vm/drop_caches").write_text("3")
        cluster_up(home)
    with closing(connect(address)) as conn:
        if options.before_others:
            for pid in (os.getpid(), conn.info.backend_pid):
                Path(f"/proc/{pid}/autogroup").write_text("-15")
        yield conn


@contextmanager
def _clone(url: str, name: str) -> Iterator[str]:
    """A copy of a database for a while, as cold as the server's cache can make it: its files were just written by the server."""
    with closing(connect(url)) as conn:
        conn.autocommit = True
        execute(conn, f"drop database if exists {name}_clone")
        execute(conn, f"create database {name}_clone template {name} strategy file_copy")
        execute(conn, "checkpoint")
        try:
            yield f"{name}_clone"
        finally:
            execute(conn, f"drop database {name}_clone")


def measure(home: Path, address: str, size: int, options: argparse.Namespace) -> Figures:
    """All that is measured on a loaded map: two readings of 'sightings', boxes, sizes, audits."""
    first = options.road * ROAD_CONES if size >= options.sightings + options.road * ROAD_CONES else 0
    found: Figures = {}
    for days, per_track in enumerate(options.per_track, start=2):
        name = f"{per_track} a track"
        cones = min(options.sightings, size - first) // per_track
        drive = drive_along(first, cones, days=days, seed=days, sightings=per_track)
        with _session(home, address, options) as conn:
            before = page_reads(conn) if options.reads else {}
            found[name] = merge(conn, drive)
            title = f"{len(drive.positions):,} sightings, {name} ({len(drive.tracks):,} tracks), into {size:,} features"
            report(title, found[name])
        if options.reads:
            with closing(connect(address)) as conn:  # a session tells its reads when it ends
                report_reads(before, page_reads(conn))
    with _session(home, address, options) as conn:
        boxes_and_sizes(conn, size, options)
    return found


def boxes_and_sizes(conn: Connection, size: int, options: argparse.Namespace) -> None:
    """Looks back, sizes of indexes, and audits where they are asked for."""
    server = executed_ms(conn, size)  # with --cold the first visit of each box, and the one after it not
    times, in_boxes = look_back(conn, size)
    middle = f"median {np.median(server):.1f} ms, 95 % {np.percentile(server, 95):.1f} ms"
    print(
        f"\n{LOOKS} boxes of 500 m as of a day, {in_boxes} features: server {middle}; "
        f"with reading median {np.median(times):.1f} ms"
    )
    for row in index_sizes(conn, ("feature", "feature_version", "delta")):
        print(
            f"{row['table_name']}: {row['index_name']} {row['bytes'] / size:.0f} bytes a feature (table {row['heap'] / size:.0f})"
        )
    if options.audits:
        start = time.perf_counter()
        for result in run_audits(conn):
            print(f"audit {result.name:24} {'passed' if result.passed else result.rows[:1]} ({result.seconds:.1f} s)")
        print(f"all audits {time.perf_counter() - start:.1f} s")


def page_reads(conn: Connection) -> dict[str, int]:
    """Pages that were not in shared buffers when they were asked for, by table and index, since statistics are kept."""
    rows = execute(
        conn,
        "select relname as name, heap_blks_read as pages from pg_statio_user_tables where schemaname = 'conetl' "
        "union all select indexrelname, idx_blks_read from pg_statio_user_indexes where schemaname = 'conetl'",
    )
    return {row["name"]: row["pages"] for row in rows}


def report_reads(before: dict[str, int], after: dict[str, int]) -> None:
    """What was read in between, most first."""
    grown = {name: pages - before.get(name, 0) for name, pages in after.items()}
    for name, pages in sorted(grown.items(), key=lambda item: -item[1]):
        if pages:
            print(f"{name:28}{pages:9,} pages read")


def _address(url: str, database: str) -> str:
    return url.replace("@/conetl?", f"@/{database}?")


if __name__ == "__main__":
    main()
