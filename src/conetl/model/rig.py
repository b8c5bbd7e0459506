"""Records of a stereo rig: its cameras, their lenses, and the covariance of its calibration.

Units and frames as in `base.py`.
"""

from __future__ import annotations

from typing import Literal
from uuid import UUID

from pydantic import Field, model_validator

from conetl.model.base import Matrix4, NonNegative, Positive, Record

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
#: Bounds of what a vehicle can carry; every reader uses these.
MIN_BASELINE_M, MAX_BASELINE_M = 0.01, 10.0
MAX_LEVER_ARM_M = 20.0
#: Fields of view of 160 to 3 degrees.
MIN_FOCAL_SHARE, MAX_FOCAL_SHARE = 0.09, 20.0
#: A 100-megapixel camera still fits.
MAX_IMAGE_PIXELS = 2**27
#: A phone reads 10 to 35 ms, a camera with 15 images a second at most 67.
MAX_READOUT_MS = 100.0
StampRow = Literal["first", "middle", "last"]
LensModel = Literal["none", "radial", "brown", "rational", "fisheye"]
#: Parameters of a camera and of the relative pose in the names of `CalibrationCovariance`.
INTERIOR = ("fx_px", "fy_px", "cx_px", "cy_px")
RELATIVE = ("rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m")
#: Number of coefficients of each lens model, in OpenCV's order.
LENS_COEFFICIENTS: dict[LensModel, int] = {"none": 0, "radial": 2, "brown": 5, "rational": 8, "fisheye": 4}


#: The sixth power of an angle is small in a telephoto lens, so its coefficients may be large.
_MOST_OF_LENS = 1e9


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
        if worst := [one for one in self.coefficients if not abs(one) <= _MOST_OF_LENS]:
            raise ValueError(
                f"a coefficient of the lens is {worst[0]:g}, expected numbers of at most {_MOST_OF_LENS:g}"
            )
        return self


class Shutter(Record):
    """When the rows of a camera's images, as they are stored, were exposed: one after the other (rolling shutter).

    The middle of the exposure of row v is v / (height - 1) times the readout after that of row 0.
    """

    readout_ms: float = Field(ge=-MAX_READOUT_MS, le=MAX_READOUT_MS)
    """From the first row to the last. Negative: the last row is first, as of a camera upside down whose images were turned."""
    readout_sigma_ms: NonNegative = 0.0
    """Where it is not 0, the images of a drive are asked for a better value (`geometry/calibration/self_calibration.py`)."""
    stamp_row: StampRow | None = None
    """The row that the time stamp of an image belongs to; None: not known, the middle is assumed."""


class Camera(Record):
    """Interior orientation of one camera in pixels; a rectified camera is one without a lens (model "none")."""

    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    lens: Lens = Lens()
    shutter: Shutter | None = Field(default=None, exclude_if=lambda shutter: shutter is None, repr=False)
    """Of the camera that took the images (`Rig.rectified_from`); None: not stated, all rows count as exposed together."""

    @model_validator(mode="after")
    def _not_too_large(self) -> Camera:
        if self.width_px * self.height_px > MAX_IMAGE_PIXELS:
            raise ValueError(f"{self.width_px} x {self.height_px} pixels are more than {MAX_IMAGE_PIXELS:,}")
        return self

    @model_validator(mode="after")
    def _principal_point_near_the_image(self) -> Camera:
        # Farther outside than the image's own size: it belongs to another image size. (After cropping it may lie outside.)
        width, height = self.width_px, self.height_px
        if not (-width < self.cx_px < 2 * width and -height < self.cy_px < 2 * height):
            raise ValueError(
                f"the principal point ({self.cx_px:g}, {self.cy_px:g}) is far outside of the image, {width} x {height} pixels"
            )
        return self


class SharedErrors(Record):
    """The part of a calibration's errors that all drives with this calibration share; the rest differs from drive to drive."""

    calibration: UUID
    """Id of the given calibration (`geometry/calibration/covariance.py`)."""
    matrix: tuple[tuple[float, ...], ...]
    """A row per parameter, in the order of `CalibrationCovariance.names`: its change by one sigma of each independent error."""


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

    @property
    def sigmas(self) -> dict[str, float]:
        """Standard deviations by name."""
        return {name: self.matrix[i][i] ** 0.5 for i, name in enumerate(self.names)}


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
                "unit (conetl rig convert --unit mm converts it to a rig.yaml), or in squares of a calibration board?"
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
