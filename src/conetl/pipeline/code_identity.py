"""Which code computed something: a hash over conetl's files, and the versions of its libraries."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from conetl.db.connection import sql_directory

#: Libraries that numbers come from.
_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "onnxruntime", "pyproj", "prefect")


def code_facts() -> dict[str, Any]:
    """Version, hash of the code, Python and the libraries that numbers come from, as JSON values."""
    return {
        "code_version": version("conetl"),
        "code_sha256": code_sha256(),
        "python": platform.python_version(),
        "libraries": {name: found for name in _LIBRARIES if (found := _version(name)) is not None},
    }


@cache
def code_sha256() -> str:
    """SHA-256 over names and bytes of conetl's modules, flows and .sql files; equal in a clone and an installed wheel."""
    flows = find_spec("flows")
    folders = {"conetl": Path(__file__).resolve().parents[1], "sql": sql_directory()}
    if flows is not None and flows.submodule_search_locations:
        folders["flows"] = Path(flows.submodule_search_locations[0])
    total = hashlib.sha256()
    for label, folder in sorted(folders.items()):
        suffix = ".sql" if label == "sql" else ".py"
        for path in sorted(folder.rglob(f"*{suffix}")):
            name = f"{label}/{path.relative_to(folder).as_posix()}"
            total.update(name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
