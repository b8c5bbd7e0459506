"""Private clusters of tests and benchmarks, which leave nothing behind."""

from __future__ import annotations

import shutil
from pathlib import Path

from conetl.db.cluster.cluster import cluster_down
from conetl.db.cluster.location import POINTER_NAME, find_location


def remove_cluster(home: Path) -> None:
    """Stop the private cluster of a home folder, if there is one, and delete its data."""
    cluster_down(home)
    location = find_location(home) if home.is_dir() else None
    if location is not None:
        shutil.rmtree(location.socket_directory, ignore_errors=True)
        shutil.rmtree(location.directory)
        (home / POINTER_NAME).unlink(missing_ok=True)
