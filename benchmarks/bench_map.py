"""Time to merge one drive into maps of 100 thousand, 1 million and 10 million features, and of queries of the past.

"100,000 sightings" is measured in both meanings: 100,000 positions, about ten per track (a drive past 10,000 cones), and 100,000
tracks of one position each (a drive past 100,000 cones, 500 km of road works in one drive).

A private cluster with fsync on, as `conetl db up` makes it, is in a temporary folder that is removed at the end. For each size
the map is loaded (`made_up_maps.load_roads`), a drive with its tracks in memory is merged, and boxes of 500 m at an instant of
the past are queried. Processor time is that of this process and of the database's backend.

    python benchmarks/bench_map.py [--sizes 100000 1000000] [--sightings 100000] [--audits] [--no-history] [--folder /tmp]
    python benchmarks/bench_map.py --home /tmp/maps --load-only      # keeps the loaded maps ...
    python benchmarks/bench_map.py --home /tmp/maps [--clone]        # ... and measures on them, or on copies of them

10 million features need about 10 GB without history (one row each), 22 GB with it, and half an hour.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from uuid import NAMESPACE_URL, uuid5

import numpy as np

from benchmarks.harness import Stopwatch, arguments_of, load, own_cluster, print_rows, write_json
from benchmarks.made_up_maps import (
    FOUNDED_NS,
    MAP_NAME,
    ROAD_CONES,
    SRID,
    SyntheticDrive,
    drive_along,
    load_roads,
    position_of,
)
from conetl.checks.verdict import judge
from conetl.db.cluster.cluster import cluster_down, cluster_up
from conetl.db.connection import Connection, connect, execute, load_sql
from conetl.db.map.commit import INFLUENCE_M, add_drive, commit_changeset, path_wkt
from conetl.db.map.map_store import drive_transaction, read_features_as_of
from conetl.db.map.replay_store import Neighbourhood, lock_neighbourhood, read_standing_around
from conetl.db.schema import migrate, run_audits
from conetl.mapping.history import DriveEvidence, apply_drive
from conetl.model.drive import DriveRecords
from conetl.model.map_records import Changeset, Decisions
from conetl.model.params import ReconcileParams
from conetl.pipeline.replay import gc_paused, replay_of_newest

QUERIES = 60
BOX_M = 500.0
#: Instant of the queries: 18 hours after the map was founded.
AS_OF = datetime.fromtimestamp(FOUNDED_NS / 1e9, UTC) + timedelta(hours=18)


#: By number of positions per track.
Figures = dict[str, Stopwatch]


def merge(conn: Connection, sightings: SyntheticDrive) -> Stopwatch:
    """The steps of `pipeline/replay.py` for a drive that is newer than all others around it, phase by phase, with the commit."""
    watch = Stopwatch(conn.info.backend_pid)
    drive = sightings.drive
    key = hashlib.sha256(f"changeset {drive.drive_id}".encode()).hexdigest()
    changeset_id = uuid5(NAMESPACE_URL, key)
    with watch.phase("lock, commit"):  # noqa: SIM117 -- its own share is the rest
        with gc_paused(), drive_transaction(conn, MAP_NAME):
            with watch.phase("place the drive"):
                place = partial(add_drive, conn, drive, key, map_name=MAP_NAME)
                near = lock_neighbourhood(
                    conn, MAP_NAME, drive, key, place, path_wkt=path_wkt(drive), influence_m=INFLUENCE_M
                )
                if not isinstance(near, Neighbourhood) or near.affected:
                    raise SystemExit("the drive is not the newest one: this would be a replay")
            with watch.phase("read the surroundings"):
                standing = read_standing_around(conn, near.drive_uuid)
            evidence = DriveEvidence(
                key=(drive.frame_pairs[0].captured_at_ns, drive.content_sha256, key),
                changeset_id=changeset_id,
                founding_key=f"{MAP_NAME}/{drive.content_sha256}",
                tracks=sightings.tracks,
                path_m=np.array([pair.pose.map_t_body_m[:2] for pair in drive.frame_pairs]),
                influence_m=INFLUENCE_M,
                check_visibility=sightings.check_visibility,
                params=ReconcileParams(),
                judge=judge,
            )
            with watch.phase("reconcile"):
                current = {feature_id: next(reversed(rows)) for feature_id, rows in standing.items()}
                extension = apply_drive(current, evidence, Decisions())
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
                    replay=replay_of_newest(standing, extension, changeset_id),
                    drive_uuid=near.drive_uuid,
                )
    rest = np.subtract(watch.phases["lock, commit"], np.sum(list(watch.phases.values())[:-1], axis=0))
    watch.phases["lock, commit"] = tuple(rest.tolist())
    return watch


def boxes(count: int) -> Iterator[tuple[float, float, float, float]]:
    """West, south, east, north of boxes of 500 m around random cones."""
    for x, y, _ in position_of(np.random.default_rng(3).integers(0, count, QUERIES)).tolist():
        yield x - BOX_M / 2, y - BOX_M / 2, x + BOX_M / 2, y + BOX_M / 2


def query_ms(conn: Connection, count: int) -> tuple[list[float], int]:
    """Milliseconds per box, with reading; and the number of features."""
    found, times = 0, []
    for box in boxes(count):
        start = time.perf_counter()
        found += len(list(read_features_as_of(conn, AS_OF, map_name=MAP_NAME, within=box)))
        times.append(1000 * (time.perf_counter() - start))
        conn.rollback()
    return times, found


def server_ms(conn: Connection, count: int) -> list[float]:
    """Milliseconds per box by the server: only planning and execution."""
    times = []
    for box in boxes(count):
        parameters: dict[str, object] = dict(zip(("west_m", "south_m", "east_m", "north_m"), box, strict=True))
        parameters |= {
            "srid": SRID,
            "map_name": MAP_NAME,
            "valid_at": AS_OF.isoformat(),
            "known_at": "infinity",
            "max_rows": None,
            "lines": False,
        }
        [plan] = execute(conn, f"explain (analyze, format json) {load_sql('map.features_as_of')}", parameters)
        top = plan["QUERY PLAN"][0]
        times.append(top["Planning Time"] + top["Execution Time"])
    conn.rollback()
    return times


def main() -> None:
    parser = arguments_of(__doc__)
    add, flag = parser.add_argument, "store_true"
    add("--sizes", type=int, nargs="+", default=[100_000, 1_000_000], help="features")
    add("--sightings", type=int, default=100_000, help="cones that the drive passes")
    add("--no-history", action=flag, help="one row per feature instead of three")
    add("--audits", action=flag, help="run all audits on the map after the merge")
    add("--folder", type=Path, help="folder of the temporary cluster")
    add("--home", type=Path, help="home folder of a cluster that is kept, with the maps loaded into it")
    add("--load-only", action=flag, help="only load the missing maps of --home")
    add("--per-track", type=int, nargs="+", default=[10, 1], help="positions per track")
    add(
        "--before-others",
        action=flag,
        help="raise the priority of this process and its session (root; Linux autogroups)",
    )
    add("--clone", action=flag, help="measure on copies of the maps, which are dropped afterwards")
    add(
        "--cold",
        action=flag,
        help="restart the server and drop the system's cache before each drive and the boxes (root)",
    )
    add("--road", type=int, default=2, help="number of the map's road of 10,000 cones where the first drive starts")
    add("--reads", action=flag, help="pages that missed shared buffers, by table and index")
    options = parser.parse_args()
    if options.home is None and (options.load_only or options.clone):
        parser.error("--load-only and --clone require --home")
    with own_cluster(options.home, folder=options.folder) as (home, url):
        results = {size: bench(home, url, size, options) for size in options.sizes}
    rows: list[dict[str, object]] = []
    before: dict[str, float] = {}
    for size, found in sorted(results.items()):
        for name, watch in (found or {}).items():
            wall_s, own_s, server_s, _ = watch.total
            used_s = own_s + server_s
            growth = used_s / before[name] if name in before else None
            rows.append(
                {"features": size, "sightings": name, "processor s": used_s, "growth": growth, "wall s": wall_s}
            )
            before[name] = used_s
    if rows:
        print_rows(f"Merge of one drive; processor time of Python and server; load {load()}", rows)
    write_json(options.json, rows)


def bench(home: Path, url: str, size: int, options: argparse.Namespace) -> Figures | None:
    """Load one size of map where it is missing, and measure."""
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
            load_roads(conn, size, history=not options.no_history)
    rows = size * (1 if options.no_history else 3)
    loaded = "loaded before" if there else f"loaded in {time.perf_counter() - start:.0f} s"
    print(f"\n=== {size:,} features, {rows:,} version rows, {loaded}; load {load()}", flush=True)
    if options.load_only:
        return None
    with ExitStack() as kept:
        if options.clone:
            name = kept.enter_context(_clone(url, name))
        return measure(home, _address(url, name), size, options)


@contextmanager
def _session(home: Path, address: str, options: argparse.Namespace) -> Iterator[Connection]:
    """A session of the server, with empty caches for --cold."""
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
    """A temporary copy of a database."""
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
    """Merges, boxes, sizes and audits of a loaded map."""
    first = options.road * ROAD_CONES if size >= options.sightings + options.road * ROAD_CONES else 0
    found: Figures = {}
    for days, per_track in enumerate(options.per_track, start=2):
        name = f"{per_track} per track"
        cones = min(options.sightings, size - first) // per_track
        drive = drive_along(first, cones, days=days, seed=days, sightings=per_track)
        with _session(home, address, options) as conn:
            before = page_reads(conn) if options.reads else {}
            found[name] = watch = merge(conn, drive)
            columns = ("wall s", "python s", "server s", "MB read")
            print_rows(
                f"\n{len(drive.positions):,} sightings, {name} ({len(drive.tracks):,} tracks), into {size:,} features",
                [
                    {"phase": n, **dict(zip(columns, s, strict=True))}
                    for n, s in (*watch.phases.items(), ("all", watch.total))
                ],
            )
        if options.reads:
            with closing(connect(address)) as conn:  # statistics of a session are complete when it ends
                after = page_reads(conn)
            grown = {relation: pages - before.get(relation, 0) for relation, pages in after.items()}
            print_rows(
                "Pages read", [{"relation": r, "pages": n} for r, n in sorted(grown.items(), key=lambda x: -x[1]) if n]
            )
    with _session(home, address, options) as conn:
        boxes_and_sizes(conn, size, options)
    return found


def boxes_and_sizes(conn: Connection, size: int, options: argparse.Namespace) -> None:
    """Queries of the past, sizes of indexes, and with --audits the audits."""
    server = server_ms(conn, size)  # with --cold the first visit of each box
    times, in_boxes = query_ms(conn, size)
    middle = f"median {np.median(server):.1f} ms, 95 % {np.percentile(server, 95):.1f} ms"
    print(
        f"\n{QUERIES} boxes of 500 m, {in_boxes} features: server {middle}; with reading median {np.median(times):.1f} ms"
    )
    sizes = execute(
        conn,
        "select c.relname as table, i.relname as index, pg_relation_size(i.oid) / %(n)s as index_bytes, "
        "pg_table_size(c.oid) / %(n)s as table_bytes "
        "from pg_class c join pg_index x on x.indrelid = c.oid join pg_class i on i.oid = x.indexrelid "
        "where c.relnamespace = 'conetl'::regnamespace and c.relname in ('feature', 'feature_version', 'delta') "
        "order by 1, 3 desc",
        {"n": size},
    )
    print_rows("Bytes per feature", sizes)
    if options.audits:
        audits = [
            {"audit": a.name, "result": "passed" if a.passed else a.rows[:1], "s": a.seconds} for a in run_audits(conn)
        ]
        print_rows("", audits)


def page_reads(conn: Connection) -> dict[str, int]:
    """Pages read outside of shared buffers, by table and index."""
    rows = execute(
        conn,
        "select relname as name, heap_blks_read as pages from pg_statio_user_tables where schemaname = 'conetl' "
        "union all select indexrelname, idx_blks_read from pg_statio_user_indexes where schemaname = 'conetl'",
    )
    return {row["name"]: row["pages"] for row in rows}


def _address(url: str, database: str) -> str:
    return url.replace("@/conetl?", f"@/{database}?")


if __name__ == "__main__":
    main()
