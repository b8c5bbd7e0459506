"""Linear algebra uses one thread per task."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

# In a process of its own: the libraries read the environment when they are imported.
_COUNT = """
import os, threading
import {first}
import numpy as np, scipy.linalg
a = np.random.default_rng(1).normal(size=(600, 600))
scipy.linalg.lu_factor(a @ a)
print(len(os.listdir("/proc/self/task")))
"""


def threads_after(first: str, environment: dict[str, str]) -> int:
    given = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")} | environment
    done = subprocess.run(
        [sys.executable, "-c", _COUNT.format(first=first)], capture_output=True, text=True, check=True, env=given
    )
    return int(done.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="threads are counted in /proc")
def test_linear_algebra_uses_one_thread_unless_configured() -> None:
    if threads_after("sys", {}) == 1:
        pytest.skip("linear algebra is single-threaded here")
    assert threads_after("conetl", {}) == 1
    assert threads_after("conetl", {"OPENBLAS_NUM_THREADS": "2"}) > 1
