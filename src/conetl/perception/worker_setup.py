"""Process settings that make image processing in several threads cheaper."""

from __future__ import annotations

import ctypes
import sys
from functools import cache

import cv2

# From glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LARGEST_KEPT_BYTES = 32 * 2**20
_KEPT_BYTES = 128 * 2**20


@cache
def set_up_worker() -> None:
    """Prepare this process for tasks that each process images in one thread. Results do not depend on it.

    OpenCV gets one thread per call: the tasks keep all cores busy, and its waiting helper threads cost a fifth of the odometry.
    glibc reuses the memory of freed images: by default it requests new pages for arrays of more than 128 kB, and the thousands of
    page faults per image cost half of the search for corners and a tenth of the detection. At most 128 MB per thread stay with
    the process.
    """
    cv2.setNumThreads(1)
    if sys.platform.startswith("linux") and hasattr(libc := ctypes.CDLL(None), "mallopt"):  # musl lacks mallopt
        libc.mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT_BYTES)
        libc.mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
