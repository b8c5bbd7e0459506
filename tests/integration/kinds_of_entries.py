"""A folder with forty kinds of entries, as they arrive in a drop folder: drives, good or not, and everything else."""

from __future__ import annotations

import os
import shutil
import sqlite3
import tarfile
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from tests.integration.small_drives import SAMPLES, cut_drive, shift_poses

#: A name that a terminal, a page or Prefect would read as something else.
NAUGHTY = "2026-07-01 \x1b[31m<b>[red]:thumbs_up:\n"


class Expected(NamedTuple):
    """The line of one entry in the plan."""

    action: str
    why: str
    """Part of its reason."""
    command: str = ""
    """Part of its command."""


@dataclass
class _Kinds:
    """The folder that is filled, and what the plan says of each path in it."""

    root: Path
    expected: dict[str, Expected] = field(default_factory=dict)

    def part(self, name: str) -> Path:
        """A path whose folder exists."""
        (self.root / name).parent.mkdir(parents=True, exist_ok=True)
        return self.root / name

    def kind(self, name: str, action: str, why: str, command: str = "") -> Path:
        self.expected[name] = Expected(action, why, command)
        return self.part(name)

    def text(self, name: str, action: str, why: str, command: str = "", content: str = "x\n") -> None:
        self.kind(name, action, why, command).write_text(content)


def make_kinds(root: Path, outside: Path) -> dict[str, Expected]:
    """Fill a folder; what the plan says of each path in it. outside: a folder that must not be read."""
    kinds = _Kinds(root)
    _add_drives(kinds)
    _add_links(kinds, outside)
    _add_for_init(kinds)
    _add_strays(kinds)
    return kinds.expected


def _add_drives(kinds: _Kinds) -> None:
    # Every one that is ingested costs seconds, so there are three
    cut_drive(SAMPLES[0], kinds.kind("good", "ingest", "new"), "2026-06-01")
    shutil.copytree(kinds.root / "good", kinds.kind("same name/good", "skip", "the same recording as"))
    held = cut_drive(
        SAMPLES[1], kinds.kind("2026/06/03/van 1/held", "ingest", "new"), "2026-06-03", frames=range(12, 17)
    )
    shift_poses(held, height_m=-48.0)
    damaged = cut_drive(SAMPLES[0], kinds.kind("damaged", "refuse", "time stamp", "conetl inspect"), "2026-06-05")
    (damaged / "image_02" / "timestamps.txt").write_text("never\n")
    no_calibration = cut_drive(SAMPLES[0], kinds.kind("no calibration", "refuse", "calib_cam_to_cam.txt"), "2026-06-06")
    for path in no_calibration.glob("calib*"):
        path.unlink()
    no_images = cut_drive(SAMPLES[0], kinds.kind("no images", "refuse", "there are no images"), "2026-06-07")
    for image in no_images.rglob("*.jpg"):
        image.unlink()
    settings = cut_drive(SAMPLES[0], kinds.kind("wrong settings", "refuse", "drive.yaml"), "2026-06-08")
    (settings / "drive.yaml").write_text("sigmas: {horizontal: 1}\n")
    kinds.kind("only settings", "refuse", "image_02", "conetl inspect")
    kinds.part("only settings/drive.yaml").write_text("drive_id: x\n")
    # A drive in a drive, and loose files that make the folder around a drive look like one
    cut_drive(
        SAMPLES[0],
        kinds.kind("good/again/inner", "not recognised", "a drive inside the drive", "conetl ingest"),
        "2026-06-10",
    )
    cut_drive(SAMPLES[0], kinds.kind(f"loose/{NAUGHTY}", "ingest", "new"), "2026-06-04")
    kinds.text("loose/drive.yaml", "not recognised", "a part of a drive", "mv")
    kinds.text("loose/clip.mp4", "not recognised", "a video or an image alone", "conetl init")


def _add_links(kinds: _Kinds, outside: Path) -> None:
    kinds.kind("link to a drive", "skip", "the same recording as").symlink_to(kinds.root / "same name" / "good")
    kinds.kind("broken link", "not recognised", "a broken link: No such file", "rm").symlink_to(kinds.root / "gone")
    kinds.kind("round", "not recognised", "a broken link: Too many levels", "rm").symlink_to("round")
    kinds.kind("deep/up", "not recognised", "a link to a folder that it is in", "rm").symlink_to(kinds.root)
    cut_drive(SAMPLES[0], outside / "private", "2026-06-12")
    kinds.kind("link outside", "not recognised", "outside of the folders", "rm").symlink_to(outside / "private")
    linked = cut_drive(SAMPLES[0], kinds.kind("linked stamps", "refuse", "outside of the folders"), "2026-06-13")
    (outside / "secret.txt").write_text("kinds.root:x:0:0\n")
    (linked / "image_02" / "timestamps.txt").unlink()
    (linked / "image_02" / "timestamps.txt").symlink_to(outside / "secret.txt")


def _add_for_init(kinds: _Kinds) -> None:
    """What `conetl init` makes drives of, bags, and archives."""
    an_image = next((SAMPLES[0] / "image_02" / "data").iterdir())
    for name in (
        "cameras/left_cam",
        "cameras/right_cam",
        "plain without log/left",
        "plain without log/right",
        "one camera",
    ):
        shutil.copy(an_image, kinds.part(f"{name}/0.jpg"))
    kinds.kind("cameras", "needs init", "2 folders of images", "conetl init")
    kinds.kind("plain without log", "needs init", "images without trajectory.csv", "conetl init")
    kinds.kind("one camera", "needs init", "images of one folder", "conetl init")
    kinds.kind("videos", "needs init", "videos without a drive.yaml", "conetl init")
    for name in ("videos/left.mp4", "videos/track.gpx"):
        kinds.part(name).write_text("x\n")
    # Bags and parts of them
    kinds.kind("cut off.mcap", "refuse", "bag", "conetl inspect").write_bytes(b"\x89MCAP0\r\n")
    kinds.kind("another.mcap", "refuse", "bag").write_bytes(b"\x89MCAP0\r\n")
    with sqlite3.connect(
        kinds.kind("bag_0.db3", "not recognised", "without its metadata.yaml", "ros2 bag reindex")
    ) as made:
        made.execute("create table topics (id integer)")
    kinds.text("run.svo2", "not recognised", "ZED", "svo_export.py")
    # Archives
    with zipfile.ZipFile(kinds.kind("drive.zip", "not recognised", "an archive", "unzip"), "w") as archive:
        archive.write(kinds.root / "good" / "calib_cam_to_cam.txt", "drive/calib_cam_to_cam.txt")
    for end, command in (
        (".7z", "7z x"),
        (".rar", "unrar x"),
        (".csv.gz", "gunzip"),
        (".mcap.zst", "unzstd"),
        (".tar.lz4", "unlz4"),
    ):
        kinds.text(f"packed{end}", "not recognised", "an archive", command)
    kinds.text("run.bag.active", "not recognised", "did not end", "rosbag reindex")
    with tarfile.open(kinds.kind("drive.tar.gz", "not recognised", "an archive", "tar -xf"), "w:gz") as archive:
        archive.add(kinds.root / "good" / "calib_cam_to_cam.txt")


def _add_strays(kinds: _Kinds) -> None:
    kinds.text("README.txt", "not recognised", "no recording", "mv")
    kinds.text("track.nmea", "not recognised", "no recording", "mv")
    kinds.text("drive.yaml", "not recognised", "a part of a drive", "mv", "drive_id: all\n")
    kinds.text("clip.mp4", "not recognised", "a video or an image alone", "conetl init")
    kinds.text("2026-03-09_drive_0042_sync", "not recognised", "a drive is a folder or a bag", "mv")
    kinds.text("<img src=x>[bold].pdf", "not recognised", "no recording", "mv")
    shutil.copytree(kinds.root / "good" / "oxts", kinds.kind("oxts", "not recognised", "a part of a drive", "mv"))
    for name in ("a.csv", "b.csv"):
        kinds.part(f"logs/{name}").write_text("x\n")
    kinds.kind("logs", "not recognised", "neither images nor videos", "mv")
    kinds.kind("empty", "not recognised", "the folder is empty", "rmdir").mkdir()
    for number in range(30):
        (kinds.root / f"{number:010d}.jpg").write_bytes(b"\xff\xd8")
    kinds.expected["30 files *.jpg"] = Expected("not recognised", "a video or an image alone")
    cut_drive(SAMPLES[0], kinds.root / "1/2/3/4/5/6/7", "2026-06-14")
    kinds.kind("1/2/3/4/5/6", "not recognised", "deeper than 6 levels", "conetl backfill")
    os.mkfifo(kinds.kind("pipe", "not recognised", "a pipe", "rm"))
    cut_drive(SAMPLES[0], kinds.kind(".hidden", "skip", "hidden"), "2026-06-15")
    kinds.text(".DS_Store", "skip", "hidden")
    odd = kinds.root / os.fsdecode(b"M\xfcnchen")
    cut_drive(SAMPLES[0], odd, "2026-06-16", frames=range(14, 15))
    kinds.expected["M\\xfcnchen"] = Expected("refuse", "not UTF-8")
