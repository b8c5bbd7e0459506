"""What the looks of `conetl watch` cost on a long drive: made-up names, no pictures.

python benchmarks/bench_look.py --pairs 36000
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from conetl.readers.recording.drive import ArrivingKitti, open_arriving

STAMP = "2026-03-02 09:41:{:02d}.{:06d}000\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=36_000)
    pairs = parser.parse_args().pairs
    with tempfile.TemporaryDirectory() as name:
        drive = make_drive(Path(name), pairs)
        print(f"{pairs} frame pairs")
        print(f"first look at all          {milliseconds(lambda: drive.new_pairs(None)):9.2f} ms")
        print(f"look at all, nothing new   {least(lambda: drive.new_pairs(None)):9.2f} ms")
        numbers = iter(range(pairs))
        print(
            f"time of a pair             {least(lambda: drive._time('image_02/timestamps.txt', next(numbers))):9.3f} ms"
        )


def make_drive(folder: Path, pairs: int) -> ArrivingKitti:
    """A drive in KITTI's layout of empty files."""
    for camera in ("image_02", "image_03"):
        (folder / camera / "data").mkdir(parents=True)
        for number in range(pairs):
            (folder / camera / "data" / f"{number:010d}.jpg").touch()
        stamps = (STAMP.format(number % 60, number) for number in range(pairs))
        (folder / camera / "timestamps.txt").write_text("".join(stamps))
    drive = open_arriving(folder)
    assert isinstance(drive, ArrivingKitti)
    return drive


def least(call: Callable[[], object], times: int = 7) -> float:
    return min(milliseconds(call) for _ in range(times))


def milliseconds(call: Callable[[], object]) -> float:
    begun = time.perf_counter()
    call()
    return (time.perf_counter() - begun) * 1e3


if __name__ == "__main__":
    main()
