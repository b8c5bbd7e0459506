"""Shared by all calibration formats: checked values whose errors name file and key, cameras, lenses and rigs."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import ArrayLike

from conetl.files.atomic import atomic_text_file
from conetl.files.documents import input_errors, shown
from conetl.geometry import pose as se3
from conetl.geometry.rectification import check_stereo_baseline, rectify
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import LENS_COEFFICIENTS, MAX_IMAGE_PIXELS, Camera, Lens, LensModel, Rig

Size = tuple[int, int]
Pair = tuple[str, str]
"""Names of the left and the right camera in a file with several."""

_METRES = {
    "m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "um": 1e-6, "µm": 1e-6, "in": 0.0254, "ft": 0.3048,
    "inch": 0.0254, "foot": 0.3048, "feet": 0.3048, "inche": 0.0254,
    **{f"{part}{metre}": factor for metre in ("meter", "metre")
       for part, factor in (("", 1.0), ("deci", 0.1), ("centi", 0.01), ("milli", 0.001), ("micro", 1e-6))},
}  # fmt: skip
#: Characters between the numbers of a text.
_BETWEEN = re.compile(r"[\s,;\[\]()]+")
_SKEW_SHARE = 1e-6
#: A size in the other order has the principal points nearer to the centre by at least this part of the image.
_CLEARLY_NEARER = 0.05


def write_yaml(path: Path, content: Mapping[str, Any]) -> None:
    """A YAML file with the keys in the given order. Raises InputError where it cannot be written."""
    with atomic_text_file(path) as file:
        yaml.safe_dump(dict(content), file, default_flow_style=None, sort_keys=False, width=200)


class Node(NamedTuple):
    """A value of a calibration file with its key, and what it is read as. Methods raise InputErrors that name both."""

    path: Path
    value: Any
    key: str = ""
    """Its key, with the keys above it."""
    length_unit: str | None = None
    """Of all lengths of the file, as the user states it."""

    def bad(self, text: str) -> InputError:
        """The error for this value."""
        return InputError(f"{self.path}: {shown(self.key) if self.key else 'it'} {text}")

    def get(self, key: str) -> Node:
        """The value of a key, None where there is none."""
        value = self.value.get(key) if isinstance(self.value, Mapping) else None
        return self._replace(value=value, key=f"{self.key}.{key}" if self.key else key)

    def at(self, key: str) -> Node:
        """The value of a required key."""
        inner = self.get(key)
        if inner.value is None:
            found = shown([*self.value]) if isinstance(self.value, Mapping) else shown(self.value)
            raise inner.bad(f"is missing; found {found or 'nothing'}")
        return inner

    def both(self, first: str, second: str) -> Node:
        """The values of two required keys."""
        one = self.at(first)
        return one._replace(value=[one.value, self.at(second).value], key=f"{one.key}, {second}")

    def number(self) -> float:
        """One finite number."""
        return float(self.numbers((1,))[0])

    def numbers(self, shape: tuple[int, ...] | None = None) -> Floats:
        """Finite numbers of the given shape (or any flat count), from lists, a text or {rows, cols, data}."""
        value = self.value
        if isinstance(value, Mapping):
            rows, cols = value.get("rows"), value.get("cols")
            data = self._replace(value=value.get("data", [])).numbers()
            if not (type(rows) is type(cols) is int and rows > 0 and rows * cols == data.size):  # True is an int, too
                raise self.bad(f"has {shown(rows)} rows and {shown(cols)} columns, but {data.size} numbers")
            value = data.reshape(rows, cols)
        if isinstance(value, str):
            value = [word for word in _BETWEEN.split(value) if word]
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise self.bad(f"must be numbers, found {shown(value)}") from None
        if shape is None:
            array = array.reshape(-1)
        elif array.size == np.prod(shape) and 1 in (*shape, *array.shape, array.ndim):
            array = array.reshape(shape)  # a row for a column, or a flat list for a matrix
        if shape is not None and array.shape != shape:
            wanted = " x ".join(map(str, shape))
            raise self.bad(f"must be {wanted} numbers, found {' x '.join(map(str, array.shape)) or 'one'}")
        if not np.isfinite(array).all():
            raise self.bad("must be finite numbers, found NaN or infinity")
        return array

    def size(self) -> Size:
        """Width and height in pixels."""
        size = self.numbers((2,))
        if not np.all((size >= 1) & (size <= MAX_IMAGE_PIXELS) & (size == np.round(size))):
            raise self.bad(f"must be whole numbers of pixels, found {size[0]:g} x {size[1]:g}")
        return int(size[0]), int(size[1])

    def size_by(self, *principal_points: Floats) -> Size:
        """Width and height of a list in either order: the principal points (2,) are nearer to the centre of the right one."""
        size = self.size()
        points = np.array(principal_points)
        off = [np.linalg.norm(points / one - 0.5, axis=1).mean() for one in (size, size[::-1])]
        return size if off[0] < off[1] + _CLEARLY_NEARER else size[::-1]

    def rotation(self) -> Floats:
        """The rotation nearest to a (3, 3) matrix written with few digits."""
        matrix = self.numbers((3, 3))
        if not se3.is_rotation(matrix):
            raise self.bad("is not a rotation")
        return se3.nearest_rotation(matrix)

    def motion(self) -> Floats:
        """A rigid motion (4, 4)."""
        matrix = self.numbers((4, 4))
        if not np.allclose(matrix[3], [0, 0, 0, 1]) or not se3.is_rotation(matrix[:3, :3]):
            raise self.bad("is not a rigid motion: a rotation, a translation in metres and the row 0, 0, 0, 1")
        return se3.se3(se3.nearest_rotation(matrix[:3, :3]), matrix[:3, 3])

    def metres(self) -> float:
        """Length of a unit, by its symbol or name."""
        name = str(self.value).strip().lower()
        if (length_m := _METRES.get(name, _METRES.get(name.removesuffix("s")))) is None:
            known = ", ".join([*_METRES][:8])
            raise self.bad(
                f"{shown(self.value)} is not a known unit; known: {known}. Give it with conetl rig convert --unit mm"
            )
        return length_m

    def unit_m(self, unit: object = "m") -> float:
        """Length of the unit that the user states, else of `unit`."""
        return self._replace(value=self.length_unit or unit, key="length unit").metres()

    def camera(self, size: Size, lens: Lens) -> Camera:
        """Camera of a matrix (3, 3) [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels."""
        k = self.numbers((3, 3))
        fx, fy, cx, cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
        if not (fx > 0 and fy > 0):
            raise self.bad(f"must have positive focal lengths, found {fx:g} and {fy:g}")
        if abs(k[0, 1]) > _SKEW_SHARE * fx:
            raise self.bad(f"has a skew of {k[0, 1]:g}; conetl does not model skew, calibrate without it")
        if not np.allclose([k[1, 0], *k[2]], [0.0, 0.0, 0.0, 1.0], atol=1e-9 * fx):
            raise self.bad("must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        width, height = size
        with input_errors(f"{self.path}: '{self.key}' cannot be used"):
            return Camera(width_px=width, height_px=height, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, lens=lens)

    def pinhole_camera(self, coefficients: str, lenses: Mapping[str | None, str | None]) -> Camera:
        """Camera of a mapping in the style of Kalibr and EuRoC: camera_model, intrinsics, resolution, distortion_model.

        coefficients: key of the lens' coefficients. lenses: "opencv", "fisheye" or None (no distortion) by distortion_model,
        which is optional if None is among its known values.
        """
        model = self.at("camera_model")
        if model.value != "pinhole":
            raise model.bad(f"{shown(model.value)} is not supported, only pinhole")
        bent = (self.get if None in lenses else self.at)("distortion_model")
        if not isinstance(bent.value, str | None) or bent.value not in lenses:
            known = ", ".join(name for name in lenses if name)
            raise bent.bad(f"{shown(bent.value)} is not supported; known: {known}")
        lens, kind = Lens(), lenses[bent.value]
        if kind is not None:
            lens = self.at(coefficients).lens(fisheye=kind == "fisheye")
        key = self.at("intrinsics")
        numbers = key.numbers((4,))
        matrix = key._replace(value=matrix_of(*numbers))
        return matrix.camera(self.at("resolution").size_by(numbers[2:]), lens)

    def lens(self, *, fisheye: bool = False) -> Lens:
        """The smallest lens model that holds OpenCV's k1, k2, p1, p2[, k3[, k4, k5, k6[, s1..s4[, tx, ty]]]].

        fisheye: they are k1, k2, k3, k4 of the equidistant model.
        """
        if fisheye:
            return self._lens("fisheye", self.numbers((4,)).tolist())
        values = self.numbers().tolist()
        if len(values) not in (0, 4, 5, 8, 12, 14):
            raise self.bad(f"must be 0, 4, 5, 8, 12 or 14 coefficients (OpenCV's order), found {len(values)}")
        if any(values[8:]):
            raise self.bad("holds thin-prism or tilt coefficients, which conetl does not model; calibrate without them")
        values = (values + [0.0] * 8)[:8]
        if any(values[5:]):
            return self._lens("rational", values)
        if any(values[2:5]):
            return self._lens("brown", values)
        return self._lens("radial" if any(values) else "none", values)

    def _lens(self, model: LensModel, values: list[float]) -> Lens:
        with input_errors(f"{self.path}: '{self.key}' cannot be used"):
            return Lens(model=model, coefficients=tuple(values[: LENS_COEFFICIENTS[model]]))

    def stereo_rig(self, tool: str, left: Camera, right: Camera, right_SE3_left: Floats, unit: object = "m") -> Rig:
        """Rig of the usual stereo calibration `p_right = R p_left + t`, as (4, 4); the body is the left camera.

        This value is the relative pose in the file. tool: the format's name, the rig's id starts with it. unit: of t, unless the
        user states it.
        """
        unit_m = self.unit_m(unit)
        with input_errors(f"{self.path}: '{self.key}' cannot be used"):
            turn = se3.nearest_rotation(right_SE3_left[:3, :3])
            left_SE3_right = se3.invert(se3.se3(turn, right_SE3_left[:3, 3] * unit_m))
            check_stereo_baseline(left_SE3_right)
            return rig_of(tool, left, right, left_SE3_right)


def choose_pair(path: Path, names: Sequence[str], pair: Sequence[str] | None) -> Pair:
    """The left and the right of a file's cameras: `pair`, else the only two in their order. Raises InputError."""
    if pair is None and len(names) == 2:
        return names[0], names[1]
    listed = shown(list(names)[:20])
    if pair is None:
        raise InputError(
            f"{path}: the file has {len(names)} cameras, {listed}; choose the stereo pair: conetl rig convert with "
            "--pair LEFT,RIGHT, or for a drive's rig.yaml 'pair: [LEFT, RIGHT]' in drive.yaml"
        )
    left, right = pair
    for name in (left, right):
        if list(names).count(name) != 1:
            raise InputError(f"{path}: there is no camera {shown(name)}; found {listed}")
    if left == right:
        raise InputError(f"{path}: {shown(left)} cannot be both the left and the right camera; found {listed}")
    return left, right


def matrix_of(fx: float, fy: float, cx: float, cy: float) -> Floats:
    """(3, 3) camera matrix."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def opencv_coefficients(lens: Lens) -> list[float]:
    """k1, k2, p1, p2, k3[, k4, k5, k6] of a polynomial lens, at least five; k1..k4 of a fisheye."""
    if lens.model == "fisheye":
        return list(lens.coefficients)
    return [*lens.coefficients, *[0.0] * (5 - len(lens.coefficients))]


def rig_of(
    tool: str,
    left: Camera,
    right: Camera,
    left_SE3_right: ArrayLike,
    *,
    rig_id: str | None = None,
    sigma_px: float = 0.5,
    body_SE3_left: ArrayLike | None = None,
) -> Rig:
    """Rig; its id is by default the format's name and a hash over its numbers."""
    body = np.eye(4) if body_SE3_left is None else np.asarray(body_SE3_left, dtype=np.float64)
    matrices = se3.to_matrix4(body), se3.to_matrix4(se3.compose(body, left_SE3_right))
    digest = hashlib.sha256(repr((left, right, matrices)).encode()).hexdigest()[:8]
    return Rig(
        rig_id=rig_id or f"{tool}-{digest}", left=left, right=right, sigma_px=sigma_px,
        body_SE3_left=matrices[0], body_SE3_right=matrices[1],
    )  # fmt: skip


def rectified_rig(rig: Rig, path: Path) -> Rig:
    """The rig of the rectified images (`rectify`). Raises InputError where it cannot be rectified."""
    with input_errors(path):
        return rectify(rig)
