"""A fleet on one map: commits per second of one and of eight writers, waiting for locks, and a month of 200 vehicles.

Boxes are drawn from what was measured of the shipped detector (`tests/synthetic/changing_road.py`); matching, positions, tracks,
the merge and PostGIS are the real ones, in a private cluster with fsync on. A drive is one street of a town with work zones of
about ten cones, which change every night. Towns are 20 km apart.

Writers: each commits drives that were computed before, in a process and session of its own: one, then several in one town, then
each in a town of its own. Waiting is sampled from pg_stat_activity. Pairs: random short drives around a border of two regions,
merged two at a time.

The month, at scale 1:N: 1/N of the vehicles in 1/N of the towns, so that every street is driven as often as by the whole fleet.
Drives arrive in the order of their recording, except for a share that arrives a day late. The first days are played again beside
the last ones, on a map of their own, drive by drive in turn: the speed of a machine that others use changes within minutes.

    python benchmarks/bench_fleet.py [--writers 8] [--drives 6] [--days 30] [--scale 100] [--zones 4] [--late 0.05] [--only month]
"""

from __future__ import annotations

import hashlib
import logging
import multiprocessing
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Any

import numpy as np
import psutil

from benchmarks.bench_kills import EMPTY
from benchmarks.harness import arguments_of, evidence_of_model, load, own_cluster, print_rows, write_json
from benchmarks.made_up_maps import DAY_NS
from conetl.db.connection import Connection, connect, execute
from conetl.db.map.map_store import find_map, read_features_as_of
from conetl.db.retention import archive_drive, prunable_drives
from conetl.db.schema import run_audits
from conetl.model.detector_evidence import AbsenceFigures
from conetl.model.drive import Drive, FramePair
from conetl.model.errors import DatabaseError
from conetl.model.params import IngestParams
from tests.integration.drives_of_days import Survey, merge
from tests.integration.test_side_by_side import BORDER_M, at_once, drive_at
from tests.synthetic.changing_road import FRAMES, HOUR_NS, RIG, Boxes, Road, change, drive_boxes, random_road
from tests.synthetic.world import ORIGIN_M, START_NS, fuse_logged, locate, make_path, shifted

MAP_NAME, YOUNG_MAP = "fleet", "young"
COMPARED_DAYS = 4
"""First and last days of the month, or a quarter of it: of these, all but the first are compared."""
VEHICLES, DRIVES_A_DAY = 200, 4
"""Of the whole fleet, and of each vehicle."""
STREETS_A_TOWN = 2
ZONES, ZONE_STEP_M, STREET_STEP_M, TOWN_STEP_M = 4, 300.0, 500.0, 20_000.0
SAMPLE_S = 0.02


@dataclass(frozen=True)
class Trip:
    """One drive along one street."""

    town: int
    street: int
    day: int
    number: int
    """Of the drives of that day on that street."""
    zones: int = ZONES
    """Of its work zones, from the start of the street."""


@cache
def zone_on(town: int, street: int, zone: int, day: int) -> Road:
    """The cones of a work zone on a day."""
    rng = np.random.default_rng((town, street, zone, day))
    if day == 0:
        return random_road(rng)
    before = zone_on(town, street, zone, day - 1)
    road = Road(dict(before.places), dict(before.heights), dict(before.places), before.next_number)
    change(road, rng)
    return road


def survey_of_trip(trip: Trip) -> Survey:
    """The records of a drive."""
    rng = np.random.default_rng((7, trip.town, trip.street, trip.day, trip.number))
    params = IngestParams()
    figures = AbsenceFigures(evidence=evidence_of_model(), score_threshold=params.detection.score_threshold)
    start_ns = START_NS + trip.day * DAY_NS + trip.number * HOUR_NS
    gnss_m = np.array([*rng.normal(0, 0.2, 2), 0.0])
    logged: list[FramePair] = []
    boxes: Boxes = {}
    for zone in range(trip.zones):
        first = zone * FRAMES
        pairs = [
            pair.model_copy(
                update={"frame_index": first + k, "captured_at_ns": pair.captured_at_ns + zone * 40_000_000_000}
            )
            for k, pair in enumerate(make_path(FRAMES, first_ns=start_ns, sigma_m=0.3))
        ]
        cones = zone_on(trip.town, trip.street, zone, trip.day).cones()
        boxes |= drive_boxes(cones, pairs, figures, rng)
        there_m = (trip.town * TOWN_STEP_M + zone * ZONE_STEP_M, trip.street * STREET_STEP_M, 0.0)
        logged += [shifted(pair, (gnss_m + there_m).tolist()) for pair in pairs]
    found, matches, positions = locate(boxes, logged, RIG)
    tracks, _ = fuse_logged(logged, RIG, found, matches, positions, params=params, evidence=evidence_of_model())
    name = f"{trip.town}_{trip.street}_{trip.day}_{trip.number}"
    drive = Drive(
        drive_id=name, source_path=name, rig=RIG, map_srid=32632, content_sha256=hashlib.sha256(name.encode()).hexdigest(),
        frame_pairs=tuple(logged), expected_frame_count=len(logged),
    )  # fmt: skip
    return Survey(drive, found, matches, positions, tracks)


@dataclass(frozen=True)
class Commit:
    """One merge: when it began and ended (s), processor time of Python and of the server, numbers of its records."""

    began_s: float
    ended_s: float
    python_s: float
    server_s: float
    tracks: int
    sightings: int
    replayed: int
    """Later drives that were compared again."""

    @property
    def wall_s(self) -> float:
        return self.ended_s - self.began_s

    @property
    def processor_s(self) -> float:
        return self.python_s + self.server_s


def commit(conn: Connection, survey: Survey, map_name: str = MAP_NAME) -> Commit:
    began_s, python_s, server_s = time.monotonic(), time.thread_time(), server_time_s(conn)
    merged = merge(conn, survey, map_name=map_name, evidence=evidence_of_model())
    if merged is None:
        raise SystemExit(f"drive {survey.drive.drive_id} was already on the map")
    python_s, server_s = time.thread_time() - python_s, server_time_s(conn) - server_s
    counts = len(survey.tracks), len(survey.positions)
    return Commit(began_s, time.monotonic(), python_s, server_s, *counts, merged.replayed)


def server_time_s(conn: Connection) -> float:
    """Processor time of a connection's server process so far, to the nanosecond (Linux)."""
    return int(Path(f"/proc/{conn.info.backend_pid}/schedstat").read_text().split()[0]) / 1e9


def write(url: str, trips: Sequence[Trip], ready: Any) -> list[Commit]:
    """One writer: computes its drives, waits for the others, and commits."""
    surveys = [survey_of_trip(trip) for trip in trips]
    with closing(connect(url)) as conn:
        ready.wait()
        return [commit(conn, survey) for survey in surveys]


class Waiting:
    """Seconds that sessions spent waiting for advisory locks, sampled."""

    def __init__(self, url: str) -> None:
        self.waiting_s = 0.0
        self._url, self._stop = url, Event()
        self._thread = Thread(target=self._sample, daemon=True)

    def __enter__(self) -> Waiting:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _sample(self) -> None:
        with closing(connect(self._url)) as conn:
            conn.autocommit = True
            before = time.monotonic()
            while not self._stop.wait(SAMPLE_S):
                waits = "select count(*) as n from pg_stat_activity where wait_event_type = 'Lock'"
                sessions = execute(conn, waits)[0]["n"]
                now = time.monotonic()
                self.waiting_s += sessions * (now - before)
                before = now


def writers(url: str, rounds: Sequence[tuple[str, Sequence[Sequence[Trip]]]]) -> list[dict[str, object]]:
    """Commits per second of each round; a round has one list of drives for each writer.

    The limit of the machine: so many commits per second would keep all cores busy, at the processor time of this round's commits.
    """
    rows: list[dict[str, object]] = []
    fork = multiprocessing.get_context("fork")
    for name, jobs in rounds:
        with fork.Manager() as manager, ProcessPoolExecutor(len(jobs), fork) as pool, Waiting(url) as waiting:
            ready = manager.Barrier(len(jobs))
            found = [job.result() for job in [pool.submit(write, url, trips, ready) for trips in jobs]]
        commits = [one for some in found for one in some]
        wall_s = max(one.ended_s for one in commits) - min(one.began_s for one in commits)
        per_s, limit_per_s = len(commits) / wall_s, psutil.cpu_count() / np.mean([one.processor_s for one in commits])
        rows.append(
            {
                "writers": name,
                "commits": len(commits),
                "tracks a drive": np.mean([one.tracks for one in commits]),
                "commits/s": per_s,
                "limit": limit_per_s,
                "share of it": per_s / limit_per_s,
                "s a commit": np.mean([one.wall_s for one in commits]),
                "Python s": np.mean([one.python_s for one in commits]),
                "server s": np.mean([one.server_s for one in commits]),
                "waiting s": waiting.waiting_s / len(commits),
                "load": load(),
            }
        )
    return rows


def in_words(rows: Sequence[Mapping[str, Any]], cores: int) -> str:
    """How much faster the last round was than the first, a single writer, and how much faster it could be on this machine."""
    one, several = rows[0], rows[-1]
    return (
        f"{several['writers']}: {several['commits/s'] / one['commits/s']:.1f} times the commits of one writer, which keeps "
        f"{one['share of it']:.2f} of the {cores} cores busy by itself: {1 / one['share of it']:.1f} times is the limit here. "
        f"The {several['writers']} reached {several['share of it']:.2f} of theirs."
    )


def pairs(url: str, count: int) -> dict[str, object]:
    """Random pairs of short drives on both sides of a border of regions, each pair merged at once; ten pairs on one map."""
    rng = np.random.default_rng(3)
    outcome: Counter[str] = Counter()
    with closing(connect(url)) as conn:
        for number in range(count):
            if number % 10 == 0:
                execute(conn, EMPTY)
                conn.commit()
            steps, hours = rng.integers(-8, 9, 2).tolist(), rng.integers(0, 41, 2).tolist()
            drives = [
                drive_at(float(round(BORDER_M) + 60 * step), hour) for step, hour in zip(steps, hours, strict=True)
            ]
            try:
                outcome["merged"] += at_once(url, drives)
            except DatabaseError as error:
                outcome["deadlocks" if "deadlock" in str(error) else f"{error}"] += 1
            if number % 10 == 9:
                outcome["audits failed"] += sum(not audit.passed for audit in run_audits(conn))
                conn.rollback()
            if number % 100 == 99:
                print(f"{number + 1} pairs: {dict(outcome)}, load {load()}", flush=True)
    return {"pairs": count, "deadlocks": 0, **outcome, "load": load()}


@contextmanager
def settled(conn: Connection) -> Iterator[None]:
    """Autocommit, for vacuum and statistics."""
    conn.rollback()
    conn.autocommit = True
    try:
        yield
    finally:
        conn.autocommit = False


def sizes(conn: Connection) -> dict[str, int]:
    """Bytes of each table with its indexes."""
    rows = execute(
        conn,
        "select relname as name, pg_total_relation_size(oid) as bytes from pg_class "
        "where relnamespace = 'conetl'::regnamespace and relkind = 'r'",
    )
    conn.rollback()
    return {row["name"]: row["bytes"] for row in rows}


def trips_of_month(days: int, scale: int, late: float, zones: int) -> list[list[Trip]]:
    """The drives of each day in the order in which they arrive."""
    rng = np.random.default_rng(11)
    streets = max(1, VEHICLES // scale) * STREETS_A_TOWN
    a_street = VEHICLES * DRIVES_A_DAY // scale // streets
    arriving: list[list[Trip]] = [[] for _ in range(days + 1)]
    for day in range(days):
        for number in range(a_street):
            for street in range(streets):
                delay = int(rng.random() < late)
                where = 100 + street // STREETS_A_TOWN, street % STREETS_A_TOWN
                arriving[day + delay].append(Trip(*where, day, number, zones))
    arriving[days - 1] += arriving.pop()
    return arriving


def month(url: str, days: int, scale: int, late: float, zones: int) -> dict[str, object]:
    """Play the month, and measure the map at its end."""
    arriving, compared_days = trips_of_month(days, scale, late, zones), min(COMPARED_DAYS, days // 4)
    begun = datetime.now(UTC)
    grown: list[int] = []
    by_day: list[list[Commit]] = []
    with closing(connect(url)) as conn, ProcessPoolExecutor(1) as ahead:
        surveys = ahead.map(survey_of_trip, [trip for trips in arriving for trip in trips], chunksize=4)
        again = ahead.map(survey_of_trip, [trip for trips in arriving[:compared_days] for trip in trips], chunksize=4)
        young: list[Commit] = []
        for day, trips in enumerate(arriving):
            by_day.append([])
            for _ in trips:
                by_day[-1].append(commit(conn, next(surveys)))
                if day >= days - compared_days and (survey := next(again, None)) is not None:
                    young.append(commit(conn, survey, YOUNG_MAP))
            grown.append(sum(sizes(conn).values()))
            if day % 5 == 4:
                wall_s, processor_s = np.median([(one.wall_s, one.processor_s) for one in by_day[-1]], axis=0)
                print(f"day {day + 1}: commit {wall_s:.2f} s, processor {processor_s:.3f} s, load {load()}", flush=True)
        replays = [one for commits in by_day for one in commits if one.replayed]
        commits = [*(one for some in by_day for one in some), *young]
        sightings = sum(one.sightings for one in commits)
        bytes_of = sizes(conn)
        with settled(conn):
            start = time.perf_counter()
            execute(conn, "vacuum analyze")
            vacuum_s = time.perf_counter() - start
        print_rows(
            "Bytes per sighting, with indexes",
            [
                {"table": name, "bytes": size / sightings}
                for name, size in sorted(bytes_of.items(), key=lambda x: -x[1])
                if size > sightings
            ],
        )
        as_of = {
            "now": time_ms(conn, None, None),
            "on the road half a month ago": time_ms(
                conn, datetime.fromtimestamp((START_NS + days // 2 * DAY_NS) / 1e9, UTC), None
            ),
            "in the database at half": time_ms(conn, None, begun + (datetime.now(UTC) - begun) / 2),
        }
        failed = [audit.name for audit in run_audits(conn) if not audit.passed]
        with TemporaryDirectory(prefix="conetl-bench-") as folder:
            drives = prunable_drives(conn, datetime.now(UTC) + timedelta(days=1))
            start = time.perf_counter()
            file_bytes = sum(archive_drive(conn, drive, Path(folder)) for drive in drives)
            archive_s = time.perf_counter() - start
            with settled(conn):
                execute(conn, "vacuum full conetl.detection, conetl.stereo_match, conetl.position")
            archived_bytes = sum(sizes(conn).values())
            came_back = commit(
                conn, survey_of_trip(Trip(100, 0, 0, 9, zones))
            )  # the archived drives of its street come back
            failed += [f"{audit.name} (archived)" for audit in run_audits(conn) if not audit.passed]
    # The first day of the young map finds nothing there.
    old = [one for day in by_day[-compared_days:] for one in day]
    compared = zip(young, old, strict=False)
    first, last = np.median(
        [
            [(one.processor_s, one.wall_s) for one in pair] for pair in list(compared)[len(by_day[0]) :]
            if not (pair[0].replayed or pair[1].replayed)
        ], axis=0,
    )  # fmt: skip
    return {
        "drives": len(commits),
        "sightings": sightings,
        f"ms of processor a commit, days 2 to {compared_days}, played beside the last": 1000 * first[0],
        f"ms of processor a commit, last {compared_days - 1} days": 1000 * last[0],
        "last / first": last[0] / first[0],
        f"ms a commit, days 2 to {compared_days}, played beside the last": 1000 * first[1],
        f"ms a commit, last {compared_days - 1} days": 1000 * last[1],
        "late drives": len(replays),
        "drives compared again for one": np.mean([one.replayed for one in replays]) if replays else 0,
        "ms of processor a late commit": 1000 * np.median([one.processor_s for one in replays]) if replays else 0,
        "MB a day, first half": (grown[days // 2] - grown[0]) / (days // 2) / 1e6,
        "MB a day, second half": (grown[-1 - compared_days] - grown[days // 2])
        / (days - 1 - compared_days - days // 2)
        / 1e6,
        "vacuum s": vacuum_s,
        "bytes a sighting": sum(bytes_of.values()) / sightings,
        "bytes a sighting, archived: tables": archived_bytes / sightings,
        "bytes a sighting, archived: files": file_bytes / sightings,
        "s to archive": archive_s,
        "archived drives that the oldest late drive brought back": came_back.replayed,
        "s of processor for it": came_back.processor_s,
        **{f"ms of the map {name}": ms for name, ms in as_of.items()},
        "audits failed": ", ".join(failed) or "none",
        "load": load(),
    }


def time_ms(conn: Connection, valid_at: datetime | None, known_at: datetime | None) -> float:
    """Median of five readings of one town."""
    info = find_map(conn, MAP_NAME)
    assert info is not None
    west_m, south_m = float(ORIGIN_M[0] + 100 * TOWN_STEP_M - 100), float(ORIGIN_M[1] - 100)
    box = (west_m, south_m, west_m + ZONES * ZONE_STEP_M, south_m + 200)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        list(read_features_as_of(conn, valid_at, known_at=known_at, map_name=MAP_NAME, within=box))
        times.append(1000 * (time.perf_counter() - start))
        conn.rollback()
    return float(np.median(times))


def main() -> None:
    parser = arguments_of(__doc__)
    add = parser.add_argument
    add("--writers", type=int, default=8)
    add("--drives", type=int, default=6, help="that each writer commits")
    add("--days", type=int, default=30, help="of the month, at least 8")
    add("--scale", type=int, default=100, help="1:N of the fleet and its towns")
    add("--zones", type=int, default=ZONES, help="work zones of a street")
    add("--late", type=float, default=0.05, help="share of drives that arrive a day late")
    add("--pairs", type=int, default=1000, help="random pairs of drives that are merged at once")
    add("--only", choices=["writers", "pairs", "month"])
    options = parser.parse_args()
    if options.days < 8:
        parser.error(f"--days {options.days}: expected 8 or more")
    n, drives, zones = options.writers, options.drives, options.zones
    logging.getLogger("conetl").setLevel(logging.ERROR)  # no warnings about sessions that wait
    figures: dict[str, object] = {}
    print(f"{psutil.cpu_count()} cores, load {load()}", flush=True)
    with own_cluster() as (_, url):
        if options.only in (None, "pairs"):
            figures["pairs"] = found = pairs(url, options.pairs)
            print_rows("Random pairs at once", [found])
            with closing(connect(url)) as conn:
                execute(conn, EMPTY)
                conn.commit()
        if options.only in (None, "writers"):
            # In every round each drive is the newest of its street; the same town is used once.
            one = [Trip(0, 0, day, 0, zones) for day in range(n * drives)]
            rounds = [
                ("1", [one[: 2 * drives]]),
                (f"{n} in one town", [[Trip(1, k, 0, d, zones) for d in range(drives)] for k in range(n)]),
                (f"{n} in {n} towns", [[Trip(2 + k, 0, 0, d, zones) for d in range(drives)] for k in range(n)]),
            ]
            figures["writers"] = rows = writers(url, rounds)
            print_rows("Writers; limit: commits/s that would keep all cores busy", rows)
            print(in_words(rows, psutil.cpu_count()))
        if options.only in (None, "month"):
            figures["month"] = played = month(url, options.days, options.scale, options.late, zones)
            print_rows(
                f"{options.days} days of {VEHICLES} vehicles at 1:{options.scale}, {100 * options.late:g} % late",
                [{"figure": name, "value": value} for name, value in played.items()],
            )
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
