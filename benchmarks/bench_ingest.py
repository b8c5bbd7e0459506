"""The complete job, from JPEG on disk to the committed map, beside decoding and the network alone on the same images.

The variants run one after the other. Memory is that of this process with Prefect's server. On a shared machine the wall clock
is not meaningful: pairs per second are also given as cores over processor time per pair, the rate of an idle machine with as
many cores.

    python benchmarks/bench_ingest.py [--pairs 600] [--drive FOLDER] [--everywhere] [--stages]
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TypeVar

from benchmarks.harness import Peak, arguments_of, load, own_home, processor_s, write_json

Result = TypeVar("Result")


def decode_and_run(drive: Path, workers: int) -> Callable[[], None]:
    """A function that decodes every image of a drive and runs the network on it, in `workers` threads, and drops the results.

    The drive is read beforehand, and the memory of freed images is used again, as in the complete job.
    """
    from conetl.geometry.camera import first_road_row
    from conetl.geometry.rig import map_SE3_left
    from conetl.model.params import IngestParams
    from conetl.perception.detector import MAX_SIDE_PX, load_detector, network_input
    from conetl.perception.images import read_image
    from conetl.perception.worker_setup import set_up_worker
    from conetl.readers.drives import read_drive

    read, _ = read_drive(drive, headers_only=True)
    margin_rad = IngestParams().detection.horizon_margin_rad
    rotations = [map_SE3_left(pair.pose, read.rig)[:3, :3] for pair in read.frame_pairs]
    row = first_road_row(read.rig.left, rotations, margin_rad)
    paths = [path for pair in read.frame_pairs for path in (pair.left_path, pair.right_path)]
    set_up_worker()

    def some(mine: list[str]) -> None:
        detector = load_detector(threads=1)
        for path in mine:
            image = read_image(Path(path))
            blob, _, _ = network_input(
                image[row:], detector.card.pad_multiple_px, MAX_SIDE_PX,
                layout=detector.card.input_layout,
            )  # fmt: skip
            detector.session.run(None, {detector.input_name: blob})

    def everything() -> None:
        with ThreadPoolExecutor(workers) as pool:
            for done in [pool.submit(some, paths[k::workers]) for k in range(workers)]:
                done.result()

    return everything


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--pairs", type=int, default=600)
    parser.add_argument("--drive", type=Path, help="KITTI drive whose images are repeated")
    parser.add_argument(
        "--everywhere",
        action="store_true",
        help="also with right images searched everywhere, as by the network alone",
    )
    parser.add_argument(
        "--stages", action="store_true", help="also without Prefect, with the processor time of each task"
    )
    arguments = parser.parse_args()
    with own_home() as home, ExitStack() as stack:
        from benchmarks import whole_job as job
        from benchmarks.whole_job import params_with, plain_ingest, prefect_ingest, settings_in
        from conetl.model.params import DetectionParams
        from conetl.pipeline.database import MapDatabase
        from flows.server import prefect_server

        source, pairs = job.source_drive(arguments.drive), arguments.pairs
        drive = job.make_long_drive(source, home / "drive", pairs)
        workers = settings_in(home).workers
        database = stack.enter_context(job.database_in(home))
        stack.enter_context(prefect_server(home))
        figures: dict[str, dict[str, float]] = {}

        def take(name: str, run: Callable[[], Result]) -> Result:
            cpu, wall, load_before = processor_s(os.getpid(), database), time.monotonic(), load()
            with Peak() as peak:
                result = run()
            cpu, wall = processor_s(os.getpid(), database) - cpu, time.monotonic() - wall
            figures[name] = {
                "processor_ms_a_pair": 1e3 * cpu / pairs, "pairs_a_second_by_the_clock": pairs / wall,
                "pairs_a_second_of_idle_cores": workers * pairs / cpu, "peak_mb": peak.bytes / 1e6,
                "peak_own_mb": peak.own_bytes / 1e6, "load": max(load_before, load()),
            }  # fmt: skip
            print(f"{name:28}" + "".join(f"{value:12.1f}" for value in figures[name].values()), flush=True)
            return result

        columns = ("ms CPU/pair", "pairs/s", "idle cores", "peak MB", "own MB", "load")
        print(
            f"{pairs} pairs of {source.name}, {workers} threads\n{'':28}" + "".join(f"{text:>12}" for text in columns)
        )
        with MapDatabase(settings_in(home)) as map_database:
            assert map_database.url  # the tables are made once in the life of a database
        take("decode + network", decode_and_run(drive, workers))
        ways = [
            ("refined", "whole job, refined", params_with(True)),
            ("plain", "whole job, logged poses", params_with(False)),
        ]
        if arguments.everywhere:
            everywhere = DetectionParams(search_right="everywhere")
            ways.append(
                ("everywhere", "the same, right everywhere", ways[1][2].model_copy(update={"detection": everywhere}))
            )
        for way, name, params in ways:
            settings = settings_in(home, way)
            settings_in(home).results_folder.mkdir(exist_ok=True)
            for old in settings_in(home).results_folder.iterdir():
                old.unlink()
            before = job.database_bytes(settings)
            take(name, partial(prefect_ingest, drive, settings, params))
            share = figures["decode + network"]["processor_ms_a_pair"] / figures[name]["processor_ms_a_pair"]
            stored = sum(path.stat().st_size for path in settings.results_folder.iterdir())
            grown = job.database_bytes(settings) - before
            print(f"  {share:.2f} of decode + network alone; {stored / 1e3 / pairs:.1f} kB of results and "
                  f"{grown / 1e3 / pairs:.1f} kB in the database")  # fmt: skip
            if arguments.stages:
                for old in settings.results_folder.iterdir():
                    old.unlink()
                again = settings_in(home, f"{settings.map_name}_stages")
                spent = take("  the same without Prefect", partial(plain_ingest, drive, again, params))
                for task, seconds in sorted(spent.items(), key=lambda item: -item[1]):
                    print(f"    {task:20} {1e3 * seconds / pairs:8.2f} ms a pair")
        write_json(arguments.json, figures)


if __name__ == "__main__":
    main()
