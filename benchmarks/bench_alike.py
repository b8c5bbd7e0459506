"""Drives with frame pairs that show the same: processor time and cones beside those of the drive without them.

Every pair three times, as from a camera of 30 Hz whose log has the poses of 10 Hz; the same with poses in between; a stop of 60 s
at 10 Hz. Repeated images have noise of their own.

    python benchmarks/bench_alike.py [--drive FOLDER] [--stop-s 60]
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import arguments_of, own_home, print_rows, write_json
from benchmarks.whole_job import settings_in, source_drive
from conetl.model.drive import Track
from conetl.perception.images import read_image
from conetl.pipeline.analysis import analyse
from conetl.readers.drives import read_drive

#: Seconds since the start, the pair whose images are shown, and where between it and the next one the log is.
Shown = tuple[float, int, float]
_NOISE, _QUALITY = 2.0, 92


def variants(pairs: int, stop_s: float) -> dict[str, list[Shown]]:
    """The drives, by name."""
    middle, stopped = pairs // 2, round(10 * stop_s)
    return {
        "plain": [(k / 10, k, 0.0) for k in range(pairs)],
        "every pair three times": [(k / 10 + j / 30, k, 0.0) for k in range(pairs) for j in range(3)],
        "30 Hz": [(k / 10 + j / 30, k, j / 3) for k in range(pairs - 1) for j in range(3)] + [((pairs - 1) / 10, pairs - 1, 0.0)],
        "a stop": [(k / 10, k, 0.0) for k in range(middle)]
        + [((middle + j) / 10, middle, 0.0) for j in range(stopped)]
        + [((k + stopped) / 10, k, 0.0) for k in range(middle, pairs)],
    }  # fmt: skip


def write_drive(source: Path, folder: Path, shown: Sequence[Shown]) -> Path:
    """A KITTI drive with these pairs; an image that was shown before has noise."""
    names = sorted(path.stem for path in (source / "oxts" / "data").glob("*.txt"))
    records = np.array([(source / "oxts" / "data" / f"{name}.txt").read_text().split() for name in names], dtype=float)
    suffix = next((source / "image_02" / "data").iterdir()).suffix
    rng, begin, seen = np.random.default_rng(1), datetime(2026, 5, 1, 8), set()
    for name in ("image_02", "image_03", "oxts"):
        (folder / name / "data").mkdir(parents=True)
        stamps = (f"{begin + timedelta(seconds=second):%Y-%m-%d %H:%M:%S.%f}000\n" for second, _, _ in shown)
        (folder / name / "timestamps.txt").write_text("".join(stamps))
    for path in source.glob("calib*.txt"):
        shutil.copy(path, folder)
    for k, (_, pair, share) in enumerate(shown):
        for side in ("image_02", "image_03"):
            image, copy = source / side / "data" / f"{names[pair]}{suffix}", folder / side / "data" / f"{k:010d}.jpg"
            if pair not in seen and suffix == ".jpg":
                shutil.copy(image, copy)
                continue
            grey_levels = read_image(image).astype(np.float64)
            noisy = np.clip(grey_levels + rng.normal(0, _NOISE, grey_levels.shape), 0, 255).astype(np.uint8)
            cv2.imwrite(str(copy), noisy, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        seen.add(pair)
        record = records[pair] + share * (records[min(pair + 1, len(records) - 1)] - records[pair])
        whole = [f"{value:.12g}" for value in record[:25]] + [f"{round(value)}" for value in record[25:]]
        (folder / "oxts" / "data" / f"{k:010d}.txt").write_text(" ".join(whole) + "\n")
    return folder


def differences(tracks: Sequence[Track], plain: Sequence[Track]) -> tuple[float, float, float]:
    """Largest difference of a position, m, the same relative to the mean of all, and of an existence probability."""
    own, others = (np.array([track.xyz_m for track in some]) for some in (tracks, plain))
    of = np.linalg.norm(own[:, None] - others, axis=2).argmin(axis=1)
    apart = own - others[of]
    exists = [abs(a.existence_probability - plain[k].existence_probability) for a, k in zip(tracks, of, strict=True)]
    both = (float(np.linalg.norm(one, axis=1).max()) for one in (apart, apart - apart.mean(axis=0)))
    return *both, max(exists)


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--drive", type=Path, help="KITTI drive whose pairs are repeated")
    parser.add_argument("--stop-s", type=float, default=60.0)
    parser.add_argument("--only", default="", help="drives whose name contains this, beside the plain one")
    parser.add_argument("--pairs", type=int, help="only so many of its pairs")
    arguments = parser.parse_args()
    source = source_drive(arguments.drive).resolve()
    pairs = min(len(list((source / "oxts" / "data").glob("*.txt"))), arguments.pairs or 10**9)
    found: dict[str, Sequence[Track]] = {}
    rows: list[dict[str, object]] = []
    plain_s = 0.0
    with own_home() as home:
        for name, shown in variants(pairs, arguments.stop_s).items():
            if name != "plain" and arguments.only not in name:
                continue
            folder = write_drive(source, home / name.replace(" ", "_"), shown)
            settings = settings_in(home / f"of {name}")
            before = time.process_time()
            drive, rejections = read_drive(folder)
            analysed = analyse(drive, rejections=rejections, settings=settings)
            found[name] = analysed.tracks
            spent_s = time.process_time() - before
            plain_s = plain_s or spent_s
            shift_m, relative_m, existence = differences(analysed.tracks, found["plain"])
            rows.append({
                "drive": name, "pairs": len(shown), "searched": len(analysed.drive.frame_pairs),
                "processor s": spent_s, "cones": len(analysed.tracks),
                "apart mm": 1e3 * shift_m, "relative mm": 1e3 * relative_m, "existence apart": existence,
                "findings": sum(check.verdict != "pass" for check in analysed.health), "times plain": spent_s / plain_s,
            })  # fmt: skip
            shutil.rmtree(folder)
    print_rows(f"{pairs} pairs of {source.name}", rows)
    write_json(arguments.json, rows)


if __name__ == "__main__":
    main()
