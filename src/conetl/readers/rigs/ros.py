"""Calibrations of the ROS world: `camera_info` pairs in YAML, as messages or in oST, read and written, and ORB-SLAM's settings.

A camera_info (camera_calibration, camera_info_manager: `left.yaml` and `right.yaml`, or `ost.txt` with both) describes raw
images. The rectification matrix rotates directions of the camera into the rectified frame, and the projection matrix of the
right camera has -fx baseline in its fourth column (REP 104, sensor_msgs/CameraInfo); both together are the relative pose. If the
cameras were calibrated one by one (identity and no fourth column), it is read from `extrinsics.yaml` beside them:
`left_SE3_right: {R: [[...], [...], [...]], t_m: [x, y, z]}`, as in a rig.yaml.

ORB-SLAM2 and 3 (Mur-Artal & Tardos 2017; Campos et al. 2021, `Settings.cc`) write such a pair as LEFT.K, D, R, P and RIGHT.*, or
two raw cameras with `Stereo.T_c1_c2` or `Tlr` (`p_left = T p_right`), or one rectified camera with `Camera.bf` = fx baseline or
`Stereo.b`, whose images are rectified already.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.files.documents import input_errors, read_yaml, shown
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.camera import matrix_k
from conetl.geometry.rectification import common_rotation, rectify
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Camera, Lens, Rig
from conetl.readers.rigs.common import Node, Pair, Size, choose_pair, matrix_of, opencv_coefficients, write_yaml
from conetl.readers.rigs.content import read_content

EXTRINSICS = "extrinsics.yaml"
_MODELS = ("plumb_bob", "rational_polynomial", "equidistant")
#: What a section of an oST file has besides its camera's name.
_OST_PARTS = ("projection", "camera matrix", "rectification", "distortion")


class CameraInfoKeys(NamedTuple):
    """Keys of a camera_info in one of its notations."""

    width: str = "image_width"
    height: str = "image_height"
    matrix: str = "camera_matrix"
    distortion: str = "distortion_coefficients"
    rectification: str = "rectification_matrix"
    projection: str = "projection_matrix"
    model: str | None = "distortion_model"
    """None where the number of coefficients says it."""


_OST_KEYS = CameraInfoKeys("width", "height", "camera matrix", "distortion", "rectification", "projection", None)
#: Of messages as text (`rostopic echo`, `ros2 topic echo`).
_MESSAGE_KEYS = tuple(CameraInfoKeys("width", "height", *names) for names in ("KDRP", "kdrp"))


def read_ros_rig(file: Node, *, pair: Pair | None = None) -> Rig:
    """Raw rig of a file with both cameras, or of one of two files; pair as in `ros_files`. Raises InputError."""
    if len(cameras := _ost_cameras(file)) > 1:
        left, right = (cameras[name] for name in choose_pair(file.path, [*cameras], pair))
        return rig_of_camera_infos(left, right, keys=[_OST_KEYS])
    files = ros_files(file.path) if pair is None else _named(file.path, pair)
    if len(files) == 1:
        other = re.sub("left|right", lambda side: "left" if side.group() == "right" else "right", file.path.name)
        advice = "name the files left.yaml and right.yaml, in one folder"
        missing = advice if other == file.path.name else f"{other} is missing beside it"
        raise InputError(f"{file.path}: this is one camera of two; {missing}")
    infos = [file if path == file.path else file._replace(path=path, value=read_content(path)) for path in files]
    for info in infos:
        if not isinstance(info.value, Mapping):
            raise info.bad("must be the mapping of a ROS camera_info")
    of_messages = (keys for keys in _MESSAGE_KEYS if keys.matrix in file.value)
    keys = _OST_KEYS if cameras else next(of_messages, CameraInfoKeys())
    for info in infos if keys in _MESSAGE_KEYS else ():
        roi, bins = info.value.get("roi"), [info.value.get(name, 0) for name in ("binning_x", "binning_y")]
        if not {0, 1}.issuperset(bins) or (isinstance(roi, Mapping) and any(roi.values())):
            raise info.bad(
                "describes images that are cropped or binned: read the recording itself, or calibrate these images"
            )
    infos = [next(iter(_ost_cameras(info).values()), info) for info in infos]
    extrinsics = files[0].parent / EXTRINSICS
    if extrinsics.is_file():
        relative = file._replace(path=extrinsics, value=read_yaml(extrinsics)).at("left_SE3_right")
        pose = se3.se3(relative.at("R").numbers((3, 3)), relative.at("t_m").numbers((3,)))
        left_camera, right_camera = (_camera(info, keys)[0] for info in infos)
        return relative.stereo_rig("ros", left_camera, right_camera, se3.invert(pose))
    return rig_of_camera_infos(*infos, keys=[keys])


def ros_files(path: Path) -> tuple[Path, ...]:
    """The left and the right file of a pair, given one with left or right in its name; a file without the other alone."""
    for ours, theirs in (("left", "right"), ("right", "left")):
        other = path.with_name(path.name.replace(ours, theirs))
        if path.name.count(ours) == 1 and other.is_file():
            return (path, other) if ours == "left" else (other, path)
    return (path,)


def _named(path: Path, pair: Pair) -> tuple[Path, ...]:
    """Two files beside a file, by their names without suffix. Raises InputError."""
    files = {file.stem: file for file in sorted(path.parent.iterdir()) if file.suffix == path.suffix}
    return tuple(files[name] for name in choose_pair(path.parent, [*files], pair))


def _ost_cameras(file: Node) -> dict[str, Node]:
    """The cameras of an oST file by the last part of their names, with the size of its images; none of another file."""
    sections = {name: part for name, part in file.value.items() if isinstance(part, Mapping)}
    size = sections.get("image", {})
    return {
        name.rpartition("/")[2]: file._replace(value={**size, **part}, key=name)
        for name, part in sections.items()
        if any(key in part for key in _OST_PARTS)
    }


def rig_of_camera_infos(
    left_info: Node, right_info: Node, *, keys: Sequence[CameraInfoKeys] = (CameraInfoKeys(),)
) -> Rig:
    """Raw rig of two camera_info mappings. Raises InputError.

    keys: of both, or of each; by default those of YAML files.
    """
    left_keys, right_keys = keys[0], keys[-1]
    left, left_R, left_p = _camera(left_info, left_keys)
    right, right_R, right_p = _camera(right_info, right_keys)
    projection = right_info.at(right_keys.projection)
    if abs(left_p[0, 3]) > 1e-9:
        raise left_info.at(left_keys.projection).bad(
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


def _camera(info: Node, keys: CameraInfoKeys) -> tuple[Camera, Floats, Floats]:
    """Camera, its rectification matrix (3, 3) and its projection matrix (3, 4)."""
    size = info.both(keys.width, keys.height).size()
    distortion, model = info.at(keys.distortion), "plumb_bob"
    if keys.model is not None:
        stated = info.at(keys.model)
        if stated.value not in _MODELS:
            raise stated.bad(f"{shown(stated.value)} is not supported; known: {', '.join(_MODELS)}")
        model = stated.value
    elif distortion.numbers().size == 4:
        raise distortion.bad("are 4 numbers, of plumb_bob or of equidistant, which this file cannot say: use its YAML")
    camera = info.at(keys.matrix).camera(size, distortion.lens(fisheye=model == "equidistant"))
    return camera, info.at(keys.rectification).rotation(), info.at(keys.projection).numbers((3, 4))


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


# --------------------------------------------------------------------------- ORB-SLAM's settings


def read_orbslam_rig(file: Node, *, image_size: Size | None = None) -> Rig:
    """Raw or rectified rig, as the settings describe it; image_size: where they have none. Raises InputError."""
    if any(key.startswith(("LEFT.", "RIGHT.")) for key in file.value):
        left, right = (
            CameraInfoKeys(f"{side}.width", f"{side}.height", f"{side}.K", f"{side}.D", f"{side}.R", f"{side}.P", None)
            for side in ("LEFT", "RIGHT")
        )
        return rig_of_camera_infos(file, file, keys=[left, right])
    first = "Camera1" if "Camera1.fx" in file.value else "Camera"
    size = image_size or file.both("Camera.width", "Camera.height").size()
    if "Camera2.fx" in file.value:
        key = file.at("Tlr" if "Tlr" in file.value else "Stereo.T_c1_c2")
        values = key.numbers()
        if values.size not in (12, 16):
            raise key.bad(f"must be 3 x 4 or 4 x 4 numbers, found {values.size}")
        left_SE3_right = key._replace(value=[*values[:12], 0, 0, 0, 1]).motion()
        cameras = [_orbslam_camera(file, name, size) for name in (first, "Camera2")]
        return key.stereo_rig("orbslam", cameras[0], cameras[1], se3.invert(left_SE3_right))
    camera = _orbslam_camera(file, first, size)
    if camera.lens.model != "none":
        raise file.at(f"{first}.k1").bad(
            "and the other coefficients must be 0 in settings of rectified images; of raw ones LEFT.K, LEFT.D, LEFT.R, LEFT.P "
            "and RIGHT.*, or Camera2.* and Stereo.T_c1_c2 are missing"
        )
    key = file.at("Stereo.b" if "Stereo.b" in file.value else "Camera.bf")
    baseline = key.number() / (1.0 if key.key == "Stereo.b" else camera.fx_px)
    return key.stereo_rig("orbslam", camera, camera, se3.se3(np.eye(3), [-baseline, 0.0, 0.0]))


def _orbslam_camera(file: Node, name: str, size: Size) -> Camera:
    matrix = matrix_of(*(file.at(f"{name}.{key}").number() for key in ("fx", "fy", "cx", "cy")))
    kind = str(file.value.get("Camera.type", "PinHole"))
    names = ("k1", "k2", "k3", "k4") if kind == "KannalaBrandt8" else ("k1", "k2", "p1", "p2", "k3")
    values = file.value if kind == "KannalaBrandt8" else {f"{name}.{key}": 0.0 for key in names} | file.value
    given = file._replace(value=values)
    bent = file._replace(value=[given.at(f"{name}.{key}").number() for key in names], key=f"{name}.k1")
    lens = Lens() if kind == "Rectified" else bent.lens(fisheye=kind == "KannalaBrandt8")
    return file._replace(value=matrix, key=f"{name}.fx").camera(size, lens)
