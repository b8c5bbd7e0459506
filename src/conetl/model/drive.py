"""Records of a drive, in the order of processing: its frame pairs and poses, and what was found in them.

Units and frames as in `base.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from pydantic import Field, field_validator, model_validator

from conetl.model.base import (
    Cov3,
    Matrix3,
    NonNegative,
    Positive,
    Probability,
    Record,
    SharedErrorJacobian,
    Vec2,
    Vec3,
    utc_from_ns,
)
from conetl.model.feature_classes import CONE
from conetl.model.rejections import Rejection
from conetl.model.rig import Rig, Side

if TYPE_CHECKING:
    from conetl.model.markings import MarkingTrack

MAX_SPEED_M_S = 100.0
#: The database column has 4 bytes.
MAX_FRAME_INDEX = 2**31 - 1
FrameIndex = Annotated[int, Field(ge=0, le=MAX_FRAME_INDEX)]


class Interpolated(Record):
    """Uncertainty that interpolation between sparse records (1 Hz) adds to a pose; all frame pairs between two records share
    it."""

    sigma_enu_m: tuple[NonNegative, NonNegative, NonNegative]
    sigma_rpy_rad: tuple[NonNegative, NonNegative, NonNegative]
    apart_s: Positive
    """Time between the records."""


class Pose(Record):
    """Exterior orientation of the body at exposure: `map_p = R @ body_p + t`, with its standard deviations."""

    map_R_body: Matrix3
    map_t_body_m: Vec3
    sigma_enu_m: tuple[NonNegative, NonNegative, NonNegative]
    """Absolute, of the body's position (GNSS/INS); strongly correlated between the frames of a drive."""
    sigma_rpy_rad: tuple[NonNegative, NonNegative, NonNegative]
    interpolated: Interpolated | None = None
    """Part of these sigmas caused by interpolation; None if records are frequent enough to neglect it."""


#: Fine structure (grey levels) below which the detector may be blind: at 4 fog and blur hide at least a third of the cones.
MIN_DETAIL = 5.0


class FramePair(Record):
    """The left and right image of one trigger, with the pose at that instant."""

    frame_index: FrameIndex
    """Number in the file name, which links images, poses and time stamps."""
    left_path: str
    right_path: str
    captured_at_ns: int
    """UTC, nanoseconds since 1970-01-01, of the left image."""
    pose: Pose
    left_sha256: str = ""
    right_sha256: str = ""
    """SHA-256 of the image files; empty if only their headers were read."""
    detail: NonNegative | None = None
    """Fine structure of its images (grey levels), the smaller of both; None if not measured."""

    @property
    def shows_absence(self) -> bool:
        """Whether a cone that is not detected in it may be gone: its images have enough detail, or their detail was not
        measured."""
        return self.detail is None or self.detail >= MIN_DETAIL

    def image(self, side: Side) -> tuple[str, str]:
        """Path and SHA-256 of the image of one side."""
        return (self.left_path, self.left_sha256) if side == "left" else (self.right_path, self.right_sha256)

    @property
    def captured_at(self) -> datetime:
        return utc_from_ns(self.captured_at_ns)

    def with_pose(self, **values: object) -> FramePair:
        """The same pair with other values of fields of its pose."""
        return self.model_copy(update={"pose": self.pose.model_copy(update=values)})


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


class CommonError(Record):
    """An error of the positions that all drives with this id share: of a base station, a datum, the lever arm of an antenna.

    It is a part of the stated sigmas, which are enlarged if they are smaller. Another sigma is another error: state the same one
    in all drives.
    """

    id: str = Field(min_length=1, max_length=200)
    """Name of its cause."""
    sigma_m: tuple[NonNegative, NonNegative, NonNegative]
    """Of each axis; one number stands for three."""
    axes: Literal["map", "vehicle"] = "map"
    """East, north, up, in which it is constant; or forward, left, up, for a lever arm: it turns with the vehicle."""

    @field_validator("sigma_m", mode="before")
    @classmethod
    def _one_for_three(cls, value: object) -> object:
        return (value,) * 3 if isinstance(value, float | int) else value


class UnclearSquares(Record):
    """Squares of the images that are blurred or covered. An object that is not detected there may still exist."""

    side_px: Positive
    """Side of a square; the first one is in the top left corner."""
    left: tuple[tuple[int, int], ...] = ()
    """Row and column of each square, from 0."""
    right: tuple[tuple[int, int], ...] = ()


class Drive(Record):
    """One recording by one rig, without the frame pairs that the reader rejected."""

    drive_id: str = Field(min_length=1, max_length=200)
    source_path: str
    rig: Rig
    map_srid: int
    content_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    """Hash of names and bytes of all files, including images."""
    frame_pairs: tuple[FramePair, ...] = Field(min_length=1, repr=False)
    expected_frame_count: int = Field(gt=0)
    """Number of frame pairs in the folder, including rejected ones."""
    clock_sigma_s: Positive | None = None
    """Sigma of the offset between the clocks of images and poses; default: that of `TrajectoryParams`."""
    control_points: tuple[SurveyedPoint, ...] = ()
    """Surveyed cones, used in the adjustment of the poses."""
    common_errors: tuple[CommonError, ...] = ()
    """Errors of the positions that other drives share, within the sigmas of the poses."""
    unclear: UnclearSquares | None = None
    """None if the images were not checked, or all squares are clear."""

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

    Box edges are measured from the edge of the image (COCO): a box over the first pixel has x 0 and width 1, and the centre of
    that pixel is 0.5 in box edges and 0 as an image point. `tracking/matching/matches.py` converts them.
    """

    frame_index: int = Field(ge=0)
    side: Side
    detection_index: int = Field(ge=0)
    """Number within its image, in order of descending score."""
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
    """Left and right detection of one object, or one of both, with the image points used for its position.

    `foot`: centre of the base where it meets the ground; `centre`: centre of the box (the paper's point); `tip`: top of the cone.
    """

    frame_index: int = Field(ge=0)
    match_index: int = Field(ge=0)
    left: Detection | None
    """None: the network found the object in the other image only, and the images of both show it here."""
    right: Detection | None
    foot_left_uv_px: Vec2
    foot_right_uv_px: Vec2
    centre_left_uv_px: Vec2
    centre_right_uv_px: Vec2
    tip_left_uv_px: Vec2
    tip_right_uv_px: Vec2
    sigma_u_px: Positive
    """Of each image point along the rows, independent in both images: sigma of the disparity / sqrt(2). sigma_v_px: across."""
    sigma_v_px: Positive
    sigma_pointing_px: NonNegative
    """Of the cone's axis along the rows, common to both images: affects the bearing, not the range."""
    sigma_outline_px: NonNegative = 0.0
    """Of the detected foot and axis, common to all observations of one cone: across the rows, and times
    `FeatureClass.outline_aside` along them."""
    refined: bool
    """Whether area-based matching refined the image points, which otherwise come from the boxes alone."""
    cost: NonNegative

    @model_validator(mode="after")
    def _has_a_box(self) -> StereoMatch:
        if not self.boxes:
            raise ValueError("expected a detection in at least one image")
        return self

    @property
    def boxes(self) -> tuple[Detection, ...]:
        """One or two."""
        return tuple(box for box in (self.left, self.right) if box is not None)

    @property
    def category(self) -> str:
        """Of its detections."""
        return self.boxes[0].category


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
    object_height_m: float
    camera_xyz_m: Vec3
    """Foot in the left camera's frame (x right, y down, z forward), without GNSS error."""
    camera_cov_m2: Cov3
    sigma_outline_m: NonNegative = 0.0
    """Common to all observations of this cone (`StereoMatch.sigma_outline_px`): down, and times `FeatureClass.outline_aside` to
    the right; included in both covariances."""
    range_m: Positive
    """Ground distance from the left camera to the foot."""
    ray_angle_rad: Positive
    residual_rms_px: NonNegative
    iterations: int = Field(ge=1)
    score: Probability


class Track(Record):
    """All positions of one physical object in one drive, in one adjustment."""

    track_index: int = Field(ge=0)
    category: str = CONE
    xyz_m: Vec3
    cov_m2: Cov3
    """Absolute: includes the errors of pose, calibration and class that observations share."""
    relative_cov_m2: Cov3
    """Without these errors: for distances between objects of one class in this drive."""
    centre_xyz_m: Vec3
    object_height_m: Positive
    object_height_sigma_m: Positive
    existence_probability: Probability
    observation_count: int = Field(ge=1)
    first_seen_ns: int
    last_seen_ns: int
    residual_rms_px: NonNegative
    nearest_range_m: Positive
    members: tuple[tuple[int, int], ...] = Field(min_length=1)
    """(frame_index, match_index) of every position."""
    shared_jacobian: SharedErrorJacobian | None = Field(default=None, exclude=True, repr=False)
    """Of calibration and class in `cov_m2`; None if unknown. Stored in the database, not part of JSON."""


class DriveRecords(NamedTuple):
    """One drive with the records of every step, in the order of processing."""

    drive: Drive
    """With refined poses and corrected right camera, if any."""
    detections: Sequence[Detection] = ()
    matches: Sequence[StereoMatch] = ()
    positions: Sequence[Position] = ()
    tracks: Sequence[Track] = ()
    rejections: Sequence[Rejection] = ()
    markings: Sequence[MarkingTrack] = ()
