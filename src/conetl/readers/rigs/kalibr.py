"""Kalibr's `camchain.yaml` of pinhole cameras (Furgale, Rehder & Siegwart 2013), read and written.

`T_cn_cnm1` of each camera after the first transforms points of the one before it to its own, metres. radtan is k1, k2, p1, p2
and equidistant is OpenCV's fisheye. `T_cam_imu` is ignored: Kalibr's IMU is any IMU, conetl's body is the INS of the trajectory;
write body_SE3_left into a rig.yaml.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from conetl.files.documents import read_yaml, shown
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.camera import intrinsics
from conetl.model.errors import CalibrationError
from conetl.model.records import Rig
from conetl.readers.rigs.common import (
    Pair,
    choose_pair,
    motion_at,
    opencv_coefficients,
    pinhole_camera,
    stereo_rig,
    write_yaml,
)

_LENSES: dict[str | None, str | None] = {"radtan": "opencv", "equidistant": "fisheye", "none": None}


def read_kalibr_rig(path: Path, *, pair: Pair | None = None) -> Rig:
    """Raw rig of cam0 (left) and cam1 (right), or of another pair of a chain of more cameras. Raises CalibrationError."""
    content = read_yaml(path)
    if not isinstance(content, Mapping):
        raise CalibrationError(f"{path}: expected a YAML mapping with the keys cam0 and cam1")
    names = sorted(
        (name for name in map(str, content) if re.fullmatch(r"cam\d{1,3}", name)), key=lambda name: int(name[3:])
    )
    if len(names) < 2 or names != [f"cam{number}" for number in range(len(names))]:
        raise CalibrationError(
            f"{path}: expected the cameras cam0 (left), cam1 (right) and so on, found {shown(names)}"
        )
    left, right = choose_pair(path, names, pair)
    left_camera, right_camera = (
        pinhole_camera(path, content[name], f"{name}.", "distortion_coeffs", _LENSES) for name in (left, right)
    )
    first, last = sorted((int(left[3:]), int(right[3:])))
    pose = np.eye(4)
    for number in range(first + 1, last + 1):
        pose = se3.compose(motion_at(path, content[f"cam{number}"], "T_cn_cnm1", f"cam{number}."), pose)
    right_SE3_left = pose if left == f"cam{first}" else se3.invert(pose)
    return stereo_rig(path, f"cam{last}.T_cn_cnm1", "kalibr", left_camera, right_camera, right_SE3_left)


def write_kalibr_rig(rig: Rig, path: Path) -> None:
    """Write a camchain. Kalibr's radtan has k1, k2, p1, p2 only: raises CalibrationError for a lens with more."""
    content: dict[str, Any] = {}
    for name, camera in (("cam0", rig.left), ("cam1", rig.right)):
        coefficients = opencv_coefficients(camera.lens)
        if camera.lens.model != "fisheye":
            if any(coefficients[4:]):
                raise CalibrationError(
                    f"{path}: Kalibr's radtan lens has no k3 to k6, but the {camera.lens.model} lens of {name} has; "
                    "export to OpenCV or ROS, or calibrate with the radial or the fisheye model"
                )
            coefficients = coefficients[:4]
        content[name] = {
            "camera_model": "pinhole",
            "intrinsics": [float(v) for v in intrinsics(camera)],
            "distortion_model": "equidistant" if camera.lens.model == "fisheye" else "radtan",
            "distortion_coeffs": coefficients,
            "resolution": [camera.width_px, camera.height_px],
        }
    content["cam1"]["T_cn_cnm1"] = se3.invert(rigs.left_SE3_right(rig)).tolist()
    write_yaml(path, content)
