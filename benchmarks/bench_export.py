"""Export of a synthetic map of a million cones: wall time, processor time of both sides, peak memory.

    .venv/bin/python benchmarks/bench_export.py [--features N] [--versions N] [--format geoparquet] [--what features]
    [--home FOLDER]

The map is made in a private PostGIS cluster unless it is there. The cluster is removed at the end unless --home names its folder.
"""

from __future__ import annotations

import json
import resource
from contextlib import closing
from pathlib import Path

from benchmarks.harness import Stopwatch, arguments_of, load, own_cluster, write_json
from benchmarks.made_up_maps import make_closures
from conetl.db.connection import Connection, connect
from conetl.db.map.map_store import find_map
from conetl.exports import FORMATS
from conetl.exports.export import export_map
from conetl.exports.source import ExportContent, ExportRequest


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--features", type=int, default=1_000_000)
    parser.add_argument("--versions", type=int, default=1)
    parser.add_argument("--format", choices=list(FORMATS), default="geoparquet")
    parser.add_argument("--what", choices=["features", "history"], default="features")
    parser.add_argument("--home", type=Path)
    options = parser.parse_args()
    map_name = f"bench_{options.features}_{options.versions}"
    with own_cluster(options.home) as (home, url), closing(connect(url)) as conn:
        if find_map(conn, map_name) is None:
            make_closures(conn, map_name, features=options.features, versions=options.versions)
        conn.rollback()
        figures = measure(conn, home, map_name, options.format, ExportContent(options.what))
    print(json.dumps(figures, indent=2))
    write_json(options.json, figures)


def measure(conn: Connection, home: Path, map_name: str, file_format: str, what: ExportContent) -> dict[str, object]:
    watch, load_before = Stopwatch(conn.info.backend_pid), load()
    with watch.phase("export"):
        path = home / f"export{FORMATS[file_format].suffix}"
        manifest = export_map(conn, path, file_format, ExportRequest(map_name, what))
    wall_s, own_s, backend_s, _ = watch.total
    status = Path(f"/proc/{conn.info.backend_pid}/status").read_text().splitlines()
    peak_kb = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))  # includes shared buffers
    return {
        "format": file_format,
        "what": what,
        "rows": manifest["rows"],
        "megabytes": round(manifest["bytes"] / 1e6, 1),
        "wall_s": round(wall_s, 1),
        "processor_s": round(own_s, 1),
        "database_processor_s": round(backend_s, 1),
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "database_peak_rss_mb": peak_kb // 1024,
        "load_before": load_before,
        "load_after": load(),
    }


if __name__ == "__main__":
    main()
