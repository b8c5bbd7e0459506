"""`rig.yaml`, conetl's own description of a rig (docs/reference/rigs.md shows one), read and written.

Cameras in pixels or in millimetres with the sensor's size, with or without a lens; the pose of the right one in the left, and
of the left one on the body; and, where known, the covariance or the sigmas of any of these parameters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from conetl.files.documents import input_errors, read_yaml
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.calibration.stereo_bundle import parameter_names
from conetl.geometry.rectification import check_stereo_baseline
from conetl.model.arrays import Floats
from conetl.model.base import Matrix3, NonNegative, Positive, Record, Vec3
from conetl.model.errors import InputError
from conetl.model.rig import CalibrationCovariance, Camera, Lens, Rig, Shutter
from conetl.readers.rigs.common import Pair, choose_pair, rig_of, write_yaml

RIG_YAML = "rig.yaml"
#: Ways to give the interior orientation: in pixels, or in millimetres with the sensor's size.
_FORMS = (
    {"fx_px", "fy_px", "cx_px", "cy_px"}, {"fx_mm", "fy_mm", "sensor_width_mm", "sensor_height_mm"},
    {"focal_mm", "sensor_width_mm", "sensor_height_mm"},
)  # fmt: skip
_PRINCIPAL_MM = {"x0_mm", "y0_mm", "principal_mm"}
#: Units of `sigmas` besides those of CalibrationCovariance.
_OTHER_UNITS = {"_deg": ("_rad", np.pi / 180), "_mm": ("_m", 0.001)}


class _CameraFile(Record):
    """Interior orientation in pixels, or in millimetres with the sensor's size (the paper's Table 1)."""

    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    fx_px: Positive | None = None
    fy_px: Positive | None = None
    cx_px: float | None = None
    cy_px: float | None = None
    fx_mm: Positive | None = None
    fy_mm: Positive | None = None
    focal_mm: Positive | tuple[Positive, Positive] | None = None
    """One number, or fx and fy, instead of fx_mm and fy_mm."""
    sensor_width_mm: Positive | None = None
    sensor_height_mm: Positive | None = None
    x0_mm: float | None = None
    """Principal point from the centre of the sensor, to the right."""
    y0_mm: float | None = None
    """Principal point from the centre of the sensor, upwards (photogrammetric axes)."""
    principal_mm: tuple[float, float] | None = None
    """Principal point from the top-left corner of the sensor, to the right and down, instead of x0_mm, y0_mm."""
    lens: Lens = Lens()
    shutter: Shutter | None = None
    """Rolling shutter; without it all rows are exposed together."""

    @model_validator(mode="after")
    def _one_form(self) -> _CameraFile:
        given = {name for name, value in self if value is not None} & _PRINCIPAL_MM.union(*_FORMS)
        centre = given & _PRINCIPAL_MM
        form = given - centre
        if form not in _FORMS or (form == _FORMS[0] and centre) or ("principal_mm" in centre and len(centre) > 1):
            raise ValueError(
                "give either fx_px, fy_px, cx_px, cy_px, or fx_mm, fy_mm (or focal_mm), sensor_width_mm, sensor_height_mm (and "
                "x0_mm, y0_mm or principal_mm)"
            )
        return self

    def px_per_mm(self) -> tuple[float, float] | None:
        """Along rows and columns; None where the sensor's size is not given."""
        if self.sensor_width_mm is None or self.sensor_height_mm is None:
            return None
        return self.width_px / self.sensor_width_mm, self.height_px / self.sensor_height_mm

    def camera(self) -> Camera:
        """In pixels, origin at the centre of the top-left pixel."""
        scale = self.px_per_mm()
        if scale is None:
            assert self.fx_px and self.fy_px and self.cx_px is not None and self.cy_px is not None  # by the validator
            fx, fy, cx, cy = self.fx_px, self.fy_px, self.cx_px, self.cy_px
        else:
            pair = self.focal_mm if isinstance(self.focal_mm, tuple) else (self.focal_mm, self.focal_mm)
            fx_mm, fy_mm = pair if self.focal_mm is not None else (self.fx_mm, self.fy_mm)
            assert fx_mm and fy_mm
            fx, fy = fx_mm * scale[0], fy_mm * scale[1]
            if self.principal_mm is not None:  # from the corner, half a pixel before the first pixel's centre
                cx, cy = self.principal_mm[0] * scale[0] - 0.5, self.principal_mm[1] * scale[1] - 0.5
            else:
                cx = (self.width_px - 1) / 2 + (self.x0_mm or 0.0) * scale[0]
                cy = (self.height_px - 1) / 2 - (self.y0_mm or 0.0) * scale[1]
        return Camera(
            width_px=self.width_px, height_px=self.height_px, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, lens=self.lens,
            shutter=self.shutter,
        )  # fmt: skip


class _RigidFile(Record):
    """`p_dst = R p_src + t`."""

    R: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    t_m: Vec3

    def matrix(self, name: str) -> Floats:
        try:
            return se3.se3(se3.nearest_rotation(np.array(self.R)), np.array(self.t_m))
        except ValueError as error:
            raise ValueError(f"{name}.R: {error}") from error


class _RigFile(Record):
    """A `rig.yaml`: two cameras, the pose of the right one in the left, and optionally of the left one on the body."""

    rig_id: str | None = Field(default=None, min_length=1)
    left: _CameraFile
    right: _CameraFile
    baseline_m: Positive | None = None
    left_SE3_right: _RigidFile | None = None
    body_SE3_left: _RigidFile | None = None
    sigma_px: Positive = 0.5
    calibration_covariance: CalibrationCovariance | None = None
    sigmas: dict[str, NonNegative] | None = Field(default=None, min_length=1)
    """Standard deviations by the names of CalibrationCovariance, also in _deg and _mm: the parameters then are uncorrelated."""

    @model_validator(mode="after")
    def _one_of_each(self) -> _RigFile:
        if (self.baseline_m is None) == (self.left_SE3_right is None):
            raise ValueError(
                "give either baseline_m (parallel cameras) or left_SE3_right (R and t_m, from right to left camera)"
            )
        if self.sigmas is not None and self.calibration_covariance is not None:
            raise ValueError("give either sigmas or calibration_covariance")
        if self.calibration_covariance is not None and self.calibration_covariance.shared is not None:
            raise ValueError("calibration_covariance has names and a matrix; what drives share of it is computed")
        return self

    def covariance(self) -> CalibrationCovariance | None:
        """Covariance of the parameters in the units of their names. Raises ValueError for unknown names."""
        covariance = self.calibration_covariance
        if self.sigmas is not None:
            converted: dict[str, float] = {}
            for name, sigma in self.sigmas.items():
                known, factor = _in_own_unit(name, self)
                if known in converted:
                    raise ValueError(f"'sigmas.{name}': {known} is given twice")
                converted[known] = sigma * factor
            diagonal = np.diag(np.square(list(converted.values())))
            covariance = CalibrationCovariance(names=tuple(converted), matrix=tuple(map(tuple, diagonal.tolist())))
        if covariance is not None:
            _check_covariance(covariance, self.left.lens, self.right.lens)
        return covariance


class _CameraOfMany(_CameraFile):
    """One camera of a rig with more than two."""

    body_SE3_camera: _RigidFile


class _RigOfMany(Record):
    """A `rig.yaml` with cameras by name, each with its pose on the body; its stereo pair has to be chosen."""

    rig_id: str | None = Field(default=None, min_length=1)
    cameras: dict[str, _CameraOfMany] = Field(min_length=2)
    sigma_px: Positive = 0.5


def _in_own_unit(name: str, file: _RigFile) -> tuple[str, float]:
    """A sigma's name in the unit of CalibrationCovariance, and its factor."""
    part, _, field = name.partition(".")
    if part in ("left", "right") and field.endswith("_mm"):
        scale = (file.left if part == "left" else file.right).px_per_mm()
        px = {"fx_mm": "fx_px", "fy_mm": "fy_px", "x0_mm": "cx_px", "y0_mm": "cy_px"}.get(field)
        if px is None or scale is None:
            raise ValueError(f"'sigmas.{name}': millimetres need a camera given in millimetres and fx, fy, x0 or y0")
        return f"{part}.{px}", scale[0 if "x" in field else 1]
    for ending, (own, factor) in _OTHER_UNITS.items():
        if part == "relative" and name.endswith(ending):
            return name.removesuffix(ending) + own, factor
    return name, 1.0


def _check_covariance(covariance: CalibrationCovariance, left: Lens, right: Lens) -> None:
    """Raise ValueError for a name that is not a parameter of the rig, or a matrix that is not a covariance."""
    known = [name for name in parameter_names(left.model) if not name.startswith("right.")]
    known += [name for name in parameter_names(right.model) if name.startswith("right.")]
    for name in covariance.names:
        if name not in known:
            raise ValueError(
                f"'{name}' in the calibration's covariance is not a parameter of this rig: {', '.join(known)}"
            )
    matrix = np.array(covariance.matrix)
    sigma = np.sqrt(np.diag(matrix))
    scale = np.where(sigma > 0, sigma, 1.0)
    if np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min() < -1e-6:
        raise ValueError("'calibration_covariance.matrix' is not a covariance: it has a negative eigenvalue")


def read_rig_yaml(path: Path, *, pair: Pair | None = None, unit_m: float = 1.0) -> Rig:
    """Rig from a `rig.yaml`: raw, where it has lenses or turned cameras. Raises InputError.

    pair: of its `cameras`; unit_m: of the lengths whose keys end in `_m`, where somebody wrote them in another unit.
    """
    content: Any = read_yaml(path)
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected a YAML mapping with the keys left, right and baseline_m")
    if unit_m != 1.0:
        content = _in_metres(content, unit_m)
    with input_errors(path):
        if "cameras" in content:
            return _pair_of_many(path, _RigOfMany.model_validate(content), pair)
        if pair is not None:
            raise ValueError("the file has no 'cameras' to choose from, but left and right; leave --pair out")
        file = _RigFile.model_validate(content)
        if file.left_SE3_right is not None:
            left_SE3_right = file.left_SE3_right.matrix("left_SE3_right")
        else:
            left_SE3_right = se3.se3(np.eye(3), np.array([file.baseline_m, 0.0, 0.0]))
        body_SE3_left = None if file.body_SE3_left is None else file.body_SE3_left.matrix("body_SE3_left")
        check_stereo_baseline(left_SE3_right)
        rig = rig_of(
            "rig", file.left.camera(), file.right.camera(), left_SE3_right,
            rig_id=file.rig_id, sigma_px=file.sigma_px, body_SE3_left=body_SE3_left,
        )  # fmt: skip
        return rig.model_copy(update={"calibration_covariance": file.covariance()})


def _in_metres(content: Any, unit_m: float, key: str = "") -> Any:
    """The same values, those of lengths multiplied."""
    if isinstance(content, dict):
        return {name: _in_metres(value, unit_m, str(name)) for name, value in content.items()}
    if isinstance(content, list):
        return [_in_metres(value, unit_m, key) for value in content]
    return content * unit_m if key.endswith("_m") and type(content) in (int, float) else content


def _pair_of_many(path: Path, file: _RigOfMany, pair: Pair | None) -> Rig:
    left, right = choose_pair(path, [*file.cameras], pair)
    body_SE3_left, body_SE3_right = (
        file.cameras[name].body_SE3_camera.matrix(f"cameras.{name}.body_SE3_camera") for name in (left, right)
    )
    left_SE3_right = se3.compose(se3.invert(body_SE3_left), body_SE3_right)
    check_stereo_baseline(left_SE3_right)
    return rig_of(
        "rig", file.cameras[left].camera(), file.cameras[right].camera(), left_SE3_right, sigma_px=file.sigma_px,
        rig_id=f"{file.rig_id}-{left}-{right}" if file.rig_id else None, body_SE3_left=body_SE3_left,
    )  # fmt: skip


def write_rig_yaml(rig: Rig, path: Path) -> None:
    """Write a rig as a `rig.yaml` with all digits. For the stored images of a rectified rig write its `rectified_from`.

    Raises InputError where the file cannot be written.
    """
    content: dict[str, Any] = {"rig_id": rig.rig_id}
    for name, camera in (("left", rig.left), ("right", rig.right)):
        content[name] = camera.model_dump(mode="json", exclude={"lens"} if camera.lens.model == "none" else None)
    content["left_SE3_right"] = _rigid(rigs.left_SE3_right(rig))
    if not rigs.body_is_left_camera(rig):
        content["body_SE3_left"] = _rigid(rigs.body_SE3_camera(rig, "left"))
    content["sigma_px"] = rig.sigma_px
    if rig.calibration_covariance is not None:
        covariance = rig.calibration_covariance.model_dump(mode="json", include={"names", "matrix"})
        content["calibration_covariance"] = covariance
    write_yaml(path, content)


def _rigid(pose: Floats) -> dict[str, Any]:
    return {"R": pose[:3, :3].tolist(), "t_m": pose[:3, 3].tolist()}
