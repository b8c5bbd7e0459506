"""A sample drive in the layouts of many makers: each is the same drive after `conetl init`, or refused with its reason."""

from __future__ import annotations

import re
import shutil
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.geometry import rig as rigs
from conetl.geometry.packing import cov_matrix
from conetl.model.drive import Drive
from conetl.model.health import Verdict
from conetl.perception.rectified_image import read_pair_image, read_rig_image
from conetl.perception.unguided_odometry import measure_motions
from conetl.pipeline.analysis import analyse
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.readers.drives.header import read_header
from conetl.readers.rigs import read_rig
from tests import recordings
from tests.cases import cases
from tests.folders import SHARED
from tests.recordings import Layout, Recorded
from tests.unit.readers import drive_formats as formats


@cache
def sample() -> Recorded:
    frames = formats.sample_frames()
    drive = read_drive(formats.SAMPLE)[0]
    return Recorded(drive.model_copy(update={"frame_pairs": drive.frame_pairs[: len(frames)]}), frames)


def georeference() -> str:
    lat, lon, height = formats.origin_of(sample().frames)[:3]
    return f"{{lon_deg: {lon!r}, lat_deg: {lat!r}, height_m: {height!r}, ATTITUDE}}"


ODOMETRY = SHARED / "kitti_odometry_20"
LAYOUTS = recordings.layouts(georeference())


def attitude_of(name: str) -> str:
    """Of the frame of the poses: level, or that of the first body."""
    if name == "poses in a level frame":
        return f"heading_deg: {formats.HEADING_DEG}"
    roll, pitch, yaw = np.degrees(sample().frames[0].oxts[3:6])  # type: ignore[index]
    return f"heading_deg: {90.0 - yaw}, roll_deg: {roll}, pitch_deg: {pitch}"


def made(name: str, tmp_path: Path) -> tuple[Path, str]:
    """The drive, and what `conetl init` said."""
    layout: Layout = LAYOUTS[name]
    folder = tmp_path / "run"
    folder.mkdir()
    path = layout.write(folder, sample())
    if layout.init is None:
        return path, ""
    words: list[str] = []
    for word in layout.init:
        text = recordings.start_of(sample()) if word == "START" else word.replace("ATTITUDE", attitude_of(name))
        words += [text] if text.startswith("--") else ["--set", text]
    result = CliRunner().invoke(app, ["init", str(path), *words])
    said = f"{result.output}{result.exception}"
    assert layout.refused is not None or result.exit_code == 0, said
    return path, said


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_is_the_same_drive_or_refused(name: str, tmp_path: Path) -> None:
    layout, wanted = LAYOUTS[name], sample().drive
    path, said = made(name, tmp_path)
    if layout.refused is not None:
        assert not (path / "drive.yaml").exists()
        assert re.search(layout.refused, said), said
        return
    header = read_header(path)
    assert (header.problem, header.frame_pairs) == (None, len(wanted.frame_pairs))
    drive, rejections = read_drive(path, images_folder=tmp_path / "images")
    assert rejections == []
    assert len(drive.frame_pairs) == len(wanted.frame_pairs)
    assert drive.rig.baseline_m == pytest.approx(wanted.rig.baseline_m, rel=1e-4)
    for pair, true in zip(drive.frame_pairs, wanted.frame_pairs, strict=True):
        assert abs(pair.captured_at_ns - true.captured_at_ns) < 2_000_000
        found, camera = rigs.map_SE3_left(pair.pose, drive.rig), rigs.map_SE3_left(true.pose, wanted.rig)
        assert np.linalg.norm(found[:3, 3] - camera[:3, 3]) < layout.far_m
        turned = np.arccos(np.clip((np.trace(found[:3, :3].T @ camera[:3, :3]) - 1) / 2, -1, 1))
        assert turned < layout.far_rad
    for n in (0, len(wanted.frame_pairs) - 1):
        for side in ("left", "right"):
            compare_images(drive, wanted, n, side, layout.off_grey)


def compare_images(drive: Drive, wanted: Drive, n: int, side: str, off_grey: float) -> None:
    """What one camera sees in a direction, the other sees there too."""
    image, true = (read_pair_image(d.frame_pairs[n], side, d.rig).astype(np.float32) for d in (drive, wanted))
    own, camera = rigs.camera_of(drive.rig, side), rigs.camera_of(wanted.rig, side)
    scale = np.array([camera.fx_px / own.fx_px, camera.fy_px / own.fy_px])
    shift = np.array([camera.cx_px, camera.cy_px]) - scale * [own.cx_px, own.cy_px]
    warp = np.array([[scale[0], 0, shift[0]], [0, scale[1], shift[1]]])
    size = (camera.width_px, camera.height_px)
    seen = cv2.warpAffine(np.full(image.shape[:2], 255, np.uint8), warp, size, flags=cv2.INTER_NEAREST) == 255
    assert seen.mean() > 0.5
    off = np.abs(cv2.warpAffine(image, warp, size) - true)[seen]
    assert off.mean() < off_grey, (off.mean(), side)


@pytest.fixture(scope="module")
def cones(sample_settings: Settings) -> np.ndarray:
    found = analyse(sample().drive, settings=sample_settings)
    return np.array([track.xyz_m for track in found.tracks])


@pytest.mark.parametrize(
    "name",
    cases(
        "Bayer in CompressedImage",
        release=["binned", "KITTI odometry, colour", "CameraInfo with a region", "Foxglove images"],
    ),
)
def test_cones_are_where_those_of_the_sample_drive_are(name: str, tmp_path: Path, cones: np.ndarray) -> None:
    """Within 2 cm. Images with less detail have the same cones within the sigmas of their own observations.

    Of all 39 frame pairs binned images are 11 mm off (root mean square), 0.7 sigma; the full images with the detail of binned
    ones 7 mm, 0.6 sigma; a mosaic 3 mm, 0.3 sigma. With the colours of another Bayer pattern it would be 1.8 sigma.
    """
    drive, _ = read_drive(made(name, tmp_path)[0], images_folder=tmp_path / "images")
    tracks = analyse(drive, settings=Settings(home=tmp_path / "home", workers=2)).tracks
    off_m = np.array([track.xyz_m for track in tracks]) - cones[:, None]  # (cones, tracks, 3)
    nearest = np.linalg.norm(off_m, axis=2).argmin(axis=1)
    assert sorted(nearest) == [*range(len(tracks))] and len(tracks) == len(cones)
    own_m, limit_m = off_m[np.arange(len(cones)), nearest], LAYOUTS[name].cones_m
    if limit_m is not None:
        assert np.linalg.norm(own_m, axis=1).max() < limit_m
    sigmas = [
        e @ np.linalg.solve(cov_matrix(tracks[k].relative_cov_m2), e) for e, k in zip(own_m, nearest, strict=True)
    ]
    assert np.sqrt(np.mean(sigmas) / 3) < 1.0


@pytest.mark.release
@pytest.mark.skipif(not ODOMETRY.is_dir(), reason=f"KITTI odometry is not at {ODOMETRY}")
def test_kitti_odometry_becomes_a_drive_in_one_round(tmp_path: Path) -> None:
    """Real images; the poses are those of visual odometry."""
    root = tmp_path / "02"
    shutil.copytree(ODOMETRY, root, ignore=shutil.ignore_patterns("*.md"))
    rig = read_rig(root / "calib_cam_to_cam.txt")
    seconds = [float(word) for word in (root / "times.txt").read_text().split()]
    folders = {side: sorted((root / f"image_{camera}").iterdir()) for side, camera in (("left", 2), ("right", 3))}
    motions = measure_motions(
        [round(time_s * 1e9) for time_s in seconds], rig, lambda n, side: read_rig_image(folders[side][n], rig, side)
    )
    poses = [np.eye(4)]
    for motion in motions:
        poses.append(poses[-1] @ np.linalg.inv(np.reshape(motion.second_SE3_first, (4, 4))))
    rows = (" ".join(f"{value:.9e}" for value in pose[:3].reshape(-1)) for pose in poses)
    (root / "poses.txt").write_text("\n".join(rows))
    place = "{lon_deg: 8.43, lat_deg: 49.002, height_m: 116, heading_deg: 57}"
    words = ["--yes", "--set", f"georeference={place}", "--set", "sigmas.horizontal_m=0.1"]
    result = CliRunner().invoke(app, ["init", str(root), *words])
    assert result.exit_code == 0, (result.output, result.exception)
    drive, rejections = read_drive(root)
    assert (len(drive.frame_pairs), rejections) == (20, [])
    found = analyse(drive, settings=Settings(home=tmp_path / "home", workers=2))
    assert [check for check in found.health if check.verdict is Verdict.HOLD] == []
