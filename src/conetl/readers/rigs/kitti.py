"""KITTI's three calibration text files (Geiger et al., IJRR 2013): the rectified pair, or the raw one behind it."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Literal

import numpy as np

from conetl.geometry.calibration.kitti_rig import kitti_raw_rig, kitti_rig
from conetl.model.errors import CalibrationError
from conetl.model.records import Rig
from conetl.readers.rigs.common import Array, Size, first_message, read_text, rectified_rig

CAM_TO_CAM = "calib_cam_to_cam.txt"
VELO_TO_CAM = "calib_velo_to_cam.txt"
IMU_TO_VELO = "calib_imu_to_velo.txt"
Images = Literal["rectified", "raw"]


def read_kitti_rig(
    cam_to_cam: Path,
    *,
    left: int = 2,
    right: int = 3,
    body_required: bool,
    images: Images = "rectified",
    rig_id: str | None = None,
    sigma_px: float = 0.5,
) -> Rig:
    """Rig of two KITTI cameras from `calib_cam_to_cam.txt` and the two files beside it.

    body_required: refuse the calibration where the chain from the IMU is missing. images: "rectified" for the pair of
    P_rect_0i, "raw" for the cameras that took the images ("synced only": S_0i, K_0i, D_0i, R_0i, T_0i), lenses included.
    rig_id: default "kitti-" and the start of a hash over the numbers. Raises CalibrationError.
    """
    keys = {"R_rect_00": 9} if images == "rectified" else {}
    for number in (left, right):
        if images == "rectified":
            keys |= {f"S_rect_{number:02d}": 2, f"P_rect_{number:02d}": 12}
        else:
            keys |= {f"{key}_{number:02d}": count for key, count in (("S", 2), ("K", 9), ("D", 5), ("R", 9), ("T", 3))}
    cameras = _read_kitti(cam_to_cam, keys)
    chain = [cam_to_cam.parent / name for name in (VELO_TO_CAM, IMU_TO_VELO)]
    absent = [path.name for path in chain if not path.is_file()]
    if absent and (body_required or len(absent) == 1):
        raise CalibrationError(
            f"{cam_to_cam.parent}: {' and '.join(absent)} missing. Poses are those of the IMU, so the chain IMU -> velodyne -> "
            "camera is needed; KITTI delivers all three calib_*.txt files together, put them side by side"
        )
    velo, imu = (None, None) if absent else [_read_kitti(path, {"R": 9, "T": 3}) for path in chain]
    if rig_id is None:
        digest = hashlib.sha256()
        for part in (cameras, velo or {}, imu or {}):
            for key in sorted(part):
                digest.update(key.encode() + part[key].tobytes())
        rig_id = f"kitti-{'raw-' if images == 'raw' else ''}{left:02d}-{right:02d}-{digest.hexdigest()[:8]}"
    make = kitti_rig if images == "rectified" else kitti_raw_rig
    try:
        return make(
            cameras, velo_to_cam=velo, imu_to_velo=imu, left=left, right=right, rig_id=rig_id, sigma_px=sigma_px
        )
    except ValueError as error:
        raise CalibrationError(f"{cam_to_cam}: {first_message(error)}") from error


def kitti_rig_for_images(
    cam_to_cam: Path,
    size: Size | None,
    *,
    left: int = 2,
    right: int = 3,
    body_required: bool,
    rig_id: str | None = None,
    sigma_px: float = 0.5,
) -> Rig:
    """Rectified rig for left images of this width and height, which tell whether they are KITTI's rectified or its raw ones.

    Raw images ("synced only") are those of the size S_0i; their rig has `rectified_from`. Where both sizes are equal, or the
    size is neither or not known, the images are taken for rectified. Raises CalibrationError.
    """
    own = read_kitti_rig(
        cam_to_cam, left=left, right=right, body_required=body_required, rig_id=rig_id, sigma_px=sigma_px
    )
    if size in (None, (own.left.width_px, own.left.height_px)) or size != kitti_raw_size(cam_to_cam, left):
        return own
    raw = read_kitti_rig(
        cam_to_cam,
        left=left,
        right=right,
        body_required=body_required,
        images="raw",
        rig_id=rig_id,
        sigma_px=sigma_px,
    )
    return rectified_rig(raw, cam_to_cam)


def kitti_raw_size(cam_to_cam: Path, number: int) -> Size | None:
    """Width and height of the raw images of a camera; None where the file does not tell. Raises CalibrationError."""
    key = f"S_{number:02d}"
    if not any(line.partition(":")[0].strip() == key for line in read_text(cam_to_cam).splitlines()):
        return None
    width, height = _read_kitti(cam_to_cam, {key: 2})[key]
    return int(width), int(height)


def _read_kitti(path: Path, wanted: dict[str, int]) -> dict[str, Array]:
    """The wanted keys of a `key: numbers` file as flat arrays, each with its expected count of finite numbers."""
    lines: dict[str, str] = {}
    for line in read_text(path).splitlines():
        key, colon, rest = line.partition(":")
        if colon:
            lines.setdefault(key.strip(), rest)
    values: dict[str, Array] = {}
    for key, count in wanted.items():
        if key not in lines:
            raise CalibrationError(
                f"{path}: the key '{key}' is missing; expected a line '{key}: ' with {count} numbers, "
                "as in KITTI's own file. Restore the file from the recording"
            )
        words = lines[key].split()
        try:
            numbers = np.array([float(word) for word in words])
        except ValueError:
            bad = next(word for word in words if not _is_number(word))
            raise CalibrationError(f"{path}: '{key}' must be {count} numbers, found '{bad}'") from None
        if len(numbers) != count:
            raise CalibrationError(f"{path}: '{key}' must be {count} numbers, found {len(numbers)}")
        if not np.isfinite(numbers).all():
            raise CalibrationError(f"{path}: '{key}' must be {count} finite numbers, found {lines[key].strip()}")
        values[key] = numbers
    return values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
