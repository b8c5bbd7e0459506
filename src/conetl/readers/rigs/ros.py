"""ROS `camera_info` YAML pairs (camera_calibration, camera_info_manager): `left.yaml` and `right.yaml`, read and written.

The pair describes the raw images. `rectification_matrix` rotates directions of the camera into the rectified frame, and
`projection_matrix` of the right camera has -fx baseline in its fourth column (REP 104, sensor_msgs/CameraInfo); both together
are the relative pose. If the cameras were calibrated one by one (identity and no fourth column), the relative pose is read from
`extrinsics.yaml` beside them: `left_SE3_right: {R: [[...], [...], [...]], t_m: [x, y, z]}`, as in a rig.yaml.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from conetl.files.documents import read_yaml, shown
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.camera import matrix_k
from conetl.geometry.rectification import common_rotation, rectify
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
    numbers_at,
    opencv_coefficients,
    opencv_lens,
    rotation,
    size_of_images,
    stereo_rig,
    write_yaml,
)

EXTRINSICS = "extrinsics.yaml"
_MODELS = ("plumb_bob", "rational_polynomial", "equidistant")


def pair_of(path: Path, pair: Pair | None = None) -> tuple[Path, Path]:
    """Both files of a pair, given one of them (with left or right in its name) or their folder.

    pair: names without suffix, of two of a folder's files. Raises CalibrationError.
    """
    if pair is not None:
        folder = path if path.is_dir() else path.parent
        files = {file.stem: file for file in sorted(folder.glob("*.y*ml"))}
        left, right = choose_pair(folder, [*files], pair)
        return files[left], files[right]
    if path.is_dir():
        for suffix in (".yaml", ".yml"):
            both = path / f"left{suffix}", path / f"right{suffix}"
            if all(file.is_file() for file in both):
                return both
        raise CalibrationError(f"{path}: expected left.yaml and right.yaml in the folder")
    name = path.name
    for ours, theirs in (("left", "right"), ("right", "left")):
        if name.count(ours) == 1:
            other = path.with_name(name.replace(ours, theirs))
            if not other.is_file():
                raise CalibrationError(f"{path}: this is one camera of two; {other.name} is missing beside it")
            return (path, other) if ours == "left" else (other, path)
    raise CalibrationError(f"{path}: this is one camera of two; name the files left.yaml and right.yaml, side by side")


def read_ros_rig(path: Path, *, pair: Pair | None = None) -> Rig:
    """Raw rig of a camera_info pair; pair as in `pair_of`. Raises CalibrationError."""
    left_path, right_path = pair_of(path, pair)
    extrinsics = left_path.parent / EXTRINSICS
    if extrinsics.is_file():
        left, right = _camera(left_path, read_yaml(left_path))[0], _camera(right_path, read_yaml(right_path))[0]
        key = "left_SE3_right"
        relative = entry(extrinsics, read_yaml(extrinsics), key)
        turn = numbers_at(extrinsics, relative, "R", (3, 3), f"{key}.")
        shift = numbers_at(extrinsics, relative, "t_m", (3,), f"{key}.")
        return stereo_rig(extrinsics, key, "ros", left, right, se3.invert(se3.se3(turn, shift)))
    return rig_of_camera_infos(left_path, read_yaml(left_path), right_path, read_yaml(right_path))


def rig_of_camera_infos(left_path: Path, left_info: Any, right_path: Path, right_info: Any) -> Rig:
    """Raw rig of two camera_info mappings (keys of the YAML files); the paths are for messages only. Raises CalibrationError."""
    left, left_R, left_p = _camera(left_path, left_info)
    right, right_R, right_p = _camera(right_path, right_info)
    key = "projection_matrix"
    if abs(left_p[0, 3]) > 1e-9:
        raise bad(left_path, key, "of the left camera must have a zero in row 1, column 4: are left and right swapped?")
    if right_p[0, 3] == 0.0:
        raise bad(
            right_path, key, "has no baseline (row 1, column 4 is 0): the two cameras were calibrated one by one. Calibrate them "
            f"as a stereo pair, or put an {EXTRINSICS} with left_SE3_right beside them",
        )  # fmt: skip
    if not right_p[0, 0] > 0:
        raise bad(right_path, key, f"must have a positive focal length, found {right_p[0, 0]:g}")
    centre = np.array([-right_p[0, 3] / right_p[0, 0], 0.0, 0.0])  # of the right camera, in the common rectified frame
    # x_rect = left_R x_left and x_rect = right_R x_right + centre
    return stereo_rig(right_path, key, "ros", left, right, se3.se3(right_R.T @ left_R, -right_R.T @ centre))


def _camera(path: Path, content: Any) -> tuple[Camera, Array, Array]:
    """Camera, its rectification matrix (3, 3) and its projection matrix (3, 4)."""
    if not isinstance(content, Mapping):
        raise CalibrationError(f"{path}: expected the YAML mapping of a ROS camera_info")
    size = size_of_images(
        path, "image_width, image_height", [entry(path, content, "image_width"), entry(path, content, "image_height")]
    )
    model = entry(path, content, "distortion_model")
    if model not in _MODELS:
        raise bad(path, "distortion_model", f"{shown(model)} is not supported; known: {', '.join(_MODELS)}")
    key = "distortion_coefficients"
    lens = (fisheye_lens if model == "equidistant" else opencv_lens)(path, key, numbers_at(path, content, key))
    k = numbers_at(path, content, "camera_matrix", (3, 3))
    turn = rotation(path, "rectification_matrix", numbers_at(path, content, "rectification_matrix", (3, 3)))
    projection = numbers_at(path, content, "projection_matrix", (3, 4))
    return camera_from_matrix(path, "camera_matrix", k, size, lens), turn, projection


def write_ros_rig(rig: Rig, folder: Path) -> None:
    """Write `left.yaml` and `right.yaml` into a folder; rectification and projection are conetl's own (`rectify`).

    Raises CalibrationError for a rig that cannot be rectified.
    """
    try:
        flat = rectify(rig)
    except ValueError as error:
        raise CalibrationError(f"{folder}: this rig cannot be rectified, as ROS requires: {error}") from error
    base_m = rig.baseline_m
    raw_R_rect = [
        rigs.body_SE3_camera(rig, side)[:3, :3].T @ rigs.body_SE3_camera(flat, side)[:3, :3]
        for side in ("left", "right")
    ]
    if flat is rig:
        # Parallel within tolerance; ROS requires exact rows, so its rotations contain the remaining turn.
        raw_R_rect = list(common_rotation(rigs.left_SE3_right(rig)))
    for name, camera, target, turn, shift in (
        ("left", rig.left, flat.left, raw_R_rect[0], 0.0),
        ("right", rig.right, flat.right, raw_R_rect[1], -base_m),
    ):
        projection = np.column_stack([matrix_k(target), [target.fx_px * shift, 0.0, 0.0]])
        content = {
            "image_width": camera.width_px,
            "image_height": camera.height_px,
            "camera_name": name,
            "camera_matrix": _matrix(matrix_k(camera)),
            "distortion_model": {"fisheye": "equidistant", "rational": "rational_polynomial"}.get(
                camera.lens.model, "plumb_bob"
            ),
            "distortion_coefficients": _matrix(np.array([opencv_coefficients(camera.lens)])),
            "rectification_matrix": _matrix(turn.T),
            "projection_matrix": _matrix(projection),
        }
        write_yaml(folder / f"{name}.yaml", content)


def _matrix(values: Array) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": [float(v) for v in values.reshape(-1)]}
