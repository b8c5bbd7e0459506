"""Calibrations of the ROS world: `camera_info` YAML pairs, read and written, and Kalibr's `camchain.yaml`, read.

A pair of camera_info (camera_calibration, camera_info_manager: `left.yaml` and `right.yaml`) describes the raw images.
`rectification_matrix` rotates directions of the camera into the rectified frame, and `projection_matrix` of the right camera has
-fx baseline in its fourth column (REP 104, sensor_msgs/CameraInfo); both together are the relative pose. If the cameras were
calibrated one by one (identity and no fourth column), the relative pose is read from `extrinsics.yaml` beside them:
`left_SE3_right: {R: [[...], [...], [...]], t_m: [x, y, z]}`, as in a rig.yaml.

A camchain (Furgale, Rehder & Siegwart 2013) has pinhole cameras; `T_cn_cnm1` of each camera after the first transforms points of
the one before it to its own, metres. radtan is k1, k2, p1, p2 and equidistant is OpenCV's fisheye. `T_cam_imu` is ignored:
Kalibr's IMU is any IMU, conetl's body is the INS of the trajectory; write body_SE3_left into a rig.yaml.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from conetl.files.documents import input_errors, read_yaml, shown
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.camera import matrix_k
from conetl.geometry.rectification import common_rotation, rectify
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Camera, Rig
from conetl.readers.rigs.common import Node, Pair, choose_pair, opencv_coefficients, write_yaml

EXTRINSICS = "extrinsics.yaml"
_MODELS = ("plumb_bob", "rational_polynomial", "equidistant")
_KALIBR_LENSES: dict[str | None, str | None] = {"radtan": "opencv", "equidistant": "fisheye", "none": None}


def pair_of(path: Path, pair: Pair | None = None) -> tuple[Path, Path]:
    """Both files of a pair, given one of them (with left or right in its name) or their folder.

    pair: names without suffix, of two of a folder's files. Raises InputError.
    """
    if pair is not None:
        folder = path if path.is_dir() else path.parent
        files = {file.stem: file for file in sorted(folder.glob("*.y*ml"))}
        left, right = choose_pair(folder, [*files], pair)
        return files[left], files[right]
    if path.is_dir():
        suffix = ".yaml" if (path / "left.yaml").is_file() else ".yml"
        return path / f"left{suffix}", path / f"right{suffix}"
    name = path.name
    for ours, theirs in (("left", "right"), ("right", "left")):
        if name.count(ours) == 1:
            other = path.with_name(name.replace(ours, theirs))
            if not other.is_file():
                raise InputError(f"{path}: this is one camera of two; {other.name} is missing beside it")
            return (path, other) if ours == "left" else (other, path)
    raise InputError(f"{path}: this is one camera of two; name the files left.yaml and right.yaml, in one folder")


def read_ros_rig(path: Path, *, pair: Pair | None = None) -> Rig:
    """Raw rig of a camera_info pair; pair as in `pair_of`. Raises InputError."""
    left_path, right_path = pair_of(path, pair)
    left_info, right_info = Node(left_path, read_yaml(left_path)), Node(right_path, read_yaml(right_path))
    extrinsics = left_path.parent / EXTRINSICS
    if extrinsics.is_file():
        relative = Node(extrinsics, read_yaml(extrinsics)).at("left_SE3_right")
        pose = se3.se3(relative.at("R").numbers((3, 3)), relative.at("t_m").numbers((3,)))
        return relative.stereo_rig("ros", _camera(left_info)[0], _camera(right_info)[0], se3.invert(pose))
    return rig_of_camera_infos(left_info, right_info)


def rig_of_camera_infos(left_info: Node, right_info: Node) -> Rig:
    """Raw rig of two camera_info mappings (keys of the YAML files). Raises InputError."""
    left, left_R, left_p = _camera(left_info)
    right, right_R, right_p = _camera(right_info)
    projection = right_info.at("projection_matrix")
    if abs(left_p[0, 3]) > 1e-9:
        raise left_info.at("projection_matrix").bad(
            "of the left camera must have a zero in row 1, column 4: are left and right swapped?"
        )
    if right_p[0, 3] == 0.0:
        raise projection.bad(
            "has no baseline (row 1, column 4 is 0): the two cameras were calibrated separately. Calibrate them as a stereo "
            f"pair, or put an {EXTRINSICS} with left_SE3_right beside them"
        )
    if not right_p[0, 0] > 0:
        raise projection.bad(f"must have a positive focal length, found {right_p[0, 0]:g}")
    centre = np.array([-right_p[0, 3] / right_p[0, 0], 0.0, 0.0])  # of the right camera, in the common rectified frame
    # x_rect = left_R x_left and x_rect = right_R x_right + centre
    return projection.stereo_rig("ros", left, right, se3.se3(right_R.T @ left_R, -right_R.T @ centre))


def _camera(info: Node) -> tuple[Camera, Floats, Floats]:
    """Camera, its rectification matrix (3, 3) and its projection matrix (3, 4)."""
    if not isinstance(info.value, Mapping):
        raise InputError(f"{info.path}: expected the YAML mapping of a ROS camera_info")
    size = info.both("image_width", "image_height").size()
    model = info.at("distortion_model")
    if model.value not in _MODELS:
        raise model.bad(f"{shown(model.value)} is not supported; known: {', '.join(_MODELS)}")
    lens = info.at("distortion_coefficients").lens(fisheye=model.value == "equidistant")
    camera = info.at("camera_matrix").camera(size, lens)
    return camera, info.at("rectification_matrix").rotation(), info.at("projection_matrix").numbers((3, 4))


def write_ros_rig(rig: Rig, folder: Path) -> None:
    """Write `left.yaml` and `right.yaml` into a folder; rectification and projection are conetl's own (`rectify`).

    Raises InputError for a rig that cannot be rectified.
    """
    with input_errors(f"{folder}: this rig cannot be rectified, as ROS requires"):
        flat = rectify(rig)
    raw_R_rect = [rigs.stored_R_camera(flat, side) for side in SIDES]
    if flat is rig:
        # Parallel within tolerance; ROS requires exact rows, so its rotations contain the remaining turn.
        raw_R_rect = [*common_rotation(rigs.left_SE3_right(rig))]
    for side, turn, shift in zip(SIDES, raw_R_rect, (0.0, -rig.baseline_m), strict=True):
        camera, target = rigs.camera_of(rig, side), rigs.camera_of(flat, side)
        projection = np.column_stack([matrix_k(target), [target.fx_px * shift, 0.0, 0.0]])
        content = {
            "image_width": camera.width_px,
            "image_height": camera.height_px,
            "camera_name": side,
            "camera_matrix": _matrix(matrix_k(camera)),
            "distortion_model": {"fisheye": "equidistant", "rational": "rational_polynomial"}.get(
                camera.lens.model, "plumb_bob"
            ),
            "distortion_coefficients": _matrix(np.array([opencv_coefficients(camera.lens)])),
            "rectification_matrix": _matrix(turn.T),
            "projection_matrix": _matrix(projection),
        }
        write_yaml(folder / f"{side}.yaml", content)


def _matrix(values: Floats) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": [float(v) for v in values.reshape(-1)]}


def read_kalibr_rig(path: Path, *, pair: Pair | None = None) -> Rig:
    """Raw rig of cam0 (left) and cam1 (right), or of another pair of a chain of more cameras. Raises InputError."""
    content = read_yaml(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: expected a YAML mapping with the keys cam0 and cam1")
    names = [name for number in range(1000) if (name := f"cam{number}") in content]
    if len(names) < 2 or names[-1] != f"cam{len(names) - 1}":
        raise InputError(f"{path}: expected the cameras cam0 (left), cam1 (right) and so on, found {shown(names)}")
    left, right = choose_pair(path, names, pair)
    chain = Node(path, content)
    left_camera, right_camera = (
        chain.get(name).pinhole_camera("distortion_coeffs", _KALIBR_LENSES) for name in (left, right)
    )
    first, last = sorted((int(left[3:]), int(right[3:])))
    pose = np.eye(4)
    for number in range(first + 1, last + 1):
        pose = se3.compose(chain.get(f"cam{number}").at("T_cn_cnm1").motion(), pose)
    right_SE3_left = pose if left == f"cam{first}" else se3.invert(pose)
    key = chain.get(f"cam{last}").at("T_cn_cnm1")
    return key.stereo_rig("kalibr", left_camera, right_camera, right_SE3_left)
