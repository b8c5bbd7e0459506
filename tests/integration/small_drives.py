"""Drives of a few frame pairs, cut out of the sample drives, as if recorded on other days; and processes of a home folder."""

from __future__ import annotations

import shutil
from pathlib import Path

SAMPLES = sorted((Path(__file__).resolve().parents[2] / "data" / "drives").iterdir())
#: Few, since every drive costs the start of a process anyway, and enough to put cones on the map.
FRAMES = range(14, 17)


def cut_drive(sample: Path, folder: Path, day: str, *, poisoned: bool = False) -> Path:
    """A few frame pairs of a sample drive, recorded on `day` (2026-04-01); poisoned: without one usable pose."""
    for side in ("image_02", "image_03"):
        (folder / side / "data").mkdir(parents=True)
        for number in FRAMES:
            shutil.copy(sample / side / "data" / f"{number:010d}.jpg", folder / side / "data")
    (folder / "oxts" / "data").mkdir(parents=True)
    for number in FRAMES:
        text = (sample / "oxts" / "data" / f"{number:010d}.txt").read_text()
        (folder / "oxts" / "data" / f"{number:010d}.txt").write_text("nan nan" if poisoned else text)
    for name in ("image_02", "image_03", "oxts"):
        stamps = (sample / name / "timestamps.txt").read_text()
        (folder / name / "timestamps.txt").write_text(stamps.replace(stamps[:10], day))
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
