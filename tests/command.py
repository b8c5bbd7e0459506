"""The command `conetl` as users run it: in a process of its own; and waiting for what such a process does."""

from __future__ import annotations

import atexit
import importlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

T = TypeVar("T")
ROOT = Path(__file__).resolve().parents[1]
#: Commands are forked from a process that has imported what takes them three seconds, all but Prefect, which reads its
#: environment then. The sample drives (`test_ingest.py`) and what is killed start an interpreter of their own.
_FORKS = get_context("forkserver")
_FORKS.set_forkserver_preload(
    [
        "tests.command",
        "conetl.cli.backfill",
        "conetl.cli.ingest",
        "conetl.cli.services",
        "conetl.pipeline.ingest",
        "conetl.reports.drive_page",
        "httpx",
    ]
)


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
    *arguments: object, before: str = "", cwd: Path = ROOT, module: str = "conetl.cli", **variables: object
) -> subprocess.CompletedProcess[str]:
    """Run one command. before: Python that runs first. module: whose `main` runs. variables: as for `environment_of`."""
    words = ["conetl", *map(str, arguments)]
    with TemporaryDirectory() as said:
        process = _FORKS.Process(
            target=_command, args=(words, before, cwd, module, environment_of(**variables), Path(said))
        )
        process.start()
        process.join(600)
        if process.exitcode is None:
            process.kill()
            raise subprocess.TimeoutExpired(words, 600)
        out, err = (Path(said, name).read_text(encoding="utf-8") for name in ("out", "err"))
        return subprocess.CompletedProcess(words, process.exitcode, out, err)


def _command(words: list[str], before: str, cwd: Path, module: str, environment: dict[str, str], said: Path) -> None:
    """What a new interpreter would do, in a process that was just forked."""
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(cwd)
    for stream, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(said / name, os.O_WRONLY | os.O_CREAT), stream)
    sys.argv = words
    try:
        exec(before, {})
        importlib.import_module(module).main()
    finally:
        atexit._run_exitfuncs()  # which processes of `multiprocessing` leave out
