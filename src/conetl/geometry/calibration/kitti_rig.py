"""From the numbers of KITTI's calibration files to a `Rig`.

KITTI (Geiger et al., IJRR 2013): `x_velo = velo_SE3_imu x_imu` (calib_imu_to_velo), `x_cam0 = cam0_SE3_velo x_velo`
(calib_velo_to_cam), `x_rect = R_rect_00 x_cam0` and `P_rect_0i = K_i [I | t_i]` in the rectified frame of camera 0. Camera i
therefore sits at `-t_i` with `t_i = K_i^-1 p4`, all three components: in P_rect_02 and P_rect_03 ty and tz are not zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry.rectification import check_stereo_baseline
from conetl.model.records import Camera, Lens, Rig

Array = NDArray[np.float64]

#: A rectified pair whose baseline points away from the image rows by more than this (as a share) is refused.
MAX_BASELINE_SLOPE = 0.1


def kitti_rig(
    cam_to_cam: Mapping[str, Array],
    *,
    raw: bool,
    velo_to_cam: Mapping[str, Array] | None,
    imu_to_velo: Mapping[str, Array] | None,
    left: int,
    right: int,
    rig_id: str,
    sigma_px: float,
) -> Rig:
    """Rig of two KITTI cameras: the rectified ones, or those that took the images ("synced only") with their lenses.

    The arrays are flat, as in the files. cam_to_cam needs `S_rect_0i` (2), `P_rect_0i` (12) of both cameras and `R_rect_00` (9);
    if raw `S_0i` (2), `K_0i` (9), `D_0i` (5), `R_0i` (9), `T_0i` (3) of both: `x_cam_i = R_0i x_cam0 + T_0i`. The other two need
    `R` (9) and `T` (3), metres. With both of them the body is the IMU (x forward, y left, z up); without, it is the left camera.
    Raises ValueError, naming the key, for an invalid matrix.
    """
    # Poses in the rectified frame of camera 0, or in camera 0.
    read = _raw_camera if raw else _rectified_camera
    (left_camera, base_SE3_left), (right_camera, base_SE3_right) = (read(cam_to_cam, n) for n in (left, right))
    left_SE3_right = se3.compose(se3.invert(base_SE3_left), base_SE3_right)
    try:
        check_stereo_baseline(left_SE3_right)
    except ValueError as error:
        raise ValueError(f"T_{left:02d}, T_{right:02d}: {error}" if raw else str(error)) from error
    x, y, z = left_SE3_right[:3, 3]
    if not raw and np.hypot(y, z) > MAX_BASELINE_SLOPE * x:
        raise ValueError(
            f"the baseline ({x:.3f}, {y:.3f}, {z:.3f}) m does not follow the image rows of a rectified pair"
        )
    body_SE3_base = se3.invert(base_SE3_left)
    if velo_to_cam is not None and imu_to_velo is not None:
        base_R_cam0 = np.eye(3) if raw else _rotation(cam_to_cam["R_rect_00"], "R_rect_00")
        cam0_SE3_body = se3.compose(_rigid(velo_to_cam, "calib_velo_to_cam"), _rigid(imu_to_velo, "calib_imu_to_velo"))
        body_SE3_base = se3.invert(se3.compose(se3.se3(base_R_cam0, np.zeros(3)), cam0_SE3_body))
    return Rig(
        rig_id=rig_id, left=left_camera, right=right_camera, sigma_px=sigma_px,
        body_SE3_left=se3.to_matrix4(se3.compose(body_SE3_base, base_SE3_left)),
        body_SE3_right=se3.to_matrix4(se3.compose(body_SE3_base, base_SE3_right)),
    )  # fmt: skip


def _rectified_camera(cam_to_cam: Mapping[str, Array], number: int) -> tuple[Camera, Array]:
    """A rectified camera and its pose (4, 4) in the rectified frame of camera 0."""
    key = f"P_rect_{number:02d}"
    p = np.asarray(cam_to_cam[key], dtype=np.float64).reshape(3, 4)
    camera = _camera(key, p[:, :3], cam_to_cam, f"S_rect_{number:02d}", Lens())
    return camera, se3.se3(np.eye(3), -np.linalg.solve(p[:, :3], p[:, 3]))


def _raw_camera(cam_to_cam: Mapping[str, Array], number: int) -> tuple[Camera, Array]:
    """A camera that took the images and its pose (4, 4) in camera 0."""
    key = f"K_{number:02d}"
    d = [float(c) for c in cam_to_cam[f"D_{number:02d}"]]
    lens = Lens(model="brown", coefficients=tuple(d)) if any(d) else Lens()
    camera = _camera(key, np.reshape(cam_to_cam[key], (3, 3)), cam_to_cam, f"S_{number:02d}", lens)
    camera_R_cam0 = _rotation(cam_to_cam[f"R_{number:02d}"], f"R_{number:02d}")
    return camera, se3.invert(se3.se3(camera_R_cam0, cam_to_cam[f"T_{number:02d}"]))


def _camera(key: str, k: Array, cam_to_cam: Mapping[str, Array], size_key: str, lens: Lens) -> Camera:
    """Camera of a matrix K (3, 3) and an image size, with the keys that they stand under."""
    if not (np.allclose(k[2], [0.0, 0.0, 1.0]) and abs(k[0, 1]) < 1e-6 and abs(k[1, 0]) < 1e-6):
        raise ValueError(f"{key}: the left 3x3 block must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    if k[0, 0] <= 0 or k[1, 1] <= 0:
        raise ValueError(f"{key}: focal lengths must be positive, found {k[0, 0]:g} and {k[1, 1]:g}")
    size = np.asarray(cam_to_cam[size_key], dtype=np.float64)
    if not np.all((size >= 1) & (size == np.round(size))):
        raise ValueError(f"{size_key}: width and height must be whole numbers of pixels, found {size}")
    fx, fy, cx, cy = (float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(
        width_px=int(size[0]), height_px=int(size[1]), fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, lens=lens
    )  # fmt: skip


def _rotation(values: Array, key: str) -> Array:
    try:
        return se3.nearest_rotation(np.asarray(values, dtype=np.float64).reshape(3, 3))
    except ValueError as error:
        raise ValueError(f"{key}: {error}") from error


def _rigid(values: Mapping[str, Array], name: str) -> Array:
    return se3.se3(_rotation(values["R"], f"R of {name}"), np.asarray(values["T"], dtype=np.float64))
