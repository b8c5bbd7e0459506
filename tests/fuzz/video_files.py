"""Small drives of stereo video for the fuzzer: how to write them, and how to read them to the last frame."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import av
import cv2
import numpy as np

from conetl.geometry.rig import camera_of
from conetl.model.errors import ConetlError, StorageError
from conetl.model.rig import Rig
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_pair_image
from conetl.perception.video import index_video
from conetl.perception.video_sync import find_video_lag
from conetl.readers.drives import read_drive
from conetl.readers.drives.drive_yaml import read_drive_yaml
from conetl.readers.drives.header import read_header
from conetl.readers.drives.proposals import propose
from conetl.readers.drives.video import preview
from conetl.readers.rigs import write_rig_yaml
from tests.prepared import prepared
from tests.video_drives import write_frames

START_S, RATE_HZ = 1_772_445_600, 10
CODECS = {
    "mp4": ("libx264", {"crf": "35", "g": "3", "bf": "1"}), "mkv": ("mjpeg", {"q:v": "9"}), "avi": ("mjpeg", {"q:v": "9"}),
    "ts": ("libx264", {"crf": "35", "bf": "0"}),
}  # fmt: skip
#: All that drive.yaml says of a video drive, for the mutations of texts.
SETTINGS = """images: {{left: left.{0}, right: right.{0}, every: 1, from_s: 0, to_s: 9, right_offset_s: 0.0,
  start: '2026-03-02 10:00:00.25Z'}}
trajectory: {{file: poses.csv, time: utc, heights: ellipsoidal}}
mount: {{forward_m: 1.2, left_m: 0.3, up_m: -0.2, pitch_deg: 3, yaw_deg: 1, roll_deg: -1}}
clock: {{offset_s: 0.0, sigma_s: 0.01, search_s: 30}}
"""


def shaken(count: int, width: int, height: int) -> list[np.ndarray]:
    """Images (height, width, 3) of a camera that shakes, the same in every run."""
    rng = np.random.default_rng(3)
    scene = cv2.resize(rng.integers(0, 255, (12, 30, 3), dtype=np.uint8), (width + 40, height + 16))
    offsets = np.clip(np.cumsum(rng.normal(0, 3, (count, 2)), axis=0) + np.array((20, 8)), 0, (40, 16)).astype(int)
    return [scene[y : y + height, x : x + width] for x, y in offsets]


@prepared
def write_video(folder: Path, suffix: str, rig: Rig, frames: int, settings: str = SETTINGS) -> Path:
    root = folder / "run"
    root.mkdir()
    images = shaken(frames, rig.left.width_px, rig.left.height_px)
    times_ns = [n * 10**9 // RATE_HZ for n in range(frames)]
    codec, options = CODECS[suffix]
    for side in ("left", "right"):
        write_frames(root / f"{side}.{suffix}", images, times_ns, codec, options)
    write_rig_yaml(rig, root / "rig.yaml")
    rows = [
        f"{START_S + n / 5},{49 + 5e-6 * n},{8.4 + 3e-7 * n * n},115,0.05,0.05,0.1" for n in range(-4, frames // 2 + 4)
    ]
    (root / "poses.csv").write_text("\n".join(["time,lat,lon,h_ell,sigma_e,sigma_n,sigma_u", *rows]) + "\n")
    (root / "times.txt").write_text("".join(f"{START_S + t / 1e9:.3f}\n" for t in times_ns))
    (root / "drive.yaml").write_text(settings.format(suffix))
    return root


def read_video_drive(path: Path, _: Path) -> object:
    """Header, drive and every image. An image may be broken or have changed, but has the size that the rig states."""
    header = read_header(path)
    header.shown_path.encode()
    drive, rejections = read_drive(path)
    drive.model_dump_json()
    for pair in drive.frame_pairs[:20]:
        for side in ("left", "right"):
            with suppress(ImageFileError, StorageError):
                image = read_pair_image(pair, side, drive.rig)
                camera = camera_of(drive.rig, side)
                assert image.shape == (camera.height_px, camera.width_px, 3), image.shape
    return [header, drive, *rejections]


def search_times(path: Path, _: Path) -> object:
    """What `conetl init` does: a proposal, then the shift of both files and the clock."""
    found: list[object] = []
    for search in (
        lambda: propose(path, {"mount": {"forward_m": 1, "left_m": 0, "up_m": 0}}),
        lambda: find_video_lag(index_video(path / "left.mp4"), index_video(path / "right.mp4")),
        lambda: preview(path, read_drive_yaml(path)),
    ):
        try:
            found.append(search())
        except (ConetlError, ImageFileError) as error:
            found.append(str(error))
    return found


def quiet() -> None:
    """The library's own messages would fill the fuzzer's pipe."""
    av.logging.set_level(av.logging.PANIC)
