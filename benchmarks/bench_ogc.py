"""OGC API Features over a map of a million cones: boxes as of an instant, 20 users at a time, beside a bare `select`.

    .venv/bin/python benchmarks/bench_ogc.py [--features N] [--users 20] [--seconds 20] [--side-m 500] [--limit 1000]
    [--pause-s 1] [--home FOLDER]

The server is `conetl view`'s, a process of its own; users are threads of this one with a connection each. Every user asks for
another box around another cone each time, as of another instant. Two ways: with a pause between two requests of a user, as
people and map programs ask, and without one, which measures throughput. The same rows are then asked of PostgreSQL by
psycopg2, by as many users at a time. Processor time is that of the server (of `select`: of the asking process) and of
PostgreSQL with its children. The private cluster lives in a folder of its own and is removed at the end unless --home names it.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
from synthetic_map import SRID, make_map

from conetl.geometry.geodesy import to_geodetic
from conetl.io.db import connect, execute, migrate
from conetl.io.services.cluster import cluster_remove, cluster_status, cluster_up
from conetl.io.stores.map_store import find_map
from conetl.io.stores.reader_pool import open_reader

MAP = "bench"
INSTANTS = ("2026-03-01T12:00:00Z", "2026-03-02T07:00:00Z", "2026-03-02T12:00:00Z", "2026-03-09T00:00:00Z")
_SELECT = """
select v.* from conetl.map_as_of(%(map)s, %(at)s::timestamptz) v
where v.geom && ST_MakeEnvelope(%(west)s, %(south)s, %(east)s, %(north)s, 32632) order by v.feature_id limit %(limit)s
"""
Ask = Callable[[int], int]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--features", type=int, default=1_000_000)
    parser.add_argument("--users", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--side-m", type=float, default=500)
    parser.add_argument("--limit", type=int, default=1000)
    parser.add_argument("--pause-s", type=float, default=1)
    parser.add_argument("--home", type=Path)
    options = parser.parse_args()
    home = options.home or Path(tempfile.mkdtemp(prefix="conetl-bench-", dir="/tmp"))
    try:
        url = cluster_up(home)
        with closing(connect(url)) as conn:
            migrate(conn)
            if find_map(conn, MAP) is None:
                conn.rollback()
                make_map(conn, MAP, features=options.features, versions=2)
                conn.autocommit = True
                execute(conn, "vacuum analyze")
            conn.rollback()
            places = execute(
                conn, "select ST_X(geom) as x, ST_Y(geom) as y from conetl.feature_version tablesample system (0.05)"
            )
        postgres = cluster_status(home).pid
        assert postgres is not None
        half = options.side_m / 2
        for pause_s in (options.pause_s, 0.0):
            print(f"-- {options.users} users, boxes of {options.side_m:g} m, pause {pause_s:g} s", flush=True)
            with served(url, home) as (port, server):
                report(
                    "OGC API",
                    run(options, pause_s, lambda: ogc_user(port, places, half, options.limit), (server, postgres)),
                )
            report(
                "select",
                run(options, pause_s, lambda: select_user(url, places, half, options.limit), (os.getpid(), postgres)),
            )
    finally:
        if options.home is None:
            cluster_remove(home)
            shutil.rmtree(home, ignore_errors=True)


@contextmanager
def served(url: str, home: Path):  # type: ignore[no-untyped-def]
    """`conetl view` on a free port; yields the port and the process id."""
    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    environment = os.environ | {"CONETL_HOME": str(home), "CONETL_DATABASE_URL": url, "CONETL_MAP_NAME": MAP}
    start = [sys.executable, "-c", "from conetl.cli import main; main()", "view", "--port", str(port)]
    with subprocess.Popen(start, env=environment, stdout=subprocess.DEVNULL) as process:
        try:
            wait_for(port)
            yield port, process.pid
        finally:
            process.terminate()


def wait_for(port: int) -> None:
    for _ in range(600):
        try:
            socket.create_connection(("127.0.0.1", port), 1).close()
            return
        except OSError:
            time.sleep(0.1)
    raise SystemExit("the server did not start within a minute")


def ogc_user(port: int, places: list[dict[str, float]], half_m: float, limit: int) -> Ask:
    """Asks for a box of items over a connection that stays open; the number of items."""
    conn = http.client.HTTPConnection("127.0.0.1", port)

    def ask(number: int) -> int:
        place, at = choose(number, places)
        corners = np.array(
            [[place["x"] - half_m, place["y"] - half_m, 0.0], [place["x"] + half_m, place["y"] + half_m, 0.0]]
        )
        (south, west, _), (north, east, _) = to_geodetic(SRID, corners)
        path = f"/ogc/collections/{MAP}.features/items?bbox={west},{south},{east},{north}&at={at}&limit={limit}"
        conn.request("GET", path)
        try:
            answer = conn.getresponse()
        except http.client.RemoteDisconnected:  # the server ended a connection that was quiet for 5 s
            conn.close()
            conn.request("GET", path)
            answer = conn.getresponse()
        body = answer.read()
        if answer.status != 200:
            raise SystemExit(f"{answer.status}: {body[:300]!r}")
        return body.count(b'"type":"Feature"')

    return ask


def select_user(url: str, places: list[dict[str, float]], half_m: float, limit: int) -> Ask:
    """The same box by SQL over a connection of its own."""
    conn = open_reader(url)

    def ask(number: int) -> int:
        place, at = choose(number, places)
        west, south, east, north = place["x"] - half_m, place["y"] - half_m, place["x"] + half_m, place["y"] + half_m
        values = {"map": MAP, "at": at, "limit": limit, "west": west, "south": south, "east": east, "north": north}
        rows = execute(conn, _SELECT, values)
        conn.rollback()
        return len(rows)

    return ask


def choose(number: int, places: list[dict[str, float]]) -> tuple[dict[str, float], str]:
    dice = random.Random(number)
    return dice.choice(places), dice.choice(INSTANTS)


def run(
    options: argparse.Namespace, pause_s: float, make: Callable[[], Ask], processes: tuple[int, int]
) -> dict[str, float]:
    """All users for so long; times of requests in ms, after one request of each to warm up."""
    times: list[float] = []
    rows: list[int] = []
    askers = [make() for _ in range(options.users)]
    for number, ask in enumerate(askers):
        ask(10**9 + number)
    before = processor_s(processes)
    end = time.perf_counter() + options.seconds

    def use(user: int) -> None:
        number = 0
        time.sleep(pause_s * random.Random(user).random())
        while time.perf_counter() < end:
            start = time.perf_counter()
            found = askers[user](user * 1_000_000 + number)
            times.append((time.perf_counter() - start) * 1000)
            rows.append(found)
            number += 1
            time.sleep(pause_s)

    threads = [threading.Thread(target=use, args=(user,)) for user in range(options.users)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    after = processor_s(processes)
    return {
        "requests": len(times),
        "per_s": round(len(times) / options.seconds, 1),
        "items_median": float(np.median(rows)),
        "p50_ms": round(float(np.percentile(times, 50)), 1),
        "p95_ms": round(float(np.percentile(times, 95)), 1),
        "p99_ms": round(float(np.percentile(times, 99)), 1),
        "server_ms_per_request": round(1000 * (after[0] - before[0]) / len(times), 2),
        "postgres_ms_per_request": round(1000 * (after[1] - before[1]) / len(times), 2),
        "load": round(os.getloadavg()[0], 1),
    }


def report(name: str, figures: dict[str, float]) -> None:
    print(f"{name:8}", json.dumps(figures), flush=True)


def processor_s(processes: tuple[int, int]) -> tuple[float, float]:
    """Processor time of one process alone, and of another one with its children, living and dead (proc(5), fields 14 to 17)."""
    server, postgres = processes
    family = [postgres, *(int(p) for p in Path(f"/proc/{postgres}/task/{postgres}/children").read_text().split())]
    return sum(_ticks(server)[:2]) / _HERTZ, (
        sum(sum(_ticks(p)[:2]) for p in family) + sum(_ticks(postgres)[2:])
    ) / _HERTZ


def _ticks(pid: int) -> list[int]:
    try:
        return [int(text) for text in Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[11:15]]
    except FileNotFoundError:
        return [0, 0, 0, 0]


_HERTZ = os.sysconf("SC_CLK_TCK")

if __name__ == "__main__":
    main()
