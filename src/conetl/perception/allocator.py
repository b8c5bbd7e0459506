"""How this process's memory allocator treats images."""

from __future__ import annotations

import ctypes
import sys
from functools import cache

# From glibc's malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LARGEST_KEPT_BYTES = 32 * 2**20
_KEPT_BYTES = 128 * 2**20


@cache
def keep_freed_images() -> bool:
    """Let the allocator use the memory of the last image for the next one; False where it cannot be told so.

    glibc gives arrays of more than 128 kB pages of their own, and hands them back to the kernel when they are freed. Each new
    image and each array computed from it then begins with thousands of page faults, which on virtual machines cost more than
    many a computation (half of the search for corners, a tenth of the detection). At most 128 MB a thread stay with the process.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    if mallopt is None:
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, _LARGEST_KEPT_BYTES) and mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES))
