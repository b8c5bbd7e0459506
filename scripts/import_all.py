"""Imports every module of conetl, its flows and Prefect's server, so that their bytecode is written.

What an extra needs may be absent.
"""

from __future__ import annotations

import contextlib
import importlib
import pkgutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

for package in ("conetl", "flows"):
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        with contextlib.suppress(ImportError):
            importlib.import_module(module.name)
importlib.import_module("prefect.server.api.server")
importlib.import_module("matplotlib.pyplot")
