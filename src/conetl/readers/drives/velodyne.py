"""LiDAR scans of a KITTI drive: `velodyne_points/data/*.bin`, four float32 per point (x, y, z in metres, reflectance).

Frame: the velodyne's, x forward, y left, z up. The scanner turns counter-clockwise seen from above, once per frame, and the
cameras are triggered when it points straight ahead (Geiger et al., IJRR 2013, and the data set's own notes); points at another
azimuth were taken earlier or later from the moving car, which `points_at_exposure` corrects.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conetl.files.documents import read_table_bytes, table_lines
from conetl.files.storage import NOT_A_FILE, is_present
from conetl.geometry import pose as se3
from conetl.geometry.rig import map_SE3_left
from conetl.model.arrays import Floats
from conetl.model.drive import FramePair
from conetl.model.errors import ConetlError, InputError
from conetl.model.rig import Rig
from conetl.readers.rigs.kitti import IMU_TO_VELO, motion_of, read_numbers
from conetl.readers.trajectories.times import parse_timestamps

VELODYNE = "velodyne_points"
_BYTES_PER_POINT = 16


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

    Points with invalid numbers or at the scanner itself (no echo) are left out.
    """
    try:
        if path.exists() and not is_present(path):
            raise ScanFileError(f"{path}: {NOT_A_FILE}; this scan is left out")
        content = path.read_bytes()
    except OSError as error:
        raise ScanFileError(f"{path}: cannot be read ({error.strerror}); this scan is left out") from error
    if not content or len(content) % _BYTES_PER_POINT:
        raise ScanFileError(
            f"{path}: {len(content)} bytes; expected one or more points of {_BYTES_PER_POINT} bytes (four float32). The file is "
            "cut off: copy it again. This scan is left out"
        )
    points = np.frombuffer(content, dtype="<f4").reshape(-1, 4)
    good = np.isfinite(points).all(axis=1) & (np.abs(points[:, :3]).sum(axis=1) > 0.1)
    if not good.any():
        raise ScanFileError(f"{path}: none of its {len(points)} points is a usable number; this scan is left out")
    return np.asarray(points[good])


def scan_period_s(drive_folder: Path) -> float:
    """Time of one turn of the scanner, from `timestamps_start.txt` and `timestamps_end.txt`; 0.1 s (KITTI's 10 Hz) without."""
    stamps = []
    for name in ("timestamps_start.txt", "timestamps_end.txt"):
        path = drive_folder / VELODYNE / name
        stamps.append(parse_timestamps(table_lines(read_table_bytes(path))) if path.is_file() else {})
    turns = [
        (end - start) * 1e-9
        for number, start in stamps[0].items()
        if isinstance(start, int) and isinstance(end := stamps[1].get(number), int) and end > start
    ]
    return float(np.median(turns)) if turns else 0.1


def left_SE3_velo(rig: Rig, drive_folder: Path) -> Floats:
    """(4, 4) velodyne points -> left camera points, for a rig read from KITTI's files in a drive's folder or its parent.

    The rig has body -> left camera; `calib_imu_to_velo.txt` has body (the IMU) -> velodyne. Raises InputError.
    """
    paths = [folder / IMU_TO_VELO for folder in (drive_folder, drive_folder.resolve().parent)]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        raise InputError(f"{drive_folder}: {IMU_TO_VELO} is neither in the drive folder nor in its parent")
    velo_SE3_body = motion_of(path, read_numbers(path, {"R": 9, "T": 3}))
    return se3.compose(se3.invert(np.array(rig.body_SE3_left)), se3.invert(velo_SE3_body))


def points_at_exposure(
    points: Floats, pair: FramePair, pairs: Mapping[int, FramePair], rig: Rig, velo: Floats, period_s: float
) -> Floats:
    """Points (N, 3) of one turn of the scanner, in its frame, at the time of the image.

    velo: (4, 4) left_SE3_velo; the car's motion comes from the poses of the frame pairs before and after.
    """
    before, after = pairs.get(pair.frame_index - 1, pair), pairs.get(pair.frame_index + 1, pair)
    seconds = (after.captured_at_ns - before.captured_at_ns) * 1e-9
    if seconds <= 0:
        return points
    moved = se3.compose(se3.invert(map_SE3_left(before.pose, rig)), map_SE3_left(after.pose, rig))
    to_velo = velo[:3, :3].T
    turned = to_velo @ moved[:3, :3] @ to_velo.T
    turn_rate = float(np.arctan2(turned[1, 0], turned[0, 0])) / seconds
    return untwist(points, to_velo @ moved[:3, 3] / seconds, turn_rate, period_s)


def untwist(points_velo_m: Floats, velocity_velo_m_s: Floats, turn_rate_rad_s: float, period_s: float) -> Floats:
    """Points (N, 3) of one turn of the scanner, moved to their positions at the time when it pointed straight ahead.

    velocity_velo_m_s: (3,) of the scanner over ground, in its own frame (x forward, y left, z up); turn_rate_rad_s: of the
    car about z, counter-clockwise; period_s: of one counter-clockwise turn. A point to the left was taken later.
    """
    later = np.arctan2(points_velo_m[:, 1], points_velo_m[:, 0]) / (2 * np.pi) * period_s
    turn = turn_rate_rad_s * later
    cos, sin = np.cos(turn), np.sin(turn)
    x, y, z = points_velo_m.T
    turned = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)
    return np.asarray(turned + later[:, None] * velocity_velo_m_s)
