"""Coordinates of foreign layers (point clouds, lane boundaries) -> the map's CRS, with the checks that such files need.

Easting and northing are transformed by PROJ in two dimensions. Heights are only converted to metres: converting heights above a
geoid to ellipsoidal ones requires a geoid model, which PROJ lacks without its grid files. The user gives the difference
(`--height-offset`), and it is compared with the drives.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError
from scipy.spatial import cKDTree

from conetl.files.documents import input_errors, shown
from conetl.geometry.geodesy import to_geodetic
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.errors import InputError

#: GEOS's number of the first type that has parts.
_MULTI_POINT = 4
#: Coordinates farther outside the CRS's area of use are warned of.
_AREA_MARGIN_DEG = 0.5
#: PROJ's confidence (percent) that a CRS is one of EPSG's.
_EPSG_CONFIDENCE = 25
#: Rows of a map farther from everything are warned of, and layers so far from every drive: ED50 is 200 m from ETRS89.
FAR_M, _LAYER_FAR_M = 1_000.0, 100.0
#: Points within this distance of the path give the height of the road, ...
_ROAD_WITHIN_M = 6.0
#: ... and are warned of from this difference to the drives' heights.
_HEIGHT_DIFFERS_M = 1.0


class Geometries(NamedTuple):
    """Geometries and their parts: points, lines, and outlines of areas."""

    shapes: Any
    """(G,) of shapely; None where one is missing or broken."""
    part_at: Ints
    """(G + 1,) number of the first part of each, then that of all parts."""
    vertex_at: Ints
    """(P + 1,) number of the first vertex of each part, then that of all vertices."""
    xyz: Floats
    """(V, 3); heights are NaN where the file has none."""


def geometries_of(well_known_binary: Any) -> Geometries:
    """Geometries (G,) as GDAL gives them, None where one is missing: all in one call of GEOS, as one for each takes 50 us."""
    shapes = shapely.from_wkb(np.asarray(well_known_binary, object), on_invalid="ignore")
    owner = np.flatnonzero(~shapely.is_missing(shapes))
    parts = shapes[owner]
    while (shapely.get_type_id(parts) >= _MULTI_POINT).any():  # collections may be in collections
        parts, inside = shapely.get_parts(parts, return_index=True)
        owner = owner[inside]
    outlines = shapely.get_exterior_ring(parts)
    parts = np.where(shapely.is_missing(outlines), parts, outlines)
    xyz, part = shapely.get_coordinates(parts, include_z=True, return_index=True)
    return Geometries(
        shapes,
        np.searchsorted(owner, np.arange(len(shapes) + 1)),
        np.searchsorted(part, np.arange(len(parts) + 1)),
        xyz,
    )


class LayerCrs(NamedTuple):
    """A layer's CRS and its transformation to the map's."""

    name: str
    to_map: Transformer
    to_lonlat: Transformer
    height_factor: float
    height_note: str | None
    """The reference of the heights, where they are known not to be ellipsoidal."""
    horizontal: CRS
    """Without heights; its area of use is that of the layer."""


def parse_crs(text: str) -> CRS:
    """A CRS from `EPSG:25832`, `25832`, WKT or a PROJ string. Raises ValueError."""
    try:
        return CRS.from_user_input(int(text) if text.strip().isdigit() else text)
    except (CRSError, OverflowError) as error:
        raise ValueError(
            f"{shown(text)} is not a coordinate reference system; write it like 25832 or EPSG:25832"
        ) from error


def height_unit_m(crs: CRS) -> float:
    """Unit of heights; without a vertical part the horizontal one (LAS 1.4, and common practice), with degrees the metre."""
    axes = crs.axis_info[2:] or crs.axis_info[: int(crs.is_projected)]
    return float(axes[0].unit_conversion_factor) if axes else 1.0


def require_unit(path: Path, crs: CRS, stated_m: float | None) -> None:
    """Raise InputError where a file states another unit of easting and northing (m) than that of their CRS."""
    unit_m = float(crs.axis_info[0].unit_conversion_factor)
    if stated_m is not None and crs.is_projected and abs(unit_m / stated_m - 1.0) > 1e-3:  # US feet are almost feet
        raise InputError(
            f"{path}: by the names of their columns, easting and northing are in units of {stated_m:g} m, but those of "
            f"{crs.name} are {unit_m:g} m: state the CRS of the file's coordinates, or convert them"
        )


def layer_crs(crs: CRS, map_srid: int) -> LayerCrs:
    """The transformation from `crs` to the map. Raises ValueError for local and engineering CRSs."""
    parts = crs.sub_crs_list if crs.is_compound else []
    flat, vertical = (parts[0], parts[1]) if len(parts) > 1 else (crs, None)
    while flat.is_bound and flat.source_crs is not None:
        flat = flat.source_crs
    if not (flat.is_projected or flat.is_geographic):
        raise ValueError(f"{crs.name} is neither a projected nor a geographic coordinate reference system")
    target = CRS.from_epsg(map_srid)
    note = None
    if vertical is not None and "ellips" not in vertical.name.lower():
        note = f"its heights are those of {vertical.name}, the map's are ellipsoidal"
    code = flat.to_epsg(_EPSG_CONFIDENCE) if flat.area_of_use is None else None  # WKT of older files has no area
    try:
        return LayerCrs(
            crs.name,
            Transformer.from_crs(flat, target, always_xy=True),
            Transformer.from_crs(flat, CRS.from_epsg(4326), always_xy=True),
            height_unit_m(crs),
            note,
            flat if code is None else CRS.from_epsg(code),
        )
    except ProjError as error:
        raise ValueError(f"there is no transformation from {crs.name} to EPSG:{map_srid}: {error}") from error


def to_map(layer: LayerCrs, xyz: Floats, height_offset_m: float = 0.0) -> Floats:
    """(N, 3) of the layer's file -> (N, 3) easting, northing, height in metres; inf where the map's CRS has no such point."""
    east, north = layer.to_map.transform(xyz[:, 0], xyz[:, 1])
    return np.column_stack([east, north, xyz[:, 2] * layer.height_factor + height_offset_m])


def axes_seem_swapped(layer: LayerCrs, xy: Floats, map_lonlat: tuple[float, float] | None) -> bool:
    """True where coordinates (N, 2) only make sense in the other order: invalid latitudes, or far from the map else.

    map_lonlat: position of the map. Projected coordinates are compared with it only.
    """
    middle = np.median(xy, axis=0)
    if layer.horizontal.is_geographic and abs(middle[1]) > 90.0 >= abs(middle[0]):
        return True
    if map_lonlat is None:
        return False
    as_is, swapped = (_distance_deg(layer, point, map_lonlat) for point in (middle, middle[::-1]))
    return bool(swapped < 1.0 and as_is > 2.0 + swapped)


def in_area(crs: CRS, lonlat: Floats, margin_deg: float) -> Bools:
    """Whether positions (N, 2) are in the area of use of a CRS, if it has one, or at most this far outside."""
    area = crs.area_of_use
    if area is None:
        return np.asarray(np.isfinite(lonlat).all(axis=1))
    lon, lat = np.where(np.isfinite(lonlat), lonlat, np.nan).T
    # The west of an area across the antimeridian is greater than its east, so longitudes count from its west.
    width = (area.east - area.west) % 360 or 360.0
    inside = (lon - area.west + margin_deg) % 360 <= width + 2 * margin_deg
    return np.asarray(inside & (lat >= area.south - margin_deg) & (lat <= area.north + margin_deg))


def _distance_deg(layer: LayerCrs, point: Floats, map_lonlat: tuple[float, float]) -> float:
    if layer.horizontal.is_geographic and abs(point[1]) > 90.0:
        return float("inf")
    lon, lat = layer.to_lonlat.transform(*point)
    if not np.isfinite([lon, lat]).all():
        return float("inf")
    return float(max(abs((lon - map_lonlat[0] + 180.0) % 360.0 - 180.0), abs(lat - map_lonlat[1])))


class MapGround(NamedTuple):
    """The road under the drives of a map, in the map's CRS, metres."""

    srid: int
    ground_m: Floats
    """(N, 3) points on the road under the poses of its drives; empty where nothing was ingested."""

    def lonlat(self) -> tuple[float, float] | None:
        """The median position; None without drives."""
        if len(self.ground_m) == 0:
            return None
        lat, lon, _ = to_geodetic(self.srid, np.median(self.ground_m, axis=0))
        return float(lon), float(lat)


def ground_under(poses_m: Floats, feet_m: Floats) -> Floats:
    """(N, 3) points on the road: positions of the body (N, 3), lowered by the median height above the feet of cones (M, 3).

    Without cones the positions themselves.
    """
    if len(poses_m) == 0 or len(feet_m) == 0:
        return poses_m
    _, nearest = cKDTree(poses_m[:, :2]).query(feet_m[:, :2])
    down = float(np.median(feet_m[:, 2] - poses_m[nearest, 2]))
    return np.asarray(poses_m + np.array([0.0, 0.0, down]))


def resolve_crs(
    path: Path, stated: CRS | None, given: str | None, ground: MapGround, why: str = "the file has no CRS"
) -> tuple[LayerCrs, list[str]]:
    """The CRS of a file: `given` by the user, else the one it states, and warnings. Raises InputError without a usable one.

    why: the reason where it states none.
    """
    warnings: list[str] = []
    with input_errors(path):
        crs = parse_crs(given) if given else stated
        if crs is None:
            raise InputError(f"{path}: {why}. State the CRS of its coordinates, e.g. --crs {ground.srid} for the map's")
        if given and stated is not None and not crs.equals(stated, ignore_axis_order=True):
            warnings.append(f"{path.name}: read as {crs.name} as given; the file itself states {stated.name}")
        layer = layer_crs(crs, ground.srid)
    if layer.height_note:
        warnings.append(f"{path.name}: {layer.height_note}; state the difference with --height-offset")
    return layer, warnings


def check_coordinates(path: Path, layer: LayerCrs, xy: Floats, ground: MapGround) -> list[str]:
    """Reject swapped coordinates, warn of ones outside their CRS's area of use. xy: (N, 2), a sample of the file."""
    finite = xy[np.isfinite(xy).all(axis=1)]
    if len(finite) == 0:
        raise InputError(f"{path}: its coordinates are not numbers")
    if axes_seem_swapped(layer, finite, ground.lonlat()):
        first, second = ("longitude", "latitude") if layer.horizontal.is_geographic else ("easting", "northing")
        x, y = np.median(finite, axis=0)
        raise InputError(
            f"{path}: {first} and {second} are swapped: expected {first} first, the file has about {x:.6g}, {y:.6g}. "
            "Write them in that order"
        )
    if layer.horizontal.is_geographic and np.abs(finite[:, 1]).max() > 90.0:
        raise InputError(
            f"{path}: latitudes up to {np.abs(finite[:, 1]).max():.6g} in {layer.name}: not degrees. State the CRS with --crs"
        )
    lonlat = np.array([layer.to_lonlat.transform(*np.median(finite, axis=0))])
    if layer.horizontal.area_of_use is not None and not in_area(layer.horizontal, lonlat, _AREA_MARGIN_DEG)[0]:
        return [f"{path.name}: its coordinates are outside the area of use of {layer.name}: is that its CRS?"]
    return []


def check_near(name: str, low_m: Floats, high_m: Floats, ground: MapGround) -> list[str]:
    """Warn of a layer whose extent (low and high corner, 2 each) is far from every drive."""
    if len(ground.ground_m) == 0:
        return []
    xy = ground.ground_m[:, :2]
    distance = float(np.linalg.norm(np.maximum(np.maximum(low_m - xy, xy - high_m), 0.0), axis=1).min())
    if distance <= _LAYER_FAR_M:
        return []
    return [f"{name}: is {distance:,.0f} m from the nearest drive of this map. Is it the right file, CRS and map?"]


def check_heights(name: str, xyz_m: Floats, ground: MapGround) -> list[str]:
    """Warn where points or vertices (N, 3) along the drives are well above or below the road."""
    if len(ground.ground_m) == 0 or len(xyz_m) == 0:
        return []
    found = cKDTree(ground.ground_m[:, :2]).query(xyz_m[:, :2], distance_upper_bound=_ROAD_WITHIN_M)
    distance, nearest = np.asarray(found[0]), np.asarray(found[1])
    near = np.isfinite(distance)
    if np.count_nonzero(near) < 10:
        return []
    difference = float(np.percentile(xyz_m[near, 2] - ground.ground_m[nearest[near], 2], 20))
    if abs(difference) < _HEIGHT_DIFFERS_M:
        return []
    return [
        f"{name}: along the drives it is {abs(difference):.1f} m {'above' if difference > 0 else 'below'} the road. The map's "
        f"heights are ellipsoidal; if the file's are above a geoid, import it with --height-offset {-difference:.1f}"
    ]


def drape(xy_m: Floats, ground: MapGround) -> Floats:
    """Heights (N,) of the road at vertices (N, 2): those under the nearest pose; 0 in a map without drives."""
    if len(ground.ground_m) == 0:
        return np.zeros(len(xy_m))
    _, nearest = cKDTree(ground.ground_m[:, :2]).query(xy_m)
    return np.asarray(ground.ground_m[nearest, 2])
