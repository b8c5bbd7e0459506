"""OpenCV's calibration files (`cv2.FileStorage`: YAML, XML or JSON), read and written.

One file with M1, D1, M2, D2, R, T (OpenCV's stereo sample; `_NAMES` has more names), or `intrinsics` and `extrinsics` side by
side (written by that sample), or `left` and `right`, each with camera_matrix and distortion_coefficients (OpenCV's single-camera
sample), with R and T in `extrinsics` or in `right`. `p_right = R p_left + T`. The unit of T (that of the board's squares) is not
in the file, and the stereo sample does not write the image size either.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from conetl.files.atomic import atomic_text_file
from conetl.files.documents import shown
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.camera import matrix_k
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Rig, Side
from conetl.readers.rigs.common import Node, Size, opencv_coefficients
from conetl.readers.rigs.content import read_content

SUFFIXES = (".yml", ".yaml", ".xml", ".json")
#: Names of keys, as regular expressions without regard to capitals. {side}: left, {s}: left, l or 1.
_MATRIX = r"(m|k|camera_?matrix|intrinsic_?matrix|intrinsics|mtx)"
_DISTORTION = r"(d|dist_?coeffs?|distortion(_?coefficients)?|dist)"
_NAMES: Mapping[str, str] = {
    "matrix": rf"{_MATRIX}_?{{s}}|{{side}}[._]?{_MATRIX}",
    "distortion": rf"{_DISTORTION}_?{{s}}|{{side}}[._]?{_DISTORTION}",
    "width": r"({side}\.)?(image_?)?width",
    "height": r"({side}\.)?(image_?)?height",
    "size": r"({side}\.)?((image|img)_?size|size|resolution)",
    "fisheye": r"({side}\.)?fisheye(_model)?",
    "model": r"({side}\.)?((distortion|camera)_)?model",
    "R": r"(right\.)?(stereo_)?(r|rotation(_matrix)?)",
    "T": r"(right\.)?(stereo_)?(t|translation(_vector)?)",
    "unit": r"(length_)?units?",
}
#: Names in messages, of the left camera.
_EXAMPLES = {
    "matrix": ("M1", "K1", "cameraMatrix1", "camera_matrix_left"), "R": ("R", "rotation_matrix"),
    "distortion": ("D1", "distCoeffs1", "dist_coeffs_left"), "T": ("T", "translation_vector"),
}  # fmt: skip
_SIDE_LETTERS = {"left": "(left|l|1)", "right": "(right|r|2)"}
#: A key by which a file is recognised: a matrix, also of a single camera.
MARKS = rf"(?i:{_MATRIX})|" + "|".join(
    f"(?i:{_NAMES['matrix'].format(side=side, s=s)})" for side, s in _SIDE_LETTERS.items()
)


def read_opencv_rig(file: Node, *, image_size: Size | None = None) -> Rig:
    """Raw rig of an OpenCV stereo calibration: one file, or one of the files of the two forms above.

    image_size: width and height where the files have none. Raises InputError.
    """
    content: dict[str, Any] = {}
    for path in opencv_files(file.path):
        prefix = f"{path.stem}." if path.stem in SIDES and path.stem not in file.value else ""
        for key, value in (file.value if path == file.path else read_content(path)).items():
            inner = value if isinstance(value, Mapping) and "data" not in value else {"": value}
            content |= {f"{prefix}{key}.{name}".rstrip("."): one for name, one in inner.items()}
    whole = file._replace(value=content)
    matrices = [_named(whole, "matrix", side) for side in SIDES]
    lenses = [_named(whole, "distortion", side).lens(fisheye=_is_fisheye(whole, side)) for side in SIDES]
    sizes = [image_size or _size(whole, side, matrices) for side in SIDES]
    left, right = (matrix.camera(size, lens) for matrix, size, lens in zip(matrices, sizes, lenses, strict=True))
    turn, shift = _named(whole, "R"), _named(whole, "T")
    r = turn.numbers()
    if r.size == 3:  # as a rotation vector
        r = np.asarray(cv2.Rodrigues(r)[0], dtype=np.float64)
    pose = se3.se3(turn._replace(value=r).numbers((3, 3)), shift.numbers((3,)))
    unit = _first(whole, "unit")
    key = whole._replace(key=f"{turn.key}, {shift.key}")
    return key.stereo_rig("opencv", left, right, pose, "m" if unit is None else unit.value)


def opencv_files(path: Path) -> tuple[Path, ...]:
    """The files of the calibration that one belongs to."""
    for parts, extra in ((("intrinsics", "extrinsics"), ()), (("left", "right"), ("extrinsics",))):
        if path.stem in (*parts, *extra):
            found = [path.with_name(f"{part}{suffix}") for part in (*parts, *extra) for suffix in SUFFIXES
                     if path.with_name(f"{part}{suffix}").is_file()]  # fmt: skip
            if {*parts} <= {one.stem for one in found}:
                return tuple(found)
    return (path,)


def _first(file: Node, what: str, side: Side = "left") -> Node | None:
    """The first key with one of the names, None without any."""
    pattern = re.compile(_NAMES[what].format(side=side, s=_SIDE_LETTERS[side]), re.IGNORECASE)
    return next((file.get(key) for key in file.value if pattern.fullmatch(key)), None)


def _named(file: Node, what: str, side: Side = "left") -> Node:
    """The same. Raises InputError without any."""
    if (found := _first(file, what, side)) is not None:
        return found
    known = [name.replace("1", "2").replace("left", "right") if side == "right" else name for name in _EXAMPLES[what]]
    about = f"{side} {what}" if what in ("matrix", "distortion") else what
    raise file.get(known[0]).bad(f"({about}) is missing; found {shown([*file.value])}. Known names: {', '.join(known)}")


def _is_fisheye(file: Node, side: Side) -> bool:
    flag = _first(file, "fisheye", side)
    if flag is not None:
        return str(flag.value).lower() not in ("0", "false", "no", "0.0")
    model = _first(file, "model", side)
    if model is None:
        return False
    known = {"fisheye": True, "equidistant": True, "kannala_brandt4": True, "plumb_bob": False, "radtan": False,
             "rational_polynomial": False, "pinhole": False, "brown": False, "opencv": False, "standard": False}  # fmt: skip
    if str(model.value).lower() not in known:
        raise model.bad(f"{shown(model.value)} is not a known lens model; known: {', '.join(known)}")
    return known[str(model.value).lower()]


def _size(file: Node, side: Side, matrices: list[Node]) -> Size:
    """Width and height; of a list in any order, in which the principal points of the matrices show which is which."""
    width, height = _first(file, "width", side), _first(file, "height", side)
    if width is not None and height is not None:
        return width._replace(value=[width.value, height.value], key=f"{width.key}, {height.key}").size()
    if (whole := _first(file, "size", side)) is None:
        raise file.get("image_width, image_height").bad(
            "are missing: some OpenCV stereo files have no image size. Add both keys to the file, or make a rig.yaml from it: "
            "conetl rig convert with --image-size 1242x375"
        )
    return whole.size_by(*(matrix.numbers((3, 3))[:2, 2] for matrix in matrices))


def write_opencv_rig(rig: Rig, path: Path) -> None:
    """Write M1, D1, M2, D2, R, T (metres) and the image size for `cv2.FileStorage`; the suffix gives YAML, XML or JSON.

    The file has one image size and one kind of lens: raises InputError for a rig that mixes them, or for another suffix,
    InputError where the file cannot be written. The body's pose and the covariance are not written.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: OpenCV's files end in {', '.join(SUFFIXES)}")
    left, right = rig.left, rig.right
    if (left.width_px, left.height_px) != (right.width_px, right.height_px):
        raise InputError(f"{path}: OpenCV's stereo files hold one image size, but the two cameras differ in theirs")
    fisheyes = [camera.lens.model == "fisheye" for camera in (left, right)]
    if fisheyes[0] != fisheyes[1]:
        raise InputError(f"{path}: OpenCV's stereo files hold two fisheye lenses or none; export to rig.yaml")
    right_SE3_left = se3.invert(rigs.left_SE3_right(rig))
    storage = cv2.FileStorage(path.suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", left.width_px)
    storage.write("image_height", left.height_px)
    storage.write("fisheye_model", int(fisheyes[0]))
    storage.write("length_unit", "m")
    for number, camera in ((1, left), (2, right)):
        storage.write(f"M{number}", matrix_k(camera))
        storage.write(f"D{number}", np.array([opencv_coefficients(camera.lens)]))
    storage.write("R", np.ascontiguousarray(right_SE3_left[:3, :3]))
    storage.write("T", np.ascontiguousarray(right_SE3_left[:3, 3:]))
    with atomic_text_file(path) as file:
        file.write(storage.releaseAndGetString())
