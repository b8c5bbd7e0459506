"""`drive.yaml`: settings of one drive. Every key is optional."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from conetl.files.documents import library_errors, read_yaml_mapping, shown, validated
from conetl.files.names import printable
from conetl.model.base import GeodeticPosition, Positive, Record
from conetl.model.errors import InputError
from conetl.model.rig import MAX_LEVER_ARM_M
from conetl.perception.video import Layout
from conetl.readers.trajectories.settings import TrajectoryFile, known_zone

DRIVE_YAML = "drive.yaml"
#: Poses recorded often are not interpolated over longer gaps.
MAX_POSE_GAP_S = 0.5
#: A clock is not searched over more than two hours on either side.
MAX_SEARCH_S = 7200.0
Metres = Annotated[float, Field(ge=-MAX_LEVER_ARM_M, le=MAX_LEVER_ARM_M)]


class Cameras(Record):
    """Folders of the left and the right rectified camera; the number links them to the calibration."""

    left: str = Field(default="image_02", pattern=r"^image_0[0-9]$")
    right: str = Field(default="image_03", pattern=r"^image_0[0-9]$")


class Sigmas(Record):
    """Standard deviations. Those of the position replace OXTS `pos_accuracy`.

    The attitude defaults are those of the OXTS RT3003 data sheet (0.03, 0.03 and 0.1 degrees), increased for the boresight.
    """

    horizontal_m: Positive | None = None
    vertical_m: Positive | None = None
    """Default: 1.5 times the horizontal one."""
    roll_deg: Positive = 0.05
    pitch_deg: Positive = 0.05
    yaw_deg: Positive = 0.15
    image_px: Positive = 0.5


class Georeference(GeodeticPosition):
    """Origin of a local trajectory (odometry, SLAM, motion capture), whose frame must be level, z up."""

    heading_deg: float = Field(ge=-360, le=360)
    """Direction of the frame's x axis, clockwise from true north; 90 where it points east."""


class Streams(Record):
    """Topics of a bag or folders of a EuRoC recording, where their types and names are ambiguous."""

    left: str | None = Field(default=None, min_length=1)
    right: str | None = Field(default=None, min_length=1)
    trajectory: str | None = Field(default=None, min_length=1)
    """NavSatFix or Odometry topic; folder beside cam0."""
    imu: str | None = Field(default=None, min_length=1)
    left_info: str | None = Field(default=None, min_length=1)
    right_info: str | None = Field(default=None, min_length=1)


class Images(Record):
    """Stereo video, or folders of images, with a trajectory file beside them."""

    left: str | None = Field(default=None, min_length=1)
    """File or folder; with `layout` the file that holds both images. Default: the one with left in its name."""
    right: str | None = Field(default=None, min_length=1)
    layout: Layout | None = None
    """Where left and right are in each frame of one file."""
    start: str | None = Field(default=None, min_length=1)
    """Time of the first left frame, like 2026-03-02 10:00:00.250, in `timestamps_timezone` or with an offset."""
    timestamps: str | None = Field(default=None, min_length=1)
    """File with the time of every left frame, one per line; then `right_timestamps` has those of the right ones."""
    right_timestamps: str | None = Field(default=None, min_length=1)
    right_offset_s: float | None = Field(default=None, ge=-3600, le=3600)
    """What to add to the right file's times to have the left one's. Default: found from the motion in the images."""
    every: int = Field(default=1, ge=1)
    """Use every n-th pair."""
    from_s: float = Field(default=0.0, ge=0, le=1e7)
    to_s: float | None = Field(default=None, gt=0, le=1e7)
    """Part of the left file that is used."""

    @model_validator(mode="after")
    def _check(self) -> Images:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError(f"to_s {self.to_s:g} is not after from_s {self.from_s:g}")
        return self


class Mount(Record):
    """The left camera on the body whose trajectory was recorded (an IMU, or the antenna), for a rig.yaml without its pose."""

    forward_m: Metres
    left_m: Metres
    up_m: Metres
    roll_deg: float = Field(default=0.0, ge=-180, le=180)
    """Positive with the left side up."""
    pitch_deg: float = Field(default=0.0, ge=-90, le=90)
    """Positive where the camera looks down."""
    yaw_deg: float = Field(default=0.0, ge=-180, le=180)
    """Positive where it looks to the left."""


class Clock(Record):
    """The clock of the images against that of the trajectory, where they are not the same."""

    offset_s: Annotated[float, Field(ge=-1e9, le=1e9)] | Literal["estimate"] = "estimate"
    """What to add to the times of the images to have those of the trajectory; `estimate`: found from turns and speeds."""
    sigma_s: float | None = Field(default=None, gt=0, le=10)
    """Sigma of the stated offset; default 0.01 s."""
    search_s: float = Field(default=30.0, gt=0, le=MAX_SEARCH_S)
    """The offset is searched between minus and plus this."""


class ControlPoints(Record):
    """Surveyed feet of cones that are used in the adjustment of the poses; a text is the name of the file."""

    file: str = Field(min_length=1, max_length=1000)
    """CSV, GeoJSON, GeoPackage, FlatGeobuf or GeoParquet inside the drive folder."""
    crs: str | None = Field(default=None, min_length=1, max_length=10_000)
    heights: str | None = Field(default=None, min_length=1, max_length=10_000)
    """As for a trajectory; default ellipsoidal."""
    sigma_m: Positive | None = None
    """Sigma of the survey, where the file has no sigma_e_m, sigma_n_m, sigma_u_m."""

    @model_validator(mode="before")
    @classmethod
    def _file_alone(cls, value: object) -> object:
        return {"file": value} if isinstance(value, str) else value


class DriveYaml(Record):
    """The whole file."""

    drive_id: str | None = Field(default=None, min_length=1, max_length=200)
    rig_id: str | None = Field(default=None, min_length=1)
    pair: tuple[str, str] | None = None
    """Left and right of the cameras of a rig.yaml with more than two."""
    map_srid: int | None = Field(default=None, gt=0, lt=1_000_000)
    timestamps_timezone: Annotated[str, AfterValidator(known_zone)] = "UTC"
    """IANA name of the time stamps' zone."""
    cameras: Cameras = Cameras()
    calibration: str | None = Field(default=None, min_length=1)
    """KITTI calib_cam_to_cam.txt, relative to the drive folder and inside it; the other two are beside it."""
    sigmas: Sigmas = Sigmas()
    georeference: Georeference | None = None
    streams: Streams = Streams()
    images: Images = Images()
    mount: Mount | None = None
    trajectory: TrajectoryFile = TrajectoryFile()
    clock: Clock | None = None
    """None: images and trajectory have one clock."""
    control_points: ControlPoints | None = None
    pair_tolerance_ms: float = Field(default=5.0, gt=0, le=60_000)
    """Left and right images farther apart in time are not a pair. (KITTI's own are up to 0.65 ms apart.)"""
    max_pose_gap_s: float | None = Field(default=None, gt=0, le=3600)
    """Poses farther apart in time are not interpolated: 0.5 s, of trajectories with fewer records see `sparse_poses.py`."""
    antenna_t_m: tuple[Metres, Metres, Metres] | None = None
    """The GNSS antenna in the frame of the attitudes (of bags the IMU's, where /tf_static has none); 0, 0, 0 if the positions are
    those of its origin."""

    @property
    def pair_tolerance_ns(self) -> int:
        return round(self.pair_tolerance_ms * 1e6)

    @property
    def max_pose_gap_ns(self) -> int:
        return round((self.max_pose_gap_s or MAX_POSE_GAP_S) * 1e9)

    def id_of(self, source: Path) -> str:
        """The drive's id: that of the file, else the name of the folder or recording itself, not of a link to it."""
        source = source.resolve()
        return printable(self.drive_id or (source.stem if is_bare_bag(source) else source.name))[:200]


def is_bare_bag(source: Path) -> bool:
    """True for a .mcap or .bag file; a bag's folder is a folder."""
    return source.suffix in (".mcap", ".bag") and source.is_file()


def small_file(source: Path, name: str) -> Path:
    """Path of a small file `name` (drive.yaml, rig.yaml) of a drive: in its folder, or NAME.drive.yaml beside a bare bag."""
    source = source.resolve()
    return source.with_name(f"{source.stem}.{name}") if is_bare_bag(source) else source / name


def read_drive_yaml(source: Path) -> DriveYaml:
    """Settings of a drive, a folder or a bare bag; all defaults without a `drive.yaml`. Raises InputError."""
    path = small_file(source, DRIVE_YAML)
    if not path.is_file():
        return DriveYaml()
    return validated(read_yaml_mapping(path, "settings", " drive_id: morning-run"), DriveYaml, f"settings {path}")


def names_images(source: Path) -> bool:
    """Whether drive.yaml names videos or folders of images; the format says what is wrong with a broken file."""
    try:
        return (source / DRIVE_YAML).is_file() and read_drive_yaml(source).images.left is not None
    except InputError:
        return False


def inside(folder: Path, name: str, source: str, beside: str = ".") -> Path:
    """Path of something named in a file, which must be in the drive folder after symbolic links are resolved.

    beside: folder in the drive's that `name` is relative to. Raises InputError naming `source` where `..`, an absolute path
    or a link leads outside.
    """
    root = folder.resolve()
    # Longer than a file system allows, or with a zero byte.
    with library_errors(f"{source}: {shown(name)} cannot be the name of a file", OSError, ValueError):
        path = (root / beside / name).resolve()
        path.exists()
    if not path.is_relative_to(root):
        raise InputError(f"{source}: {shown(name)} is outside the drive folder {folder}; name a path inside it")
    return path
