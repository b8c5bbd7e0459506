"""OGC API Features over a map of a million cones: boxes as of an instant, 20 users at a time, beside a bare `select`.

    .venv/bin/python benchmarks/bench_ogc.py [--features N] [--users 20] [--seconds 20] [--side-m 500] [--limit 1000]
    [--pause-s 1] [--steady] [--home FOLDER]

The server is `conetl view`'s, a process of its own; users are threads of this one with a connection each. Every user asks for
another box around another cone each time, as of another instant. Two ways: with a pause between two requests of a user, as
people and map programs ask, and without one, which measures throughput. A pause is drawn from an exponential distribution with
the mean --pause-s, and so is the wait before a user's first request (users who know nothing of each other; the thinking time
of load generators); --steady makes all pauses equal. The same rows are then asked of PostgreSQL by psycopg2, by as many users at
a time.

Requests are made before the clock runs and answers only read to their end, because this process has the same processors;
afterwards some answers are asked again, parsed and compared with the rows of the `select`. Processor time is that of the server,
of PostgreSQL with its children and of this process (the users). The private cluster lives in a folder of its own and is removed
at the end unless --home names it.
"""

from __future__ import annotations

import argparse
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
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
from synthetic_map import SRID, make_map

from conetl.db.cluster.cluster import cluster_remove, cluster_status, cluster_up
from conetl.db.connection import Connection, connect, execute
from conetl.db.map.map_store import find_map
from conetl.db.reader_pool import open_reader
from conetl.db.schema import migrate
from conetl.geometry.geodesy import to_geodetic

MAP = "bench"
INSTANTS = ("2026-03-01T12:00:00Z", "2026-03-02T07:00:00Z", "2026-03-02T12:00:00Z", "2026-03-09T00:00:00Z")
_SELECT = """
select v.* from conetl.map_as_of(%(map)s, %(at)s::timestamptz) v
where v.geom && ST_MakeEnvelope(%(west)s, %(south)s, %(east)s, %(north)s, 32632) order by v.feature_id limit %(limit)s
"""
#: The same cones by their longitudes and latitudes, as a box in degrees means it (its edges are not parallel to those in metres).
_IN_DEGREES = """
select v.feature_id from conetl.map_as_of(%(map)s, %(at)s::timestamptz) v
cross join lateral (select ST_Transform(v.geom, 4326) as place) p
where v.geom && ST_Expand(ST_MakeEnvelope(%(west)s, %(south)s, %(east)s, %(north)s, 32632), %(spare_m)s)
and ST_X(p.place) between %(lon_west)s and %(lon_east)s and ST_Y(p.place) between %(lat_south)s and %(lat_north)s
order by v.feature_id limit %(limit)s
"""
#: Different questions; each user begins elsewhere in the list.
_QUESTIONS = 4000
#: Answers that are compared with the rows of the `select`.
_CHECKED = 20


@dataclass(frozen=True)
class Question:
    """One box as of one instant, for the server and for PostgreSQL."""

    path: str
    values: dict[str, Any]


#: Asks one question and returns when all of the answer has come.
Ask = Callable[[Question], None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--features", type=int, default=1_000_000)
    parser.add_argument("--users", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--side-m", type=float, default=500)
    parser.add_argument("--limit", type=int, default=1000)
    parser.add_argument("--pause-s", type=float, default=1)
    parser.add_argument("--steady", action="store_true", help="all pauses equal, instead of exponentially distributed")
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
            questions = make_questions(conn, options.side_m, options.limit)
        postgres = cluster_status(home).pid
        assert postgres is not None
        with served(url, home) as (port, server):
            for pause_s in (options.pause_s, 0.0):
                print(f"-- {options.users} users, boxes of {options.side_m:g} m, mean pause {pause_s:g} s", flush=True)
                asked = run(options, pause_s, questions, partial(ogc_user, port), (server, postgres))
                report("OGC API", asked)
                asked = run(options, pause_s, questions, partial(select_user, url), (os.getpid(), postgres))
                report("select", asked)
            print(check(port, url, questions[:_CHECKED]), flush=True)
    finally:
        if options.home is None:
            cluster_remove(home)
            shutil.rmtree(home, ignore_errors=True)


def make_questions(conn: Connection, side_m: float, limit: int) -> list[Question]:
    """Boxes around cones from all over the map."""
    rows = execute(
        conn,
        "select ST_X(geom) as x, ST_Y(geom) as y from conetl.feature_version tablesample system (0.05) repeatable (1)",
    )
    dice = random.Random(1)
    places = np.array([(p["x"], p["y"]) for p in dice.choices(rows, k=_QUESTIONS)])
    low, high = places - side_m / 2, places + side_m / 2
    heights = np.zeros((_QUESTIONS, 1))
    south_west, north_east = (to_geodetic(SRID, np.hstack([corner, heights])) for corner in (low, high))
    questions = []
    for k in range(_QUESTIONS):
        at = dice.choice(INSTANTS)
        (south, west, _), (north, east, _) = south_west[k].tolist(), north_east[k].tolist()
        path = f"/ogc/collections/{MAP}.features/items?bbox={west},{south},{east},{north}&at={at}&limit={limit}"
        values = dict(zip(("west", "south", "east", "north"), (*low[k].tolist(), *high[k].tolist()), strict=True))
        values |= {"lon_west": west, "lat_south": south, "lon_east": east, "lat_north": north, "spare_m": 0.1 * side_m}
        questions.append(Question(path, values | {"map": MAP, "at": at, "limit": limit}))
    return questions


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


def ogc_user(port: int) -> Ask:
    """Asks the server over a connection that stays open."""
    conn = socket.create_connection(("127.0.0.1", port))
    conn.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    buffer = bytearray(1 << 20)

    def ask(question: Question) -> None:
        nonlocal conn
        sent = f"GET {question.path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
        try:
            conn.sendall(sent)
            status = _read_answer(conn, buffer)
        except ConnectionError:  # the server ended a connection that was quiet for 5 s
            conn.close()
            conn = socket.create_connection(("127.0.0.1", port))
            conn.sendall(sent)
            status = _read_answer(conn, buffer)
        if status != b"200":
            raise SystemExit(f"{status!r}: {question.path}")

    return ask


def _read_answer(conn: socket.socket, buffer: bytearray) -> bytes:
    """Read one answer with a Content-Length to its end; its status. Raises ConnectionError where the server closed."""
    got = 0
    end = -1
    while end < 0:
        count = conn.recv_into(memoryview(buffer)[got:])
        if not count:
            raise ConnectionResetError
        got += count
        end = buffer.find(b"\r\n\r\n", 0, got)
    head = bytes(buffer[:end])
    rest = int(head.lower().split(b"content-length:", 1)[1].split(b"\r\n", 1)[0]) - (got - end - 4)
    while rest:
        count = conn.recv_into(buffer, min(rest, len(buffer)))
        if not count:
            raise ConnectionResetError
        rest -= count
    return head.split(b" ", 2)[1]


def select_user(url: str) -> Ask:
    """Asks the same by SQL over a connection of its own; the rows stay as they came, nobody makes objects of them."""
    conn = open_reader(url)

    def ask(question: Question) -> None:
        with conn.cursor() as cursor:
            cursor.execute(_SELECT, question.values)
        conn.rollback()

    return ask


def check(port: int, url: str, questions: list[Question]) -> str:
    """Raise SystemExit unless the answers hold the cones that PostgreSQL finds; a word on what was compared."""
    items = 0
    with closing(open_reader(url)) as conn:
        for question in questions:
            with urlopen(f"http://127.0.0.1:{port}{question.path}") as answer:
                page = json.load(answer)
            found = [item["id"] for item in page["features"]]
            rows = [str(row["feature_id"]) for row in execute(conn, _IN_DEGREES, question.values)]
            all_of_them = len(rows) < question.values["limit"]
            if found != rows or (all_of_them and page["numberMatched"] != len(rows)):
                raise SystemExit(
                    f"{question.path}: {len(found)} items, {page['numberMatched']} matched, {len(rows)} rows"
                )
            items += len(found)
    return f"{len(questions)} answers compared with the rows of the select: {items} items, all the same"


def run(
    options: argparse.Namespace,
    pause_s: float,
    questions: list[Question],
    make: Callable[[], Ask],
    processes: tuple[int, int],
) -> dict[str, float]:
    """All users for so long; times of requests in ms, after two requests of each to warm up."""
    times: list[float] = []
    askers = [make() for _ in range(options.users)]
    for k, ask in enumerate(2 * askers):
        ask(questions[-1 - k])
    barrier = threading.Barrier(options.users + 1)
    end = 0.0

    def use(user: int) -> None:
        pauses = _pauses(random.Random(user), pause_s, options.steady)
        number = user * len(questions) // options.users
        barrier.wait()
        time.sleep(next(pauses))
        while time.perf_counter() < end:
            question = questions[number % len(questions)]
            start = time.perf_counter()
            askers[user](question)
            times.append((time.perf_counter() - start) * 1000)
            number += 1
            time.sleep(next(pauses))

    threads = [threading.Thread(target=use, args=(user,), daemon=True) for user in range(options.users)]
    for thread in threads:
        thread.start()
    before, before_users = processor_s(processes), time.process_time()
    end = time.perf_counter() + options.seconds
    barrier.wait()
    for thread in threads:
        thread.join()
    after, after_users = processor_s(processes), time.process_time()
    return {
        "requests": len(times),
        "per_s": round(len(times) / options.seconds, 1),
        "p50_ms": round(float(np.percentile(times, 50)), 1),
        "p95_ms": round(float(np.percentile(times, 95)), 1),
        "p99_ms": round(float(np.percentile(times, 99)), 1),
        "server_ms_per_request": round(1000 * (after[0] - before[0]) / len(times), 2),
        "postgres_ms_per_request": round(1000 * (after[1] - before[1]) / len(times), 2),
        "users_ms_per_request": round(1000 * (after_users - before_users) / len(times), 2),
        "load": round(os.getloadavg()[0], 1),
    }


def _pauses(dice: random.Random, mean_s: float, steady: bool) -> Iterator[float]:
    """The wait before the first request, and then the pauses between two (s)."""
    if steady:
        yield mean_s * dice.random()
    while True:
        yield mean_s if steady or not mean_s else dice.expovariate(1 / mean_s)


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
