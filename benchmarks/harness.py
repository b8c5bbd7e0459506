"""Shared by the benchmarks: temporary homes and clusters, a running web view, processor time and memory, tables and JSON.

Nothing here imports Prefect, which reads its environment when it is imported.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import psutil
from rich.console import Console
from rich.table import Table

from conetl.db.cluster.cluster import cluster_up
from conetl.db.connection import connect
from conetl.db.schema import migrate
from conetl.model.detector_evidence import DetectorEvidence
from conetl.perception.model_card import read_model_card
from conetl.pipeline.settings import prefect_environment
from tests.clusters import remove_cluster
from tests.command import free_port, until

#: The command line in a process of its own.
CONETL = (sys.executable, "-m", "conetl")


def arguments_of(doc: str | None) -> argparse.ArgumentParser:
    """A parser with the module's docstring as help and the option --json."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures to FILE")
    return parser


@contextmanager
def own_home() -> Iterator[Path]:
    """CONETL_HOME in a temporary folder, with Prefect's environment for it. Enter it before Prefect is first imported."""
    with tempfile.TemporaryDirectory(prefix="conetl-bench-") as folder:
        home = Path(folder) / "home"
        (home / "prefect").mkdir(parents=True)
        os.environ.update(prefect_environment(home))
        yield home


@contextmanager
def own_cluster(home: Path | None = None, *, folder: Path | None = None) -> Iterator[tuple[Path, str]]:
    """Home and URL of a private cluster with all tables, as `conetl db up` makes it. A temporary one unless `home` is given."""
    chosen = home or Path(tempfile.mkdtemp(prefix="conetl-bench-", dir=folder or "/tmp"))
    try:
        url = cluster_up(chosen)
        with closing(connect(url)) as conn:
            migrate(conn)
        yield chosen, url
    finally:
        if home is None:
            remove_cluster(chosen)
            shutil.rmtree(chosen, ignore_errors=True)


@contextmanager
def served_view(home: Path, url: str, map_name: str, *options: str) -> Iterator[tuple[str, int]]:
    """`conetl view` on a free port: its address without a slash at the end, and the process id."""
    port = free_port()
    environment = os.environ | {"CONETL_HOME": str(home), "CONETL_DATABASE_URL": url, "CONETL_MAP_NAME": map_name}
    command = [*CONETL, "view", "--port", str(port), "--no-login", *options]
    address = f"http://127.0.0.1:{port}"
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            until(lambda: _answers(address), "the start of the server", every_s=0.1)
            yield address, process.pid
        finally:
            process.send_signal(signal.SIGINT)


def _answers(address: str) -> bool:
    with suppress(OSError), urlopen(f"{address}/", timeout=1):
        return True
    return False


@cache
def evidence_of_model() -> DetectorEvidence:
    """What was measured of the shipped detector, by which simulations draw boxes."""
    evidence = read_model_card(None).evidence
    if evidence is None:
        raise SystemExit("the sidecar of the shipped model has no evidence, which the simulation requires")
    return evidence


def best_ms(work: Callable[[], object], times: int = 30) -> float:
    """The shortest of several runs: the least disturbed by other programs."""
    found = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        found.append(time.perf_counter() - start)
    return 1000 * min(found)


def tree(pid: int | None = None) -> list[psutil.Process]:
    """A process and all its descendants."""
    top = psutil.Process(pid)
    return [top, *top.children(recursive=True)]


def processor_s(*pids: int, name: str = "") -> float:
    """Processor time of process trees, including ended processes that were waited for. name: only processes with this in it."""
    total = 0.0
    for pid in pids:
        for process in tree(pid):
            try:
                if name in process.name():
                    total += sum(process.cpu_times()[:4])
            except psutil.NoSuchProcess:
                continue
    return total


@dataclass
class Stopwatch:
    """Seconds by phase: wall clock, this process, the database's backend; and MB that the backend read from disk."""

    backend_pid: int
    phases: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        start = self._now()
        yield
        self.phases[name] = tuple(b - a for a, b in zip(start, self._now(), strict=True))  # type: ignore[assignment]

    def _now(self) -> tuple[float, float, float, float]:
        backend = psutil.Process(self.backend_pid)
        user_s, system_s = backend.cpu_times()[:2]
        return time.perf_counter(), time.process_time(), user_s + system_s, backend.io_counters().read_bytes / 1e6

    @property
    def total(self) -> tuple[float, float, float, float]:
        return tuple(map(sum, zip(*self.phases.values(), strict=True)))  # type: ignore[return-value]


class Peak:
    """Peak resident memory of this process, and of it with its descendants, sampled once per second."""

    def __init__(self, every_s: float = 1.0) -> None:
        self.bytes = self.own_bytes = 0
        self._every_s, self._stop = every_s, threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)

    def __enter__(self) -> Peak:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._stop.wait(self._every_s):
            sizes = []
            for process in tree():
                try:
                    sizes.append(process.memory_info().rss)
                except psutil.NoSuchProcess:
                    sizes.append(0)
            self.bytes, self.own_bytes = max(self.bytes, sum(sizes)), max(self.own_bytes, sizes[0])


def load() -> float:
    """Load average of the last minute."""
    return round(os.getloadavg()[0], 1)


def print_rows(title: str, rows: Sequence[Mapping[str, object]]) -> None:
    """A table with one column per key of the first row; floats with three significant digits or more."""
    table = Table(title=title, title_justify="left", box=None)
    for number, name in enumerate(rows[0]):
        table.add_column(name, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    Console(width=max(Console().width, 140)).print(table)


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.1f}" if abs(value) >= 100 else f"{value:.3g}"
    return "" if value is None else str(value)


def write_json(path: Path | None, figures: Any) -> None:
    """Write the figures where --json was given."""
    if path is not None:
        path.write_text(json.dumps(figures, indent=2, default=float) + "\n", encoding="utf-8")
        print(f"wrote {path}")
