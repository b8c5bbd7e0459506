"""`drive.yaml`: what a drive folder says of itself where the files' own word is not enough. Every key is optional."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any
from zoneinfo import ZoneInfo

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from conetl.files.names import printable
from conetl.model.errors import DriveFolderError

Positive = Annotated[float, Field(gt=0)]
DRIVE_YAML = "drive.yaml"


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Cameras(_Section):
    """Folders of the left and the right rectified camera; the number links them to the calibration."""

    left: str = Field(default="image_02", pattern=r"^image_0[0-9]$")
    right: str = Field(default="image_03", pattern=r"^image_0[0-9]$")


class Sigmas(_Section):
    """Standard deviations. Those of the position replace OXTS `pos_accuracy`.

    The attitude defaults are those of the OXTS RT3003 data sheet (0.03, 0.03 and 0.1 degrees) with room for the boresight.
    """

    horizontal_m: Positive | None = None
    vertical_m: Positive | None = None
    """Default: 1.5 times the horizontal one."""
    roll_deg: Positive = 0.05
    pitch_deg: Positive = 0.05
    yaw_deg: Positive = 0.15
    image_px: Positive = 0.5


class Georeference(_Section):
    """Where a local trajectory (odometry, SLAM, motion capture) lies on the earth: its frame must be level, z up."""

    lon_deg: float = Field(ge=-180, le=180)
    lat_deg: float = Field(ge=-90, le=90)
    height_m: float = Field(ge=-20_000, le=20_000)
    """Of the frame's origin, above the WGS 84 ellipsoid."""
    heading_deg: float = Field(ge=-360, le=360)
    """Of the frame's x axis, clockwise from true north; 90 for a frame whose x axis points east."""


class Streams(_Section):
    """Which of a recording's streams is what, where their types do not tell: topics of a bag, folders of a EuRoC recording."""

    left: str | None = Field(default=None, min_length=1)
    right: str | None = Field(default=None, min_length=1)
    trajectory: str | None = Field(default=None, min_length=1)
    """NavSatFix or Odometry topic; folder beside cam0."""
    imu: str | None = Field(default=None, min_length=1)
    left_info: str | None = Field(default=None, min_length=1)
    right_info: str | None = Field(default=None, min_length=1)


class DriveYaml(_Section):
    """The whole file."""

    drive_id: str | None = Field(default=None, min_length=1, max_length=200)
    rig_id: str | None = Field(default=None, min_length=1)
    map_srid: int | None = Field(default=None, gt=0)
    timestamps_timezone: str = "UTC"
    """IANA name of the zone that the time stamps are written in."""
    cameras: Cameras = Cameras()
    calibration: str | None = Field(default=None, min_length=1)
    """KITTI calib_cam_to_cam.txt, relative to the drive folder and inside it; the other two lie beside it."""
    sigmas: Sigmas = Sigmas()
    georeference: Georeference | None = None
    streams: Streams = Streams()
    pair_tolerance_ms: Positive = 5.0
    """EuRoC and bags: left and right images farther apart in time are no pair."""
    max_pose_gap_s: Positive = 0.5
    """EuRoC and bags: poses farther apart in time are not interpolated."""
    antenna_t_m: tuple[float, float, float] | None = None
    """Bags: the GNSS antenna in the IMU's frame, where /tf_static does not tell; 0, 0, 0 if reduced already."""

    def id_of(self, source: Path) -> str:
        """The drive's id: what the file says, else the name of the folder or recording itself, whatever link leads to it."""
        source = source.resolve()
        return printable(self.drive_id or (source.stem if is_bare_bag(source) else source.name))[:200]

    @field_validator("timestamps_timezone")
    @classmethod
    def _known_zone(cls, value: str) -> str:
        try:
            ZoneInfo(value)
        except (KeyError, ValueError, OSError) as error:
            raise ValueError(f"'{value}' is not a time zone; expected a name such as UTC or Europe/Berlin") from error
        return value


def is_bare_bag(source: Path) -> bool:
    """True for a .mcap file; a bag's folder is a folder."""
    return source.suffix == ".mcap" and source.is_file()


def small_file(source: Path, name: str) -> Path:
    """Where the small file `name` (drive.yaml, rig.yaml) of a drive lies: in its folder; NAME.drive.yaml beside NAME.mcap."""
    source = source.resolve()
    return source.with_name(f"{source.stem}.{name}") if is_bare_bag(source) else source / name


def read_drive_yaml(source: Path) -> DriveYaml:
    """Settings of a drive, a folder or a bare bag; all defaults where it has no `drive.yaml`. Raises DriveFolderError."""
    path = small_file(source, DRIVE_YAML)
    if not path.is_file():
        return DriveYaml()
    try:
        content: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise DriveFolderError(f"{path}: this cannot be read as YAML: {error}") from error
    if content is None:
        return DriveYaml()
    if not isinstance(content, dict):
        raise DriveFolderError(f"{path}: expected a YAML mapping, for example 'drive_id: morning-run'")
    try:
        return DriveYaml.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            known = ", ".join(DriveYaml.model_fields)
            raise DriveFolderError(f"{path}: the key '{key}' is not known. Known keys: {known}") from error
        raise DriveFolderError(f"{path}: '{key}': {first['msg']}; found {first['input']!r}") from error


def inside(folder: Path, name: str, source: str, beside: str = ".") -> Path:
    """Path of something that a file names, which must stay in the drive folder, symbolic links resolved.

    beside: folder in the drive's that `name` is relative to. Raises DriveFolderError naming `source` where `..`, an absolute path
    or a link leads out.
    """
    root = folder.resolve()
    path = (root / beside / name).resolve()
    if not path.is_relative_to(root):
        raise DriveFolderError(f"{source}: '{name}' leads out of the drive folder {folder}; name a place inside it")
    return path
