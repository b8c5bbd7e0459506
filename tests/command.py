"""The command `conetl` as users run it: in a process of its own."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def free_port(host: str = "127.0.0.1") -> int:
    """A TCP port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


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
