"""Latitude, longitude, ellipsoidal height and local level frames -> the map's coordinate reference system (CRS).

Easting and northing come from pyproj; heights stay ellipsoidal (WGS 84), whatever the map CRS says about heights.
GNSS/INS headings count from true north or east, the map's axes are grid north and grid east; the angle between them is the
meridian (grid) convergence, up to 3 degrees in a UTM zone: 1.5 degrees are 26 cm at 10 m.

The CRS also stretches lengths, by 0.9996 to 1.001 in UTM. Poses stay rigid motions and local vectors (camera to cone) are
**not** stretched: that leaves up to 4 mm at 10 m at a zone's middle, at its edges 6 mm at a latitude of 30 degrees and 10 mm at
the equator, and keeps cone heights and distances true; beyond its zone a CRS stretches more. Directions are turned by one
angle, which only a conformal CRS allows: others are refused.

A local level frame (odometry, SLAM, motion capture) is tangent to the ellipsoid at its origin: x and y level, z up. Its poses
go through earth-centred coordinates (EPSG:4978), so that the earth's curvature and the convergence apply at every pose.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError

from conetl.geometry import pose as se3

Array = NDArray[np.float64]

#: CRSs that stretch lengths by more than this are refused as map CRS (Web Mercator stretches by 1.5 in Karlsruhe).
MAX_SCALE_ERROR = 0.01
#: CRSs that distort angles by more than this are refused: 7 mm at 15 m. Equal-area grids do: EPSG:3035 by 0.95 degrees in Madrid.
MAX_ANGULAR_DISTORTION_DEG = 0.05


def utm_srid(lat_deg: float, lon_deg: float) -> int:
    """EPSG code of the WGS 84 UTM zone of a position: 326xx north, 327xx south of the equator.

    Plain 6 degree zones (without the exceptions of Norway and Svalbard). Raises ValueError beyond 84 N / 80 S.
    """
    if not (-80.0 <= lat_deg <= 84.0 and -180.0 <= lon_deg <= 180.0):
        raise ValueError(f"latitude {lat_deg}, longitude {lon_deg} lies outside UTM (80 S to 84 N): set map_srid")
    zone = min(int((lon_deg + 180.0) // 6.0) + 1, 60)
    return (32600 if lat_deg >= 0 else 32700) + zone


def check_map_srid(srid: int) -> None:
    """Raise ValueError, with the reason, unless EPSG:srid is a projected CRS in metres."""
    _crs(srid)


def to_map(srid: int, lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike) -> Array:
    """Easting, northing, ellipsoidal height (..., 3) in metres of WGS 84 positions.

    Raises ValueError for a CRS that cannot be a map CRS, or positions that it cannot express.
    """
    lat, lon, height = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (lat_deg, lon_deg, height_m)))
    east, north = _transformer(srid).transform(lon, lat)
    xyz = np.stack([np.asarray(east), np.asarray(north), height], axis=-1)
    if not np.isfinite(xyz).all():
        raise ValueError(f"EPSG:{srid} cannot express all positions: is it the CRS of this area?")
    return xyz


def to_geodetic(srid: int, xyz_m: ArrayLike) -> Array:
    """Latitude, longitude (degrees, WGS 84) and ellipsoidal height (..., 3) of map points (..., 3)."""
    xyz = np.asarray(xyz_m, dtype=np.float64)
    lon, lat = _transformer(srid).transform(xyz[..., 0], xyz[..., 1], direction="INVERSE")
    return np.stack([np.asarray(lat), np.asarray(lon), xyz[..., 2]], axis=-1)


def grid_convergence_rad(srid: int, lat_deg: ArrayLike, lon_deg: ArrayLike) -> Array:
    """Meridian convergence: angle from true north to grid north, clockwise positive, in radians.

    North of the equator and east of the central meridian it is positive. A heading counted counter-clockwise from true east
    becomes one from grid east by adding it; a clockwise azimuth from true north by subtracting it.
    """
    factors = _projection(srid).get_factors(
        np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
    )
    return np.radians(np.asarray(factors.meridian_convergence, dtype=np.float64))


def check_scale(srid: int, lat_deg: float, lon_deg: float) -> None:
    """Raise ValueError where the map CRS stretches lengths or distorts angles too much for measurements at a position."""
    factors = _projection(srid).get_factors(lon_deg, lat_deg)
    scale, distortion_deg = float(factors.meridional_scale), float(factors.angular_distortion)
    if not abs(scale - 1.0) <= MAX_SCALE_ERROR:
        fault = f"stretches lengths by {scale:.4f}"
    elif not distortion_deg <= MAX_ANGULAR_DISTORTION_DEG:
        fault = f"is not conformal: it distorts angles by {distortion_deg:.2f} degrees"
    else:
        return
    raise ValueError(
        f"EPSG:{srid} {fault} at latitude {lat_deg:.4f}, longitude {lon_deg:.4f}: "
        f"choose a map CRS made for surveying in this area, for example EPSG:{utm_srid(lat_deg, lon_deg)}, or "
        "see whether latitude and longitude are swapped"
    )


def local_to_map(
    srid: int, lat_deg: float, lon_deg: float, height_m: float, heading_deg: float, local_SE3_body: ArrayLike
) -> Array:
    """map_SE3_body (N, 4, 4) of poses local_SE3_body (N, 4, 4) in metres.

    lat_deg, lon_deg, height_m: WGS 84 position of the local frame's origin, height ellipsoidal. heading_deg: direction of its x
    axis, clockwise from true north. Raises ValueError where the map CRS cannot express the positions.
    """
    poses = np.asarray(local_SE3_body, dtype=np.float64).reshape(-1, 4, 4)
    turn = np.radians(90.0 - heading_deg)
    ecef_R_local = ecef_R_enu(lat_deg, lon_deg) @ se3.rotation_from_rpy(0.0, 0.0, turn)
    origin = np.array(_to_ecef().transform(lon_deg, lat_deg, height_m))
    ecef = origin + poses[:, :3, 3] @ ecef_R_local.T
    lon, lat, height = _to_ecef().transform(ecef[:, 0], ecef[:, 1], ecef[:, 2], direction="INVERSE")
    positions_m = to_map(srid, lat, lon, height)
    enu_R_body = np.swapaxes(ecef_R_enu(lat, lon), -1, -2) @ ecef_R_local @ poses[:, :3, :3]
    return se3.se3(enu_to_grid(srid, lat, lon, enu_R_body), positions_m)


def enu_to_grid(srid: int, lat_deg: ArrayLike, lon_deg: ArrayLike, enu_R_body: ArrayLike) -> Array:
    """map_R_body (..., 3, 3) of attitudes against true east, true north, up (..., 3, 3): turned by the grid convergence."""
    convergence = grid_convergence_rad(srid, lat_deg, lon_deg)
    zero = np.zeros_like(convergence)
    turned: Array = se3.rotation_from_rpy(zero, zero, convergence) @ np.asarray(enu_R_body, dtype=np.float64)
    return turned


def ecef_R_enu(lat_deg: ArrayLike, lon_deg: ArrayLike) -> Array:
    """(..., 3, 3) whose columns are east, north and up at a position, in earth-centred coordinates."""
    lat, lon = np.broadcast_arrays(np.radians(lat_deg), np.radians(lon_deg))
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(lon)], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=-1)
    return np.stack([east, north, up], axis=-1)


#: From body axes (forward, left, up) to those of a camera that looks forward (right, down, forward).
CAMERA_R_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def sensor_R_body(sensor_R_left: ArrayLike) -> Array:
    """(3, 3) from conetl's body axes (x forward, y left, z up) to a sensor with any axes.

    The body's axes are the sensor's own, permuted: of the 24 permutations the one nearest to forward, left and up of the left
    camera (rotation sensor_R_left). An IMU whose x axis points up (EuRoC's) would have no roll and yaw otherwise.
    """
    wanted = np.asarray(sensor_R_left, dtype=np.float64) @ CAMERA_R_BODY
    axes = [
        np.eye(3)[:, order] * np.array(signs)
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return max((turn for turn in axes if np.linalg.det(turn) > 0), key=lambda turn: float(np.sum(turn * wanted)))


@lru_cache(maxsize=16)
def _crs(srid: int) -> CRS:
    try:
        crs = CRS.from_epsg(srid)
    except CRSError as error:
        raise ValueError(f"EPSG:{srid} is not a known coordinate reference system") from error
    axes = {axis.direction for axis in crs.axis_info}
    if not crs.is_projected or any(abs(axis.unit_conversion_factor - 1.0) > 1e-12 for axis in crs.axis_info):
        raise ValueError(f"EPSG:{srid} ({crs.name}) is not a projected CRS in metres; a UTM zone (EPSG:326xx) is one")
    if axes != {"east", "north"}:
        raise ValueError(f"EPSG:{srid} ({crs.name}) does not have the axes east and north")
    return crs


@lru_cache(maxsize=16)
def _transformer(srid: int) -> Transformer:
    return Transformer.from_crs(CRS.from_epsg(4326), _crs(srid), always_xy=True)


@lru_cache(maxsize=16)
def _projection(srid: int) -> Proj:
    return Proj(_crs(srid))


@lru_cache(maxsize=1)
def _to_ecef() -> Transformer:
    return Transformer.from_crs(4979, 4978, always_xy=True)
