"""Calibration of an OAK camera (DepthAI): the EEPROM's `calib.json`, with cameras by socket.

`extrinsics` of a camera are a transform of points: `p_to = R p_this + t`, in centimetres, to the camera `toCameraSocket`
(CalibrationHandler of depthai-core stores OpenCV's R and T of the stereo calibration there). In a file of a device,
`rectifiedRotationRight @ R = rectifiedRotationLeft` holds to 2e-8 and the baseline to 4e-9 of its length; every file is
checked by it. Pixels and lenses are OpenCV's.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from conetl.files.documents import read_json, shown
from conetl.geometry import pose as se3
from conetl.model.errors import CalibrationError
from conetl.model.records import Camera, Rig
from conetl.readers.rigs.common import (
    Array,
    Pair,
    bad,
    camera_from_matrix,
    choose_pair,
    entry,
    fisheye_lens,
    numbers,
    numbers_at,
    opencv_lens,
    rotation,
    size_of_images,
    stereo_rig,
)

#: Metres by DepthAI's LengthUnit; files without it are in centimetres.
_UNITS_M = {0: 1.0, 1: 0.01, 2: 0.001}
_LENSES = {0: opencv_lens, 1: fisheye_lens}
#: Angle (rad) by which a pose may differ from the rectification in the same file.
_MAX_CONTRADICTION = 5e-3


def read_oak_rig(path: Path, *, pair: Pair | None = None) -> Rig:
    """Raw rig of two cameras; pair: sockets like CAM_B,CAM_C or 1,2; default the stereo pair that the file names.

    Raises CalibrationError.
    """
    content = read_json(path)
    cameras = _cameras(path, content)
    rectification = content.get("stereoRectificationData")
    rectification = rectification if isinstance(rectification, Mapping) else {}
    stated = tuple(_socket(rectification.get(f"{side}CameraSocket")) for side in ("left", "right"))
    named = None if pair is None else tuple(_socket(name) for name in pair)
    left, right = choose_pair(path, [*cameras], named or (stated if all(name in cameras for name in stated) else None))
    poses: dict[tuple[str, str], Array] = {}
    for name, camera in cameras.items():
        found = _pose(path, camera, f"cameraData.{name}.")
        if found is not None:
            poses[found[0], name] = found[1]
    right_SE3_left = se3.connect(poses, right, left)
    key = f"cameraData.{left}.extrinsics"
    if right_SE3_left is None:
        raise bad(path, key, f"does not lead to {right}: the two cameras were not calibrated together")
    if (left, right) == stated:
        _check(path, rectification, right_SE3_left)
    left_camera, right_camera = (_camera(path, cameras[name], f"cameraData.{name}.") for name in (left, right))
    return stereo_rig(path, key, "oak", left_camera, right_camera, right_SE3_left)


def _socket(value: Any) -> str:
    """Name of a socket: CAM_A of 0, A or CAM_A."""
    text = str(value).strip().upper().removeprefix("CAM_")
    if text.isdecimal() and len(text) < 3 and int(text) < 26:
        text = chr(ord("A") + int(text))
    return f"CAM_{text}"


def _cameras(path: Path, content: Any) -> dict[str, Any]:
    """Calibrated cameras by socket; the file has pairs of number and camera, or a mapping."""
    data = entry(path, content, "cameraData")
    items = [*data.items()] if isinstance(data, Mapping) else data
    if not isinstance(items, list) or not all(isinstance(item, list | tuple) and len(item) == 2 for item in items):
        raise bad(path, "cameraData", "must hold pairs of socket and camera")
    found = {
        _socket(name): camera for name, camera in items if isinstance(camera, Mapping) and camera.get("intrinsicMatrix")
    }
    if len(found) < 2:
        raise bad(
            path, "cameraData", f"has {len(found)} calibrated cameras, expected two or more: calibrate the device"
        )
    return found


def _camera(path: Path, camera: Mapping[str, Any], where: str) -> Camera:
    kind = camera.get("cameraType", 0)
    if type(kind) is not int or kind not in _LENSES:
        raise bad(path, f"{where}cameraType", f"{shown(kind)} is not supported, only 0 (perspective) and 1 (fisheye)")
    size = size_of_images(
        path, f"{where}width, height", [entry(path, camera, "width", where), entry(path, camera, "height", where)]
    )
    key = f"{where}distortionCoeff"
    coefficients = numbers_at(path, camera, "distortionCoeff", None, where)
    if kind == 1 and coefficients.size == 14:  # the EEPROM has 14 places whatever the lens
        coefficients = coefficients[:4]
    k = numbers_at(path, camera, "intrinsicMatrix", (3, 3), where)
    return camera_from_matrix(path, f"{where}intrinsicMatrix", k, size, _LENSES[kind](path, key, coefficients))


def _pose(path: Path, camera: Mapping[str, Any], where: str) -> tuple[str, Array] | None:
    """The socket that a camera's extrinsics lead to, and to_SE3_camera (4, 4); None at the end of the chain."""
    extrinsics = camera.get("extrinsics")
    where = f"{where}extrinsics."
    if not isinstance(extrinsics, Mapping) or extrinsics.get("toCameraSocket", -1) == -1:
        return None
    unit = extrinsics.get("lengthUnit", 1)
    if type(unit) is not int or unit not in _UNITS_M:
        raise bad(path, f"{where}lengthUnit", f"must be 0 (m), 1 (cm) or 2 (mm), found {shown(unit)}")
    matrix = numbers_at(path, extrinsics, "rotationMatrix", (3, 3), where)
    shift = entry(path, extrinsics, "translation", where)
    t = numbers(path, f"{where}translation", [entry(path, shift, axis, f"{where}translation.") for axis in "xyz"], (3,))
    turn = rotation(path, f"{where}rotationMatrix", matrix)
    return _socket(extrinsics["toCameraSocket"]), se3.se3(turn, _UNITS_M[unit] * t)


def _check(path: Path, rectification: Mapping[str, Any], right_SE3_left: Array) -> None:
    """Raise CalibrationError where the rectification in the file is that of another pose."""
    turns = []
    for side in ("Left", "Right"):
        try:
            turn = numbers_at(path, rectification, f"rectifiedRotation{side}", (3, 3), "stereoRectificationData.")
        except CalibrationError:
            return  # files of some devices have none
        if not se3.is_rotation(turn):
            return
        turns.append(turn)
    left_R, right_R = turns
    centre = se3.invert(right_SE3_left)[:3, 3]
    along = left_R @ centre / np.linalg.norm(centre)
    worst = max(float(np.abs(right_R @ right_SE3_left[:3, :3] - left_R).max()), float(np.abs(along[1:]).max()))
    if not worst <= _MAX_CONTRADICTION:
        raise bad(
            path, "stereoRectificationData", f"contradicts the extrinsics by {worst:.3g} rad: one of them is of another "
            "calibration. Calibrate the device anew, or delete this key if the extrinsics are right",
        )  # fmt: skip
