"""KITTI's three calibration text files (Geiger et al., IJRR 2013): the rectified pair, or its raw one."""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path
from typing import Literal

from conetl.files.documents import named, read_limited
from conetl.geometry.calibration.kitti_rig import kitti_rig
from conetl.model.errors import CalibrationError
from conetl.model.records import Rig
from conetl.readers.rigs.common import Array, Size, calibration_errors, numbers, rectified_rig

CAM_TO_CAM = "calib_cam_to_cam.txt"
VELO_TO_CAM = "calib_velo_to_cam.txt"
IMU_TO_VELO = "calib_imu_to_velo.txt"


@calibration_errors()
def read_kitti_rig(
    cam_to_cam: Path,
    *,
    left: int = 2,
    right: int = 3,
    body_required: bool,
    images: Literal["rectified", "raw"] | Size | None = "rectified",
    rig_id: str | None = None,
    sigma_px: float = 0.5,
) -> Rig:
    """Rig of two KITTI cameras from `calib_cam_to_cam.txt` and the two files beside it.

    body_required: reject the calibration if the chain from the IMU is missing. images: "rectified" for the pair of
    P_rect_0i, "raw" for the cameras that took the images ("synced only": S_0i, K_0i, D_0i, R_0i, T_0i), lenses included; or
    width and height of the left images, which decide: raw ones have the size S_0i and give a rectified rig with
    `rectified_from`; where both sizes are equal, or theirs is unknown or neither, they are assumed to be rectified.
    rig_id: default "kitti-" and the start of a hash over the numbers. Raises CalibrationError.
    """
    if images is None or isinstance(images, tuple):
        read = partial(
            read_kitti_rig, cam_to_cam, left=left, right=right, body_required=body_required, rig_id=rig_id, sigma_px=sigma_px
        )  # fmt: skip
        own = read()
        if images in (None, (own.left.width_px, own.left.height_px)) or images != _raw_size(cam_to_cam, left):
            return own
        return rectified_rig(read(images="raw"), cam_to_cam)
    keys = {"R_rect_00": 9} if images == "rectified" else {}
    for number in (left, right):
        if images == "rectified":
            keys |= {f"S_rect_{number:02d}": 2, f"P_rect_{number:02d}": 12}
        else:
            keys |= {f"{key}_{number:02d}": count for key, count in (("S", 2), ("K", 9), ("D", 5), ("R", 9), ("T", 3))}
    cameras = read_numbers(cam_to_cam, keys)
    chain = [cam_to_cam.parent / name for name in (VELO_TO_CAM, IMU_TO_VELO)]
    absent = [path.name for path in chain if not path.is_file()]
    if absent and (body_required or len(absent) == 1):
        raise CalibrationError(
            f"{cam_to_cam.parent}: {' and '.join(absent)} missing. Poses are those of the IMU, so the chain IMU -> velodyne -> "
            "camera is needed; KITTI delivers all three calib_*.txt files together, put them side by side"
        )
    velo, imu = (None, None) if absent else [read_numbers(path, {"R": 9, "T": 3}) for path in chain]
    if rig_id is None:
        digest = hashlib.sha256()
        for part in (cameras, velo or {}, imu or {}):
            for key in sorted(part):
                digest.update(key.encode() + part[key].tobytes())
        rig_id = f"kitti-{'raw-' if images == 'raw' else ''}{left:02d}-{right:02d}-{digest.hexdigest()[:8]}"
    with named(cam_to_cam, CalibrationError):
        return kitti_rig(
            cameras, raw=images == "raw", velo_to_cam=velo, imu_to_velo=imu, left=left, right=right, rig_id=rig_id,
            sigma_px=sigma_px,
        )  # fmt: skip


def _raw_size(cam_to_cam: Path, number: int) -> Size | None:
    """Width and height of the raw images of a camera; None where the file has none. Raises CalibrationError."""
    key = f"S_{number:02d}"
    if key not in _lines(cam_to_cam):
        return None
    width, height = read_numbers(cam_to_cam, {key: 2})[key]
    return int(width), int(height)


@calibration_errors()
def read_numbers(path: Path, wanted: dict[str, int]) -> dict[str, Array]:
    """The wanted keys of a `key: numbers` file as flat arrays, given their counts of numbers. Raises CalibrationError."""
    lines = _lines(path)
    for key, count in wanted.items():
        if key not in lines:
            raise CalibrationError(
                f"{path}: the key '{key}' is missing; expected a line '{key}: ' with {count} numbers, "
                "as in KITTI's own file. Restore the file from the recording"
            )
    return {key: numbers(path, key, lines[key].split(), (count,)) for key, count in wanted.items()}


def _lines(path: Path) -> dict[str, str]:
    """What follows the colon, by key; of a repeated key the first."""
    parts = [line.partition(":") for line in reversed(read_limited(path).splitlines())]
    return {key.strip(): rest for key, colon, rest in parts if colon}
