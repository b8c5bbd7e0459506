"""Names for files that are being written, and what becomes of those whose writer was killed.

A file, or a folder of files that belong together, appears under its own name only when it is whole; until then it is called
`.<name>.<host>.<pid>.<random>.tmp` beside it. A process that is killed leaves such
a file behind. The name says whose it is, so the next run can tell it from one that another process is writing at this moment.
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
    """Where to write a file before it takes the name `path`."""
    return path.with_name(f".{cut_to_bytes(path.name, 100)}.{_host()}.{os.getpid()}.{uuid4().hex}.tmp")


def sweep(folders: Iterable[Path]) -> list[Path]:
    """Remove what killed processes of this machine left in the folders (not below them), also whole folders; the paths removed.

    A file whose process number is in use again is kept until the next time; one that cannot be removed is left.
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
