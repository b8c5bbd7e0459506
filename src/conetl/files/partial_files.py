"""Names of files that are being written, and removal of those of killed processes.

A file, or a folder of files that belong together, gets its own name only when it is complete; until then its name is
`.<name>.<host>.<pid>.<random>.tmp` beside it. Host and process number distinguish the files of a killed process from those that
another process is writing.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
from collections.abc import Iterable
from pathlib import Path
from uuid import uuid4

from conetl.files.names import cut_to_bytes

_NAME = re.compile(r"\.(?P<host>[A-Za-z0-9-]+)\.(?P<pid>[0-9]+)\.[0-9a-f]{32}\.tmp$")


def aside(path: Path) -> Path:
    """Temporary path of a file that is to get the name `path`."""
    return path.with_name(f".{cut_to_bytes(path.name, 100)}.{_host()}.{os.getpid()}.{uuid4().hex}.tmp")


def sweep(folders: Iterable[Path]) -> list[Path]:
    """Remove temporary files and folders of killed processes of this machine in the folders, not below; the removed paths.

    A file whose process number is in use again is kept; one that cannot be removed is skipped.
    """
    removed = []
    for folder in folders:
        for path in folder.glob(".*.tmp"):
            name = _NAME.search(path.name)
            if name is None or name["host"] != _host() or Path(f"/proc/{name['pid']}").exists():
                continue
            try:
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink()
            except OSError:
                continue
            removed.append(path)
    return removed


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9-]", "-", socket.gethostname()) or "host"
