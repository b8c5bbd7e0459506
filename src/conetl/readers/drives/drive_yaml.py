"""`drive.yaml`: settings of one drive. Every key is optional."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, Field, field_validator, model_validator

from conetl.files.documents import library_errors, nested_model, read_yaml_mapping, shown, validated
from conetl.files.names import printable
from conetl.model.base import GeodeticPosition, NonNegative, Positive, Record
from conetl.model.drive import CommonError
from conetl.model.errors import InputError
from conetl.model.rig import MAX_LEVER_ARM_M, MAX_READOUT_MS, StampRow
from conetl.perception.video import Layout
from conetl.readers.trajectories.settings import TrajectoryFile, known_zone, setting

DRIVE_YAML = "drive.yaml"
#: Poses recorded often are not interpolated over longer gaps.
MAX_POSE_GAP_S = 0.5
#: A clock is not searched over more than two hours on either side.
MAX_SEARCH_S = 7200.0
Metres = Annotated[float, Field(ge=-MAX_LEVER_ARM_M, le=MAX_LEVER_ARM_M)]


class Cameras(Record):
    """Folders of the left and the right rectified camera; the number links them to the calibration."""

    left: str = Field(default="image_02", pattern=r"^image_0[0-9]$")
    """Folder of the left camera."""
    right: str = Field(default="image_03", pattern=r"^image_0[0-9]$")
    """Folder of the right camera."""


class Sigmas(Record):
    """Standard deviations. Those of the position replace OXTS `pos_accuracy`.

    The attitude defaults are those of the OXTS RT3003 data sheet (0.03, 0.03 and 0.1 degrees), increased for the boresight.
    """

    horizontal_m: Positive | None = setting(
        "Accuracy of the positions, horizontally, in metres: RTK 0.02, corrected 0.5, single 3.", 0.02
    )
    vertical_m: Positive | None = None
    """Default: 1.5 times the horizontal one."""
    roll_deg: Positive = 0.05
    """Of the attitude, as are the next two; the mount included."""
    pitch_deg: Positive = setting(
        "1 if the angles of the mount were estimated by eye; so are yaw_deg, roll_deg.", 1, default=0.05
    )
    yaw_deg: Positive = 0.15
    """Of the heading."""
    image_px: Positive = 0.5
    """Of an image point; replaces sigma_px of rig.yaml."""


class Georeference(GeodeticPosition):
    """Origin of a local trajectory (odometry, SLAM, motion capture), whose frame has z up."""

    heading_deg: float = Field(ge=-360, le=360)
    """Direction of the frame's x axis, clockwise from true north; 90 where it points east."""
    roll_deg: float = Field(default=0.0, ge=-90, le=90)
    """Of a frame that is not level: positive with its left side (y) up."""
    pitch_deg: float = Field(default=0.0, ge=-90, le=90)
    """Of such a frame: positive with its front (x) down."""


class Streams(Record):
    """Topics of a bag or folders of a EuRoC recording, where their types and names are ambiguous."""

    left: str | None = Field(default=None, min_length=1)
    """Images of the left camera."""
    right: str | None = Field(default=None, min_length=1)
    """Images of the right camera."""
    trajectory: str | None = Field(default=None, min_length=1)
    """NavSatFix or Odometry topic; folder beside cam0."""
    imu: str | None = Field(default=None, min_length=1)
    """Imu topic, with the attitudes."""
    left_info: str | None = Field(default=None, min_length=1)
    """CameraInfo topic of the left camera."""
    right_info: str | None = Field(default=None, min_length=1)
    """CameraInfo topic of the right camera."""


class Images(Record):
    """Stereo video, or folders of images, with a trajectory file beside them."""

    left: str | None = setting("File or folder of the left camera, or a pattern.", "left.mp4", min_length=1)
    """With `layout` the file that holds both images. Default: the one with left in its name. A pattern (`*_left.png`,
    `GX??0042.MP4`) names images, or the chapters of a video."""
    right: str | None = setting("File or folder of the right camera, or a pattern.", "right.mp4", min_length=1)
    layout: Layout | None = setting(
        "Where left and right are in each frame of one file: left-right, right-left, top-bottom or bottom-top.",
        "left-right",
    )
    start: str | None = setting(
        "Time of the first left frame, in UTC or with a UTC offset; to the second if not known better.",
        "2026-03-02 11:00:00.250+01:00",
        min_length=1,
    )
    """Without an offset in `timestamps_timezone`. Of images: the time of second 0 in `timestamps`."""
    timestamps: str | None = setting(
        "File with the time of each left image, one per line (UTC, or nanoseconds since 1970), or the trajectory if it has one "
        "record per image.",
        "left.txt",
        min_length=1,
    )
    right_timestamps: str | None = setting("The same for the right images, if they differ.", "right.txt", min_length=1)
    right_offset_s: float | None = setting(
        "Seconds by which the right file begins after the left one; 0 if both start at the same trigger.",
        0,
        ge=-3600,
        le=3600,
    )
    """Default: found from the motion in the images."""
    crop: tuple[int, int, int, int] | None = setting(
        "Part of the calibration's images that these are: first column and row (negative: padded), width, height.",
        [0, 40, 1280, 640],
    )
    binning: int = setting(
        "Pixels of the calibration's images that are one pixel here, in each direction; with crop.",
        2,
        default=1,
        ge=1,
        le=16,
    )
    every: int = setting("Use every n-th frame pair.", 2, default=1, ge=1)
    from_s: float = setting("Start at this second of the left file.", 10, default=0.0, ge=0, le=1e7)
    to_s: float | None = setting("Stop at this second of the left file.", 70, gt=0, le=1e7)

    @model_validator(mode="after")
    def _check(self) -> Images:
        if self.binning > 1 and self.crop is None:
            raise ValueError(
                "binning needs crop, the part of the calibration's images that was binned: [0, 0, width, height]"
            )
        if self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError(f"to_s {self.to_s:g} is not after from_s {self.from_s:g}")
        if self.left is not None and self.left == self.right:
            raise ValueError(
                f"left and right are the same file, {self.left}; if it holds both images, state left and layout"
            )
        return self


class Mount(Record):
    """The left camera on the body whose trajectory was recorded (an IMU, or the antenna), for a rig.yaml without its pose."""

    forward_m: Metres = setting("Metres forward.", 1.2, default=...)
    left_m: Metres = setting("Metres to the left; negative: to the right.", 0.3, default=...)
    up_m: Metres = setting("Metres up.", -0.2, default=...)
    roll_deg: float = setting("Positive with the left side up.", 0.5, default=0.0, ge=-180, le=180)
    pitch_deg: float = setting("Degrees by which it looks down; negative: up.", 3, default=0.0, ge=-90, le=90)
    yaw_deg: float = setting("Degrees by which it looks to the left.", -1.5, default=0.0, ge=-180, le=180)


class CameraShutter(Record):
    """Rolling shutter of one camera, as in rig.yaml; what is not stated stays as it is there."""

    readout_ms: float | None = setting(
        "Milliseconds from the exposure of the first row to that of the last one; most video cameras and phones take 5 to 30, "
        "global shutters 0.",
        10,
        ge=-MAX_READOUT_MS,
        le=MAX_READOUT_MS,
    )
    readout_sigma_ms: NonNegative | None = None
    """Standard deviation of readout_ms; above 0 the images may improve the stated value."""
    stamp_row: StampRow | None = setting(
        "The row that the times of the images belong to: first, middle or last.", "first"
    )


class ShutterSettings(CameraShutter):
    """Of both cameras."""

    right: CameraShutter = CameraShutter()
    """Where the right camera differs."""


class Clock(Record):
    """The clock of the images against that of the trajectory, where they are not the same."""

    offset_s: Annotated[float, Field(ge=-1e9, le=1e9)] | Literal["estimate"] = setting(
        "Seconds to add to the times of the images; estimate: find them from turns and speeds.",
        "estimate",
        default="estimate",
    )
    sigma_s: float | None = Field(default=None, gt=0, le=10)
    """Sigma of the stated offset; default 0.01 s."""
    search_s: float = Field(default=30.0, gt=0, le=MAX_SEARCH_S)
    """The offset is searched between minus and plus this."""


class ControlPoints(Record):
    """Surveyed feet of cones that are used in the adjustment of the poses; a text is the name of the file."""

    file: str = Field(min_length=1, max_length=1000)
    """CSV, GeoJSON, GeoPackage, FlatGeobuf or GeoParquet inside the drive folder."""
    crs: str | None = Field(default=None, min_length=1, max_length=10_000)
    """Of the points, where the file states none, as any text that PROJ knows."""
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

    drive_id: str | None = setting("Default: the name of the folder.", "morning-run", min_length=1, max_length=200)
    rig_id: str | None = Field(default=None, min_length=1)
    """Name of the rig. Default: a hash over the numbers of its calibration."""
    pair: tuple[str, str] | None = None
    """Left and right of the cameras of a rig.yaml with more than two."""
    map_srid: int | None = Field(default=None, gt=0, lt=1_000_000)
    """EPSG code of a new map. Default: the UTM zone of its first drive."""
    timestamps_timezone: Annotated[str, AfterValidator(known_zone)] = setting(
        "Time zone of times of images without an offset.", "Europe/Berlin", default="UTC"
    )
    cameras: Cameras = Cameras()
    calibration: str | None = Field(default=None, min_length=1)
    """KITTI calib_cam_to_cam.txt, relative to the drive folder and inside it; the other two are beside it."""
    sigmas: Sigmas = Field(default=Sigmas(), description="Of the trajectory; they replace those of the log.")
    georeference: Georeference | None = setting(
        "Where a local trajectory begins: longitude, latitude, ellipsoidal height of its origin, and the direction of its x axis "
        "(of poses of the left camera: of the vehicle at the first one), clockwise from north.",
        {"lon_deg": 8.43, "lat_deg": 49.002, "height_m": 116.0, "heading_deg": 57.0},
    )
    streams: Streams = Streams()
    images: Images = Field(default=Images(), description="The videos or folders of images.")
    mount: Mount | None = setting(
        "The left camera as seen from the antenna or IMU of the log: metres forward, left, up, and degrees of downward tilt.",
        {"forward_m": 1.2, "left_m": 0.3, "up_m": -0.2, "pitch_deg": 3},
    )
    trajectory: TrajectoryFile = Field(default=TrajectoryFile(), description="The GNSS/INS log.")
    shutter: ShutterSettings = Field(default=ShutterSettings(), description="Rolling shutter of the cameras.")
    clock: Clock | None = Field(default=None, description="Of the images relative to the trajectory.")
    """None: images and trajectory have one clock."""
    common_errors: tuple[CommonError, ...] = setting(
        "Errors of the positions that other drives share, of base station, datum or lever arm, as a part of the sigmas.",
        [{"id": "base-north", "sigma_m": 0.02}],
        default=(),
    )
    """One, or a list of them."""
    control_points: ControlPoints | None = setting("Surveyed cones that correct the poses.", "points.csv")
    pair_tolerance_ms: float = Field(default=5.0, gt=0, le=60_000)
    """Left and right images farther apart in time are not a pair. (KITTI's own are up to 0.65 ms apart.)"""
    max_pose_gap_s: float | None = Field(default=None, gt=0, le=3600)
    """Poses farther apart in time are not interpolated. Default: 0.5 s; 2.5 times the interval of sparse records, up to 5 s."""
    antenna_t_m: tuple[Metres, Metres, Metres] | None = None
    """The GNSS antenna in the frame of the attitudes (of bags the IMU's, where /tf_static has none); 0, 0, 0 if the positions are
    those of its origin."""

    @field_validator("common_errors", mode="before")
    @classmethod
    def _one_alone(cls, value: object) -> object:
        return (value,) if isinstance(value, Mapping) else value

    @field_validator("common_errors")
    @classmethod
    def _each_once(cls, value: tuple[CommonError, ...]) -> tuple[CommonError, ...]:
        ids = [one.id for one in value]
        if len(set(ids)) < len(ids):
            raise ValueError("two errors have the same id")
        return value

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
    content = read_yaml_mapping(path, "settings", " drive_id: morning-run")
    return validated(stated(content), DriveYaml, f"settings {path}")


def stated(values: Mapping[str, Any], model: type[BaseModel] = DriveYaml) -> dict[str, Any]:
    """Settings without the keys that have no value, as `conetl init` writes those that are still needed.

    Unknown keys stay: behind a decimal comma in {forward_m: 1,07} there is one.
    """
    kept = dict(values)
    for key in values.keys() & model.model_fields.keys():
        value, inner = values[key], nested_model(model.model_fields[key].annotation)
        if inner is not None and isinstance(value, Mapping) and value:
            kept[key] = value = stated(value, inner) or None
        if value is None:
            del kept[key]
    return kept


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
    # Longer than a file system allows, with a zero byte, or a link to itself.
    with library_errors(f"{source}: {shown(name)} cannot be the name of a file", OSError, ValueError, RuntimeError):
        path = (root / beside / name).resolve()
        path.exists()
    if not path.is_relative_to(root):
        raise InputError(f"{source}: {shown(name)} is outside the drive folder {folder}; name a path inside it")
    return path


def named_in_yaml(root: Path, name: str, what: str, *, folder: bool = False) -> Path:
    """Path of a file that drive.yaml names, as `inside`. Raises InputError where there is none.

    what: it is, with its verb: `the log is`; folder: whether it may be a folder.
    """
    path = inside(root, name, DRIVE_YAML)
    if not (path.is_file() or (folder and path.is_dir())):
        raise InputError(f"{path}: {what} missing, which {DRIVE_YAML} names; copy it, or correct the name")
    return path
