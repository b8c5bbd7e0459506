"""Shared by the benchmarks of the complete job: a long drive made of a short one, and an ingest with and without Prefect."""

from __future__ import annotations

import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import closing, contextmanager, suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import psutil

from conetl.db.cluster.cluster import cluster_up
from conetl.db.connection import connect, execute
from conetl.model.ingest_report import DriveOnHoldError
from conetl.model.params import IngestParams
from conetl.pipeline.executor import ThreadExecutor
from conetl.pipeline.ingest import ingest
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import read_header
from tests.clusters import remove_cluster
from tests.folders import KITTI, SAMPLE


def source_drive(given: Path | None) -> Path:
    """The drive whose images are repeated: the real street where it is available, else a sample drive."""
    return given or (KITTI if KITTI.is_dir() else SAMPLE)


def make_long_drive(source: Path, folder: Path, pairs: int, *, start: datetime | None = None) -> Path:
    """A KITTI drive of `pairs` frame pairs: `source` forwards and backwards in turn, at 10 pairs per second. Images are links.

    Consecutive pairs have different images, unlike those of a frozen camera.
    """
    numbers = sorted(int(path.stem) for path in (source / "oxts" / "data").glob("*.txt"))
    forth_and_back = numbers + numbers[-2:0:-1]
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
        number = forth_and_back[k % len(forth_and_back)]
        for side in ("image_02", "image_03"):
            (folder / side / "data" / f"{k:010d}{suffix}").symlink_to(source / side / "data" / f"{number:010d}{suffix}")
        shutil.copy(source / "oxts" / "data" / f"{number:010d}.txt", folder / "oxts" / "data" / f"{k:010d}.txt")
    return folder


def database_pid(settings: Settings) -> int:
    """Process id of the private cluster, which is started if necessary."""
    with closing(connect(cluster_up(settings.home))) as conn:
        return int(psutil.Process(conn.info.backend_pid).ppid())


def database_bytes(settings: Settings) -> int:
    """Size of the map's database on disk."""
    with closing(connect(cluster_up(settings.home))) as conn:
        return int(execute(conn, "select pg_database_size(current_database()) as size")[0]["size"])


@contextmanager
def database_in(home: Path) -> Iterator[int]:
    """A private cluster for one benchmark; its process id."""
    try:
        yield database_pid(settings_in(home))
    finally:
        remove_cluster(home)


class TimedExecutor(ThreadExecutor):
    """Steps on a plain pool of threads; keeps the processor time of each (without OpenCV's own threads)."""

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
    executor = TimedExecutor(settings.workers)
    with executor, suppress(DriveOnHoldError):  # the same images all over contradict GNSS
        ingest(drive, params, settings, executor=executor)
    return executor.spent_s


def prefect_ingest(drive: Path, settings: Settings, params: IngestParams) -> None:
    """Ingest as `conetl ingest` does, with the running Prefect server."""
    from flows.ingest_drive import ingest_here

    with suppress(DriveOnHoldError):
        ingest_here(read_header(drive), settings, params, map_srid=None)


def settings_in(home: Path, map_name: str = "default") -> Settings:
    """Settings with everything below one folder, independent of the environment."""
    return Settings(home=home, map_name=map_name, database_url=None)


def params_with(refine: bool) -> IngestParams:
    """The default parameters, with trajectory refinement and self-calibration on or off."""
    trajectory = IngestParams().trajectory.model_copy(update={"refine": refine, "self_calibrate": refine})
    return IngestParams().model_copy(update={"trajectory": trajectory})
