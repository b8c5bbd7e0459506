"""Calibration files of many tools -> `Rig`, and some back: one module per format, `read_rig` recognises the format.

The result is the rig of the stored images: raw, with its lenses, unless the file describes a rectified pair
(`geometry/rectification.py` makes the other from it). Every error is an InputError that names the file, the key, what was
expected and what to do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from inspect import signature
from pathlib import Path
from typing import Literal, NamedTuple

from conetl.files.documents import read_json, read_limited, read_yaml
from conetl.model.errors import InputError
from conetl.model.rig import Camera, Rig
from conetl.readers.rigs.common import Pair, Size, read_xml, rectified_rig
from conetl.readers.rigs.devices import read_oak_rig, read_zed_rig
from conetl.readers.rigs.kitti import CAM_TO_CAM, IMU_TO_VELO, VELO_TO_CAM, read_kitti_rig
from conetl.readers.rigs.matlab import read_matlab_rig, structure
from conetl.readers.rigs.metashape import looks_like_metashape, read_metashape_rig
from conetl.readers.rigs.opencv import looks_like_opencv, read_opencv_rig, write_opencv_rig
from conetl.readers.rigs.rig_yaml import RIG_YAML, read_rig_yaml, write_rig_yaml
from conetl.readers.rigs.ros import read_kalibr_rig, read_ros_rig, write_ros_rig

__all__ = [
    "CAM_TO_CAM", "FORMAT_NAMES", "IMU_TO_VELO", "RIG_SUFFIXES", "RIG_YAML", "VELO_TO_CAM", "WRITERS", "Format", "FoundRigs",
    "find_rigs", "read_given_rig", "read_kitti_rig", "read_rig", "read_rig_and_format", "read_rig_for_images", "read_rig_yaml",
    "write_rig_yaml",
]  # fmt: skip

Format = Literal["rig", "kitti", "opencv", "kalibr", "ros", "matlab", "zed", "oak", "metashape"]
FORMAT_NAMES: dict[Format, str] = {
    "rig": "conetl rig.yaml", "kitti": "KITTI calib_cam_to_cam.txt", "opencv": "OpenCV stereo calibration",
    "kalibr": "Kalibr camchain", "ros": "ROS camera_info pair", "matlab": "MATLAB stereoParameters",
    "zed": "ZED factory calibration", "oak": "OAK (DepthAI) calibration", "metashape": "Metashape cameras",
}  # fmt: skip
_READERS: dict[Format, Callable[..., Rig]] = {
    "rig": read_rig_yaml, "kitti": read_kitti_rig, "kalibr": read_kalibr_rig, "ros": read_ros_rig,
    "opencv": read_opencv_rig, "matlab": read_matlab_rig, "zed": read_zed_rig, "oak": read_oak_rig,
    "metashape": read_metashape_rig,
}  # fmt: skip
#: Names in messages of the options that readers have besides the path.
_CALLED = {"image_size": "image size", "length_unit": "unit", "pair": "pair of cameras"}
#: Writers by format; that of ROS takes a folder, the others a file.
WRITERS: dict[str, Callable[[Rig, Path], None]] = {
    "rig": write_rig_yaml, "opencv": write_opencv_rig, "ros": write_ros_rig,
}  # fmt: skip
_KNOWN = (
    "rig.yaml, KITTI calib_cam_to_cam.txt, OpenCV .yml/.xml/.json, Kalibr camchain.yaml, ROS left.yaml + right.yaml, "
    "MATLAB .json/.mat, ZED SN*.conf, OAK calib.json, Metashape cameras.xml"
)


def read_rig(
    path: Path, *, image_size: Size | None = None, length_unit: str | None = None, pair: Pair | None = None
) -> Rig:
    """Rig from a calibration file of any known format, or from a folder with one; see `read_rig_and_format`."""
    return read_rig_and_format(path, image_size=image_size, length_unit=length_unit, pair=pair)[0]


def read_rig_and_format(
    path: Path, *, image_size: Size | None = None, length_unit: str | None = None, pair: Pair | None = None
) -> tuple[Rig, Format]:
    """Rig and its recognised format.

    image_size (width, height) and length_unit are for files without them, image_size also chooses the resolution of a ZED file.
    pair: names of the left and the right camera in a file with more than two. A KITTI calibration gives its rectified pair
    (cameras 02 and 03; with the two other files beside it the body is the IMU, else the left camera). Raises InputError.
    """
    path, found = _recognise(path, pair)
    options = {"image_size": image_size, "length_unit": length_unit, "pair": pair}
    given = {name: value for name, value in options.items() if value is not None}
    foreign = [_CALLED[name] for name in given if name not in signature(_READERS[found]).parameters]
    if foreign:
        raise InputError(f"{path}: a {FORMAT_NAMES[found]} has its own {' and '.join(foreign)}; leave them out")
    return _READERS[found](path, **given), found


def read_rig_for_images(path: Path, size: Size | None) -> Rig:
    """The rectified rig for images of this width and height (None: unknown), of a calibration file of any known format.

    Where they are raw, `rectified_from` is the rig that took them. Raises InputError.
    """
    path, found = _recognise(path)
    if found == "kitti":
        return read_kitti_rig(path, images=size)
    return rectified_rig(read_rig(path, image_size=size if found == "zed" else None), path)


def _recognise(path: Path, pair: Pair | None = None) -> tuple[Path, Format]:
    """The file to read (or the folder, for formats of several files) and its format. Raises InputError."""
    if path.is_dir():
        return _in_folder(path, pair)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file. Known: {_KNOWN}, or a folder that holds one of them")
    kind = _OF_SUFFIX.get(path.suffix.lower())
    if kind is None:
        raise InputError(f"{path}: a calibration is not a '{path.suffix.lower()}' file. Known: {_KNOWN}")
    return path, kind(path) if callable(kind) else kind


def _of_json(path: Path) -> Format:
    content = read_json(path)
    if structure(content) is not None:
        return "matlab"
    if isinstance(content, Mapping) and "cameraData" in content:
        return "oak"
    if looks_like_opencv(content):
        return "opencv"
    raise InputError(
        f"{path}: neither MATLAB's stereoParameters (CameraParameters1) nor an OAK's cameraData nor OpenCV's (M1, D1); "
        f"known: {_KNOWN}"
    )


def _of_yaml(path: Path) -> Format:
    text = read_limited(path)
    if text.lstrip().startswith("%YAML:") or "!!opencv" in text:
        return "opencv"
    content = read_yaml(path)
    if isinstance(content, Mapping) and "cam0" in content:
        return "kalibr"
    ros = {"projection_matrix", "rectification_matrix"}
    if isinstance(content, Mapping) and "camera_matrix" in content and not ros.isdisjoint(content):
        return "ros"
    return "opencv" if looks_like_opencv(content) else "rig"


#: The format, or how to find it in the content.
_OF_SUFFIX: dict[str, Format | Callable[[Path], Format]] = {
    ".txt": "kitti", ".mat": "matlab", ".conf": "zed", ".json": _of_json, ".yaml": _of_yaml, ".yml": _of_yaml,
    ".xml": lambda path: "metashape" if looks_like_metashape(read_xml(path)) else "opencv",
}  # fmt: skip


def _in_folder(folder: Path, pair: Pair | None) -> tuple[Path, Format]:
    if pair is not None and any((folder / f"{pair[0]}{suffix}").is_file() for suffix in (".yaml", ".yml")):
        return folder, "ros"
    found: list[tuple[Path, Format]] = []
    if (folder / RIG_YAML).is_file():
        found.append((folder / RIG_YAML, "rig"))
    if (folder / CAM_TO_CAM).is_file():
        found.append((folder / CAM_TO_CAM, "kitti"))
    found += [(path, "kalibr") for path in sorted(folder.glob("*camchain*.yaml"))]
    for left, right in (("left", "right"), ("intrinsics", "extrinsics")):
        first = next((p for s in (".yaml", ".yml", ".xml") if (p := folder / f"{left}{s}").is_file()), None)
        if first is not None and (folder / f"{right}{first.suffix}").is_file():
            found.append((folder, "ros" if first.suffix != ".xml" and _of_yaml(first) == "ros" else "opencv"))
    if len(found) != 1:
        names = " and ".join(path.name if path != folder else FORMAT_NAMES[kind] for path, kind in found)
        raise InputError(
            f"{folder}: expected one of {RIG_YAML} and {CAM_TO_CAM} (or another calibration) in the folder, found "
            f"{names or 'none of them'}; name the file itself. Known: {_KNOWN}"
        )
    return found[0]


# --------------------------------------------------------------------------- the calibrations in a folder, for `conetl init`

RIG_SUFFIXES = frozenset(_OF_SUFFIX.keys() - {".txt"})
_LARGEST_BYTES = 4_000_000
#: How far a principal point is from the centre of its image, at most, in parts of the image's size.
_OFF_CENTRE = 0.2
#: Baselines that a file without a unit may mean in millimetres (m).
_MILLIMETRES_M = (0.1, 2.0)


class FoundRigs(NamedTuple):
    """What `find_rigs` found; reasons are sentences that name the file."""

    fitting: list[tuple[Path, Rig, str]]
    """With their formats in words."""
    of_other_size: list[str]
    unread: list[str]


def find_rigs(paths: Sequence[Path], size: tuple[int, int] | None) -> FoundRigs:
    """The calibrations for images of this size (width, height): rig.yaml, or if there is none that fits, those of other tools.

    paths: files of one folder, with one of `RIG_SUFFIXES`. Raises InputError for a rig.yaml that cannot be read.
    """
    found = FoundRigs([], [], [])
    for path in sorted(paths, key=lambda path: (path.name != RIG_YAML, path.name)):
        of_conetl = bool(found.fitting) and found.fitting[0][0].name == RIG_YAML
        if of_conetl or path.stat().st_size > _LARGEST_BYTES:
            continue
        try:
            rig, kind = read_given_rig(path, size)
        except InputError as error:
            if path.name == RIG_YAML:
                raise
            found.unread.append(f"{path.name} is not used as a calibration: {str(error).removeprefix(f'{path}: ')}")
            continue
        width_px, height_px = rig.left.width_px, rig.left.height_px
        if size is None or size == (width_px, height_px):
            found.fitting.append((path, rig, kind))
        else:
            found.of_other_size.append(
                f"calibration {path.name}: for images of {width_px} x {height_px}, these have {size[0]} x {size[1]}; 'conetl rig "
                "convert --scale-to' fits one to images that were scaled"
            )
    return found


def read_given_rig(path: Path, size: tuple[int, int] | None) -> tuple[Rig, str]:
    """A calibration, and its format in words. Raises InputError.

    A file without an image size is one of images of this size, one without a unit whose baseline in metres is too long is in mm.
    """
    try:
        rig, kind = read_rig_and_format(path)
        return rig, FORMAT_NAMES[kind]
    except InputError:
        shortest_m, longest_m = _MILLIMETRES_M
        for image_size, unit in ((size, None), (None, "mm"), (size, "mm")):
            with suppress(InputError):
                rig, kind = read_rig_and_format(path, image_size=image_size, length_unit=unit)
                # With another size the principal point would not be near the centre.
                if _is_centred(rig.left) and _is_centred(rig.right):
                    if unit is None:
                        return rig, FORMAT_NAMES[kind]
                    if shortest_m <= rig.baseline_m <= longest_m:
                        return rig, f"{FORMAT_NAMES[kind]}, lengths taken as mm"
        raise


def _is_centred(camera: Camera) -> bool:
    x, y = camera.cx_px / camera.width_px, camera.cy_px / camera.height_px
    return max(abs(x - 0.5), abs(y - 0.5)) <= _OFF_CENTRE
