"""Calibration files of many tools -> `Rig`, and some back: one table of formats, recognised by the keys of their content.

The result is the rig of the stored images: raw, with its lenses, unless the file describes a rectified pair
(`geometry/rectification.py` makes the other from it). Every error is an InputError that names the file, the key, what was
expected, what to do and the format that the file was read as.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from inspect import signature
from itertools import islice
from pathlib import Path
from typing import Any, Literal, NamedTuple

from conetl.files.documents import shown
from conetl.model.errors import InputError
from conetl.model.rig import Camera, Rig
from conetl.readers.rigs import opencv
from conetl.readers.rigs.common import Node, Pair, Size, rectified_rig
from conetl.readers.rigs.content import keys_of, read_content
from conetl.readers.rigs.devices import read_oak_rig, read_zed_rig
from conetl.readers.rigs.kalibr import read_kalibr_rig
from conetl.readers.rigs.kitti import (
    CAM_TO_CAM,
    IMU_TO_VELO,
    VELO_TO_CAM,
    kitti_files,
    read_kitti_rig,
    read_named_kitti_rig,
)  # fmt: skip
from conetl.readers.rigs.matlab import read_matlab_rig
from conetl.readers.rigs.metashape import read_metashape_rig
from conetl.readers.rigs.rectified import read_middlebury_rig, read_projections_rig
from conetl.readers.rigs.rig_yaml import RIG_YAML, read_rig_yaml, write_rig_yaml
from conetl.readers.rigs.ros import read_orbslam_rig, read_ros_rig, ros_files, write_ros_rig

__all__ = [
    "CAM_TO_CAM", "FORMAT_NAMES", "IMU_TO_VELO", "RIG_SUFFIXES", "RIG_YAML", "VELO_TO_CAM", "WRITERS", "Format", "FoundRigs",
    "find_rigs", "read_given_rig", "read_kitti_rig", "read_rig", "read_rig_and_format", "read_rig_for_images", "read_rig_yaml",
    "write_rig_yaml",
]  # fmt: skip

Format = Literal[
    "rig", "kitti", "kitti_rectified", "middlebury", "matlab", "oak", "zed", "metashape", "kalibr", "orbslam", "ros", "opencv"
]  # fmt: skip


class _Kind(NamedTuple):
    """One format."""

    name: str
    keys: str
    """A file with a key that matches is of this format: a regular expression for a whole key, with a dot those of mappings."""
    read: Callable[..., Rig]
    """Of the file's content; its keyword arguments are the options that the format needs."""
    files: Callable[[Path], tuple[Path, ...]] = lambda path: (path,)
    """All files of the calibration that a file belongs to."""


def _read_own(file: Node, *, pair: Pair | None = None) -> Rig:
    return read_rig_yaml(file.path, pair=pair, unit_m=file.unit_m())


#: The first with a matching key is that of the file.
_KINDS: dict[Format, _Kind] = {
    "rig": _Kind("conetl rig.yaml", r"(cameras\.[^.]+|left|right)\.(\w+_(px|mm)|lens\..+)|baseline_m", _read_own),
    "kitti": _Kind("KITTI calib_cam_to_cam.txt", r"(S|K|D|R|T|[SRP]_rect)_0\d", read_named_kitti_rig, kitti_files),
    "kitti_rectified": _Kind("KITTI odometry or object calib.txt", r"P\d|R0_rect|Tr_velo_to_cam", read_projections_rig),
    "middlebury": _Kind("Middlebury calib.txt", r"cam\d|doffs|ndisp", read_middlebury_rig),
    "matlab": _Kind("MATLAB stereoParameters", r"(\w+\.)?CameraParameters1(\..+)?", read_matlab_rig),
    "oak": _Kind("OAK (DepthAI) calibration", r"cameraData(\..+)?", read_oak_rig),
    "zed": _Kind("ZED factory calibration", r"(?i:(LEFT|RIGHT)_(CAM|DISTO)\w*\..+|STEREO\.baseline)", read_zed_rig),
    "metashape": _Kind("Metashape cameras", r"document\.chunk", read_metashape_rig),
    "kalibr": _Kind("Kalibr camchain", r"cam\d+\..+", read_kalibr_rig),
    "orbslam": _Kind("ORB-SLAM settings", r"Camera\d?\.(fx|bf|type|width)|(LEFT|RIGHT)\.P", read_orbslam_rig),
    "ros": _Kind(
        "ROS camera_info pair",
        r"(projection|rectification)_matrix(\..+)?|.+\.camera matrix|binning_x",
        read_ros_rig,
        ros_files,
    ),
    "opencv": _Kind("OpenCV stereo calibration", opencv.MARKS, opencv.read_opencv_rig, opencv.opencv_files),
}
FORMAT_NAMES: dict[Format, str] = {found: kind.name for found, kind in _KINDS.items()}
#: Names in messages of the options that readers have besides the file.
_CALLED = {"image_size": "image size", "pair": "pair of cameras"}
#: Writers by format; that of ROS takes a folder, the others a file.
WRITERS: dict[str, Callable[[Rig, Path], None]] = {
    "rig": write_rig_yaml, "opencv": opencv.write_opencv_rig, "ros": write_ros_rig,
}  # fmt: skip
#: Larger files are no calibrations; keys that are looked at.
_LARGEST_BYTES, _MOST_KEYS = 4_000_000, 1_000
_KNOWN = ", ".join(FORMAT_NAMES.values())
#: Suffixes of files that are looked at in a folder.
RIG_SUFFIXES = frozenset({".yaml", ".yml", ".xml", ".json", ".conf", ".mat", ".txt", ".ini"})
#: Those of many other files, of which nothing is said.
_TEXTS = (".txt", ".ini")


def read_rig(
    path: Path, *, image_size: Size | None = None, length_unit: str | None = None, pair: Pair | None = None
) -> Rig:
    """Rig from a calibration file of any known format, or from a folder with one; see `read_rig_and_format`."""
    return read_rig_and_format(path, image_size=image_size, length_unit=length_unit, pair=pair)[0]


def read_rig_and_format(
    path: Path, *, image_size: Size | None = None, length_unit: str | None = None, pair: Pair | None = None
) -> tuple[Rig, Format]:
    """Rig and its recognised format.

    image_size (width, height) is for files without it, it also chooses the resolution of a ZED file. length_unit: of the lengths
    in the file, where it is not that of its format. pair: names of the left and the right camera in a file with more than two. A
    KITTI calibration gives its rectified pair (cameras 02 and 03; with the two other files beside it the body is the IMU, else
    the left camera). Raises InputError.
    """
    file, found = _recognise(path, pair)
    return _read(file._replace(length_unit=length_unit), found, {"image_size": image_size, "pair": pair}), found


def _read(file: Node, found: Format, options: Mapping[str, Any]) -> Rig:
    kind = _KINDS[found]
    given = {name: value for name, value in options.items() if value is not None}
    foreign = [_CALLED[name] for name in given if name not in signature(kind.read).parameters]
    if foreign:
        raise InputError(f"{file.path}: a {kind.name} has its own {' and '.join(foreign)}; leave them out")
    try:
        return kind.read(file, **given)
    except InputError as error:
        raise InputError(f"{error} (read as {kind.name})") from error


def read_rig_for_images(path: Path, size: Size | None) -> Rig:
    """The rectified rig for images of this width and height (None: unknown), of a calibration file of any known format.

    Where they are raw, `rectified_from` is the rig that took them. Raises InputError.
    """
    file, found = _recognise(path)
    known = signature(_KINDS[found].read).parameters
    if found == "kitti":
        return read_named_kitti_rig(file, images=size)
    try:
        rig = _read(file, found, {})
    except InputError:
        if size is None or "image_size" not in known:
            raise
        rig = _read(file, found, {"image_size": size})
    return rectified_rig(rig, path)


def _recognise(path: Path, pair: Pair | None = None) -> tuple[Node, Format]:
    """The content of a file, or of the first file of the only calibration in a folder, and its format. Raises InputError."""
    if path.is_dir():
        return _in_folder(path, pair)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file. Known: {_KNOWN}, or a folder that holds one of them")
    if path.name == RIG_YAML:
        return Node(path, {}), "rig"
    content = read_content(path)
    keys = [*islice(keys_of(content), _MOST_KEYS)]
    found = next((found for found, kind in _KINDS.items() if any(re.fullmatch(kind.keys, key) for key in keys)), None)
    if found is None:
        for belongs_to in (kitti_files(path), opencv.opencv_files(path)):
            if belongs_to[0] != path:  # a part without a camera
                return _recognise(belongs_to[0])
        raise InputError(f"{path}: not a calibration that conetl knows: found {shown(keys)}. Known: {_KNOWN}")
    return Node(path, content), found


def _in_folder(folder: Path, pair: Pair | None) -> tuple[Node, Format]:
    if pair is not None:
        named = [path for path in sorted(folder.glob(f"{glob.escape(pair[0])}.*")) if path.suffix in RIG_SUFFIXES]
        if named:
            return _recognise(named[0])
    found = [path for path, error in _calibrations(sorted(folder.iterdir())) if error is None]
    if len(found) != 1:
        names = " and ".join(path.name for path in found)
        raise InputError(
            f"{folder}: expected one calibration in the folder, found {names or 'none'}; name the file itself. Known: {_KNOWN}"
        )
    return _recognise(found[0])


def _calibrations(paths: Iterable[Path]) -> Iterator[tuple[Path, InputError | None]]:
    """The first file of each calibration, and files that look like one and are not, with the reason."""
    seen: set[Path] = set()
    for path in paths:
        is_small = path.suffix.lower() in RIG_SUFFIXES and path.is_file() and path.stat().st_size <= _LARGEST_BYTES
        if path in seen or not is_small:
            continue
        try:
            file, found = _recognise(path)
            files = _KINDS[found].files(file.path)
            if seen.isdisjoint(files):
                yield files[0], None
            seen.update(files)
        except InputError as error:
            if path.suffix.lower() not in _TEXTS:
                yield path, error


# --------------------------------------------------------------------------- the calibrations in a folder, for `conetl init`

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

    paths: files of one folder, with one of `RIG_SUFFIXES`; texts without a calibration's keys are other files of the recording.
    Raises InputError for a rig.yaml that cannot be read.
    """
    found = FoundRigs([], [], [])
    for path, problem in _calibrations(sorted(paths, key=lambda path: (path.name != RIG_YAML, path.name))):
        try:
            if problem is not None:
                raise problem
            rig, kind = read_given_rig(path, size)
        except InputError as error:
            if path.name == RIG_YAML:
                raise
            found.unread.append(f"{path.name} is not used as a calibration: {str(error).removeprefix(f'{path}: ')}")
            continue
        width_px, height_px = rig.left.width_px, rig.left.height_px
        if size is None or size == (width_px, height_px):
            found.fitting.append((path, rig, kind))
            if path.name == RIG_YAML:
                break
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
