"""The simulated stereo rig: the numbers of KITTI's calibration files, and the resulting poses of the cameras on the body.

The chain is KITTI's (Geiger et al., IJRR 2013): IMU -> velodyne -> camera 0 -> rectified camera 0 -> P_rect_0i = K [I | t_i].
It is computed here independently of the code that reads calibration files, so that one checks the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry.pose import se3
from conetl.simulation.scene import PinholeCamera

Array = NDArray[np.float64]

F_PX, CX_PX, CY_PX = 640.0, 478.35, 146.20
"""For images of 960 x 320."""
DESIGN_SIZE = (960, 320)
CAMERA_HEIGHT_M = 1.65
BASELINE_M = 0.5402


@dataclass(frozen=True)
class SimulatedRig:
    """Two rectified cameras on an IMU; (4, 4) matrices, metres."""

    camera: PinholeCamera
    velo_SE3_imu: Array
    cam0_SE3_velo: Array
    rect_R_cam0: Array
    """(3, 3) R_rect_00"""
    t_rect_m: dict[int, Array]
    """Camera number -> (3,) t of P_rect = K [I | t]."""

    def body_SE3_camera(self, number: int) -> Array:
        """(4, 4) pose of rectified camera `number` on the IMU."""
        cami_SE3_rect, rect_SE3_cam0 = se3(np.eye(3), self.t_rect_m[number]), se3(self.rect_R_cam0, np.zeros(3))
        return np.asarray(np.linalg.inv(cami_SE3_rect @ rect_SE3_cam0 @ self.cam0_SE3_velo @ self.velo_SE3_imu))

    @property
    def imu_height_m(self) -> float:
        """Height of the IMU for the left camera's height above the road."""
        return CAMERA_HEIGHT_M - float(self.body_SE3_camera(2)[2, 3])

    def k(self) -> Array:
        """(3, 3) interior orientation, the same for all four cameras."""
        c = self.camera
        return np.array([[c.f_px, 0.0, c.cx_px], [0.0, c.f_px, c.cy_px], [0.0, 0.0, 1.0]])


def simulated_rig(width_px: int = DESIGN_SIZE[0], height_px: int = DESIGN_SIZE[1]) -> SimulatedRig:
    """The rig, with the field of view of the 960-pixel image at any width; other aspect ratios add or remove rows evenly."""
    scale = width_px / DESIGN_SIZE[0]
    camera = PinholeCamera(
        width_px, height_px, F_PX * scale, (CX_PX + 0.5) * scale - 0.5,
        (CY_PX + 0.5 - DESIGN_SIZE[1] / 2) * scale + height_px / 2 - 0.5,
    )  # fmt: skip
    axes = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # x forward, y left -> x right, y down
    return SimulatedRig(
        camera=camera,
        velo_SE3_imu=se3(_degrees(0.31, -0.17, 0.22), (-0.7914, 0.3308, -0.8126)),
        cam0_SE3_velo=se3(_degrees(1.45, -0.24, 0.13) @ axes, (0.0123, -0.0694, -0.2871)),
        rect_R_cam0=_degrees(0.28, 0.41, -0.35),
        t_rect_m={
            0: np.zeros(3), 1: np.array([-0.5374, 0.0, 0.0]),
            2: np.array([0.0598, -0.0011, 0.0028]), 3: np.array([0.0598 - BASELINE_M, -0.0011, 0.0028]),
        },
    )  # fmt: skip


def _degrees(x: float, y: float, z: float) -> Array:
    return np.asarray(Rotation.from_euler("xyz", [math.radians(a) for a in (x, y, z)]).as_matrix())
