"""Factory calibrations of stereo cameras. Pixels and lenses are OpenCV's.

ZED: `SNxxxx.conf`, an INI file with one calibration per resolution, lengths in millimetres. The pose is that of Stereolabs' own
calibration tool (zed-opencv-calibration), which writes the result of `cv2.stereoCalibrate`: `p_right = R p_left + t` with the
rotation vector (RX, CV, RZ) and t = (-Baseline, TY, TZ). Older programs negate TY and TZ, which the file cannot decide: they are
tenths of a millimetre, and a millimetre of TY at 120 mm is half a degree of tilt. `conetl inspect` shows rows that do not fit.

OAK (DepthAI): the EEPROM's `calib.json`, with cameras by socket. `extrinsics` of a camera are a transform of points:
`p_to = R p_this + t`, in centimetres, to the camera `toCameraSocket` (CalibrationHandler of depthai-core stores OpenCV's R and T
of the stereo calibration there). In a file of a device, `rectifiedRotationRight @ R = rectifiedRotationLeft` holds to 2e-8 and
the baseline to 4e-9 of its length; every file is checked by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from configparser import Error, RawConfigParser
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.files.documents import MAX_SHOWN, library_errors, read_json, read_limited, shown
from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import MIN_BASELINE_M, Camera, Lens, Rig
from conetl.readers.rigs.common import LENGTH_UNITS, Node, Pair, Size, choose_pair, matrix_of

#: Size of one camera's image by the name of the resolution.
RESOLUTIONS: dict[str, Size] = {
    "4K": (3840, 2160), "2K": (2208, 1242), "FHD1200": (1920, 1200), "FHD": (1920, 1080), "HD": (1280, 720), "SVGA": (960, 600),
    "VGA": (672, 376),
}  # fmt: skip
_POLYNOMIAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
Sections = dict[str, dict[str, str]]
#: Metres by DepthAI's LengthUnit; files without it are in centimetres.
_UNITS_M = {0: 1.0, 1: 0.01, 2: 0.001}
#: Angle (rad) by which a pose may differ from the rectification in the same file.
_MAX_CONTRADICTION = 5e-3


def read_zed_rig(path: Path, *, image_size: Size | None = None) -> Rig:
    """Raw rig of one resolution; image_size: width and height of one camera's image, where the file has several.

    Raises InputError.
    """
    sections = _sections(path)
    name = _resolution(path, sections, image_size)
    left, right = (_zed_camera(path, sections, side, name) for side in ("LEFT", "RIGHT"))
    stereo = Node(path, sections.get("STEREO", {}), "STEREO")
    baseline = stereo.at("baseline").number()
    ty, tz = (stereo._replace(value={key: "0"} | stereo.value).at(key).number() for key in ("ty", "tz"))
    turn = [stereo.at(f"{key}_{name.lower()}").number() for key in ("rx", "cv", "rz")]
    key = Node(path, baseline, "STEREO.Baseline")
    if not baseline * LENGTH_UNITS["mm"] >= MIN_BASELINE_M:
        raise key.bad(f"must be {MIN_BASELINE_M / LENGTH_UNITS['mm']:g} millimetres or more, found {baseline:g}")
    if not np.linalg.norm(turn) < np.pi / 4:
        angles = Node(path, turn, f"STEREO.RX_{name}, CV_{name}, RZ_{name}")
        raise angles.bad(f"must be small angles in radians, found {shown(turn)}")
    shift_m = LENGTH_UNITS["mm"] * np.array([-baseline, ty, tz])
    return key.stereo_rig("zed", left, right, se3.se3(Rotation.from_rotvec(turn).as_matrix(), shift_m))


def _sections(path: Path) -> Sections:
    """Values by section (in capitals) and key (in lower case)."""
    parser = RawConfigParser(inline_comment_prefixes=("#", ";"))
    with library_errors(f"{path}: not an INI file", Error):
        parser.read_string(read_limited(path), source=path.name[:MAX_SHOWN])
    return {name.upper(): dict(parser.items(name)) for name in parser.sections()}


def _resolution(path: Path, sections: Sections, image_size: Size | None) -> str:
    known = [name for name in RESOLUTIONS if f"LEFT_CAM_{name}" in sections and f"RIGHT_CAM_{name}" in sections]
    if not known:
        raise InputError(
            f"{path}: expected the sections LEFT_CAM_HD and RIGHT_CAM_HD (or {', '.join(RESOLUTIONS)}) of a ZED camera, found "
            f"{shown([*sections])}"
        )
    fitting = [name for name in known if image_size in (None, RESOLUTIONS[name])]
    if len(fitting) == 1:
        return fitting[0]
    sizes = ", ".join(f"{RESOLUTIONS[name][0]}x{RESOLUTIONS[name][1]} ({name})" for name in known)
    given = "" if image_size is None else f", none is {image_size[0]}x{image_size[1]}"
    raise InputError(
        f"{path}: the file has calibrations for images of {sizes}{given}; name that of your images: conetl rig convert with "
        "--image-size (one camera's image, half of a side-by-side one)"
    )


def _zed_camera(path: Path, sections: Sections, side: str, name: str) -> Camera:
    camera = Node(path, sections[f"{side}_CAM_{name}"], f"{side}_CAM_{name}")
    k = matrix_of(*(camera.at(key).number() for key in ("fx", "fy", "cx", "cy")))
    return camera._replace(value=k).camera(RESOLUTIONS[name], _zed_lens(camera, sections, f"{side}_DISTO"))


def _zed_lens(camera: Node, sections: Sections, disto: str) -> Lens:
    """Coefficients beside the camera matrix, or (files of newer cameras) in a section for all resolutions."""
    found = [part for part in (camera.key, disto) if "k1" in sections.get(part, {})]
    if len(found) != 1:
        raise camera.get("k1").bad(
            f"must be in one of {camera.key} and {disto}, found in {' and '.join(found) or 'none'}"
        )
    given = sections[found[0]]
    # k3 to k6 and the tangential coefficients are zero where a file does not have them.
    lens = Node(camera.path, dict.fromkeys(_POLYNOMIAL, "0") | given, found[0])
    if "k4" in given and "p1" not in given:
        raise lens.at("k4").bad("without p1 and p2 is a fisheye lens, whose meaning in ZED files conetl does not know")
    return Node(lens.path, [lens.at(key).number() for key in _POLYNOMIAL], f"{lens.key}.k1 to k6").lens()


def read_oak_rig(path: Path, *, pair: Pair | None = None) -> Rig:
    """Raw rig of two cameras; pair: sockets like CAM_B,CAM_C or 1,2; default the stereo pair that the file names.

    Raises InputError.
    """
    content = Node(path, read_json(path))
    cameras = _cameras(content)
    rectification = content.get("stereoRectificationData")
    stated = tuple(_socket(rectification.get(f"{side}CameraSocket").value) for side in ("left", "right"))
    named = None if pair is None else tuple(_socket(name) for name in pair)
    left, right = choose_pair(path, [*cameras], named or (stated if all(name in cameras for name in stated) else None))
    poses: dict[tuple[str, str], Floats] = {}
    for name, camera in cameras.items():
        found = _pose(camera)
        if found is not None:
            poses[found[0], name] = found[1]
    right_SE3_left = se3.find_pose(poses, right, left)
    extrinsics = cameras[left].get("extrinsics")
    if right_SE3_left is None:
        raise extrinsics.bad(f"does not lead to {right}: the two cameras were not calibrated together")
    if (left, right) == stated:
        _check(rectification, right_SE3_left)
    return extrinsics.stereo_rig("oak", _oak_camera(cameras[left]), _oak_camera(cameras[right]), right_SE3_left)


def _socket(value: Any) -> str:
    """Name of a socket: CAM_A of 0, A or CAM_A."""
    text = str(value).strip().upper().removeprefix("CAM_")
    if text.isdecimal() and len(text) < 3 and int(text) < 26:
        text = chr(ord("A") + int(text))
    return f"CAM_{text}"


def _cameras(content: Node) -> dict[str, Node]:
    """Calibrated cameras by socket; the file has pairs of number and camera, or a mapping."""
    data = content.at("cameraData")
    items = [*data.value.items()] if isinstance(data.value, Mapping) else data.value
    if not isinstance(items, list) or not all(isinstance(item, list | tuple) and len(item) == 2 for item in items):
        raise data.bad("must hold pairs of socket and camera")
    found = {
        _socket(name): Node(data.path, camera, f"cameraData.{_socket(name)}")
        for name, camera in items
        if isinstance(camera, Mapping) and camera.get("intrinsicMatrix")
    }
    if len(found) < 2:
        raise data.bad(f"has {len(found)} calibrated cameras, expected two or more: calibrate the device")
    return found


def _oak_camera(camera: Node) -> Camera:
    kind = camera.value.get("cameraType", 0)
    if type(kind) is not int or kind not in (0, 1):
        text = f"{shown(kind)} is not supported, only 0 (perspective) and 1 (fisheye)"
        raise camera.get("cameraType").bad(text)
    size = camera.both("width", "height").size()
    bent = camera.at("distortionCoeff")
    if kind == 1 and bent.numbers().size == 14:  # the EEPROM has 14 places whatever the lens
        bent = bent._replace(value=bent.numbers()[:4])
    return camera.at("intrinsicMatrix").camera(size, bent.lens(fisheye=kind == 1))


def _pose(camera: Node) -> tuple[str, Floats] | None:
    """The socket that a camera's extrinsics lead to, and to_SE3_camera (4, 4); None at the end of the chain."""
    extrinsics = camera.get("extrinsics")
    if not isinstance(extrinsics.value, Mapping) or extrinsics.value.get("toCameraSocket", -1) == -1:
        return None
    unit = extrinsics.value.get("lengthUnit", 1)
    if type(unit) is not int or unit not in _UNITS_M:
        raise extrinsics.get("lengthUnit").bad(f"must be 0 (m), 1 (cm) or 2 (mm), found {shown(unit)}")
    turn, shift = extrinsics.at("rotationMatrix").rotation(), extrinsics.at("translation")
    t = shift._replace(value=[shift.at(axis).value for axis in "xyz"]).numbers((3,))
    return _socket(extrinsics.value["toCameraSocket"]), se3.se3(turn, _UNITS_M[unit] * t)


def _check(rectification: Node, right_SE3_left: Floats) -> None:
    """Raise InputError where the rectification in the file is that of another pose."""
    try:
        left_R, right_R = (rectification.at(f"rectifiedRotation{side}").numbers((3, 3)) for side in ("Left", "Right"))
    except InputError:
        return  # files of some devices have none
    if not (se3.is_rotation(left_R) and se3.is_rotation(right_R)):
        return
    centre = se3.invert(right_SE3_left)[:3, 3]
    along = left_R @ centre / np.linalg.norm(centre)
    worst = max(float(np.abs(right_R @ right_SE3_left[:3, :3] - left_R).max()), float(np.abs(along[1:]).max()))
    if not worst <= _MAX_CONTRADICTION:
        raise rectification.bad(
            f"contradicts the extrinsics by {worst:.3g} rad: one of them is of another calibration. Recalibrate the device, "
            "or delete this key if the extrinsics are right"
        )
