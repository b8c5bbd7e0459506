"""Calibration files -> `Rig`: KITTI's text files and conetl's own `rig.yaml` (docs/coordinates.md shows one).

Everything wrong with a file ends in one CalibrationError that names file, key, what was expected and what to do.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from conetl.errors import CalibrationError
from conetl.geometry import pose as se3
from conetl.geometry.calibration import check_rectified_baseline, kitti_rig
from conetl.records import Camera, Rig

Array = NDArray[np.float64]
Positive = Annotated[float, Field(gt=0)]
Triple = tuple[float, float, float]

CAM_TO_CAM = "calib_cam_to_cam.txt"
VELO_TO_CAM = "calib_velo_to_cam.txt"
IMU_TO_VELO = "calib_imu_to_velo.txt"
RIG_YAML = "rig.yaml"


def read_rig(path: Path) -> Rig:
    """Rig from a `calib_cam_to_cam.txt` (cameras 02 and 03), a folder with one, or a `rig.yaml`.

    With `calib_velo_to_cam.txt` and `calib_imu_to_velo.txt` beside it the body is the IMU, else the left camera.
    Raises CalibrationError.
    """
    if path.is_dir():
        candidates = [path / name for name in (RIG_YAML, CAM_TO_CAM) if (path / name).is_file()]
        if len(candidates) != 1:
            found = "none of them" if not candidates else "both"
            raise CalibrationError(f"{path}: expected one of {RIG_YAML} and {CAM_TO_CAM} in the folder, found {found}")
        path = candidates[0]
    if not path.is_file():
        raise CalibrationError(
            f"{path}: there is no such file. Give a {RIG_YAML}, a KITTI {CAM_TO_CAM}, or a folder that holds one of them"
        )
    if path.suffix.lower() in {".yaml", ".yml"}:
        return read_rig_yaml(path)
    if path.suffix.lower() == ".txt":
        return read_kitti_rig(path, body_required=False)
    raise CalibrationError(f"{path}: a calibration is a .yaml file or a KITTI .txt file, not '{path.suffix}'")


# --------------------------------------------------------------------------- KITTI


def read_kitti_rig(
    cam_to_cam: Path,
    *,
    left: int = 2,
    right: int = 3,
    body_required: bool,
    rig_id: str | None = None,
    sigma_px: float = 0.5,
) -> Rig:
    """Rig of two rectified KITTI cameras from `calib_cam_to_cam.txt` and the two files beside it.

    body_required: refuse the calibration where the chain from the IMU is missing. rig_id: default "kitti-" and the start of a
    hash over the numbers. Raises CalibrationError.
    """
    keys = {"R_rect_00": 9}
    for number in (left, right):
        keys |= {f"S_rect_{number:02d}": 2, f"P_rect_{number:02d}": 12}
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
        rig_id = f"kitti-{left:02d}-{right:02d}-{digest.hexdigest()[:8]}"
    try:
        return kitti_rig(
            cameras, velo_to_cam=velo, imu_to_velo=imu, left=left, right=right, rig_id=rig_id, sigma_px=sigma_px
        )
    except ValueError as error:
        raise CalibrationError(f"{cam_to_cam}: {_first_message(error)}") from error


def _read_kitti(path: Path, wanted: dict[str, int]) -> dict[str, Array]:
    """The wanted keys of a `key: numbers` file as flat arrays, each with its expected count of finite numbers."""
    lines: dict[str, str] = {}
    for line in _read_text(path).splitlines():
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


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path}: this is not a text file") from error
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error


# --------------------------------------------------------------------------- rig.yaml


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _CameraFile(_Model):
    """Interior orientation in pixels, or in millimetres with the sensor's size (the paper's Table 1)."""

    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    fx_px: Positive | None = None
    fy_px: Positive | None = None
    cx_px: float | None = None
    cy_px: float | None = None
    fx_mm: Positive | None = None
    fy_mm: Positive | None = None
    sensor_width_mm: Positive | None = None
    sensor_height_mm: Positive | None = None
    x0_mm: float = 0.0
    """Principal point from the centre of the sensor, to the right."""
    y0_mm: float = 0.0
    """Principal point from the centre of the sensor, upwards (photogrammetric axes)."""

    @model_validator(mode="after")
    def _one_form(self) -> _CameraFile:
        pixels = [self.fx_px, self.fy_px, self.cx_px, self.cy_px]
        millimetres = [self.fx_mm, self.fy_mm, self.sensor_width_mm, self.sensor_height_mm]
        whole = [all(v is not None for v in group) for group in (pixels, millimetres)]
        some = [any(v is not None for v in group) for group in (pixels, millimetres)]
        if sum(whole) != 1 or sum(some) != 1 or (whole[0] and (self.x0_mm or self.y0_mm)):
            raise ValueError(
                "give either fx_px, fy_px, cx_px, cy_px, or fx_mm, fy_mm, sensor_width_mm, sensor_height_mm (and x0_mm, y0_mm)"
            )
        return self

    def camera(self) -> Camera:
        """In pixels, origin at the centre of the top-left pixel."""
        if self.fx_px is not None and self.fy_px is not None and self.cx_px is not None and self.cy_px is not None:
            fx, fy, cx, cy = self.fx_px, self.fy_px, self.cx_px, self.cy_px
        else:
            assert self.fx_mm and self.fy_mm and self.sensor_width_mm and self.sensor_height_mm  # by the validator
            px_per_mm = (self.width_px / self.sensor_width_mm, self.height_px / self.sensor_height_mm)
            fx, fy = self.fx_mm * px_per_mm[0], self.fy_mm * px_per_mm[1]
            cx = (self.width_px - 1) / 2 + self.x0_mm * px_per_mm[0]
            cy = (self.height_px - 1) / 2 - self.y0_mm * px_per_mm[1]
        return Camera(width_px=self.width_px, height_px=self.height_px, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy)


class _RigidFile(_Model):
    """`p_dst = R p_src + t`."""

    R: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    t_m: Triple

    def matrix(self, name: str) -> Array:
        try:
            return se3.se3(se3.nearest_rotation(np.array(self.R)), np.array(self.t_m))
        except ValueError as error:
            raise ValueError(f"{name}.R: {error}") from error


class _RigFile(_Model):
    """A `rig.yaml`: two rectified cameras, how the right one sits on the left, and (optionally) the left one on the body."""

    rig_id: str | None = Field(default=None, min_length=1)
    left: _CameraFile
    right: _CameraFile
    baseline_m: Positive | None = None
    left_SE3_right: _RigidFile | None = None
    body_SE3_left: _RigidFile | None = None
    sigma_px: Positive = 0.5

    @model_validator(mode="after")
    def _one_relative_pose(self) -> _RigFile:
        if (self.baseline_m is None) == (self.left_SE3_right is None):
            raise ValueError(
                "give either baseline_m (parallel cameras) or left_SE3_right (R, t_m of right points to left)"
            )
        return self


def read_rig_yaml(path: Path) -> Rig:
    """Rig from a `rig.yaml`. Raises CalibrationError."""
    try:
        content: Any = yaml.safe_load(_read_text(path))
    except yaml.YAMLError as error:
        raise CalibrationError(f"{path}: this is not YAML: {error}") from error
    if not isinstance(content, dict):
        raise CalibrationError(f"{path}: expected a YAML mapping with the keys left, right and baseline_m")
    try:
        file = _RigFile.model_validate(content)
        if file.left_SE3_right is not None:
            left_SE3_right = file.left_SE3_right.matrix("left_SE3_right")
        else:
            left_SE3_right = se3.se3(np.eye(3), np.array([file.baseline_m, 0.0, 0.0]))
        body_SE3_left = np.eye(4) if file.body_SE3_left is None else file.body_SE3_left.matrix("body_SE3_left")
        check_rectified_baseline(left_SE3_right)
        return Rig(
            rig_id=file.rig_id or f"rig-{hashlib.sha256(repr(file).encode()).hexdigest()[:8]}",
            left=file.left.camera(), right=file.right.camera(), sigma_px=file.sigma_px,
            body_SE3_left=se3.to_matrix4(body_SE3_left),
            body_SE3_right=se3.to_matrix4(se3.compose(body_SE3_left, left_SE3_right)),
        )  # fmt: skip
    except ValueError as error:
        raise CalibrationError(f"{path}: {_first_message(error)}") from error


def _first_message(error: ValueError) -> str:
    """One sentence of a validation error, with the key it is about."""
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        return f"'{key}': {first['msg']}" if key else first["msg"]
    return str(error)
