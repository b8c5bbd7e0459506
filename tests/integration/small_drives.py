"""Drives of a few frame pairs, cut out of the sample drives, as if recorded on other days; and processes of a home folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path

from conetl.pipeline.executor import step

SAMPLES = sorted((Path(__file__).resolve().parents[2] / "data" / "drives").iterdir())
#: Few, since every drive costs the start of a process anyway, and enough to put cones on the map.
FRAMES = range(14, 17)
#: In place of `publish`, whose files take half of the time of a small drive.
unpublished = step("publish")(lambda *_: None)


def cut_drive(
    sample: Path, folder: Path, day: str = "", *, frames: Iterable[int] = FRAMES, poisoned: bool = False
) -> Path:
    """Some frame pairs of a sample drive, recorded on `day` (2026-04-01); poisoned: without one usable pose.

    The numbers of the files link them, so they are kept.
    """
    for name, suffix in (("image_02", "jpg"), ("image_03", "jpg"), ("oxts", "txt")):
        (folder / name / "data").mkdir(parents=True)
        for number in frames:
            file = shutil.copy(sample / name / "data" / f"{number:010d}.{suffix}", folder / name / "data")
            if poisoned and name == "oxts":
                Path(file).write_text("nan nan")
        stamps = (sample / name / "timestamps.txt").read_text()
        (folder / name / "timestamps.txt").write_text(stamps.replace(stamps[:10], day or stamps[:10]))
    for path in sample.glob("calib*.txt"):
        shutil.copy(path, folder)
    return folder


def shift_poses(drive: Path, *, lat_deg: float = 0.0, height_m: float = 0.0, first: int = 0) -> None:
    """Move the logged positions from one record on, as another datum, post-processing or a jump does."""
    for record in sorted((drive / "oxts" / "data").iterdir())[first:]:
        lat, lon, height, *others = record.read_text().split()
        moved = f"{float(lat) + lat_deg:.12f}", lon, f"{float(height) + height_m:.4f}"
        record.write_text(" ".join([*moved, *others]))


def processes_with(variable: str, value: object) -> set[int]:
    """Living processes with this variable in their environment; children inherit it."""
    mark = f"{variable}={value}".encode()
    found = set()
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and mark in (entry / "environ").read_bytes().split(b"\0"):
                found.add(int(entry.name))
        except OSError:  # gone, or another user's
            continue
    return found


def spoil_huffman_table(image: Path) -> None:
    """A JPEG with a whole header and a whole end that no decoder takes."""
    data = bytearray(image.read_bytes())
    lengths = data.index(b"\xff\xc4") + 5
    data[lengths : lengths + 16] = b"\xff" * 16
    image.write_bytes(data)
