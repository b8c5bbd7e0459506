"""What the benchmarks of the whole job share: a long drive made of a short one, processor time and memory of process trees,
and an ingest with and without Prefect.
"""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import closing, contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import psutil

from conetl.db.cluster.cluster import cluster_remove, cluster_up
from conetl.db.connection import connect, execute
from conetl.model.ingest_report import IngestReport
from conetl.model.params import IngestParams
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.executor import ThreadExecutor
from conetl.pipeline.ingest import ingest
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import read_header

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("CONETL_SHARED_DATA", ROOT.parent / "shared" / "data"))
KITTI = SHARED / "kitti_2011_09_26_drive_0005_sync"
SAMPLE = ROOT / "data" / "drives" / "2026-03-02_taper_pass1"


def source_drive(given: Path | None) -> Path:
    """The drive whose pictures are repeated: the real street where it is to be had, else a sample drive."""
    return given or (KITTI if KITTI.is_dir() else SAMPLE)


def make_long_drive(source: Path, folder: Path, pairs: int, *, start: datetime | None = None) -> Path:
    """A KITTI drive of `pairs` frame pairs: the car of `source` goes to and fro, at 10 pairs a second. Images are links.

    No two neighbouring pairs show the same picture, so that nothing looks like a stuck camera.
    """
    numbers = sorted(int(path.stem) for path in (source / "oxts" / "data").glob("*.txt"))
    there_and_back = numbers + numbers[-2:0:-1]
    suffix = next((source / "image_02" / "data").iterdir()).suffix
    for name in ("image_02", "image_03", "oxts"):
        (folder / name / "data").mkdir(parents=True)
    for path in source.glob("calib*.txt"):
        shutil.copy(path, folder)
    begin = start or datetime(2026, 5, 1, 8)
    stamps = [f"{begin + timedelta(seconds=k / 10):%Y-%m-%d %H:%M:%S.%f}000\n" for k in range(pairs)]
    for name in ("image_02", "image_03", "oxts"):
        (folder / name / "timestamps.txt").write_text("".join(stamps))
    for k in range(pairs):
        number = there_and_back[k % len(there_and_back)]
        for side in ("image_02", "image_03"):
            (folder / side / "data" / f"{k:010d}{suffix}").symlink_to(source / side / "data" / f"{number:010d}{suffix}")
        shutil.copy(source / "oxts" / "data" / f"{number:010d}.txt", folder / "oxts" / "data" / f"{k:010d}.txt")
    return folder


def tree(pid: int | None = None) -> list[psutil.Process]:
    """A process and all below it."""
    top = psutil.Process(pid)
    return [top, *top.children(recursive=True)]


def processor_s(*pids: int) -> float:
    """Processor time of process trees so far, those of their processes included that ended and were waited for."""
    total = 0.0
    for pid in pids:
        for process in tree(pid):
            try:
                times = process.cpu_times()
            except psutil.NoSuchProcess:
                continue
            total += times.user + times.system + times.children_user + times.children_system
    return total


def database_pid(settings: Settings) -> int:
    """The private cluster's first process; the cluster is started where it does not run."""
    with closing(connect(cluster_up(settings.home))) as conn:
        backend = execute(conn, "select pg_backend_pid() as pid")[0]["pid"]
        return psutil.Process(backend).ppid()


def database_bytes(settings: Settings) -> int:
    """Size of the map's database on disk."""
    with closing(connect(cluster_up(settings.home))) as conn:
        return int(execute(conn, "select pg_database_size(current_database()) as size")[0]["size"])


@contextmanager
def database_in(home: Path) -> Iterator[int]:
    """A private cluster for the time of a benchmark; the id of its first process."""
    try:
        yield database_pid(settings_in(home))
    finally:
        cluster_remove(home)


class Peak:
    """Most resident memory of this process and its children together, looked at once a second."""

    def __init__(self, every_s: float = 1.0) -> None:
        self.bytes = self.own_bytes = 0
        self._every_s, self._stop = every_s, threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> Peak:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._stop.wait(self._every_s):
            sizes = []
            for process in tree():
                try:
                    sizes.append(process.memory_info().rss)
                except psutil.NoSuchProcess:
                    sizes.append(0)
            self.bytes, self.own_bytes = max(self.bytes, sum(sizes)), max(self.own_bytes, sizes[0])


class TimedExecutor(ThreadExecutor):
    """Steps on a plain pool of threads; keeps the processor time of each (OpenCV's own threads go uncounted)."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self.spent_s: dict[str, float] = defaultdict(float)

    def run(self, step: Callable[..., Any], *arguments: Any) -> Any:
        given = [argument.result() if isinstance(argument, Future) else argument for argument in arguments]
        before = time.thread_time()
        try:
            return super().run(step, *given)
        finally:
            self.spent_s[step.__name__] += time.thread_time() - before


def plain_ingest(drive: Path, settings: Settings, params: IngestParams) -> dict[str, float]:
    """Ingest without Prefect; processor seconds of each step."""
    with TimedExecutor(settings.workers) as executor:
        ingest(drive, params, settings, executor=executor)
    return executor.spent_s


def prefect_ingest(drive: Path, settings: Settings, params: IngestParams) -> IngestReport:
    """Ingest as `conetl ingest` does, with the Prefect server that runs."""
    from flows.ingest_drive import ingest_by_command

    with MapDatabase(settings) as database:
        return ingest_by_command(read_header(drive), settings, params, map_srid=None, database=database)


def settings_in(home: Path, map_name: str = "default") -> Settings:
    """Settings with everything below one folder, whatever the environment says."""
    return Settings(home=home, map_name=map_name, database_url=None)


def params_with(refine: bool) -> IngestParams:
    """The default parameters, with trajectory refinement and self-calibration on or off."""
    trajectory = IngestParams().trajectory.model_copy(update={"refine": refine, "self_calibrate": refine})
    return IngestParams().model_copy(update={"trajectory": trajectory})
