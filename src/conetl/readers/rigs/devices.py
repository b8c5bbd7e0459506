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
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.files.documents import shown
from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import Camera, Lens, Rig
from conetl.readers.rigs.common import Node, Pair, Size, choose_pair, matrix_of

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


def read_zed_rig(file: Node, *, image_size: Size | None = None) -> Rig:
    """Raw rig of one resolution; image_size: width and height of one camera's image, where the file does not say it alone.

    Raises InputError.
    """
    sections = {
        name.upper(): {key.lower(): value for key, value in values.items()}
        for name, values in file.value.items()
        if isinstance(values, Mapping)
    }
    name, size = _resolution(file, sections, image_size)
    left, right = (_zed_camera(file, sections, side, name).camera(size, _zed_lens(file, sections, side, name))
                   for side in ("LEFT", "RIGHT"))  # fmt: skip
    stereo = file._replace(value=sections.get("STEREO", {}), key="STEREO")
    baseline = stereo.at("baseline").number()
    ty, tz = (stereo._replace(value={key: "0"} | stereo.value).at(key).number() for key in ("ty", "tz"))
    turn = [stereo.at(f"{key}_{name.lower()}").number() for key in ("rx", "cv", "rz")]
    if not np.linalg.norm(turn) < np.pi / 4:
        angles = Node(file.path, turn, f"STEREO.RX_{name}, CV_{name}, RZ_{name}")
        raise angles.bad(f"must be small angles in radians, found {shown(turn)}")
    pose = se3.se3(Rotation.from_rotvec(turn).as_matrix(), np.array([-baseline, ty, tz]))
    return stereo.at("baseline").stereo_rig("zed", left, right, pose, "mm")


def _resolution(file: Node, sections: Sections, image_size: Size | None) -> tuple[str, Size]:
    """The name of the resolution in the sections, and the size of its images."""
    names = [name.removeprefix("LEFT_CAM_") for name in sections if name.startswith("LEFT_CAM_")]
    names = [name for name in names if f"RIGHT_CAM_{name}" in sections]
    if not names:
        raise file.bad(
            f"must have the sections LEFT_CAM_HD and RIGHT_CAM_HD of a ZED camera, found {shown([*sections])}"
        )
    sizes = {name: RESOLUTIONS.get(name, image_size if len(names) == 1 else None) for name in names}
    fitting = [(name, size) for name, size in sizes.items() if size is not None and image_size in (None, size)]
    if len(fitting) == 1 and (image_size is not None or len(names) == 1):
        return fitting[0]
    listed = ", ".join(
        f"{size[0]}x{size[1]} ({name})" if size else f"unknown size ({name})" for name, size in sizes.items()
    )
    given = "" if image_size is None else f", none is {image_size[0]}x{image_size[1]}"
    raise file._replace(key="LEFT_CAM, RIGHT_CAM").bad(
        f"are for images of {listed}{given}; name that of your images: conetl rig convert with --image-size (one camera's "
        "image, half of a side-by-side one)"
    )


def _zed_camera(file: Node, sections: Sections, side: str, name: str) -> Node:
    """The camera matrix (3, 3)."""
    camera = file._replace(value=sections[f"{side}_CAM_{name}"], key=f"{side}_CAM_{name}")
    return camera._replace(value=matrix_of(*(camera.at(key).number() for key in ("fx", "fy", "cx", "cy"))))


def _zed_lens(file: Node, sections: Sections, side: str, name: str) -> Lens:
    """Coefficients beside the camera matrix, or (files of newer cameras) in a section for all resolutions."""
    own, disto = f"{side}_CAM_{name}", f"{side}_DISTO"
    found = [part for part in (own, disto) if "k1" in sections.get(part, {})]
    if len(found) != 1:
        problem = f"must be in one of {own} and {disto}, found in {' and '.join(found) or 'none'}"
        raise file._replace(key=f"{own}.k1").bad(problem)
    given = sections[found[0]]
    # k3 to k6 and the tangential coefficients are zero where a file does not have them.
    lens = file._replace(value=dict.fromkeys(_POLYNOMIAL, "0") | given, key=found[0])
    if "k4" in given and "p1" not in given:
        raise lens.at("k4").bad("without p1 and p2 is a fisheye lens, whose meaning in ZED files conetl does not know")
    return lens._replace(value=[lens.at(key).number() for key in _POLYNOMIAL], key=f"{lens.key}.k1 to k6").lens()


def read_oak_rig(content: Node, *, pair: Pair | None = None) -> Rig:
    """Raw rig of two cameras; pair: sockets like CAM_B,CAM_C or 1,2; default the stereo pair that the file names.

    Raises InputError.
    """
    cameras = _cameras(content)
    rectification = content.get("stereoRectificationData")
    stated = tuple(_socket(rectification.get(f"{side}CameraSocket").value) for side in ("left", "right"))
    named = None if pair is None else tuple(_socket(name) for name in pair)
    left, right = choose_pair(
        content.path, [*cameras], named or (stated if all(name in cameras for name in stated) else None)
    )
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
        _socket(name): data._replace(value=camera, key=f"cameraData.{_socket(name)}")
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
    unit_m = _UNITS_M[unit] if camera.length_unit is None else 1.0
    return _socket(extrinsics.value["toCameraSocket"]), se3.se3(turn, unit_m * t)


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
