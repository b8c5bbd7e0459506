"""Latitude, longitude, ellipsoidal height and local level frames -> the map's coordinate reference system (CRS).

Easting and northing come from pyproj; heights remain ellipsoidal (WGS 84) in any map CRS.
GNSS/INS headings count from true north or east, the map's axes are grid north and grid east; the angle between them is the
meridian (grid) convergence, up to 3 degrees in a UTM zone: 1.5 degrees are 26 cm at 10 m.

The CRS also stretches lengths, by 0.9996 to 1.001 in UTM. Poses stay rigid motions and local vectors (camera to cone) are
**not** stretched: that leaves up to 4 mm at 10 m at a zone's middle, at its edges 6 mm at a latitude of 30 degrees and 10 mm at
the equator, and keeps cone heights and distances true; beyond its zone a CRS stretches more. Directions are turned by one
angle, which only a conformal CRS allows: others are refused.

A local level frame (odometry, SLAM, motion capture) is tangent to the ellipsoid at its origin: x and y level, z up. Its poses
go through earth-centred coordinates (EPSG:4978), so that the earth's curvature and the convergence apply at every pose.

Heights become those above a geoid or of a national network, and back, by PROJ's grids.
"""

from __future__ import annotations

import re
import warnings
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Proj, Transformer
from pyproj.crs import CompoundCRS
from pyproj.datadir import get_user_data_dir  # type: ignore[attr-defined]
from pyproj.exceptions import CRSError, ProjError
from pyproj.transformer import AreaOfInterest, TransformerGroup
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.errors import InputError

#: CRSs that stretch lengths by more than this are refused as map CRS (Web Mercator stretches by 1.5 in Karlsruhe).
MAX_SCALE_ERROR = 0.01
#: CRSs that distort angles by more than this (7 mm at 15 m) are refused, as equal-area grids (EPSG:3035, 0.95 degrees in Madrid).
MAX_ANGULAR_DISTORTION_DEG = 0.05
#: Name of the height system of a map that states none.
ELLIPSOIDAL = "ellipsoidal"
_CODES = re.compile(r"(?:EPSG:)?(\d{4,6})(?:\+(?:EPSG:)?(\d{4,6}))?", re.IGNORECASE)


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


def to_map(srid: int, lat_deg: ArrayLike, lon_deg: ArrayLike, height_m: ArrayLike) -> Floats:
    """Easting, northing, ellipsoidal height (..., 3) in metres of WGS 84 positions.

    Raises ValueError for a CRS that cannot be a map CRS, or positions that it cannot express.
    """
    lat, lon, height = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (lat_deg, lon_deg, height_m)))
    east, north = _transformer(srid).transform(lon, lat)
    xyz = np.stack([np.asarray(east), np.asarray(north), height], axis=-1)
    if not np.isfinite(xyz).all():
        raise ValueError(f"EPSG:{srid} cannot express all positions: is it the CRS of this area?")
    return xyz


def to_geodetic(srid: int, xyz_m: ArrayLike) -> Floats:
    """Latitude, longitude (degrees, WGS 84) and ellipsoidal height (..., 3) of map points (..., 3)."""
    xyz = np.asarray(xyz_m, dtype=np.float64)
    lon, lat = _transformer(srid).transform(xyz[..., 0], xyz[..., 1], direction="INVERSE")
    return np.stack([np.asarray(lat), np.asarray(lon), xyz[..., 2]], axis=-1)


def grid_convergence_rad(srid: int, lat_deg: ArrayLike, lon_deg: ArrayLike) -> Floats:
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
        "check whether latitude and longitude are swapped"
    )


def local_to_map(
    srid: int, lat_deg: float, lon_deg: float, height_m: float, heading_deg: float, local_SE3_body: ArrayLike
) -> Floats:
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


def enu_to_grid(srid: int, lat_deg: ArrayLike, lon_deg: ArrayLike, enu_R_body: ArrayLike) -> Floats:
    """map_R_body (..., 3, 3) of attitudes against true east, true north, up (..., 3, 3): turned by the grid convergence."""
    convergence = grid_convergence_rad(srid, lat_deg, lon_deg)
    zero = np.zeros_like(convergence)
    return np.asarray(se3.rotation_from_rpy(zero, zero, convergence) @ np.asarray(enu_R_body, dtype=np.float64))


def ecef_R_enu(lat_deg: ArrayLike, lon_deg: ArrayLike) -> Floats:
    """(..., 3, 3) whose columns are east, north and up at a position, in earth-centred coordinates."""
    lat, lon = np.broadcast_arrays(np.radians(lat_deg), np.radians(lon_deg))
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(lon)], axis=-1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=-1)
    return np.stack([east, north, up], axis=-1)


#: From body axes (forward, left, up) to those of a camera that looks forward (right, down, forward).
CAMERA_R_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def sensor_R_body(sensor_R_left: ArrayLike) -> Floats:
    """(3, 3) from conetl's body axes (x forward, y left, z up) to the axes of a sensor.

    The body's axes are the sensor's own, permuted: of the 24 permutations the one nearest to forward, left and up of the left
    camera (rotation sensor_R_left). Without this, an IMU whose x axis points up (EuRoC's) would have no defined roll and yaw.
    """
    wanted = np.asarray(sensor_R_left, dtype=np.float64) @ CAMERA_R_BODY
    axes = np.rint(Rotation.create_group("O").as_matrix())
    return np.asarray(axes[np.argmax((axes * wanted).sum(axis=(1, 2)))])


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


def height_system_name(vertical_srid: int | None) -> str:
    """`ellipsoidal`, or `EPSG:<code>`: the value of the field `height_system`."""
    return ELLIPSOIDAL if vertical_srid is None else f"EPSG:{vertical_srid}"


def parse_crs(text: str) -> tuple[int, int | None]:
    """EPSG codes of `EPSG:25832` or `EPSG:25832+7837`; also of a compound CRS with one code. Raises InputError."""
    found = _CODES.fullmatch(text.strip())
    if found is None:
        raise InputError(f"invalid CRS {text!r}: use for example EPSG:25832, or EPSG:25832+7837 with a height system")
    flat, vertical = _known(int(found[1])), found[2]
    if vertical is None and flat.is_compound:
        horizontal, system = (part.to_epsg() for part in flat.sub_crs_list)
        if horizontal and system:
            return horizontal, system
    if vertical is not None and not _known(int(vertical)).is_vertical:
        raise InputError(
            f"{text}: EPSG:{vertical} ({_known(int(vertical)).name}) is not a height system; EPSG:7837 is one"
        )
    return int(found[1]), None if vertical is None else int(vertical)


def map_crs(text: str) -> tuple[int, int | None]:
    """As `parse_crs`, for the CRS of a map: projected, in metres, with heights for which the grids are installed."""
    srid, vertical_srid = parse_crs(text)
    try:
        check_map_srid(srid)
    except ValueError as error:
        raise InputError(f"{error}: choose another one, for example EPSG:25832") from error
    if vertical_srid is not None:
        _height_transformer(srid, srid, vertical_srid)
    return srid, vertical_srid


def compound_crs(srid: int, vertical_srid: int | None) -> CRS:
    """The compound CRS of both codes, or the plain one if there is no height system."""
    flat = _known(srid)
    if vertical_srid is None:
        return flat
    vertical = _known(vertical_srid)
    return CompoundCRS(f"{flat.name} + {vertical.name}", [flat, vertical])


def to_crs(xyz_m: ArrayLike, source_srid: int, srid: int, vertical_srid: int | None) -> Floats:
    """Positions (N, 3) with ellipsoidal heights in metres -> (N, 3) in EPSG:srid with heights of the system.

    vertical_srid: None for heights above the WGS 84 ellipsoid. Geographic CRS have longitude, latitude in degrees. Raises
    InputError where a grid is missing, which it names, or a position is outside of the area.
    """
    xyz = np.asarray(xyz_m, dtype=np.float64).reshape(-1, 3)
    if (source_srid == srid and vertical_srid is None) or not len(xyz):
        return xyz
    try:
        done = np.column_stack(_height_transformer(source_srid, srid, vertical_srid).transform(*xyz.T))
    except ProjError as error:
        raise InputError(f"positions cannot be transformed into {_named_crs(srid, vertical_srid)}: {error}") from error
    lost = int((~np.isfinite(done).all(axis=1)).sum())
    if lost:
        raise InputError(f"{lost} of {len(xyz)} positions are outside of the area of {_named_crs(srid, vertical_srid)}")
    return done


def to_ellipsoidal(xyz_m: ArrayLike, crs: CRS) -> Floats:
    """Positions (N, 3) in a compound CRS -> the same with ellipsoidal heights. Raises InputError, which names a missing grid."""
    srid, vertical_srid = (part.to_epsg() for part in crs.sub_crs_list)
    if srid is None or vertical_srid is None:
        raise InputError(f"the CRS {crs.name} has no EPSG codes of its parts: convert the file to ellipsoidal heights")
    transformer = _height_transformer(srid, srid, vertical_srid)
    xyz = np.asarray(xyz_m, dtype=np.float64).reshape(-1, 3)
    return np.column_stack(transformer.transform(xyz[:, 0], xyz[:, 1], xyz[:, 2], direction="INVERSE"))


def bbox_of_degrees(points: ArrayLike) -> list[float]:
    """Lowest and highest longitude, latitude and, where there is one, height of points (N, 2 or 3), less than 180 degrees apart.

    West is greater than east across 180 degrees (RFC 7946, 5.2).
    """
    xyz = np.asarray(points, dtype=np.float64)
    low, high, lon = xyz.min(axis=0), xyz.max(axis=0), xyz[:, 0]
    if high[0] - low[0] > 180.0:
        low[0], high[0] = lon[lon > 0].min(), lon[lon <= 0].max()
    return [*low.tolist(), *high.tolist()]


def axis_rotations(xyz_m: ArrayLike, source_srid: int, srid: int) -> Floats:
    """Rotations (N, 2, 2) from the axes of EPSG:source_srid to those of EPSG:srid at positions (N, 3), for covariances.

    Both CRSs are conformal to a few parts in a thousand, so their axes differ by the convergence of the grids; scale is ignored.
    """
    xy = np.asarray(xyz_m, dtype=np.float64).reshape(-1, 3)[:, :2]
    if source_srid == srid:
        return np.broadcast_to(np.eye(2), (len(xy), 2, 2))
    transformer = Transformer.from_crs(source_srid, srid, always_xy=True)
    there = np.column_stack(transformer.transform(xy[:, 0], xy[:, 1]))
    north = np.column_stack(transformer.transform(xy[:, 0], xy[:, 1] + 100.0)) - there
    angle = np.arctan2(-north[:, 0], north[:, 1])
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)


def _named_crs(srid: int, vertical_srid: int | None) -> str:
    return f"EPSG:{srid}" + (f"+{vertical_srid}" if vertical_srid else "")


def _known(code: int) -> CRS:
    try:
        return CRS.from_epsg(code)
    except CRSError as error:
        raise InputError(f"EPSG:{code} is not known to PROJ: check the code") from error


def operations(source: CRS, target: CRS, area: AreaOfInterest | None) -> TransformerGroup:
    """PROJ's transformations, the best first; never one that leaves heights unchanged because a grid is missing.

    Raises ProjError or CRSError.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a missing grid is an error of the caller
        return TransformerGroup(source, target, True, area, allow_ballpark=False)


def missing_grids(group: TransformerGroup) -> list[str]:
    """Names of the grids that PROJ's best transformation lacks; those that PROJ does without are left out."""
    lacking = ([g.short_name for g in op.grids if not g.available] for op in group.unavailable_operations)
    return next(filter(None, lacking), [])


def area_of_interest(lon: float, lat: float) -> AreaOfInterest | None:
    """Area around a position (degrees), for PROJ's choice between its transformations; None near a pole or the antimeridian."""
    if not (abs(lon) < 179 and abs(lat) < 89):
        return None
    return AreaOfInterest(lon - 0.05, lat - 0.05, lon + 0.05, lat + 0.05)


@cache
def _height_transformer(source_srid: int, srid: int, vertical_srid: int | None) -> Transformer:
    """From EPSG:source_srid with ellipsoidal heights."""
    # In two dimensions heights stay above the WGS 84 ellipsoid, whatever the ellipsoid of the CRS.
    source, target = _known(source_srid), compound_crs(srid, vertical_srid)
    source = source if vertical_srid is None else source.to_3d()
    use = source.area_of_use
    area = AreaOfInterest(*use.bounds) if use is not None and use.west < use.east else None
    try:
        group = operations(source, target, area)
    except (ProjError, CRSError) as error:
        raise InputError(f"no transformation to {_named_crs(srid, vertical_srid)}: {error}") from error
    missing = missing_grids(group)
    if missing and not (group.transformers and group.best_available):
        what, code = ("positions in", srid) if vertical_srid is None else ("heights of", vertical_srid)
        raise InputError(
            f"{what} EPSG:{code} ({_known(code).name}) need the grid {missing[0]}, which is not installed: "
            f"put it into {get_user_data_dir()} (`pyproj sync --file {missing[0]}` does)"
        )
    if not group.transformers:
        raise InputError(f"PROJ has no transformation from EPSG:{source_srid} to {_named_crs(srid, vertical_srid)}")
    return group.transformers[0]
