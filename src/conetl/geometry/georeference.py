"""Poses in a local level frame (odometry, SLAM, motion capture) -> poses in the map, by the frame's own place and heading.

The local frame is tangent to the ellipsoid at its origin: x and y level, z up. It is turned into earth-centred coordinates
(EPSG:4978) and from there to the map, so that the earth's curvature and the grid's convergence are accounted for at every pose.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Transformer

from conetl.geometry import geodesy
from conetl.geometry import pose as se3

Array = NDArray[np.float64]


def local_to_map(
    srid: int, lat_deg: float, lon_deg: float, height_m: float, heading_deg: float, local_SE3_body: ArrayLike
) -> Array:
    """map_SE3_body (N, 4, 4) of poses local_SE3_body (N, 4, 4) in metres.

    lat_deg, lon_deg, height_m: WGS 84 place of the local frame's origin, height ellipsoidal. heading_deg: direction of its x
    axis, clockwise from true north. Raises ValueError where the map CRS cannot express the places.
    """
    poses = np.asarray(local_SE3_body, dtype=np.float64).reshape(-1, 4, 4)
    turn = np.radians(90.0 - heading_deg)
    ecef_R_local = ecef_R_enu(lat_deg, lon_deg) @ se3.rotation_from_rpy(0.0, 0.0, turn)
    origin = np.array(_to_ecef().transform(lon_deg, lat_deg, height_m))
    ecef = origin + poses[:, :3, 3] @ ecef_R_local.T
    lon, lat, height = _to_ecef().transform(ecef[:, 0], ecef[:, 1], ecef[:, 2], direction="INVERSE")
    places = geodesy.to_map(srid, lat, lon, height)
    enu_R_body = np.swapaxes(ecef_R_enu(lat, lon), -1, -2) @ ecef_R_local @ poses[:, :3, :3]
    return se3.se3(enu_to_grid(srid, lat, lon, enu_R_body), places)


def enu_to_grid(srid: int, lat_deg: ArrayLike, lon_deg: ArrayLike, enu_R_body: ArrayLike) -> Array:
    """map_R_body (..., 3, 3) of attitudes against true east, true north, up (..., 3, 3): turned by the grid convergence."""
    convergence = geodesy.grid_convergence_rad(srid, lat_deg, lon_deg)
    zero = np.zeros_like(convergence)
    turned: Array = se3.rotation_from_rpy(zero, zero, convergence) @ np.asarray(enu_R_body, dtype=np.float64)
    return turned


def ecef_R_enu(lat_deg: ArrayLike, lon_deg: ArrayLike) -> Array:
    """(..., 3, 3) whose columns are east, north and up of a place, in earth-centred coordinates."""
    lat, lon = np.broadcast_arrays(np.radians(lat_deg), np.radians(lon_deg))
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(lon)], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=-1)
    return np.stack([east, north, up], axis=-1)


def sensor_R_body(sensor_R_left: ArrayLike) -> Array:
    """(3, 3) from the body as conetl means it (x forward, y left, z up) to a sensor whose axes point anywhere.

    The body's axes are the sensor's own, renamed: of the 24 ways to do so, the one nearest to forward, left and up as the
    left camera (rotation sensor_R_left) sees them. The identity for a sensor that has them right. An IMU whose x axis points up
    (EuRoC's) would have no roll and yaw of its own.
    """
    wanted = np.asarray(sensor_R_left, dtype=np.float64) @ np.array(
        [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    )
    ways = [
        np.eye(3)[:, order] * np.array(signs)
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return max((way for way in ways if np.linalg.det(way) > 0), key=lambda way: float(np.sum(way * wanted)))


@lru_cache(maxsize=1)
def _to_ecef() -> Transformer:
    return Transformer.from_crs(4979, 4978, always_xy=True)
