"""Export of a made-up map of a million cones: wall time, processor time of both sides, peak memory.

    .venv/bin/python benchmarks/bench_export.py [--features N] [--versions N] [--format geoparquet] [--what features]
    [--home FOLDER]

Runs a private PostGIS cluster in a folder of its own and makes the map there unless it is there already; removes it at the end
unless --home names the folder. The processor time of the database is that of its session. Says what else the machine was doing.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import tempfile
import time
from pathlib import Path

from synthetic_map import make_map

from conetl.db.cluster.cluster import cluster_remove, cluster_up
from conetl.db.connection import Connection, connect, execute
from conetl.db.map.map_store import find_map
from conetl.db.schema import migrate
from conetl.exports import FORMATS
from conetl.exports.export import export_map
from conetl.exports.source import ExportRequest, What


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--features", type=int, default=1_000_000)
    parser.add_argument("--versions", type=int, default=1)
    parser.add_argument("--format", choices=list(FORMATS), default="geoparquet")
    parser.add_argument("--what", choices=["features", "history"], default="features")
    parser.add_argument("--home", type=Path)
    options = parser.parse_args()
    home = options.home or Path(tempfile.mkdtemp(prefix="conetl-bench-", dir="/tmp"))
    try:
        conn = connect(cluster_up(home))
        migrate(conn)
        map_name = f"bench_{options.features}_{options.versions}"
        if find_map(conn, map_name) is None:
            conn.rollback()
            make_map(conn, map_name, features=options.features, versions=options.versions)
        conn.rollback()
        print(json.dumps(measure(conn, home, map_name, options.format, What(options.what)), indent=2))
        conn.close()
    finally:
        if options.home is None:
            cluster_remove(home)
            shutil.rmtree(home, ignore_errors=True)


def measure(conn: Connection, home: Path, map_name: str, file_format: str, what: What) -> dict[str, object]:
    pid = execute(conn, "select pg_backend_pid() as pid")[0]["pid"]
    path = home / f"export{FORMATS[file_format].suffix}"
    load = os.getloadavg()[0]
    before, server_before, start = time.process_time(), server_seconds(pid), time.perf_counter()
    manifest = export_map(conn, path, file_format, ExportRequest(map_name, what))
    return {
        "format": file_format,
        "what": what,
        "rows": manifest["rows"],
        "megabytes": round(manifest["bytes"] / 1e6, 1),
        "wall_s": round(time.perf_counter() - start, 1),
        "processor_s": round(time.process_time() - before, 1),
        "database_processor_s": round(server_seconds(pid) - server_before, 1),
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "database_peak_rss_mb": server_peak_mb(pid),
        "load_before": round(load, 1),
        "load_after": round(os.getloadavg()[0], 1),
    }


def server_seconds(pid: int) -> float:
    """Processor time of a process of this machine (proc(5): utime and stime are fields 14 and 15)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def server_peak_mb(pid: int) -> int:
    """Greatest resident memory of a process of this machine, with the buffers that it shares with others (proc(5): VmHWM)."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) // 1024 for line in lines if line.startswith("VmHWM"))


if __name__ == "__main__":
    main()
