"""LiDAR scans of a KITTI drive: `velodyne_points/data/*.bin`, four float32 a point (x, y, z in metres, reflectance).

Frame: the velodyne's, x forward, y left, z up. The scanner turns counter-clockwise seen from above, once a frame, and the
cameras are triggered when it looks straight ahead (Geiger et al., IJRR 2013, and the data set's own notes); a point seen at
another azimuth was taken earlier or later, while the car moved on. `steps/lidar_check.py` takes that out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conetl.errors import CalibrationError, ConetlError
from conetl.geometry import pose as se3
from conetl.io.calibration.files import IMU_TO_VELO
from conetl.io.drive_folder.timestamps import parse_timestamps
from conetl.records import Rig

VELODYNE = "velodyne_points"
_BYTES_A_POINT = 16


class ScanFileError(ConetlError):
    """One LiDAR scan cannot be used; the others can."""


def list_scans(drive_folder: Path) -> dict[int, Path]:
    """Frame number -> file of every LiDAR scan of a drive; empty where the drive has none."""
    data = drive_folder / VELODYNE / "data"
    if not data.is_dir():
        return {}
    return {int(p.stem): p for p in sorted(data.glob("*.bin")) if p.stem.isascii() and p.stem.isdigit()}


def read_scan(path: Path) -> NDArray[np.float32]:
    """Points (N, 4) of one scan: x, y, z (m, velodyne frame), reflectance. Raises ScanFileError.

    Points that are no numbers, or lie at the scanner itself (no echo), are left out.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ScanFileError(f"{path}: cannot be read ({error.strerror}); this scan is left out") from error
    if not content or len(content) % _BYTES_A_POINT:
        raise ScanFileError(
            f"{path}: {len(content)} bytes; expected a whole number of points of {_BYTES_A_POINT} bytes (four float32) and at "
            "least one. The file is cut off: copy it again. This scan is left out"
        )
    points = np.frombuffer(content, dtype="<f4").reshape(-1, 4)
    good = np.isfinite(points).all(axis=1) & (np.abs(points[:, :3]).sum(axis=1) > 0.1)
    if not good.any():
        raise ScanFileError(f"{path}: none of its {len(points)} points is a usable number; this scan is left out")
    return np.asarray(points[good])


def scan_period_s(drive_folder: Path) -> float:
    """Time of one turn of the scanner, from `timestamps_start.txt` and `timestamps_end.txt`; 0.1 s where they are missing.

    (10 Hz is what KITTI's scanner is set to.)
    """
    stamps = []
    for name in ("timestamps_start.txt", "timestamps_end.txt"):
        path = drive_folder / VELODYNE / name
        stamps.append(parse_timestamps(path.read_text(encoding="utf-8", errors="replace")) if path.is_file() else {})
    turns = [
        (end - start) * 1e-9
        for number, start in stamps[0].items()
        if isinstance(start, int) and isinstance(end := stamps[1].get(number), int) and end > start
    ]
    return float(np.median(turns)) if turns else 0.1


def left_SE3_velo(rig: Rig, calibration_folder: Path) -> NDArray[np.float64]:
    """(4, 4) velodyne points -> left camera points, for a rig read from KITTI's files in `calibration_folder`.

    The rig holds body -> left camera; `calib_imu_to_velo.txt` gives body (the IMU) -> velodyne, and the rest is a product.
    Raises CalibrationError.
    """
    path = calibration_folder / IMU_TO_VELO
    velo_SE3_body = _read_rigid(path)
    return se3.compose(se3.invert(np.array(rig.body_SE3_left)), se3.invert(velo_SE3_body))


def _read_rigid(path: Path) -> NDArray[np.float64]:
    """(4, 4) from a KITTI file with the lines `R: ` (9 numbers) and `T: ` (3 numbers, metres)."""
    try:
        lines = dict(line.split(":", 1) for line in path.read_text(encoding="utf-8").splitlines() if ":" in line)
        rotation = np.array(lines["R"].split(), dtype=np.float64).reshape(3, 3)
        shift = np.array(lines["T"].split(), dtype=np.float64).reshape(3)
        return se3.se3(se3.nearest_rotation(rotation), shift)
    except (OSError, UnicodeDecodeError, KeyError, ValueError) as error:
        raise CalibrationError(
            f"{path}: expected lines 'R: ' with 9 and 'T: ' with 3 numbers, as in KITTI's own file ({error})"
        ) from error
