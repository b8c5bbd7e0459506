"""What the benchmarks of the whole job share: a long drive made of a short one, processor time and memory of process trees,
and the flow with Prefect taken out of it.
"""

from __future__ import annotations

import logging
import os
import shutil
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import patch
from uuid import uuid4

import psutil
from prefect import Flow, Task
from prefect.utilities.annotations import opaque

from conetl.db.cluster.cluster import cluster_remove, cluster_up
from conetl.db.connection import connect, execute
from conetl.model.ingest_report import IngestReport
from conetl.model.params import IngestParams
from conetl.pipeline.settings import Settings

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


class _PlainTask:
    """A task's function, in the caller's thread or in one of the pool's; keeps the processor time of its threads by name."""

    def __init__(self, task: Task[..., Any], pool: ThreadPoolExecutor, spent_s: dict[str, float]) -> None:
        self._task, self._pool, self._spent_s = task, pool, spent_s

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        before = time.thread_time()
        try:
            return self._task.fn(*(a.unwrap() if isinstance(a, opaque) else a for a in arguments), **named)
        finally:
            self._spent_s[self._task.name] += time.thread_time() - before

    def submit(self, *arguments: Any, **named: Any) -> Future[Any]:
        def work() -> (
            Any
        ):  # like Prefect's tasks, it waits for what it is given; what it waits for was submitted before it
            return self(*(a.result() if isinstance(a, Future) else a for a in arguments), **named)

        return self._pool.submit(work)


@contextmanager
def plain_ingest(workers: int, spent_s: dict[str, float] | None = None) -> Iterator[Callable[..., IngestReport]]:
    """The body of `ingest-drive` as it stands, on a plain pool of threads: no task, run, artifact, event or log of Prefect.

    spent_s: processor time of each task's threads is added here (OpenCV's own threads go uncounted).
    """
    from flows import analysis, changeset_events, ingest_drive, merge, publish, refinement
    from flows import drive_artifacts as control_room

    def nothing(*_: Any, **__: Any) -> Any:
        return uuid4()

    modules: tuple[ModuleType, ...] = (
        analysis,
        changeset_events,
        control_room,
        ingest_drive,
        merge,
        publish,
        refinement,
    )
    named = {"get_run_logger": lambda: logging.getLogger("plain"), "emit_event": nothing}
    named["get_run_context"] = lambda: SimpleNamespace(task_run=SimpleNamespace(id=uuid4()))
    times = defaultdict(float) if spent_s is None else spent_s
    patches = []
    with ThreadPoolExecutor(workers) as pool:
        for module in modules:
            for name, value in vars(module).items():
                if isinstance(value, Task):
                    patches.append(patch.object(module, name, _PlainTask(value, pool, times)))
                elif name in named:
                    patches.append(patch.object(module, name, named[name]))
                elif name.endswith("_artifact"):
                    patches.append(patch.object(module, name, nothing))
        for each in patches:
            each.start()
        try:
            flow: Flow[..., IngestReport] = ingest_drive.ingest_drive
            yield flow.fn
        finally:
            for each in patches:
                each.stop()


def settings_in(home: Path, map_name: str = "default") -> Settings:
    """Settings with everything below one folder, whatever the environment says."""
    return Settings(home=home, map_name=map_name, database_url=None)


def params_with(refine: bool) -> IngestParams:
    """The default parameters, with trajectory refinement and self-calibration on or off."""
    trajectory = IngestParams().trajectory.model_copy(update={"refine": refine, "self_calibrate": refine})
    return IngestParams().model_copy(update={"trajectory": trajectory})
