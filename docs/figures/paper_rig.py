"""The rig of Lagahit & Tseng as records and as rendered images, for comparison with their figures.

From its Tables 1 and 2: focal lengths of the left and the right camera, the base, and all sigmas; Sony a6000 sensors of 23.5 x
15.6 mm with 6000 x 4000 pixels; a cone at 8.53 m ground distance. Assumed: angles of Table 2 in degrees, no correlations,
principal points in the middle of the sensors and parallel cameras (their values change the effect of the sigmas little).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.model.base import Matrix4
from conetl.model.rig import CalibrationCovariance, Camera, Rig
from conetl.simulation.scenario import Cone, World
from conetl.simulation.scene import build_scene, render

Array = NDArray[np.float64]

SENSOR_MM = (23.5, 15.6)
SIZE_PX = (6000, 4000)
#: Left, right; pixels are square.
FOCAL_MM = (15.9004, 15.8703)
BASELINE_M = 0.2745
GROUND_DISTANCE_M = 8.53
CAMERA_HEIGHT_M = 1.35
"""Assumed: a tripod."""
CONE_HEIGHT_M = 0.70
"""Assumed."""
_INTERIOR = ("fx_px", "fy_px", "cx_px", "cy_px")
_PARAMETERS = (
    *(f"{side}.{field}" for side in ("left", "right") for field in _INTERIOR),
    *(f"relative.r{axis}_rad" for axis in "xyz"),
    *(f"relative.t{axis}_m" for axis in "xyz"),
)
_PX_PER_MM = (SIZE_PX[0] / SENSOR_MM[0], SIZE_PX[1] / SENSOR_MM[1])
#: Sigmas of Table 1, left and right: focal length, x and y of the principal point (mm).
_FOCAL_SIGMA_MM = (0.0151, 0.0152)
_PRINCIPAL_SIGMA_MM = ((0.0187, 0.0161), (0.0200, 0.0165))
#: Of Table 2: omega, phi, kappa (degrees), X, Y, Z (mm).
_ANGLE_SIGMA_DEG = (0.0648, 0.0842, 0.0077)
_BASE_SIGMA_MM = (0.1296, 0.1064, 0.5825)


def _stated_sigmas() -> dict[str, float]:
    stated: dict[str, float] = {}
    for side, focal_mm, principal_mm in zip(("left", "right"), _FOCAL_SIGMA_MM, _PRINCIPAL_SIGMA_MM, strict=True):
        for axis, px_per_mm, centre_mm in zip("xy", _PX_PER_MM, principal_mm, strict=True):
            stated[f"{side}.f{axis}_px"] = focal_mm * px_per_mm
            stated[f"{side}.c{axis}_px"] = centre_mm * px_per_mm
    for axis, angle_deg, shift_mm in zip("xyz", _ANGLE_SIGMA_DEG, _BASE_SIGMA_MM, strict=True):
        stated[f"relative.r{axis}_rad"] = math.radians(angle_deg)
        stated[f"relative.t{axis}_m"] = shift_mm / 1000
    return stated


#: One sigma of each calibration parameter.
SIGMAS = _stated_sigmas()


@dataclass(frozen=True)
class RenderedPair:
    """Linear radiance (H, W, 3) of both cameras, cut out of the full images; the rig of the cut-outs is exact."""

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    rig: Rig
    foot_m: Array
    """(3,) truth, left camera frame."""
    object_height_m: float


def paper_rig(*, baseline_m: float = BASELINE_M, sigmas: dict[str, float] | None = None) -> Rig:
    """The rig, level, without a body; `sigmas` (default: `SIGMAS`) become its calibration covariance, uncorrelated."""
    stated = SIGMAS if sigmas is None else sigmas
    left, right = (
        Camera(
            width_px=SIZE_PX[0], height_px=SIZE_PX[1], fx_px=f_mm * _PX_PER_MM[0], fy_px=f_mm * _PX_PER_MM[1],
            cx_px=(SIZE_PX[0] - 1) / 2, cy_px=(SIZE_PX[1] - 1) / 2,
        )
        for f_mm in FOCAL_MM
    )  # fmt: skip
    matrix = np.diag(np.square(list(stated.values()))).tolist()
    return Rig(
        rig_id="a6000-pair", left=left, right=right, body_SE3_left=_shift(0.0), body_SE3_right=_shift(baseline_m),
        calibration_covariance=CalibrationCovariance(names=tuple(stated), matrix=tuple(tuple(row) for row in matrix)),
    )  # fmt: skip


def drawn_views(rig: Rig, rng: np.random.Generator, count: int) -> tuple[Array, Array, Array]:
    """`count` rigs that the calibration of `rig` could have meant, its parameters drawn from their covariance.

    Returns what `changed_views` returns. Raises ValueError without a covariance.
    """
    if rig.calibration_covariance is None:
        raise ValueError("drawn_views: the rig has no calibration covariance")
    values, vectors = np.linalg.eigh(np.array(rig.calibration_covariance.matrix))
    names = rig.calibration_covariance.names
    changes = rng.normal(size=(count, len(names))) * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return changed_views(rig, names, changes)


def changed_views(rig: Rig, names: Sequence[str], changes: Array) -> tuple[Array, Array, Array]:
    """The rig with parameters of its calibration changed, as `geometry.intersection.intersect` takes views; left camera's frame.

    changes (N, K), of the K named parameters. Returns k_px (N, 2, 4), left_R_camera (N, 2, 3, 3), centre_m (N, 2, 3). The
    relative orientation becomes (R exp(r), t + dt), see `CalibrationCovariance`. Raises ValueError for a name that is
    no parameter of a rectified rig.
    """
    unknown = [name for name in names if name not in _PARAMETERS]
    if unknown:
        raise ValueError(f"changed_views: no parameters of a rectified rig: {', '.join(unknown)}")
    count = len(changes)
    change = dict.fromkeys(_PARAMETERS, np.zeros(count)) | {name: changes[:, i] for i, name in enumerate(names)}
    k = np.zeros((count, 2, 4))
    for side, camera in enumerate((rig.left, rig.right)):
        for i, field in enumerate(_INTERIOR):
            k[:, side, i] = getattr(camera, field) + change[f"{('left', 'right')[side]}.{field}"]
    relative = np.linalg.inv(np.array(rig.body_SE3_left)) @ np.array(rig.body_SE3_right)
    rotation, centre = np.tile(np.eye(3), (count, 2, 1, 1)), np.zeros((count, 2, 3))
    turn = np.column_stack([change[f"relative.r{axis}_rad"] for axis in "xyz"])
    rotation[:, 1] = relative[:3, :3] @ Rotation.from_rotvec(turn).as_matrix()
    centre[:, 1] = relative[:3, 3] + np.column_stack([change[f"relative.t{axis}_m"] for axis in "xyz"])
    return k, rotation, centre


def render_pair(
    *,
    ground_distance_m: float = GROUND_DISTANCE_M,
    side_m: float = 0.2,
    baseline_m: float = BASELINE_M,
    cone_yaw_rad: float = 0.3,
    sun_azimuth_deg: float = 118.0,
    margin_px: int = 60,
    samples_per_pixel: int = 16,
    seed: int = 0,
) -> RenderedPair:
    """One cone on the road at a ground distance from the left camera, side_m to the right of its axis; both images cut to it.

    Both cameras have the focal length of the left one, as after rectification. The window holds the cone in both images with
    `margin_px` around it. Raises InputError where Mitsuba is missing.
    """
    full = paper_rig(baseline_m=baseline_m)
    ahead = math.sqrt(ground_distance_m**2 - side_m**2)
    foot = np.array([side_m, CAMERA_HEIGHT_M, ahead])
    fx, fy, cx, cy = full.left.fx_px, full.left.fy_px, full.left.cx_px, full.left.cy_px
    half = 0.75 * (0.03 + 0.5 * CONE_HEIGHT_M)  # half the plate's diagonal and a little
    u0 = math.floor(cx + fx * (side_m - half - baseline_m) / (ahead - half)) - margin_px
    u1 = math.ceil(cx + fx * (side_m + half) / (ahead - half)) + margin_px
    v0 = math.floor(cy + fy * (CAMERA_HEIGHT_M - CONE_HEIGHT_M) / (ahead + half)) - margin_px
    v1 = math.ceil(cy + fy * CAMERA_HEIGHT_M / (ahead - half)) + margin_px
    width, height = u1 - u0, v1 - v0
    cut = full.left.model_copy(update={"width_px": width, "height_px": height, "cx_px": cx - u0, "cy_px": cy - v0})
    # The renderer has square pixels; rows are resampled to the rig's, which are 0.2 % taller.
    spare = math.ceil(0.003 * SIZE_PX[1]) + 2
    height_px, cx_px, cy_px = height + 2 * spare, cx - u0, (cy - v0) + spare
    square = Camera(width_px=width, height_px=height_px, fx_px=fx, fy_px=fx, cx_px=cx_px, cy_px=cy_px)
    scale = fx / fy
    rows = np.array([[1.0, 0.0, 0.0], [0.0, scale, square.cy_px - scale * cut.cy_px]])
    world = World(
        cones=(Cone("T", ahead, -side_m, CONE_HEIGHT_M, yaw_rad=cone_yaw_rad),), objects=(), sun_elevation_deg=34.0,
        sun_azimuth_deg=sun_azimuth_deg, turbidity=2.6, texture_seed=17,
    )  # fmt: skip
    scene = build_scene(world)
    images = []
    for number, base in enumerate((0.0, baseline_m)):
        road_SE3_camera = np.eye(4)
        road_SE3_camera[:3, :3] = [
            [0, 0, 1],
            [-1, 0, 0],
            [0, -1, 0],
        ]  # x right, y down, z ahead on x ahead, y left, z up
        road_SE3_camera[:3, 3] = (0.0, -base, CAMERA_HEIGHT_M)
        radiance = render(scene, square, road_SE3_camera, samples_per_pixel=samples_per_pixel, seed=2 * seed + number)
        images.append(
            cv2.warpAffine(radiance, rows, (width, height), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP).astype(
                np.float32
            )
        )
    rig = full.model_copy(update={"left": cut, "right": cut, "calibration_covariance": None})
    return RenderedPair(images[0], images[1], rig, foot, CONE_HEIGHT_M)


def _shift(x_m: float) -> Matrix4:
    return ((1.0, 0.0, 0.0, x_m), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
