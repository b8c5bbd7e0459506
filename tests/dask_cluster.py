"""A Dask cluster of this machine, for a test or a benchmark."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from distributed import Client

from flows.tasks import DASK_CONFIG
from tests.command import until

#: As docs/operate/deploy.md sets them.
ENVIRONMENT = {
    f"DASK_{name.upper().replace('.', '__').replace('-', '_')}": str(value) for name, value in DASK_CONFIG.items()
}


@contextmanager
def dask_workers(folder: Path, count: int) -> Iterator[tuple[str, dict[str, subprocess.Popen[bytes]]]]:
    """A Dask scheduler on loopback and its workers, each a process of one thread: address, and all processes by name."""
    file, dask = folder / "scheduler.json", [sys.executable, "-m", "dask"]
    commands = {"scheduler": [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]}
    for number in range(count):
        name = f"worker-{number}"
        commands[name] = [*dask, "worker", "--name", name, "--no-nanny", "--nthreads", "1", "--no-dashboard"]
        commands[name] += ["--local-directory", str(folder)]
    with ExitStack() as stack:
        processes = {}
        for name, command in commands.items():
            whole = [*command, "--scheduler-file", str(file)]
            processes[name] = stack.enter_context(subprocess.Popen(whole, env={**os.environ, **ENVIRONMENT}))
            stack.callback(processes[name].kill)
        until(file.exists, "the scheduler's file")
        with Client(scheduler_file=str(file)) as client:
            client.wait_for_workers(count, timeout=120)
            address = client.scheduler.address
        yield address, processes
