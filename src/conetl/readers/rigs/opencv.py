"""OpenCV's calibration files (`cv2.FileStorage`: YAML, XML or JSON), read and written.

One file with M1, D1, M2, D2, R, T (OpenCV's stereo sample; `_NAMES` has more names), or `intrinsics` and `extrinsics` side by
side (written by that sample), or `left` and `right`, each with camera_matrix and distortion_coefficients (OpenCV's single-camera
sample), with R and T in `extrinsics` or in `right`. `p_right = R p_left + T`. The unit of T (that of the board's squares) is not
in the file, and the stereo sample does not write the image size either.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import cv2
import numpy as np

from conetl.files.atomic import atomic_text_file
from conetl.files.documents import MAX_DEPTH, parse_yaml, read_json, read_limited, shown
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.camera import matrix_k
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Camera, Rig, Side
from conetl.readers.rigs.common import Node, Size, opencv_coefficients, read_xml

_YAML_HEADER = re.compile(r"^\s*%YAML[^\n]*\n")
_MATRIX_TAG = re.compile(r"!!opencv-(nd-)?matrix")
_DOTTED = {".nan": math.nan, ".inf": math.inf, "-.inf": -math.inf}
SUFFIXES = (".yml", ".yaml", ".xml", ".json")
_NAMES: Mapping[str, tuple[str, ...]] = {
    "left.K": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "camera_matrix1", "camera_matrix_left", "left_camera_matrix",
               "K_left", "cameraMatrixL", "LEFT.K", "intrinsicMatrix1"),
    "right.K": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "camera_matrix2", "camera_matrix_right", "right_camera_matrix",
                "K_right", "cameraMatrixR", "RIGHT.K", "intrinsicMatrix2"),
    "left.D": ("D1", "distCoeffs1", "dist_coeffs_1", "dist_coeffs1", "distortion_coefficients_1", "distortion_coefficients1",
               "dist_coeffs_left", "left_distortion_coefficients", "D_left", "distCoeffsL", "LEFT.D", "distortionCoefficients1"),
    "right.D": ("D2", "distCoeffs2", "dist_coeffs_2", "dist_coeffs2", "distortion_coefficients_2", "distortion_coefficients2",
                "dist_coeffs_right", "right_distortion_coefficients", "D_right", "distCoeffsR", "RIGHT.D",
                "distortionCoefficients2"),
    "R": ("R", "rotation", "rotation_matrix", "stereo_R"),
    "T": ("T", "translation", "translation_vector", "t", "stereo_T"),
    "K": ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "M"),
    "D": ("distortion_coefficients", "distCoeffs", "Distortion_Coefficients", "dist_coeffs", "D"),
}  # fmt: skip
_SIZE_NAMES = ("image_size", "imageSize", "size", "img_size", "resolution")
_UNIT_NAMES = ("length_unit", "unit", "units")
_FISHEYE_NAMES = ("fisheye_model", "fisheye")
_MODEL_NAMES = ("distortion_model", "model", "camera_model")


def read_storage(path: Path) -> dict[str, Any]:
    """Content of an OpenCV file as plain dictionaries, lists and strings. Raises InputError.

    `cv2.FileStorage` is not used: a damaged file corrupts its memory (OpenCV 5.0).
    """
    if path.suffix.lower() == ".json":
        content = read_json(path)
    elif path.suffix.lower() == ".xml":
        content = _of_element(path, read_xml(path), 0)
    else:
        content = parse_yaml(path, _MATRIX_TAG.sub("", _YAML_HEADER.sub("", read_limited(path), count=1)))
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected keys and values such as M1, D1, M2, D2, R, T")
    return {str(key): _plain(value) for key, value in content.items()}


def _of_element(path: Path, element: Element, depth: int) -> Any:
    """Elements as dictionaries by name, those named `_` as lists, their texts as they are."""
    if depth > MAX_DEPTH:
        raise InputError(f"{path}: nested too deeply")
    if len(element) == 0:
        return (element.text or "").strip().strip('"')
    if element[0].tag == "_":
        return [_of_element(path, child, depth + 1) for child in element]
    return {child.tag: _of_element(path, child, depth + 1) for child in element}


def _plain(value: Any) -> Any:
    """A value of the file; matrices and lists of numbers as `numbers` reads them."""
    if isinstance(value, dict) and {"dt", "data"} <= value.keys():
        sizes = _words(value["sizes"]) if "sizes" in value else [value.get("rows"), value.get("cols")]
        channels = re.match(r"\d*", str(value["dt"]).strip())
        many = int(channels.group()[:2]) if channels and channels.group() else 1
        rows, *others = [int(str(n)) if str(n).isdecimal() and len(str(n)) < 9 else 0 for n in sizes] or [0]
        return {"rows": rows, "cols": math.prod(others) * many, "data": _words(value["data"])}
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    words = _words(value)
    return words if isinstance(value, list) or len(words) > 1 else value


def _words(value: Any) -> list[Any]:
    """The numbers of a list, or of a text of several; OpenCV writes NaN and infinity with a dot."""
    words = value if isinstance(value, list) else value.split() if isinstance(value, str) else [value]
    return [_DOTTED.get(word.lower(), word) if isinstance(word, str) else word for word in words]


def looks_like_opencv(content: Any) -> bool:
    """True where a mapping has the camera matrices of a stereo file."""
    return isinstance(content, Mapping) and any(name in content for name in (*_NAMES["left.K"], *_NAMES["right.K"]))


def read_opencv_rig(path: Path, *, image_size: Size | None = None, length_unit: str | None = None) -> Rig:
    """Raw rig of an OpenCV stereo calibration: one file, or a folder (or one of the files) of the two forms above.

    image_size: width and height where the files have none. length_unit: of T, default metres. Raises InputError.
    """
    files = _files(path)
    content: dict[str, Any] = {}
    for name, file in files.items():
        for key, value in read_storage(file).items():
            content[f"{name}.{key}" if name in ("left", "right") else key] = value
    whole = Node(next(iter(files.values())), content)
    left, right = (_camera(whole, side, image_size) for side in SIDES)
    turn, shift = (
        _named(whole, name, (*_NAMES[name], *(f"right.{one}" for one in _NAMES[name]))) for name in ("R", "T")
    )
    r = turn.numbers()
    if r.size == 3:  # as a rotation vector
        r = np.asarray(cv2.Rodrigues(r)[0], dtype=np.float64)
    stated = next((str(content[name]) for name in _UNIT_NAMES if name in content), "m")
    unit_m = Node(whole.path, length_unit or stated, "length_unit").metres()
    pose = se3.se3(turn._replace(value=r).numbers((3, 3)), shift.numbers((3,)) * unit_m)
    return Node(whole.path, None, f"{turn.key}, {shift.key}").stereo_rig("opencv", left, right, pose)


def _files(path: Path) -> dict[str, Path]:
    """The files of one calibration, by their part in it."""
    folder = path if path.is_dir() else path.parent
    for parts, extra in ((("intrinsics", "extrinsics"), ()), (("left", "right"), ("extrinsics",))):
        if path.is_file() and path.stem not in (*parts, *extra):
            continue
        files = {part: folder / f"{part}{suffix}" for part in (*parts, *extra) for suffix in SUFFIXES
                 if (folder / f"{part}{suffix}").is_file()}  # fmt: skip
        if all(part in files for part in parts):
            return files
    return {"stereo": path}


def _named(file: Node, what: str, names: tuple[str, ...]) -> Node:
    """The first existing one of several names. Raises InputError."""
    found = _first(file, names)
    if found is not None:
        return found
    text = f"({what}) is missing; found {shown([*file.value])}. Known names: {', '.join(names[:6])}"
    raise file.get(names[0]).bad(text)


def _camera(file: Node, side: Side, image_size: Size | None) -> Camera:
    k, d = (
        _named(file, f"{side} {what}", (*_NAMES[f"{side}.{key}"], *(f"{side}.{name}" for name in _NAMES[key])))
        for what, key in (("matrix", "K"), ("distortion", "D"))
    )
    lens = d.lens(fisheye=_is_fisheye(file, side))
    return k.camera(image_size or _size(file, side), lens)


def _first(file: Node, names: Iterable[str]) -> Node | None:
    """The same, None without any; of LEFT.K also K in LEFT."""
    for name in names:
        part, _, rest = name.partition(".")
        value = file.value.get(name, file.get(part).get(rest).value)
        if value is not None:
            return Node(file.path, value, name)
    return None


def _scalar(file: Node, side: Side, names: tuple[str, ...]) -> Node | None:
    return _first(file, (key for name in names for key in (f"{side}.{name}", name)))


def _is_fisheye(file: Node, side: Side) -> bool:
    flag = _scalar(file, side, _FISHEYE_NAMES)
    if flag is not None:
        return str(flag.value).lower() not in ("0", "false", "no", "0.0")
    model = _scalar(file, side, _MODEL_NAMES)
    if model is None:
        return False
    known = {"fisheye": True, "equidistant": True, "kannala_brandt4": True, "plumb_bob": False, "radtan": False,
             "rational_polynomial": False, "pinhole": False, "brown": False, "opencv": False, "standard": False}  # fmt: skip
    if str(model.value).lower() not in known:
        raise model.bad(f"{shown(model.value)} is not a known lens model; known: {', '.join(known)}")
    return known[str(model.value).lower()]


def _size(file: Node, side: Side) -> Size:
    width, height = _scalar(file, side, ("image_width", "width")), _scalar(file, side, ("image_height", "height"))
    if width is not None and height is not None:
        return Node(file.path, [width.value, height.value], f"{width.key}, {height.key}").size()
    whole = _scalar(file, side, _SIZE_NAMES)
    if whole is not None:
        return whole.size()
    raise file.get("image_width, image_height").bad(
        "are missing: some OpenCV stereo files have no image size. Add both keys to the file, or make a rig.yaml from it: conetl "
        "rig convert with --image-size 1242x375"
    )


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
