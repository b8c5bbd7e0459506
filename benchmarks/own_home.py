"""A folder of its own for a benchmark that starts Prefect, which reads its environment when it is imported: nothing here does."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from conetl.pipeline.settings import prefect_environment


@contextmanager
def own_home() -> Iterator[Path]:
    """CONETL_HOME in a temporary folder, to which Prefect's environment points: enter it before the first import of Prefect."""
    with tempfile.TemporaryDirectory(prefix="conetl-bench-") as folder:
        home = Path(folder) / "home"
        (home / "prefect").mkdir(parents=True)
        os.environ.update(prefect_environment(home))
        yield home
