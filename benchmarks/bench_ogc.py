"""OGC API Features over a map of a million cones: boxes as of an instant, 20 users at a time, beside a plain `select`.

    .venv/bin/python benchmarks/bench_ogc.py [--features N] [--users 20] [--seconds 20] [--side-m 500] [--limit 1000]
    [--pause-s 1] [--steady] [--home FOLDER]

The server is `conetl view`, a process of its own; users are threads of this one with a connection each. Every request has
another box around another cone, as of another instant. The benchmark runs with a pause between two requests of a user, as
people and map programs request, and without one, which measures throughput. Pauses, and the wait before a user's first request,
are exponentially distributed with the mean --pause-s; --steady makes all pauses equal. Then as many users request the same rows
from PostgreSQL by psycopg2.

Requests are prepared before the clock starts and responses are only read to their end, because this process shares the
processors; afterwards some responses are compared with the rows of the `select`. Processor time is that of the server, of
PostgreSQL with its children and of this process (the users). The cluster is removed at the end unless --home names its folder.
"""

from __future__ import annotations

import argparse
import json
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np

from benchmarks.harness import arguments_of, load, own_cluster, print_rows, processor_s, served_view, write_json
from benchmarks.made_up_maps import SRID, make_closures
from conetl.db.cluster.cluster import cluster_status
from conetl.db.connection import Connection, connect, execute
from conetl.db.map.map_store import find_map
from conetl.db.reader_pool import open_reader
from conetl.geometry.geodesy import to_geodetic

MAP = "bench"
INSTANTS = ("2026-03-01T12:00:00Z", "2026-03-02T07:00:00Z", "2026-03-02T12:00:00Z", "2026-03-09T00:00:00Z")
_SELECT = """
select v.* from conetl.map m join conetl.feature_version v using (map_id)
where m.map_name = %(map)s and v.present and v.valid_period @> %(at)s::timestamptz and v.system_period @> 'infinity'::timestamptz
and v.geom && ST_MakeEnvelope(%(west)s, %(south)s, %(east)s, %(north)s, 32632) order by v.feature_id limit %(limit)s
"""
#: The same cones within a box in degrees, whose edges are not parallel to those in metres.
_IN_DEGREES = """
select v.feature_id from conetl.feature_states(%(map)s, %(at)s::timestamptz) v
cross join lateral (select ST_Transform(v.geom, 4326) as place) p
where v.geom && ST_Expand(ST_MakeEnvelope(%(west)s, %(south)s, %(east)s, %(north)s, 32632), %(spare_m)s)
and ST_X(p.place) between %(lon_west)s and %(lon_east)s and ST_Y(p.place) between %(lat_south)s and %(lat_north)s
order by v.feature_id limit %(limit)s
"""
#: Different requests; each user starts elsewhere in the list.
_REQUESTS = 4000
#: Responses that are compared with the rows of the `select`.
_CHECKED = 20


@dataclass(frozen=True)
class BoxRequest:
    """One box as of one instant, for the server and for PostgreSQL."""

    path: str
    values: dict[str, Any]


#: Sends one request and returns after the last byte of the response.
Send = Callable[[BoxRequest], None]


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--features", type=int, default=1_000_000)
    parser.add_argument("--users", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--side-m", type=float, default=500)
    parser.add_argument("--limit", type=int, default=1000)
    parser.add_argument("--pause-s", type=float, default=1)
    parser.add_argument("--steady", action="store_true", help="all pauses equal, instead of exponentially distributed")
    parser.add_argument("--home", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, object]] = []
    with own_cluster(options.home) as (home, url):
        with closing(connect(url)) as conn:
            if find_map(conn, MAP) is None:
                make_closures(conn, MAP, features=options.features, versions=2)
            requests = make_requests(conn, options.side_m, options.limit)
        postgres = cluster_status(home).pid
        assert postgres is not None
        with served_view(home, url, MAP) as (address, server):
            for pause_s in (options.pause_s, 0.0):
                for name, user, pid in (
                    ("OGC API", partial(ogc_user, address), server),
                    ("select", partial(select_user, url), None),
                ):
                    figures = run(options, pause_s, requests, user, pid, postgres)
                    rows.append({"source": name, "pause s": pause_s, **figures})
            checked = check(address, url, requests[:_CHECKED])
    print_rows(f"{options.users} users, boxes of {options.side_m:g} m, load {load()}", rows)
    print(checked)
    write_json(options.json, rows)


def make_requests(conn: Connection, side_m: float, limit: int) -> list[BoxRequest]:
    """Boxes around cones from all over the map."""
    sample = "select ST_X(geom) as x, ST_Y(geom) as y from conetl.feature_version tablesample system (%(share)s) repeatable (1)"
    rows = execute(conn, sample, {"share": 0.05}) or execute(conn, sample, {"share": 100})
    dice = random.Random(1)
    centres = np.array([(p["x"], p["y"]) for p in dice.choices(rows, k=_REQUESTS)])
    corners = [centres - side_m / 2, centres + side_m / 2]
    heights = np.zeros((_REQUESTS, 1))
    degrees = [to_geodetic(SRID, np.hstack([corner, heights])) for corner in corners]
    requests = []
    for low, high, (south, west, _), (north, east, _) in zip(*corners, *degrees, strict=True):
        at = dice.choice(INSTANTS)
        path = f"/ogc/collections/{MAP}.features/items?bbox={west},{south},{east},{north}&at={at}&limit={limit}"
        values = dict(zip(("west", "south", "east", "north"), (*low.tolist(), *high.tolist()), strict=True))
        values |= dict(
            zip(("lon_west", "lat_south", "lon_east", "lat_north"), map(float, (west, south, east, north)), strict=True)
        )
        requests.append(BoxRequest(path, values | {"map": MAP, "at": at, "limit": limit, "spare_m": 0.1 * side_m}))
    return requests


def ogc_user(address: str) -> Send:
    """Requests from the server over a connection that stays open."""
    url = urlsplit(address)
    conn = socket.create_connection((url.hostname, url.port))
    conn.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    buffer = bytearray(1 << 20)

    def send(request: BoxRequest) -> None:
        nonlocal conn
        sent = f"GET {request.path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
        try:
            conn.sendall(sent)
            status = _read_response(conn, buffer)
        except ConnectionError:  # the server closes a connection after 5 s without a request
            conn.close()
            conn = socket.create_connection((url.hostname, url.port))
            conn.sendall(sent)
            status = _read_response(conn, buffer)
        if status != b"200":
            raise SystemExit(f"{status!r}: {request.path}")

    return send


def _read_response(conn: socket.socket, buffer: bytearray) -> bytes:
    """Read one response with a Content-Length to its end; its status. Raises ConnectionError where the server closed."""
    got, end = 0, -1
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


def select_user(url: str) -> Send:
    """The same query over a database connection; the rows are not converted to objects."""
    conn = open_reader(url)

    def send(request: BoxRequest) -> None:
        with conn.cursor() as cursor:
            cursor.execute(_SELECT, request.values)
        conn.rollback()

    return send


def check(address: str, url: str, requests: list[BoxRequest]) -> str:
    """A sentence about the comparison. Raises SystemExit unless the responses hold the cones that PostgreSQL finds."""
    items = 0
    with closing(open_reader(url)) as conn:
        for request in requests:
            with urlopen(address + request.path) as response:
                page = json.load(response)
            found = [item["id"] for item in page["features"]]
            rows = [str(row["feature_id"]) for row in execute(conn, _IN_DEGREES, request.values)]
            complete = len(rows) < request.values["limit"]
            if found != rows or (complete and page["numberMatched"] != len(rows)):
                raise SystemExit(
                    f"{request.path}: {len(found)} items, {page['numberMatched']} matched, {len(rows)} rows"
                )
            items += len(found)
    return f"{len(requests)} responses compared with the rows of the select: {items} items, all equal"


def run(
    options: argparse.Namespace,
    pause_s: float,
    requests: list[BoxRequest],
    user: Callable[[], Send],
    server: int | None,
    postgres: int,
) -> dict[str, float]:
    """All users for --seconds, after two requests of each to warm up."""
    times_ms: list[float] = []
    senders = [user() for _ in range(options.users)]
    for k, send in enumerate(2 * senders):
        send(requests[-1 - k])
    barrier = threading.Barrier(options.users + 1)
    end = 0.0

    def use(number: int) -> None:
        pauses = _pauses(random.Random(number), pause_s, options.steady)
        k = number * len(requests) // options.users
        barrier.wait()
        time.sleep(next(pauses))
        while time.perf_counter() < end:
            start = time.perf_counter()
            senders[number](requests[k % len(requests)])
            times_ms.append((time.perf_counter() - start) * 1000)
            k += 1
            time.sleep(next(pauses))

    threads = [threading.Thread(target=use, args=(number,), daemon=True) for number in range(options.users)]
    for thread in threads:
        thread.start()
    before = processor_times(server, postgres)
    end = time.perf_counter() + options.seconds
    barrier.wait()
    for thread in threads:
        thread.join()
    after = processor_times(server, postgres)
    server_ms, postgres_ms, users_ms = (1000 * (np.subtract(after, before)) / len(times_ms)).tolist()
    p50, p95, p99 = np.percentile(times_ms, (50, 95, 99)).tolist()
    return {
        "requests": len(times_ms),
        "per s": len(times_ms) / options.seconds,
        "p50 ms": p50,
        "p95 ms": p95,
        "p99 ms": p99,
        "server ms per request": server_ms,
        "postgres": postgres_ms,
        "users": users_ms,
    }


def processor_times(server: int | None, postgres: int) -> tuple[float, float, float]:
    """Processor time of the server, of PostgreSQL with its children, and of this process, in seconds."""
    return processor_s(*([server] if server else [])), processor_s(postgres), time.process_time()


def _pauses(dice: random.Random, mean_s: float, steady: bool) -> Iterator[float]:
    """The wait before the first request, then the pauses between two (s)."""
    if steady:
        yield mean_s * dice.random()
    while True:
        yield mean_s if steady or not mean_s else dice.expovariate(1 / mean_s)


if __name__ == "__main__":
    main()
