"""A sample drive as a plain folder, written piece by piece."""

from __future__ import annotations

import csv
import io
import math
import shutil
from pathlib import Path

from conetl.readers.drives import read_drive
from conetl.readers.drives.plain import Row
from conetl.readers.rigs.rig_yaml import write_rig_yaml
from conetl.readers.trajectories.oxts import parse_oxts

SAMPLE = sorted((Path(__file__).resolve().parents[1] / "data" / "drives").iterdir())[0]
FRAMES = range(10, 22)


def begin(folder: Path) -> Path:
    """A plain folder before the first image: folders, rig and the head of trajectory.csv."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    drive, _ = read_drive(SAMPLE, headers_only=True)
    write_rig_yaml(drive.rig, folder / "rig.yaml")
    (folder / "trajectory.csv").write_text(",".join(Row.model_fields) + "\n")
    return folder


def image(number: int, side: str) -> tuple[bytes, str]:
    """Bytes and name of one image."""
    camera = {"left": "image_02", "right": "image_03"}[side]
    return (SAMPLE / camera / "data" / f"{number:010d}.jpg").read_bytes(), f"{number:06d}.jpg"


def write_images(folder: Path, number: int) -> None:
    for side in ("left", "right"):
        data, name = image(number, side)
        (folder / side / name).write_bytes(data)


def row(number: int, **changes: object) -> str:
    """The pair's line of trajectory.csv, with its newline."""
    record = parse_oxts((SAMPLE / "oxts" / "data" / f"{number:010d}.txt").read_text())
    stamp = (SAMPLE / "image_02" / "timestamps.txt").read_text().splitlines()[number]
    degrees = [math.degrees(angle) for angle in (record.roll_rad, record.pitch_rad, record.yaw_rad)]
    sigmas = ["0.02", "0.02", "0.03", "0.05", "0.05", "0.15"]
    values = [f"{number:06d}", stamp, record.lon_deg, record.lat_deg, record.height_m, *degrees, *sigmas]
    named = dict(zip(Row.model_fields, values, strict=True)) | changes
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(named.values())
    return text.getvalue()


def append(folder: Path, text: str) -> None:
    with (folder / "trajectory.csv").open("a") as file:
        file.write(text)


def kitti_head(folder: Path) -> Path:
    """A KITTI folder before the first image."""
    for name in ("image_02", "image_03", "oxts"):
        (folder / name / "data").mkdir(parents=True)
        (folder / name / "timestamps.txt").write_text("")
    for path in SAMPLE.glob("calib*.txt"):
        shutil.copy(path, folder)
    return folder
