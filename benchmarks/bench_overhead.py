"""Cost of Prefect: `ingest` of one long drive through a running Prefect server, and the same steps without Prefect.

Processor time of this process, of the Prefect server and of PostGIS. First both variants run from images ("cold"), each into a
map of its own; then both again with the results of all chunks on disk ("warm"), where orchestration is most of the work, so
that other load of the machine does not hide it. The result is the warm difference over the cold run without Prefect.

With `--dask 4` also from images by as many workers of a Dask cluster on this machine, in turn with threads, whose figure does
not contain what the waiting cluster takes. Each worker has loaded its libraries: all have worked on another drive.

    python benchmarks/bench_overhead.py [--pairs 1000] [--no-refine] [--rounds 3] [--drive FOLDER] [--chunk-pairs 128] [--dask 4]
"""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path

from benchmarks.harness import arguments_of, load, own_home, processor_s, write_json
from conetl.model.params import IngestParams

IMPORTS = {
    "the steps alone": "import conetl.pipeline.ingest",
    "the flow, with Prefect": "import flows.ingest_drive",
}


def cpu_of_import(statement: str, rounds: int) -> float:
    """Processor time of a Python process with this statement, the best of several."""
    took = []
    for _ in range(rounds):
        before = os.times()
        subprocess.run([sys.executable, "-c", statement], check=True)
        after = os.times()
        took.append(after.children_user + after.children_system - before.children_user - before.children_system)
    return min(took)


@contextmanager
def warm_workers(home: Path, source: Path, count: int, params: IngestParams) -> Iterator[tuple[str, list[int]]]:
    """Address and process ids of a cluster whose workers have all worked on another drive."""
    from benchmarks import whole_job as job
    from tests.dask_cluster import dask_workers

    other = job.make_long_drive(source, home / "other", 32 * count, start=datetime(2026, 5, 2, 8))
    with dask_workers(home, count) as (address, processes):
        changed = {"task_runner": "dask", "dask_address": address}
        settings = job.settings_in(home, "other").model_copy(update=changed)
        job.prefect_ingest(other, settings, params.model_copy(update={"chunk_pairs": 16}))
        yield address, [process.pid for process in processes.values()]


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--drive", type=Path)
    parser.add_argument("--rounds", type=int, default=3, help="warm rounds of each variant, and imports")
    parser.add_argument("--chunk-pairs", type=int, help="frame pairs per task")
    parser.add_argument("--no-refine", action="store_true")
    parser.add_argument("--dask", type=int, metavar="WORKERS")
    arguments = parser.parse_args()
    with own_home() as home, ExitStack() as stack:
        from benchmarks import whole_job as job
        from benchmarks.whole_job import params_with, plain_ingest, prefect_ingest, settings_in
        from flows.server import prefect_server

        source = job.source_drive(arguments.drive)
        drive = job.make_long_drive(source, home / "drive", arguments.pairs)
        params, workers = params_with(not arguments.no_refine), settings_in(home).workers
        if arguments.chunk_pairs:
            params = params.model_copy(update={"chunk_pairs": arguments.chunk_pairs})
        database = stack.enter_context(job.database_in(home))
        before = processor_s(os.getpid())
        stack.enter_context(prefect_server(home))
        start_s = processor_s(os.getpid()) - before

        def took(
            run: Callable[..., object], map_name: str, *, without: Sequence[int] = (), **changed: object
        ) -> tuple[float, float]:
            def spent_s() -> float:
                return processor_s(os.getpid(), database) - processor_s(*without)

            if not map_name.startswith("warm"):
                shutil.rmtree(settings_in(home).results_folder, ignore_errors=True)
            cpu, wall = spent_s(), time.monotonic()
            run(drive, settings_in(home, map_name).model_copy(update=changed), params)
            return spent_s() - cpu, time.monotonic() - wall

        cold: dict[str, tuple[float, float]] = {}
        cold["plain"] = took(plain_ingest, "cold_plain")
        cold["prefect"] = took(prefect_ingest, "cold_prefect")
        warm: dict[str, list[float]] = {"plain": [], "prefect": []}
        for k in range(arguments.rounds):
            warm["plain"].append(took(plain_ingest, f"warm_plain_{k}")[0])
            warm["prefect"].append(took(prefect_ingest, f"warm_prefect_{k}")[0])
        beside: list[tuple[float, float]] = []
        if arguments.dask:
            address, of_dask = stack.enter_context(warm_workers(home, source, arguments.dask, params))
            for k in range(arguments.rounds):
                by_dask = took(prefect_ingest, f"dask_{k}", task_runner="dask", dask_address=address)[0]
                beside.append((took(prefect_ingest, f"threads_{k}", without=of_dask)[0], by_dask))
        print(f"{arguments.pairs} pairs of {source.name}, refinement {params.trajectory.refine}, "
              f"{workers} detection tasks at a time, load {load():.1f}")  # fmt: skip
        for way, (cpu, wall) in cold.items():
            print(f"{way:8} from images: {cpu:7.1f} s of processor time, {wall:7.1f} s wall clock")
        for way, times in warm.items():
            print(f"{way:8} with results on disk: {', '.join(f'{t:.2f}' for t in times)} s of processor time")
        extra = statistics.median(warm["prefect"]) - statistics.median(warm["plain"])
        print(f"Prefect costs {extra:.2f} s: {100 * extra / cold['plain'][0]:.2f} % of the run without Prefect")
        print(f"cold against cold: {100 * (cold['prefect'][0] / cold['plain'][0] - 1):+.2f} %")
        imports = {name: cpu_of_import(text, arguments.rounds) for name, text in IMPORTS.items()}
        print(f"once per command: start of the server {start_s:.1f} s; "
              + "; ".join(f"import of {name} {took_s:.1f} s" for name, took_s in imports.items()))  # fmt: skip
        for both in beside:
            threads, dask = (1000 * took_s / arguments.pairs for took_s in both)
            print(f"from images by threads {threads:.1f} ms of processor time per pair, by {arguments.dask} workers of Dask "
                  f"{dask:.1f}: {100 * (dask / threads - 1):+.1f} %")  # fmt: skip
        figures = {"cold_s": cold, "warm_s": warm, "prefect_s": extra, "server_start_s": start_s}
        write_json(arguments.json, {**figures, "threads_and_dask_s": beside})


if __name__ == "__main__":
    main()
