"""Images of one cone in front of a wall, by ray casting: small enough for tests, with the true disparity of the axis."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.model.drive import Detection
from conetl.model.rig import Camera

F_PX, BASE_M, SIZE = 700.0, 0.54, (110, 180)
_FINE = 3
_CAMERA_HEIGHT_M, _WALL_M = 1.2, 30.0
#: Body of a 70 cm cone: radius at the foot and at the tip.
FOOT_RADIUS_M, TIP_RADIUS_M, HEIGHT_M, PLATE_M = 0.14, 0.035, 0.70, 0.38


class ConePair(NamedTuple):
    """Left and right image (H, W, 3), the left detection and what is true."""

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    detection: Detection
    disparity_px: float
    camera: Camera
    """The left one."""


def cone_pair(range_m: float, seed: int, *, noise: float = 2.0, post: bool = False, flat: bool = False) -> ConePair:
    """One cone at a depth, seen by a level stereo pair (baseline to the right). post: something else stands before it.

    flat: no texture, nothing but one grey.
    """
    rng = np.random.default_rng(seed)
    aside = float(rng.uniform(-0.3, 0.3)) + BASE_M / 2
    skin = rng.uniform(0.6, 1.0, (64, 64))
    wall = cv2.GaussianBlur(rng.uniform(0, 1, (400, 2400)), (0, 0), 4)
    wall = (wall - wall.min()) / np.ptp(wall)
    cx = SIZE[1] / 2 + F_PX * (BASE_M / 2) / range_m - F_PX * BASE_M / 2 / range_m
    cy = 50.0 - F_PX * (_CAMERA_HEIGHT_M - HEIGHT_M / 2) / range_m
    images = []
    for camera_x in (0.0, BASE_M):
        fine = _render(range_m, aside - camera_x, camera_x, cx, cy, skin, wall, post)
        image = cv2.resize(cv2.GaussianBlur(fine, (0, 0), 0.45 * _FINE), SIZE[::-1], interpolation=cv2.INTER_AREA)
        if flat:
            image = np.full_like(image, 90.0)
        images.append(np.clip(image + rng.normal(0, 0 if flat else noise, image.shape), 0, 255).astype(np.uint8))
    foot_u, foot_v = cx + F_PX * aside / range_m, cy + F_PX * _CAMERA_HEIGHT_M / range_m
    tip_v = cy + F_PX * (_CAMERA_HEIGHT_M - HEIGHT_M) / range_m
    width = F_PX * PLATE_M / range_m
    jitter = rng.normal(0, 0.02 * width, 3)
    detection = Detection(
        frame_index=0, side="left", detection_index=0, x_px=foot_u + 0.5 - width / 2 + jitter[0], y_px=tip_v,
        w_px=width * (1 + 0.05 * rng.normal()), h_px=foot_v - tip_v + 0.1 * width, score=0.9,
        foot_px=(foot_u + 0.5 + jitter[1], foot_v + 0.5), tip_px=(foot_u + 0.5 + jitter[2], tip_v + 0.5),
    )  # fmt: skip
    camera = Camera(width_px=SIZE[1], height_px=SIZE[0], fx_px=F_PX, fy_px=F_PX, cx_px=cx, cy_px=cy)
    return ConePair(images[0], images[1], detection, F_PX * BASE_M / range_m, camera)


def _render(
    range_m: float, x0: float, camera_x: float, cx: float, cy: float,
    skin: NDArray[np.float64], wall: NDArray[np.float64], post: bool,
) -> NDArray[np.float64]:  # fmt: skip
    """Grey values (H * fine, W * fine, 3) as one camera sees them; x0: of the cone's axis in that camera."""
    v, u = np.mgrid[0 : SIZE[0] * _FINE, 0 : SIZE[1] * _FINE]
    x, y = ((u + 0.5) / _FINE - 0.5 - cx) / F_PX, ((v + 0.5) / _FINE - 0.5 - cy) / F_PX
    # |(x z - x0, z - z0)| = r(y z), r linear in height above the foot: a quadratic in z
    slope = (FOOT_RADIUS_M - TIP_RADIUS_M) / HEIGHT_M
    r0, r1 = FOOT_RADIUS_M - slope * _CAMERA_HEIGHT_M, slope * y
    a, b, c = x**2 + 1 - r1**2, -2 * (x * x0 + range_m) - 2 * r0 * r1, x0**2 + range_m**2 - r0**2
    root = b**2 - 4 * a * c
    z = (-b - np.sqrt(np.maximum(root, 0))) / (2 * a)
    height = _CAMERA_HEIGHT_M - y * z
    hit = (root > 0) & (height > 0) & (height < HEIGHT_M)
    angle = np.arctan2(x * z - x0, range_m - z)
    texture = skin[(height / HEIGHT_M * 63).astype(int) % 64, ((angle + np.pi) * 10).astype(int) % 64]
    shade = (0.8 + 0.2 * np.cos(angle - 0.6)) * (0.9 + 0.1 * texture)
    white = ((height * 6).astype(int) % 2)[..., None] == 1
    cone = shade[..., None] * np.where(white, [200.0, 205.0, 210.0], [40.0, 90.0, 220.0])
    column = np.clip(((x * _WALL_M + camera_x) * 60 + 1200).astype(int), 0, wall.shape[1] - 1)
    row = np.clip((y * _WALL_M * 60 + 100).astype(int), 0, wall.shape[0] - 1)
    image = np.where(hit[..., None], cone, (60 + 90 * wall[row, column])[..., None])
    if post:  # half a metre in front, over the right half of the cone
        near = range_m - 1.5
        before = np.abs(x * near - (x0 + 0.09)) < 0.07
        image[before] = 30.0
    return np.asarray(image)
