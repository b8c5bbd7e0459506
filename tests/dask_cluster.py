"""A Dask cluster of this machine, for a test or a benchmark."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from distributed import Client


@contextmanager
def dask_workers(folder: Path, count: int) -> Iterator[tuple[str, dict[str, subprocess.Popen[bytes]]]]:
    """A Dask scheduler on loopback and its workers, each a process of one thread: address, and processes by name."""
    file, dask = folder / "scheduler.json", [sys.executable, "-m", "dask"]
    commands = {"scheduler": [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]}
    for number in range(count):
        name = f"worker-{number}"
        commands[name] = [*dask, "worker", "--name", name, "--no-nanny", "--nthreads", "1", "--no-dashboard"]
        commands[name] += ["--local-directory", str(folder)]
    with ExitStack() as stack:
        processes = {}
        for name, command in commands.items():
            processes[name] = stack.enter_context(subprocess.Popen([*command, "--scheduler-file", str(file)]))
            stack.callback(processes[name].kill)
        deadline = time.monotonic() + 120
        while not file.exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        with Client(scheduler_file=str(file)) as client:
            client.wait_for_workers(count, timeout=120)
            address = client.scheduler.address
        yield address, {name: process for name, process in processes.items() if name != "scheduler"}
