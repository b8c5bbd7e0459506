"""Where a layer lies: into the map's CRS, with a word on everything that looks wrong."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from scipy.spatial import cKDTree

from conetl.geometry.geodesy import to_geodetic
from conetl.model.errors import InputError
from conetl.readers.base_layers.layer_crs import LayerCrs, axes_seem_swapped, layer_crs, outside_area, parse_crs

Array = NDArray[np.float64]

#: A layer farther from every drive than this is warned of.
FAR_M = 1_000.0
#: Points so near to the path tell the height of the road, ...
_ROAD_WITHIN_M = 6.0
#: ... and are compared with the drives' from this difference on.
_HEIGHT_DIFFERS_M = 2.0


class MapPlace(NamedTuple):
    """What the drives of a map say of where it is. All in the map's CRS, metres."""

    srid: int
    ground_m: Array
    """(N, 3) places on the road under the poses of its drives; empty where nothing was ingested."""

    def lonlat(self) -> tuple[float, float] | None:
        """Somewhere in the middle of the map."""
        if len(self.ground_m) == 0:
            return None
        lat, lon, _ = to_geodetic(self.srid, np.median(self.ground_m, axis=0))
        return float(lon), float(lat)


def ground_under(poses_m: Array, feet_m: Array) -> Array:
    """(N, 3) places on the road: poses of the body (N, 3), lowered by what lies between it and the feet of cones (M, 3) nearby.

    Without cones the poses themselves.
    """
    if len(poses_m) == 0 or len(feet_m) == 0:
        return poses_m
    _, nearest = cKDTree(poses_m[:, :2]).query(feet_m[:, :2])
    down = float(np.median(feet_m[:, 2] - poses_m[nearest, 2]))
    return np.asarray(poses_m + np.array([0.0, 0.0, down]))


def resolve_crs(path: Path, stated: CRS | None, given: str | None, place: MapPlace) -> tuple[LayerCrs, list[str]]:
    """The CRS to read a file in: `given` by the user, else the one that it states. Raises InputError where there is none."""
    warnings: list[str] = []
    try:
        crs = parse_crs(given) if given else stated
        if crs is None:
            raise InputError(
                f"{path}: the file does not say in which CRS its coordinates are. State it, e.g. --crs {place.srid} for the "
                "map's"
            )
        if given and stated is not None and not crs.equals(stated, ignore_axis_order=True):
            warnings.append(f"{path.name}: read as {crs.name} as you say; the file itself states {stated.name}")
        layer = layer_crs(crs, place.srid)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    if layer.height_note:
        warnings.append(f"{path.name}: {layer.height_note}; state the difference with --height-offset")
    return layer, warnings


def check_coordinates(path: Path, layer: LayerCrs, xy: Array, place: MapPlace) -> list[str]:
    """Refuse swapped coordinates, warn of ones outside the area of their CRS. xy: (N, 2) of the file, some of it."""
    finite = xy[np.isfinite(xy).all(axis=1)]
    if len(finite) == 0:
        raise InputError(f"{path}: its coordinates are no numbers")
    if axes_seem_swapped(layer, finite, place.lonlat()):
        first, second = ("longitude", "latitude") if layer.geographic else ("easting", "northing")
        x, y = np.median(finite, axis=0)
        raise InputError(
            f"{path}: {first} and {second} are swapped: expected {first} first, the file has {x:.6g}, {y:.6g} or so. "
            "Write it in that order"
        )
    if layer.geographic and np.abs(finite[:, 1]).max() > 90.0:
        raise InputError(
            f"{path}: latitudes up to {np.abs(finite[:, 1]).max():.6g} in {layer.name}: no degrees. State the CRS with --crs"
        )
    if outside_area(layer, finite):
        return [f"{path.name}: its coordinates lie outside the area that {layer.name} is made for: is that its CRS?"]
    return []


def check_near(name: str, low_m: Array, high_m: Array, place: MapPlace) -> list[str]:
    """Warn of a layer whose extent (low and high corner, 2 each) lies far from every drive."""
    if len(place.ground_m) == 0:
        return []
    xy = place.ground_m[:, :2]
    distance = float(np.linalg.norm(np.maximum(np.maximum(low_m - xy, xy - high_m), 0.0), axis=1).min())
    if distance <= FAR_M:
        return []
    return [
        f"{name}: lies {distance / 1000:,.0f} km from the nearest drive of this map. Is it the right file, CRS and map?"
    ]


def check_heights(name: str, xyz_m: Array, place: MapPlace) -> list[str]:
    """Warn where points or vertices (N, 3) along the drives lie well above or below the road."""
    if len(place.ground_m) == 0 or len(xyz_m) == 0:
        return []
    found = cKDTree(place.ground_m[:, :2]).query(xyz_m[:, :2], distance_upper_bound=_ROAD_WITHIN_M)
    distance, nearest = np.asarray(found[0]), np.asarray(found[1])
    near = np.isfinite(distance)
    if np.count_nonzero(near) < 10:
        return []
    difference = float(np.percentile(xyz_m[near, 2] - place.ground_m[nearest[near], 2], 20))
    if abs(difference) < _HEIGHT_DIFFERS_M:
        return []
    return [
        f"{name}: along the drives it lies {abs(difference):.1f} m {'above' if difference > 0 else 'below'} the road. The map's "
        f"heights are ellipsoidal; if the file's count from a geoid, import it with --height-offset {-difference:.1f}"
    ]


def drape(xy_m: Array, place: MapPlace) -> Array:
    """Heights (N,) of the road for vertices (N, 2): those under the nearest pose. 0 in a map without drives."""
    if len(place.ground_m) == 0:
        return np.zeros(len(xy_m))
    _, nearest = cKDTree(place.ground_m[:, :2]).query(xy_m)
    return np.asarray(place.ground_m[nearest, 2])
