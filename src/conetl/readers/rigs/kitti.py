"""KITTI's three calibration text files (Geiger et al., IJRR 2013): the rectified pair, or its raw one.

`x_velo = velo_SE3_imu x_imu` (calib_imu_to_velo), `x_cam0 = cam0_SE3_velo x_velo` (calib_velo_to_cam), `x_rect = R_rect_00
x_cam0` and `P_rect_0i = K_i [I | t_i]` in the rectified frame of camera 0. Camera i therefore sits at `-t_i` with `t_i = K_i^-1
p4`, all three components: in P_rect_02 and P_rect_03 ty and tz are not zero. For the raw pair `x_cam_i = R_0i x_cam0 + T_0i`.
"""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from conetl.files.documents import input_errors
from conetl.geometry import pose as se3
from conetl.geometry.rectification import check_stereo_baseline
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import Camera, Rig
from conetl.readers.rigs.common import Node, Pair, Size, rectified_rig
from conetl.readers.rigs.content import read_content
from conetl.readers.rigs.rectified import camera_of_projection

CAM_TO_CAM = "calib_cam_to_cam.txt"
VELO_TO_CAM = "calib_velo_to_cam.txt"
IMU_TO_VELO = "calib_imu_to_velo.txt"
#: A rectified pair whose baseline points away from the image rows by more than this (as a share) is refused.
_MAX_BASELINE_SLOPE = 0.1


def read_kitti_rig(
    cam_to_cam: Path,
    *,
    left: int = 2,
    right: int = 3,
    body_required: bool = False,
    images: Literal["raw"] | Size | None = None,
    rig_id: str | None = None,
    sigma_px: float = 0.5,
    unit_m: float = 1.0,
) -> Rig:
    """Rig of two KITTI cameras from `calib_cam_to_cam.txt` and the two files beside it; without them the body is the left camera.

    body_required: reject the calibration if the chain from the IMU is missing. images: None for the rectified pair of P_rect_0i,
    "raw" for the cameras that took the images ("synced only": S_0i, K_0i, D_0i, R_0i, T_0i), lenses included; or width and
    height of the left images, which decide: raw ones have the size S_0i and give a rectified rig with `rectified_from`; those of
    another size, or where both sizes are equal, are taken for rectified ones.
    rig_id: default "kitti-" and the start of a hash over the numbers. unit_m: of all lengths. Raises InputError.
    """
    if isinstance(images, tuple):
        read = partial(
            read_kitti_rig, cam_to_cam, left=left, right=right, body_required=body_required, rig_id=rig_id, sigma_px=sigma_px
        )  # fmt: skip
        own, key = read(), f"S_{left:02d}"
        raw_size = Node(cam_to_cam, read_content(cam_to_cam, of_lines=True)).get(key)
        is_own = images == (own.left.width_px, own.left.height_px)
        if is_own or raw_size.value is None or [*images] != raw_size.numbers((2,)).tolist():
            return own
        return rectified_rig(read(images="raw"), cam_to_cam)
    raw = images == "raw"
    own_keys = {"S": 2, "K": 9, "D": 5, "R": 9, "T": 3} if raw else {"S_rect": 2, "P_rect": 12}
    keys = {f"{key}_{number:02d}": count for number in (left, right) for key, count in own_keys.items()}
    cameras = read_numbers(cam_to_cam, keys if raw else {"R_rect_00": 9} | keys)
    chain = [cam_to_cam.parent / name for name in (VELO_TO_CAM, IMU_TO_VELO)]
    absent = [path.name for path in chain if not path.is_file()]
    if absent and (body_required or len(absent) == 1):
        raise InputError(
            f"{cam_to_cam.parent}: {' and '.join(absent)} missing. Poses are those of the IMU, so the chain IMU -> velodyne -> "
            "camera is needed; KITTI delivers all three calib_*.txt files together; put them into the same folder"
        )
    links = [] if absent else [read_numbers(path, {"R": 9, "T": 3}) for path in chain]
    for link in links:
        link["T"] *= unit_m
    if rig_id is None:
        digest = hashlib.sha256()
        for part in (cameras, *links):
            for key in sorted(part):
                digest.update(key.encode() + part[key].tobytes())
        rig_id = f"kitti-{'raw-' if raw else ''}{left:02d}-{right:02d}-{digest.hexdigest()[:8]}"
    # Poses in camera 0, or in its rectified frame.
    read_camera = _raw_camera if raw else _rectified_camera
    (left_camera, base_SE3_left), (right_camera, base_SE3_right) = (
        read_camera(cam_to_cam, cameras, number) for number in (left, right)
    )
    for pose in (base_SE3_left, base_SE3_right):
        pose[:3, 3] *= unit_m
    x, y, z = (left_SE3_right := se3.compose(se3.invert(base_SE3_left), base_SE3_right))[:3, 3]
    with input_errors(f"{cam_to_cam}: T_{left:02d}, T_{right:02d}" if raw else cam_to_cam):
        check_stereo_baseline(left_SE3_right)
        if not raw and np.hypot(y, z) > _MAX_BASELINE_SLOPE * x:
            raise ValueError(
                f"the baseline ({x:.3f}, {y:.3f}, {z:.3f}) m does not follow the image rows of a rectified pair"
            )
    body_SE3_base = se3.invert(base_SE3_left)
    if links:
        base_R_cam0 = np.eye(3) if raw else Node(cam_to_cam, cameras["R_rect_00"], "R_rect_00").rotation()
        cam0_SE3_velo, velo_SE3_body = (motion_of(path, link) for path, link in zip(chain, links, strict=True))
        cam0_SE3_body = se3.compose(cam0_SE3_velo, velo_SE3_body)
        body_SE3_base = se3.invert(se3.compose(se3.se3(base_R_cam0, np.zeros(3)), cam0_SE3_body))
    with input_errors(cam_to_cam):
        return Rig(
            rig_id=rig_id, left=left_camera, right=right_camera, sigma_px=sigma_px,
            body_SE3_left=se3.to_matrix4(se3.compose(body_SE3_base, base_SE3_left)),
            body_SE3_right=se3.to_matrix4(se3.compose(body_SE3_base, base_SE3_right)),
        )  # fmt: skip


def _rectified_camera(path: Path, cameras: dict[str, Floats], number: int) -> tuple[Camera, Floats]:
    """A rectified camera and its pose (4, 4) in the rectified frame of camera 0."""
    key, size = f"P_rect_{number:02d}", f"S_rect_{number:02d}"
    return camera_of_projection(Node(path, cameras[key], key), Node(path, cameras[size], size).size())


def _raw_camera(path: Path, cameras: dict[str, Floats], number: int) -> tuple[Camera, Floats]:
    """A camera that took the images and its pose (4, 4) in camera 0."""
    s, k, d, r, t = (f"{key}_{number:02d}" for key in "SKDRT")
    camera = Node(path, cameras[k], k).camera(Node(path, cameras[s], s).size(), Node(path, cameras[d], d).lens())
    return camera, se3.invert(se3.se3(Node(path, cameras[r], r).rotation(), cameras[t]))


def motion_of(path: Path, link: dict[str, Floats]) -> Floats:
    """The motion (4, 4) of R (9) and T (3) of a file. Raises InputError."""
    return se3.se3(Node(path, link["R"], "R").rotation(), link["T"])


def read_named_kitti_rig(file: Node, *, pair: Pair | None = None, images: Size | None = None) -> Rig:
    """Rig of the calibration that a file belongs to, of the pair that images are usually of; pair: names with their numbers.

    The data set KITTI-360 has the cameras 00 and 01 only. Raises InputError.
    """
    left, right = (0, 1) if {"P_rect_00", "P_rect_02"} & file.value.keys() == {"P_rect_00"} else (2, 3)
    if pair is not None:
        left, right = (int(name[-1:]) if name[-1:].isdecimal() else 9 for name in pair)
    return read_kitti_rig(file.path, left=left, right=right, images=images, unit_m=file.unit_m())


def kitti_files(path: Path) -> tuple[Path, ...]:
    """The file with the cameras, and those beside it."""
    files = [path.with_name(name) for name in (CAM_TO_CAM, VELO_TO_CAM, IMU_TO_VELO)]
    return tuple(files) if path in files and files[0].is_file() else (path,)


def read_numbers(path: Path, wanted: dict[str, int]) -> dict[str, Floats]:
    """The wanted keys of a file as flat arrays, given their counts of numbers. Raises InputError."""
    file = Node(path, read_content(path, of_lines=True))
    return {key: file.at(key).numbers((count,)) for key, count in wanted.items()}
