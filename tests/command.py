"""The command `conetl` as users run it: in a process of its own; and waiting for what such a process does."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
ROOT = Path(__file__).resolve().parents[1]


def free_port(host: str = "127.0.0.1") -> int:
    """A TCP port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


def until(condition: Callable[[], T], what: str, patience_s: float = 120, every_s: float = 0.02) -> T:
    """What the condition gives once that is something. Fails after a while."""
    deadline = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < deadline, f"timed out: {what}"
        time.sleep(every_s)
    return found


def environment_of(**variables: object) -> dict[str, str]:
    """The environment of this process without what it says to Prefect and conetl, and with these variables."""
    others = {name: value for name, value in os.environ.items() if not name.startswith(("PREFECT_", "CONETL_"))}
    return others | {name: str(value) for name, value in variables.items()}


def conetl(
    *arguments: object, before: str = "", cwd: Path = ROOT, **variables: object
) -> subprocess.CompletedProcess[str]:
    """Run one command. before: Python that runs first. variables: as for `environment_of`."""
    return subprocess.run(
        [sys.executable, "-c", f"{before}\nfrom conetl.cli import main; main()", *map(str, arguments)],
        env=environment_of(**variables), cwd=cwd, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
