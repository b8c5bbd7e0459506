"""Plain drive folders: left, right, trajectory.csv, rig.yaml."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conetl.geometry import geodesy
from conetl.model.errors import DriveFolderError
from conetl.model.rejections import RejectionReason as R
from conetl.readers.drives import read_drive
from tests.prepared import prepared

STEMS = ("a10", "a20", "b05", "b06")
CAMERA = "{width_px: 96, height_px: 32, fx_px: 60, fy_px: 60, cx_px: 47.5, cy_px: 15.5}"
BODY = "body_SE3_left: {R: [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], t_m: [1.0, 0.2, 0.7]}\n"
RIG = f"rig_id: bike\nleft: {CAMERA}\nright: {CAMERA}\nbaseline_m: 0.27\n{BODY}"
HEADER = (
    "stem,captured_at,lon_deg,lat_deg,height_m,roll_deg,pitch_deg,yaw_deg,"
    "sigma_e_m,sigma_n_m,sigma_u_m,sigma_roll_deg,sigma_pitch_deg,sigma_yaw_deg"
)


def row(i: int, stem: str, time: str | None = None) -> str:
    return f"{stem},{time or f'2026-03-01T12:00:{i:02d}.5Z'},151.2,-33.9,30,1,2,90,0.02,0.03,0.05,0.1,0.1,0.2"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    root = tmp_path / "plain_run"
    for side in ("left", "right"):
        (root / side).mkdir(parents=True)
        for stem in STEMS:
            cv2.imwrite(str(root / side / f"{stem}.jpg"), np.full((32, 96, 3), 100, np.uint8))
    (root / "rig.yaml").write_text(RIG)
    (root / "trajectory.csv").write_text("\n".join([HEADER, *(row(i, s) for i, s in enumerate(STEMS))]) + "\n")
    return root


@prepared
def edit(drive: Path, name: str, old: str, new: str) -> None:
    text = (drive / name).read_text()
    assert old in text
    (drive / name).write_text(text.replace(old, new, 1))


def test_a_whole_plain_drive(drive: Path) -> None:
    result, rejections = read_drive(drive)
    assert rejections == []
    assert (result.drive_id, result.rig.rig_id, result.map_srid) == ("plain_run", "bike", 32756)
    assert [pair.frame_index for pair in result.frame_pairs] == [0, 1, 2, 3]
    assert [Path(pair.left_path).stem for pair in result.frame_pairs] == list(STEMS)
    pair = result.frame_pairs[2]
    assert pair.captured_at_ns == 1_772_366_402_500_000_000
    np.testing.assert_allclose(pair.pose.map_t_body_m, geodesy.to_map(32756, -33.9, 151.2, 30.0))
    convergence = float(geodesy.grid_convergence_rad(32756, -33.9, 151.2))
    np.testing.assert_allclose(
        Rotation.from_matrix(pair.pose.map_R_body).as_euler("ZYX")[::-1],
        [math.radians(1), math.radians(2), math.pi / 2 + convergence],
        atol=1e-12,
    )
    assert pair.pose.sigma_enu_m == (0.02, 0.03, 0.05)
    assert read_drive(drive)[0].content_sha256 == result.content_sha256


def add_row(text: str) -> Callable[[Path], None]:
    return lambda d: (d / "trajectory.csv").write_text((d / "trajectory.csv").read_text() + text + "\n") and None


LOSSES: dict[str, tuple[Callable[[Path], object], str, R]] = {
    "short row": (edit("trajectory.csv", ",0.1,0.1,0.2\n", "\n"), "a10", R.POSE_INVALID),
    "zero sigma": (edit("trajectory.csv", "0.02,0.03", "0,0.03"), "a10", R.POSE_INVALID),
    "a wild fix at the start": (edit("trajectory.csv", "151.2,", "151.25,"), "a10", R.POSE_INVALID),
    "two rows of one stem": (add_row(row(9, "a20")), "a20", R.POSE_INVALID),
    "no image on either side": (lambda d: [(d / s / "a20.jpg").unlink() for s in ("left", "right")], "a20", R.IMAGE_MISSING),
    "bad time": (edit("trajectory.csv", row(1, "a20"), row(1, "a20", "yesterday")), "a20", R.TIMESTAMP_INVALID),
}  # fmt: skip


@pytest.mark.parametrize("name", LOSSES)
def test_a_broken_pair_costs_that_pair_only(drive: Path, name: str) -> None:
    damage, stem, reason = LOSSES[name]
    damage(drive)
    result, rejections = read_drive(drive)
    assert [(r.record, r.reason) for r in rejections] == [(f"frame pair '{stem}'", reason)]
    assert [Path(pair.left_path).stem for pair in result.frame_pairs] == [s for s in STEMS if s != stem]
    assert result.expected_frame_count == 4


FAILURES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no rig": (lambda d: (d / "rig.yaml").unlink(), "rig.yaml is missing"),
    "rig without a body": (edit("rig.yaml", BODY, ""), "'body_SE3_left' is missing"),
    "no trajectory": (lambda d: (d / "trajectory.csv").unlink(), "trajectory.csv is missing"),
    "column missing": (edit("trajectory.csv", ",sigma_yaw_deg", ",sigma_jaw_deg"), "missing sigma_yaw_deg; unknown sigma_jaw"),
    "no rows": (lambda d: (d / "trajectory.csv").write_text(HEADER + "\n"), "the file has no rows"),
    "focal length in millimetres": (
        edit("rig.yaml", "fx_px: 60, fy_px: 60", "fx_px: 4, fy_px: 4"), "the focal length of the left camera is 4 px",
    ),
    "no images": (lambda d: [p.unlink() for s in ("left", "right") for p in (d / s).iterdir()], "no images"),
    "right folder missing": (lambda d: (d / "right").rename(d / "wrong"), "the folder right is missing"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAILURES)
def test_an_unusable_drive_raises_one_message(drive: Path, name: str) -> None:
    damage, words = FAILURES[name]
    damage(drive)
    with pytest.raises(DriveFolderError) as raised:
        read_drive(drive)
    assert words in str(raised.value)
    assert "plain_run" in str(raised.value)


def test_rolling_shutters_of_drive_yaml_and_rig_yaml(drive: Path) -> None:
    def shutters() -> list[dict[str, object] | None]:
        rig = read_drive(drive)[0].rig
        return [one.shutter and one.shutter.model_dump() for one in (rig.left, rig.right)]

    assert shutters() == [None, None]
    left = CAMERA.replace("15.5}", "15.5, shutter: {readout_ms: 12, stamp_row: last}}")
    (drive / "rig.yaml").write_text(RIG.replace(CAMERA, left, 1))
    assert shutters() == [{"readout_ms": 12.0, "readout_sigma_ms": 0.0, "stamp_row": "last"}, None]
    settings = "shutter: {readout_ms: 10, stamp_row: first, right: {readout_ms: 11, readout_sigma_ms: 0.5}}\n"
    (drive / "drive.yaml").write_text(settings)
    assert shutters() == [
        {"readout_ms": 10.0, "readout_sigma_ms": 0.0, "stamp_row": "first"},
        {"readout_ms": 11.0, "readout_sigma_ms": 0.5, "stamp_row": "first"},
    ]
    (drive / "drive.yaml").write_text("shutter: {stamp_row: first}\n")
    with pytest.raises(DriveFolderError, match="'shutter' needs readout_ms"):
        read_drive(drive)
