"""OXTS records of KITTI (GNSS/INS): a folder with data/*.txt, 30 numbers a file, and timestamps.txt.

Fields used: 0 lat, 1 lon (degrees), 2 alt (m, ellipsoidal), 3 roll, 4 pitch, 5 yaw (rad, yaw 0 = true east, counter-
clockwise), 23 pos_accuracy (m, north/east). KITTI's `dataformat.txt` describes all of them.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.files.documents import input_errors
from conetl.geometry import pose as se3
from conetl.model.errors import InputError
from conetl.readers.trajectories.clocks import TimeFormat, time_reader
from conetl.readers.trajectories.recorded import VERTICAL_FACTOR, Reading, Records, check_fix
from conetl.readers.trajectories.settings import TrajectoryFile

FIELD_COUNT = 30
MAX_POS_ACCURACY_M = 100.0
MAX_FILES = 1_000_000
MAX_RECORD_BYTES = 10_000
_MAX_STAMPS_BYTES = 64_000_000


class OxtsRecord(NamedTuple):
    """The fields of one OXTS file that conetl uses."""

    lat_deg: float
    lon_deg: float
    height_m: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    pos_accuracy_m: float


def parse_oxts(text: str, *, accuracy_required: bool = True) -> OxtsRecord:
    """The record of one OXTS file. Raises ValueError with what was found and expected.

    accuracy_required: refuse a `pos_accuracy` that cannot be a sigma; unnecessary where drive.yaml gives the sigma.
    """
    words = text.split()
    if len(words) != FIELD_COUNT:
        raise ValueError(f"expected {FIELD_COUNT} numbers, found {len(words)}")
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise ValueError(f"expected {FIELD_COUNT} numbers, found text that is not a number") from None
    lat, lon, height, roll, pitch, yaw = values[:6]
    record = OxtsRecord(lat, lon, height, roll, pitch, yaw, values[23])
    for name, value, turns in (("roll_rad", roll, 0.5), ("pitch_rad", pitch, 0.25), ("yaw_rad", yaw, 1.0)):
        limit = 2 * math.pi * turns + 1e-3
        if not abs(value) <= limit:  # NaN and infinity fail too
            raise ValueError(f"{name} is {value}, expected a number between {-limit:g} and {limit:g}")
    check_fix(lat, lon, height)
    if accuracy_required and not 0.0 < record.pos_accuracy_m <= MAX_POS_ACCURACY_M:
        raise ValueError(
            f"pos_accuracy is {record.pos_accuracy_m}, expected metres between 0 and {MAX_POS_ACCURACY_M:g}; "
            "give sigmas.horizontal_m in drive.yaml if the recorder does not write it"
        )
    return record


def folder_of(path: Path) -> Path | None:
    """The folder with data and timestamps.txt: the path itself or its folder oxts; None for anything else."""
    return next((f for f in (path, path / "oxts") if (f / "data").is_dir() and (f / "timestamps.txt").is_file()), None)


def looks_like(path: Path) -> bool:
    """Whether a folder holds OXTS records: its first text file has their number of values."""
    folder = folder_of(path)
    if folder is None:
        return False
    first = next((p for p in islice((folder / "data").iterdir(), 10) if p.suffix == ".txt"), None)
    return first is not None and len(_text(first, MAX_RECORD_BYTES).split()) == FIELD_COUNT


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The records of a folder. Raises InputError."""
    folder = folder_of(path)
    if folder is None:
        raise InputError(f"{path}: expected a folder with data/*.txt and timestamps.txt, as KITTI's oxts")
    return Reading(_records(folder, settings))


def _records(folder: Path, settings: TrajectoryFile) -> Iterator[Records]:
    with input_errors(folder):
        with os.scandir(folder / "data") as entries:
            found = (Path(e.path) for e in entries if e.name.endswith(".txt"))
            files = {
                int(p.stem): p
                for p in islice(found, MAX_FILES)
                if p.stem.isascii() and p.stem.isdigit() and len(p.stem) < 19
            }
        lines = _text(folder / "timestamps.txt", _MAX_STAMPS_BYTES).splitlines()
        numbers = [number for number in sorted(files) if number < len(lines)]
        times, wrong = time_reader(TimeFormat(settings.scale("UTC"), "stamp"))(
            [lines[number] for number in numbers], None
        )
        values = np.full((len(numbers), len(OxtsRecord._fields)), np.nan)
        for i, number in enumerate(numbers):
            try:
                values[i] = parse_oxts(_text(files[number], MAX_RECORD_BYTES), accuracy_required=False)
            except ValueError as error:
                wrong.setdefault(i, str(error))
    rotations = se3.rotation_from_rpy(values[:, 3], values[:, 4], values[:, 5])
    sigma = np.full((len(numbers), 6), np.nan)
    accuracy = np.where((values[:, 6] > 0) & (values[:, 6] <= MAX_POS_ACCURACY_M), values[:, 6], np.nan)
    sigma[:, :3] = accuracy[:, None] * np.array([1.0, 1.0, VERTICAL_FACTOR])
    if numbers:
        yield Records(times, values[:, :3], rotations, sigma, wrong, (files[number].name for number in numbers))


def _text(path: Path, max_bytes: int) -> str:
    with path.open("rb") as file:
        return file.read(max_bytes).decode("utf-8", errors="replace")
