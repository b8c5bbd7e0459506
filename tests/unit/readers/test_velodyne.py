from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from conetl.geometry import pose as se3
from conetl.model.errors import InputError
from conetl.readers.drives.velodyne import ScanFileError, left_SE3_velo, list_scans, read_scan, scan_period_s
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
