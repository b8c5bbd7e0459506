"""Freed images stay with the process."""

from __future__ import annotations

import subprocess
import sys

import pytest

# In a process of its own: the settings cannot be undone.
_COUNT = """
import resource
import numpy as np
from conetl.perception.worker_setup import set_up_worker
if {keep}:
    set_up_worker()
def images():
    return [np.ones(1_500_000, dtype=np.uint8) for _ in range(6)]
for _ in range(3):
    images()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(10):
    images()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a setting of glibc")
def test_pages_of_a_freed_image_serve_the_next_one() -> None:
    faults = {
        keep: int(subprocess.check_output([sys.executable, "-c", _COUNT.format(keep=keep)], text=True))
        for keep in (False, True)
    }
    if faults[False] < 1_000:
        pytest.skip(f"this C library keeps freed memory anyway ({faults[False]} page faults)")
    assert faults[True] < faults[False] / 10
