"""Chains of cameras in Kalibr's notation (Furgale, Rehder & Siegwart 2013), also as OpenVINS writes them; read only.

Cameras are pinholes; radtan is k1, k2, p1, p2 and equidistant is OpenCV's fisheye. `T_cn_cnm1` of each camera after the first
transforms points of the one before it to its own, metres. Without it the cameras are joined by the IMU: `T_cam_imu` (Kalibr)
transforms points of the IMU to the camera, `T_imu_cam` (OpenVINS) those of the camera to the IMU. The IMU is not used otherwise:
it is any IMU, conetl's body is the INS of the trajectory; write body_SE3_left into a rig.yaml.
"""

from __future__ import annotations

import numpy as np

from conetl.files.documents import shown
from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.rig import Rig
from conetl.readers.rigs.common import Node, Pair, choose_pair

_LENSES: dict[str | None, str | None] = {"radtan": "opencv", "equidistant": "fisheye", "none": None}


def read_kalibr_rig(chain: Node, *, pair: Pair | None = None) -> Rig:
    """Raw rig of cam0 (left) and cam1 (right), or of another pair of a chain of more cameras. Raises InputError."""
    names = [name for number in range(1000) if (name := f"cam{number}") in chain.value]
    if len(names) < 2 or names[-1] != f"cam{len(names) - 1}":
        raise chain.bad(f"must have the cameras cam0 (left), cam1 (right) and so on, found {shown(names)}")
    left, right = choose_pair(chain.path, names, pair)
    cameras = [chain.get(name).pinhole_camera("distortion_coeffs", _LENSES) for name in (left, right)]
    first, last = sorted((left, right), key=names.index)
    steps = names[names.index(first) + 1 : names.index(last) + 1]
    key = chain.get(last).get("T_cn_cnm1")
    if key.value is None and all(_imu_key(chain, name) for name in (left, right)):
        left_SE3_imu, right_SE3_imu = (_cam_SE3_imu(chain, name) for name in (left, right))
        key, pose = (
            chain.get(last).get(_imu_key(chain, last) or ""),
            se3.compose(right_SE3_imu, se3.invert(left_SE3_imu)),
        )
    else:
        pose = np.eye(4)
        for name in steps:
            pose = se3.compose(chain.get(name).at("T_cn_cnm1").motion(), pose)
        pose = pose if left == first else se3.invert(pose)
    return key.stereo_rig("kalibr", cameras[0], cameras[1], pose)


def _imu_key(chain: Node, name: str) -> str | None:
    """The key of a camera's pose relative to the IMU."""
    return next((key for key in ("T_cam_imu", "T_imu_cam") if chain.get(name).get(key).value is not None), None)


def _cam_SE3_imu(chain: Node, name: str) -> Floats:
    key = _imu_key(chain, name) or ""
    pose = chain.get(name).at(key).motion()
    return pose if key == "T_cam_imu" else se3.invert(pose)
