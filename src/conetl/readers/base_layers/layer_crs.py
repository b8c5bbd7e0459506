"""Coordinates of foreign layers (point clouds, lane boundaries) -> the map's CRS, with the checks that such files need.

Easting and northing go through PROJ in two dimensions. Heights are only brought to metres: from heights above a geoid to the
map's ellipsoidal ones it takes a geoid model, which PROJ does not have without its grid files; the difference is stated by hand
(`--height-offset`), and compared with the drives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

Array = NDArray[np.float64]

#: How far beyond the area that a CRS is made for (degrees) places may lie before it is said.
_AREA_MARGIN_DEG = 0.5

#: Percent of confidence with which PROJ takes a CRS for one of EPSG's.
_SURE_ENOUGH = 25


class LayerCrs(NamedTuple):
    """How a layer's coordinates become those of the map."""

    name: str
    to_map: Transformer
    to_lonlat: Transformer
    geographic: bool
    height_factor: float
    height_note: str | None
    """What the heights are, where they are known not to be ellipsoidal."""
    area_lonlat: tuple[float, float, float, float] | None
    """West, south, east, north of the area that the CRS is made for."""


def parse_crs(text: str) -> CRS:
    """A CRS from `EPSG:25832`, `25832`, WKT or a PROJ string. Raises ValueError."""
    try:
        return CRS.from_user_input(int(text) if text.strip().isdigit() else text)
    except CRSError as error:
        raise ValueError(f"{text!r} is no coordinate reference system; write it like 25832 or EPSG:25832") from error


def layer_crs(crs: CRS, map_srid: int) -> LayerCrs:
    """The way from `crs` to the map. Raises ValueError for a CRS that has no place on the earth (local, engineering)."""
    parts = crs.sub_crs_list if crs.is_compound else []
    flat, vertical = (parts[0], parts[1]) if len(parts) > 1 else (crs, None)
    while flat.is_bound and flat.source_crs is not None:
        flat = flat.source_crs
    if not (flat.is_projected or flat.is_geographic):
        raise ValueError(f"{crs.name} is neither a projected nor a geographic coordinate reference system")
    target = CRS.from_epsg(map_srid)
    axes = vertical.axis_info if vertical is not None else flat.axis_info[2:]
    # Without a vertical CRS, heights are in the unit of the plane (LAS 1.4, and practice elsewhere); degrees mean metres.
    units = [axis.unit_conversion_factor for axis in axes] or (
        [flat.axis_info[0].unit_conversion_factor] if flat.is_projected else [1.0]
    )
    note = None
    if vertical is not None and "ellips" not in vertical.name.lower():
        note = f"its heights are those of {vertical.name}, the map's are ellipsoidal"
    area = flat.area_of_use
    if area is None and (code := flat.to_epsg(_SURE_ENOUGH)) is not None:  # WKT of older files does not name the area
        area = CRS.from_epsg(code).area_of_use
    try:
        return LayerCrs(
            crs.name,
            Transformer.from_crs(flat, target, always_xy=True),
            Transformer.from_crs(flat, CRS.from_epsg(4326), always_xy=True),
            bool(flat.is_geographic),
            float(units[0]),
            note,
            None if area is None else (area.west, area.south, area.east, area.north),
        )
    except ProjError as error:
        raise ValueError(f"there is no way from {crs.name} to EPSG:{map_srid}: {error}") from error


def to_map(layer: LayerCrs, xyz: Array, height_offset_m: float = 0.0) -> Array:
    """(N, 3) of the layer's file -> (N, 3) easting, northing, height in metres; what the map's CRS cannot express becomes inf."""
    east, north = layer.to_map.transform(xyz[:, 0], xyz[:, 1])
    return np.column_stack([east, north, xyz[:, 2] * layer.height_factor + height_offset_m])


def axes_seem_swapped(layer: LayerCrs, xy: Array, place_lonlat: tuple[float, float] | None) -> bool:
    """True where coordinates (N, 2) only make sense the other way round: no latitude, or far from a place that they else lie at.

    place_lonlat: where the map is. Projected coordinates are judged by the place alone.
    """
    middle = np.median(xy, axis=0)
    if layer.geographic and abs(middle[1]) > 90.0 >= abs(middle[0]):
        return True
    if place_lonlat is None:
        return False
    as_is, swapped = (_distance_deg(layer, point, place_lonlat) for point in (middle, middle[::-1]))
    return bool(swapped < 1.0 and as_is > 2.0 + swapped)


def outside_area(layer: LayerCrs, xy: Array) -> bool:
    """True where the middle of coordinates (N, 2) lies outside the area that their CRS is made for."""
    if layer.area_lonlat is None:
        return False
    lon, lat = layer.to_lonlat.transform(*np.median(xy, axis=0))
    west, south, east, north = layer.area_lonlat
    if not np.isfinite([lon, lat]).all():
        return True
    inside_lon = west <= lon <= east if west <= east else lon >= west or lon <= east
    near_lon = inside_lon or min(abs(lon - west), abs(lon - east)) <= _AREA_MARGIN_DEG
    return not (near_lon and south - _AREA_MARGIN_DEG <= lat <= north + _AREA_MARGIN_DEG)


def _distance_deg(layer: LayerCrs, point: Array, place_lonlat: tuple[float, float]) -> float:
    if layer.geographic and abs(point[1]) > 90.0:
        return float("inf")
    lon, lat = layer.to_lonlat.transform(*point)
    if not np.isfinite([lon, lat]).all():
        return float("inf")
    return float(max(abs((lon - place_lonlat[0] + 180.0) % 360.0 - 180.0), abs(lat - place_lonlat[1])))
