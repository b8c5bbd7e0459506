from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from conetl.geometry import pose as se3
from conetl.geometry.rig import map_SE3_left
from conetl.model.drive import FramePair, Pose
from conetl.model.errors import InputError
from conetl.readers.drives.velodyne import (
    ScanFileError,
    left_SE3_velo,
    list_scans,
    points_at_exposure,
    read_scan,
    scan_period_s,
)
from conetl.readers.rigs import CAM_TO_CAM, IMU_TO_VELO, read_kitti_rig
from conetl.simulation.trajectory import CAM0_SE3_VELO, RECT_R_CAM0, T_RECT_M
from tests.folders import SAMPLE


def write_scan(folder: Path, number: int, points: np.ndarray) -> Path:
    data = folder / "velodyne_points" / "data"
    data.mkdir(parents=True, exist_ok=True)
    path = data / f"{number:010d}.bin"
    points.astype("<f4").tofile(path)
    return path


def test_scans_are_found_by_number_and_read_as_written(tmp_path: Path) -> None:
    points = np.array([[5.0, 1.0, -1.5, 0.3], [7.0, -1.0, -1.4, 0.1]])
    write_scan(tmp_path, 7, points)
    write_scan(tmp_path, 12, points)
    (tmp_path / "velodyne_points" / "data" / "notes.bin").write_bytes(b"x")
    scans = list_scans(tmp_path)
    assert list(scans) == [7, 12]
    assert read_scan(scans[7]) == pytest.approx(points.astype(np.float32))


@pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir])
def test_what_is_no_file_is_left_out(make: Callable[[Path], object], tmp_path: Path) -> None:
    make(tmp_path / "1.bin")
    with pytest.raises(ScanFileError, match=r"1.bin: this is a folder, a pipe or a broken link.*left out"):
        read_scan(tmp_path / "1.bin")


def test_a_drive_without_lidar_has_no_scans(tmp_path: Path) -> None:
    assert list_scans(tmp_path) == {}


def test_points_without_echo_are_left_out(tmp_path: Path) -> None:
    points = np.array([[5.0, 1.0, -1.5, 0.3], [np.nan, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [np.inf, 1.0, 1.0, 0.2]])
    assert read_scan(write_scan(tmp_path, 0, points)).shape == (1, 4)


@pytest.mark.parametrize("content", [b"", b"12345", np.full((3, 4), np.nan, "<f4").tobytes()])
def test_a_bad_file_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "0000000003.bin"
    path.write_bytes(content)
    with pytest.raises(ScanFileError, match=r"0000000003\.bin"):
        read_scan(path)
    with pytest.raises(ScanFileError, match="cannot be read"):
        read_scan(tmp_path / "0000000004.bin")


def test_the_period_is_that_of_the_time_stamps(tmp_path: Path) -> None:
    folder = tmp_path / "velodyne_points"
    folder.mkdir()
    assert scan_period_s(tmp_path) == 0.1
    (folder / "timestamps_start.txt").write_text("2011-09-26 13:04:39.50\n2011-09-26 13:04:39.60\nnonsense\n")
    (folder / "timestamps_end.txt").write_text(
        "2011-09-26 13:04:39.62\n2011-09-26 13:04:39.72\n2011-09-26 13:04:39.82\n"
    )
    assert scan_period_s(tmp_path) == pytest.approx(0.12)


def test_the_chain_from_the_scanner_to_the_left_camera_is_kittis() -> None:
    rig = read_kitti_rig(SAMPLE / CAM_TO_CAM, body_required=True)
    found = left_SE3_velo(rig, SAMPLE)
    # The same numbers, multiplied out on their own.
    expected = se3.se3(np.eye(3), T_RECT_M[2]) @ se3.se3(RECT_R_CAM0, np.zeros(3)) @ CAM0_SE3_VELO
    assert found == pytest.approx(expected, abs=1e-6)


def test_a_broken_calibration_is_refused_by_name(tmp_path: Path) -> None:
    rig = read_kitti_rig(SAMPLE / CAM_TO_CAM, body_required=True)
    (tmp_path / IMU_TO_VELO).write_text("R: 1 0 0\nT: 0 0 0\n")
    with pytest.raises(InputError, match=IMU_TO_VELO):
        left_SE3_velo(rig, tmp_path)


def test_points_are_where_they_were_at_the_exposure() -> None:
    """A car in a bend, and each point seen when the scanner points to it."""
    rig = read_kitti_rig(SAMPLE / CAM_TO_CAM, body_required=True)
    left_of_velo = left_SE3_velo(rig, SAMPLE)

    def pose(t_s: float) -> Pose:
        yaw = 0.7 + 0.2 * t_s
        at = 60.0 * np.array([np.sin(yaw), -np.cos(yaw), 0.0])  # 12 m/s
        return se3.to_pose(se3.se3(se3.rotation_from_rpy(0.0, 0.0, yaw), at), np.full(6, 0.01))

    def in_scanner(points_m: np.ndarray, t_s: float) -> np.ndarray:
        to_velo = se3.invert(map_SE3_left(pose(t_s), rig) @ left_of_velo)
        return np.asarray(to_velo[:3, :3] @ points_m + to_velo[:3, 3])

    true = np.array([[4.0, 7.0, -1.0], [9.0, 0.0, -1.5], [5.0, -6.0, 0.5]])
    back = map_SE3_left(pose(0.1), rig) @ left_of_velo
    seen = true.copy()
    for _ in range(5):
        times_s = 0.1 + np.arctan2(seen[:, 1], seen[:, 0]) / (2 * np.pi) * 0.1
        seen = np.array([in_scanner(back[:3, :3] @ p + back[:3, 3], t) for p, t in zip(true, times_s, strict=True)])
    start_ns = 1_700_000_000_000_000_000
    pairs = {
        k: FramePair(
            frame_index=k, left_path="", right_path="", captured_at_ns=start_ns + k * 10**8, pose=pose(k * 0.1)
        )
        for k in range(3)
    }
    found = points_at_exposure(seen, pairs[1], pairs, rig, left_of_velo, 0.1)
    assert np.abs(seen - true).max() > 0.1
    assert found == pytest.approx(true, abs=0.01)
