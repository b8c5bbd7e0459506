"""Where tests find the repository, its sample drives, and real data if they are at hand."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = sorted((ROOT / "data" / "drives").iterdir())
SAMPLE = SAMPLES[0]
SHARED = Path(os.environ.get("CONETL_SHARED_DATA", ROOT.parent / "shared" / "data"))
KITTI = SHARED / "kitti_2011_09_26_drive_0005_sync"
needs_kitti = pytest.mark.skipif(
    not KITTI.is_dir(), reason=f"the KITTI drive is not at {KITTI}; set CONETL_SHARED_DATA to the folder that holds it"
)
