"""Records of a drive as frozen, validated models, in the order of processing.

Pydantic refuses unknown fields, NaN and infinity. Lengths are metres, image points pixels of the original (rectified) image
with the origin at the centre of the top-left pixel, angles radians, times UTC nanoseconds since 1970. Map coordinates are
easting, northing (of the map CRS) and ellipsoidal height. See docs/reference/coordinates.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, TypeVar
from uuid import UUID

from pydantic import BaseModel, ConfigDict, Field, model_validator

from conetl.model.feature_classes import CONE
from conetl.model.rejections import Rejection

if TYPE_CHECKING:
    from conetl.model.markings import MarkingTrack

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Matrix3 = tuple[Vec3, Vec3, Vec3]
Matrix4Row = tuple[float, float, float, float]
Matrix4 = tuple[Matrix4Row, Matrix4Row, Matrix4Row, Matrix4Row]
#: Symmetric 3x3 matrix as its upper triangle xx, xy, xz, yy, yz, zz (m^2).
Cov3 = tuple[float, float, float, float, float, float]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Probability = Annotated[float, Field(ge=0, le=1)]

# Bounds of what a vehicle can record; every reader uses these.
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
#: Roads are between -430 and 5,900 m above the sea, and the geoid is within 110 m of the ellipsoid.
MIN_HEIGHT_M, MAX_HEIGHT_M = -500.0, 9_000.0
Height = Annotated[float, Field(ge=MIN_HEIGHT_M, le=MAX_HEIGHT_M)]
MIN_BASELINE_M, MAX_BASELINE_M = 0.01, 10.0
MAX_LEVER_ARM_M = 20.0
#: Fields of view of 160 to 3 degrees.
MIN_FOCAL_SHARE, MAX_FOCAL_SHARE = 0.09, 20.0
MAX_SPEED_M_S = 100.0
#: A 100-megapixel camera still fits.
MAX_IMAGE_PIXELS = 2**27
#: The database holds 4 bytes.
MAX_FRAME_INDEX = 2**31 - 1
FrameIndex = Annotated[int, Field(ge=0, le=MAX_FRAME_INDEX)]


class Record(BaseModel):
    """Base of all records: immutable, closed, finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


R = TypeVar("R", bound=Record)


#: One set for all records of a type: records are never changed, and a set each takes as long as the rest of `sound`.
_fields_of = cache(lambda record_type: set(record_type.model_fields))


def sound(record_type: type[R], **values: Any) -> R:
    """A record of values that are known to be valid, without checking them again; every field must be given.

    For rows read from the database and values computed from such: checks would dominate the comparison of a drive with 100,000
    features. Like `model_construct`, in a third of its time.
    """
    record = record_type.__new__(record_type)
    put = object.__setattr__
    put(record, "__dict__", values)
    put(record, "__pydantic_fields_set__", _fields_of(record_type))
    put(record, "__pydantic_extra__", None)
    put(record, "__pydantic_private__", None)
    return record


# --------------------------------------------------------------------------- drive


LensModel = Literal["none", "radial", "brown", "rational", "fisheye"]
#: Parameters of a camera and of the relative pose in the names of `CalibrationCovariance`.
INTERIOR = ("fx_px", "fy_px", "cx_px", "cy_px")
RELATIVE = ("rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m")
#: Number of coefficients of each lens model, in OpenCV's order.
LENS_COEFFICIENTS: dict[LensModel, int] = {"none": 0, "radial": 2, "brown": 5, "rational": 8, "fisheye": 4}


class Lens(Record):
    """Distortion of one camera's lens, acting on normalised image coordinates x/z, y/z.

    radial: k1, k2; brown: k1, k2, p1, p2, k3 (Brown 1971); rational: k1, k2, p1, p2, k3, k4, k5, k6; fisheye: k1, k2, k3, k4
    of the equidistant model (Kannala & Brandt 2006).
    """

    model: LensModel = "none"
    coefficients: tuple[float, ...] = ()

    @model_validator(mode="after")
    def _as_many_as_the_model_has(self) -> Lens:
        if len(self.coefficients) != LENS_COEFFICIENTS[self.model]:
            wanted = LENS_COEFFICIENTS[self.model]
            raise ValueError(f"lens model '{self.model}' has {wanted} coefficients, found {len(self.coefficients)}")
        return self


class GeodeticPosition(Record):
    """A position of WGS 84."""

    lat_deg: Latitude
    lon_deg: Longitude
    height_m: Height
    """Above the ellipsoid."""


class Camera(Record):
    """Interior orientation of one camera in pixels; a rectified camera is one without a lens (model "none")."""

    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    lens: Lens = Lens()

    @model_validator(mode="after")
    def _not_too_large(self) -> Camera:
        if self.width_px * self.height_px > MAX_IMAGE_PIXELS:
            raise ValueError(f"{self.width_px} x {self.height_px} pixels are more than {MAX_IMAGE_PIXELS:,}")
        return self


class SharedErrors(Record):
    """Errors of a calibration common to all drives that use it; the rest is of this drive alone."""

    calibration: UUID
    """Id of the given calibration (`geometry/calibration/covariance.py`)."""
    matrix: tuple[tuple[float, ...], ...]
    """One row per parameter, in the order of `CalibrationCovariance.names`: its change by one sigma of each independent
    error."""


class CalibrationCovariance(Record):
    """Covariance of a rig's calibration: errors common to all images of the rig.

    `names` are fields of the rig: left.fx_px, left.fy_px, left.cx_px, left.cy_px, left.lens.0, left.lens.1 ... (in the order of
    `Lens.coefficients`), right.* likewise, relative.rx_rad, relative.ry_rad, relative.rz_rad, relative.tx_m, relative.ty_m,
    relative.tz_m. The relative ones perturb left_SE3_right = (R, t) as (R exp(r), t + dt), r a rotation vector in the right
    camera's frame, dt in the left camera's. Parameters without a name are exact. Units are those of the names.
    """

    names: tuple[str, ...] = Field(min_length=1)
    matrix: tuple[tuple[float, ...], ...]
    shared: SharedErrors | None = None
    """The part common to all drives with the same calibration; None: all of it."""

    @model_validator(mode="after")
    def _square_and_symmetric(self) -> CalibrationCovariance:
        size = len(self.names)
        if len(set(self.names)) != size:
            raise ValueError("each calibration parameter may be named once")
        if len(self.matrix) != size or any(len(row) != size for row in self.matrix):
            raise ValueError(f"expected a {size} x {size} matrix, one row and column per name")
        for i in range(size):
            if self.matrix[i][i] < 0:
                raise ValueError(f"the variance of {self.names[i]} is negative")
            for j in range(i):
                bound = 1e-6 * (self.matrix[i][i] * self.matrix[j][j]) ** 0.5 + 1e-30
                if abs(self.matrix[i][j] - self.matrix[j][i]) > bound:
                    raise ValueError(f"the matrix is not symmetric at {self.names[i]}, {self.names[j]}")
        return self


class Rig(Record):
    """Two cameras on a body (the INS unit, or the left camera if there is none).

    The rig of a `Drive` is rectified: no lens distortion, equal rows. If the stored images are not, `rectified_from` is the rig
    that took them, and images are resampled from it when they are read.

    `body_SE3_left`/`body_SE3_right` map camera points (x right, y down, z forward) to body points; their translation is the
    lever arm, their rotation the boresight.
    """

    rig_id: str = Field(min_length=1)
    left: Camera
    right: Camera
    body_SE3_left: Matrix4
    body_SE3_right: Matrix4
    sigma_px: Positive = 0.5
    calibration_covariance: CalibrationCovariance | None = None
    """Of this rig's own parameters; None where unknown. A rectified rig has that of `rectified_from`."""
    rectified_from: Rig | None = None

    @model_validator(mode="after")
    def _fits_on_a_vehicle(self) -> Rig:
        if not MIN_BASELINE_M <= self.baseline_m <= MAX_BASELINE_M:
            raise ValueError(
                f"the baseline is {self.baseline_m:.4g} m, expected {MIN_BASELINE_M:g} to {MAX_BASELINE_M:g} m: is it in another "
                "unit? conetl rig convert --unit mm makes a rig.yaml of it"
            )
        for name, camera in (("left", self.left), ("right", self.right)):
            if not MIN_FOCAL_SHARE <= camera.fx_px / camera.width_px <= MAX_FOCAL_SHARE:
                raise ValueError(
                    f"the focal length of the {name} camera is {camera.fx_px:.4g} px, expected {MIN_FOCAL_SHARE:g} to "
                    f"{MAX_FOCAL_SHARE:g} widths of its images ({camera.width_px} px): is it in another unit?"
                )
        arm_m = max(abs(self.body_SE3_left[i][3]) for i in range(3))
        if not arm_m <= MAX_LEVER_ARM_M:
            raise ValueError(f"the lever arm of body_SE3_left is {arm_m:.4g} m, expected at most {MAX_LEVER_ARM_M:g} m")
        return self

    @property
    def baseline_m(self) -> float:
        a, b = self.body_SE3_left, self.body_SE3_right
        apart_m = [a[i][3] - b[i][3] for i in range(3)]
        return float(sum(d * d for d in apart_m) ** 0.5)  # a power would raise OverflowError


class Interpolated(Record):
    """What interpolation between sparse records (1 Hz) adds to the sigmas of a pose.

    The frame pairs between two records share it: they are no measurements of their own.
    """

    sigma_enu_m: tuple[NonNegative, NonNegative, NonNegative]
    sigma_rpy_rad: tuple[NonNegative, NonNegative, NonNegative]
    apart_s: Positive
    """Time between the records."""


class Pose(Record):
    """Exterior orientation of the body at exposure: `map_p = R @ body_p + t`, with its standard deviations."""

    map_R_body: Matrix3
    map_t_body_m: Vec3
    sigma_enu_m: tuple[NonNegative, NonNegative, NonNegative]
    """Of the body's position (GNSS/INS), absolute; strongly correlated between the frames of one drive."""
    sigma_rpy_rad: tuple[NonNegative, NonNegative, NonNegative]
    interpolated: Interpolated | None = None
    """The part of these sigmas that comes from interpolation; None of poses recorded often enough for it not to matter."""


#: Fine structure (grey levels) below which the detector may be blind: at 4 fog and blur hide at least a third of the cones.
MIN_DETAIL = 5.0


class FramePair(Record):
    """The left and right image of one trigger, with the pose at that instant."""

    frame_index: FrameIndex
    """Number in the file name; it links images, poses and time stamps."""
    left_path: str
    right_path: str
    captured_at_ns: int
    """UTC, nanoseconds since 1970-01-01, of the left image."""
    pose: Pose
    left_sha256: str = ""
    right_sha256: str = ""
    """Of the image files, as they were read with the drive; empty where only their headers were."""
    detail: NonNegative | None = None
    """Fine structure that its images show (grey levels), the smaller of both; None where it was not measured."""

    @property
    def shows_absence(self) -> bool:
        """Whether a cone that is not detected in its images may be gone: they show enough, or it was not measured."""
        return self.detail is None or self.detail >= MIN_DETAIL

    def image(self, side: Side) -> tuple[str, str]:
        """Path and SHA-256 of the image of one side."""
        return (self.left_path, self.left_sha256) if side == "left" else (self.right_path, self.right_sha256)

    @property
    def captured_at(self) -> datetime:
        return utc_from_ns(self.captured_at_ns)


class ImageDetail(Record):
    """Fine structure that one image shows, in grey levels (`perception/image_detail.py`)."""

    frame_index: int = Field(ge=0)
    side: Side
    detail: NonNegative


class SurveyedPoint(Record):
    """A surveyed point in the CRS of the map, with ellipsoidal height, on which a cone's foot stands."""

    name: str
    xyz_m: Vec3
    sigma_m: tuple[Positive, Positive, Positive]
    """East, north, up."""


class UnclearSquares(Record):
    """Squares of the images that a drive's lenses show blurred or not at all: there nothing is missing that is not found."""

    side_px: Positive
    """Of a square; the first one is in the top left corner."""
    left: tuple[tuple[int, int], ...] = ()
    """Row and column of each, counted from 0."""
    right: tuple[tuple[int, int], ...] = ()


class Drive(Record):
    """One recording by one rig, without the frame pairs that the reader rejected."""

    drive_id: str = Field(min_length=1, max_length=200)
    source_path: str
    rig: Rig
    map_srid: int
    content_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    """Hash over names and bytes of all files read, images included."""
    frame_pairs: tuple[FramePair, ...] = Field(min_length=1)
    expected_frame_count: int = Field(gt=0)
    """Number of frame pairs in the folder, rejected ones included."""
    clock_sigma_s: Positive | None = None
    """Of the offset between the clocks of images and poses; None: as the parameters assume (`TrajectoryParams`)."""
    control_points: tuple[SurveyedPoint, ...] = ()
    """They take part in the adjustment of its poses."""
    unclear: UnclearSquares | None = None
    """None where its images were not looked at, or all of them is clear."""

    @model_validator(mode="after")
    def _frames_in_order(self) -> Drive:
        indices = [pair.frame_index for pair in self.frame_pairs]
        if any(b <= a for a, b in pairwise(indices)):
            raise ValueError("frame pairs must have strictly increasing frame_index")
        return self

    @property
    def captured_ns(self) -> tuple[int, int]:
        """Instants of the first and the last frame pair."""
        times_ns = [pair.captured_at_ns for pair in self.frame_pairs]
        return min(times_ns), max(times_ns)

    @property
    def captured_from(self) -> datetime:
        return utc_from_ns(self.captured_ns[0])

    @property
    def captured_to(self) -> datetime:
        return utc_from_ns(self.captured_ns[1])


# --------------------------------------------------------------------------- image space


class Detection(Record):
    """A box from the network, in pixels of the original image; x_px, y_px is the top-left corner.

    Box edges count from the image's edge (COCO): a box over the first pixel has x 0, width 1, and the centre of that pixel is
    0.5 in box edges and 0 as an image point. `tracking/matching/matches.py` converts them.
    """

    frame_index: int = Field(ge=0)
    side: Side
    detection_index: int = Field(ge=0)
    """Number within its image, by descending score."""
    category: str = CONE
    x_px: float
    y_px: float
    w_px: Positive
    h_px: Positive
    score: Probability
    foot_px: Vec2 | None = None
    """Centre of the cone's foot on the ground, in box edges like x_px; None if the network does not give it."""
    tip_px: Vec2 | None = None
    """Top of the cone's axis, likewise."""


class StereoMatch(Record):
    """Left and right detection of one object, with the image points that geometry uses.

    `foot`: centre of the base where it meets the ground; `centre`: centre of the box (the paper's point); `tip`: top of the cone.
    """

    frame_index: int = Field(ge=0)
    match_index: int = Field(ge=0)
    left: Detection
    right: Detection
    foot_left_uv_px: Vec2
    foot_right_uv_px: Vec2
    centre_left_uv_px: Vec2
    centre_right_uv_px: Vec2
    tip_left_uv_px: Vec2
    tip_right_uv_px: Vec2
    sigma_u_px: Positive
    """Of each image point along the rows, independent in both images: sigma of disparity over sqrt(2). sigma_v_px: across
    them."""
    sigma_v_px: Positive
    sigma_pointing_px: NonNegative
    """Along the rows, common to both images: position of the cone's axis. Affects the bearing, not the range."""
    sigma_outline_px: NonNegative = 0.0
    """Across the rows, and times `FeatureClass.outline_aside` along them, common to all observations of one cone: the detector's
    foot and axis."""
    refined: bool
    """True if refined by area-based matching, False if from box edges alone."""
    cost: NonNegative


# --------------------------------------------------------------------------- object space


class Position(Record):
    """Foot and box centre of one cone in the map frame, from one frame pair, by forward intersection."""

    frame_index: int = Field(ge=0)
    match_index: int = Field(ge=0)
    category: str = CONE
    xyz_m: Vec3
    """Foot centre on the ground; `geom` of the map."""
    cov_m2: Cov3
    centre_xyz_m: Vec3
    cone_height_m: float
    camera_xyz_m: Vec3
    """The foot in the left camera's frame (x right, y down, z forward), free of GNSS error."""
    camera_cov_m2: Cov3
    sigma_outline_m: NonNegative = 0.0
    """Down, and times `FeatureClass.outline_aside` to the right, common to all observations of this cone
    (`StereoMatch.sigma_outline_px`); part of both covariances."""
    range_m: Positive
    """Ground distance from the left camera to the foot."""
    ray_angle_rad: Positive
    residual_rms_px: NonNegative
    iterations: int = Field(ge=1)
    score: Probability


class SharedErrorJacobian(NamedTuple):
    """Change of a position by one sigma of each error that drives share: of a calibration, or of a class of objects."""

    calibrations: tuple[UUID, ...]
    """Sorted; also `class_error_id` of a class."""
    moved_m: bytes
    """(C, 3, K) metres of the map, big-endian float32: by calibration, axis, error; see `geometry/calibration/covariance.py`."""


class Track(Record):
    """All positions of one physical cone in one drive, jointly adjusted."""

    track_index: int = Field(ge=0)
    category: str = CONE
    xyz_m: Vec3
    cov_m2: Cov3
    """Absolute, with the errors of pose and calibration that all observations share, and of the class that its objects share."""
    relative_cov_m2: Cov3
    """Without these: for distances between objects of one class in this drive."""
    centre_xyz_m: Vec3
    cone_height_m: Positive
    cone_height_sigma_m: Positive
    existence_probability: Probability
    observation_count: int = Field(ge=1)
    first_seen_ns: int
    last_seen_ns: int
    residual_rms_px: NonNegative
    nearest_range_m: Positive
    members: tuple[tuple[int, int], ...] = Field(min_length=1)
    """(frame_index, match_index) of every position."""
    shared_jacobian: SharedErrorJacobian | None = Field(default=None, exclude=True, repr=False)
    """Of the parts of calibration and class in `cov_m2`; None where unknown. Stored in the database, not part of JSON."""


class DriveRecords(NamedTuple):
    """One drive with the records of every step, in the order of processing."""

    drive: Drive
    """With refined poses and the corrected right camera, if any."""
    detections: Sequence[Detection] = ()
    matches: Sequence[StereoMatch] = ()
    positions: Sequence[Position] = ()
    tracks: Sequence[Track] = ()
    rejections: Sequence[Rejection] = ()
    markings: Sequence[MarkingTrack] = ()


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def utc_from_ns(nanoseconds: int) -> datetime:
    """UTC datetime of nanoseconds since 1970, truncated to microseconds (what datetime can hold)."""
    return _EPOCH + timedelta(microseconds=nanoseconds // 1000)


def ns_from_utc(instant: datetime) -> int:
    """UTC nanoseconds since 1970 of a datetime with a time zone."""
    return (instant - _EPOCH) // timedelta(microseconds=1) * 1000
