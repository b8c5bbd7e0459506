"""True trajectory of the vehicle, the cameras on it, and the OXTS records of its GNSS/INS with drift and noise.

Map frame: easting, northing, ellipsoidal height of EPSG:32632, as one rigid Cartesian frame around the site. OXTS yaw counts
from TRUE east, the map's axes are grid axes: yaw_true = yaw_grid - convergence (clockwise positive).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from conetl.geometry.geodesy import CAMERA_R_BODY, grid_convergence_rad
from conetl.geometry.pose import se3
from conetl.model.arrays import Floats
from conetl.simulation.scenario import ScenarioPass

MAP_SRID = 32632
SITE_MAP_M = (458_312.40, 5_427_846.75, 115.32)
"""Origin of the road frame, near 49.0 N, 8.43 E."""
SITE_GRID_YAW_RAD = math.radians(32.4)
SITE_SLOPE_RAD = -0.006
"""The road climbs by 6 mm per metre."""
FRAME_PERIOD_S = 0.1
POS_ACCURACY_M = 0.02
"""In the records, rounded up as receivers do; `stated_sigmas` has the true ones."""
GRAVITY_M_S2 = 9.81
CAMERA_HEIGHT_M = 1.65
BASELINE_M = 0.5402


def _rotation_deg(x: float, y: float, z: float) -> Floats:
    return np.asarray(Rotation.from_euler("xyz", [math.radians(a) for a in (x, y, z)]).as_matrix())


#: IMU -> velodyne -> camera 0 (from axes x forward, y left to x right, y down) -> R_rect_00.
VELO_SE3_IMU = se3(_rotation_deg(0.31, -0.17, 0.22), (-0.7914, 0.3308, -0.8126))
CAM0_SE3_VELO = se3(_rotation_deg(1.45, -0.24, 0.13) @ CAMERA_R_BODY, (0.0123, -0.0694, -0.2871))
RECT_R_CAM0 = _rotation_deg(0.28, 0.41, -0.35)
#: Camera number -> (3,) t of P_rect = K [I | t].
T_RECT_M = {
    0: np.zeros(3), 1: np.array([-0.5374, 0.0, 0.0]), 2: np.array([0.0598, -0.0011, 0.0028]),
    3: np.array([0.0598 - BASELINE_M, -0.0011, 0.0028]),
}  # fmt: skip


def body_SE3_camera(number: int) -> Floats:
    """(4, 4) pose of rectified camera `number` on the IMU."""
    cami_SE3_rect, rect_SE3_cam0 = se3(np.eye(3), T_RECT_M[number]), se3(RECT_R_CAM0, np.zeros(3))
    return np.asarray(np.linalg.inv(cami_SE3_rect @ rect_SE3_cam0 @ CAM0_SE3_VELO @ VELO_SE3_IMU))


class DriftModel(NamedTuple):
    """First-order Gauss-Markov drift and white noise, one sigma."""

    drift: float
    correlation_s: float
    white: float

    @property
    def sigma(self) -> float:
        """Sigma of one value."""
        return math.hypot(self.drift, self.white)


HORIZONTAL_M = DriftModel(0.015, 20.0, 0.003)
VERTICAL_M = DriftModel(0.020, 20.0, 0.003)
ATTITUDE_RAD = DriftModel(math.radians(0.02), 20.0, math.radians(0.002))


def map_SE3_road() -> Floats:
    """(4, 4) pose of the road frame in the map."""
    return se3(Rotation.from_euler("ZY", [SITE_GRID_YAW_RAD, SITE_SLOPE_RAD]).as_matrix(), SITE_MAP_M)


def true_poses(scenario: ScenarioPass, times_s: Floats) -> Floats:
    """(N, 4, 4) map_SE3_body at times from the start of the drive, of a slightly swaying vehicle."""
    camera_ahead_m, _, above_imu_m = body_SE3_camera(2)[:3, 3].tolist()
    duration_s = (scenario.frame_count - 1) * FRAME_PERIOD_S
    poses = np.zeros((len(times_s), 4, 4))
    direction = math.copysign(1.0, scenario.end_x_m - scenario.start_x_m)
    for n, t in enumerate(times_s):
        share = t / duration_s
        share += 0.012 * math.sin(2 * math.pi * share)  # not quite constant speed
        x = scenario.start_x_m + (scenario.end_x_m - scenario.start_x_m) * share - direction * camera_ahead_m
        y, slope = _path(scenario, x)
        heading = math.atan2(direction * slope, direction) + math.radians(0.25) * math.sin(1.7 * t + 0.4)
        pitch = math.radians(0.22) * math.sin(5.3 * t + 1.0)
        roll = math.radians(0.30) * math.sin(3.1 * t + 2.0)
        z = CAMERA_HEIGHT_M - above_imu_m + 0.008 * math.sin(6.1 * t)
        poses[n] = se3(Rotation.from_euler("ZYX", [heading, pitch, roll]).as_matrix(), (x, y, z))
    return np.asarray(map_SE3_road() @ poses)


def _path(scenario: ScenarioPass, x_m: float) -> tuple[float, float]:
    """y of the vehicle's path and its slope dy/dx: a smooth change of lane position along the taper."""
    y0, y1 = scenario.path_y_m
    start, end = -5.0, 35.0
    s = min(max((x_m - start) / (end - start), 0.0), 1.0)
    return y0 + (y1 - y0) * s * s * (3 - 2 * s), (y1 - y0) * 6 * s * (1 - s) / (end - start)


def measured_poses(poses: Floats, times_s: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """(N, 3) positions in the map and (N, 3) roll, pitch, grid yaw of the GNSS/INS."""
    errors = np.stack([gauss_markov(m, times_s, rng) for m in (HORIZONTAL_M, HORIZONTAL_M, VERTICAL_M)], axis=1)
    turns = np.stack([gauss_markov(ATTITUDE_RAD, times_s, rng) for _ in range(3)], axis=1)
    ypr = Rotation.from_matrix(poses[:, :3, :3]).as_euler("ZYX")
    return poses[:, :3, 3] + errors, ypr[:, ::-1] + turns


def stated_sigmas() -> dict[str, float]:
    """`sigmas` of drive.yaml: standard deviations of what `measured_poses` adds, metres and degrees."""
    position = {"horizontal_m": HORIZONTAL_M.sigma, "vertical_m": VERTICAL_M.sigma}
    attitude = dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), math.degrees(ATTITUDE_RAD.sigma))
    return {name: round(value, 5) for name, value in (position | attitude).items()}


def gauss_markov(model: DriftModel, times_s: Floats, rng: np.random.Generator) -> Floats:
    """(N,) exponentially correlated noise (Maybeck, Stochastic Models, 1979, 4.11) plus white noise."""
    drift = np.zeros(len(times_s))
    drift[0] = rng.normal(0.0, model.drift)
    for n in range(1, len(times_s)):
        keep = math.exp(-(times_s[n] - times_s[n - 1]) / model.correlation_s)
        drift[n] = keep * drift[n - 1] + rng.normal(0.0, model.drift * math.sqrt(1.0 - keep * keep))
    return drift + rng.normal(0.0, model.white, len(times_s))


def oxts_records(positions_m: Floats, rpy_grid_rad: Floats, times_s: Floats) -> list[list[float]]:
    """KITTI's 30 numbers per pose; lat/lon in degrees, yaw from true east, velocities and rates by differences."""
    lon, lat = Transformer.from_crs(MAP_SRID, 4326, always_xy=True).transform(positions_m[:, 0], positions_m[:, 1])
    convergence = grid_convergence_rad(MAP_SRID, lat, lon)
    rpy = rpy_grid_rad.copy()
    rpy[:, 2] = (rpy[:, 2] - convergence + np.pi) % (2 * np.pi) - np.pi
    smooth = np.column_stack([_smooth(column, times_s) for column in positions_m.T])
    velocity = np.gradient(smooth, times_s, axis=0)
    cos, sin = np.cos(convergence), np.sin(convergence)  # grid to true: rotate by minus the convergence
    east, north = cos * velocity[:, 0] + sin * velocity[:, 1], cos * velocity[:, 1] - sin * velocity[:, 0]
    turns = Rotation.from_euler("ZYX", rpy[:, ::-1])
    enu = np.column_stack([east, north, velocity[:, 2]])
    body_velocity = turns.inv().apply(enu)
    force = np.gradient(enu, times_s, axis=0) + np.array([0.0, 0.0, GRAVITY_M_S2])
    body_force = turns.inv().apply(force)
    unwrapped = np.unwrap(rpy, axis=0)
    rates = np.gradient(np.column_stack([_smooth(column, times_s) for column in unwrapped.T]), times_s, axis=0)
    quality = np.tile([POS_ACCURACY_M, 0.03, 4, 14, 6, 6, 6], (len(lat), 1))
    records: list[list[float]] = np.column_stack([
        lat, lon, positions_m[:, 2], rpy, north, east, body_velocity[:, :2], velocity[:, 2], body_force, body_force, rates, rates,
        quality,
    ]).tolist()  # fmt: skip
    return records


def _smooth(values: Floats, times_s: Floats) -> Floats:
    """A polynomial fit of noisy values, for their derivatives."""
    centred = times_s - times_s.mean()
    degree = min(6, len(values) - 1)
    return np.asarray(np.polynomial.Polynomial.fit(centred, values, degree)(centred))
