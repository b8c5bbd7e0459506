"""Routes of the search for cones, drives, days, towns and coordinates, and of longitude and latitude in the browser.

The page computes the coordinates under the cursor, and places the tiles of a base map, by polynomials of the map's projection,
without a request for each.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from typing import Annotated

import numpy as np
from fastapi import APIRouter, HTTPException, Query

from conetl.db.map.map_store import find_features, list_changesets, require_map
from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.geometry.towns import Town, towns_called, towns_near
from conetl.model.arrays import Floats
from conetl.model.base import Vec3, utc_from_ns
from conetl.web import models as m
from conetl.web import rows as to
from conetl.web.parameters import MapName, Origin, Reader, cut

router = APIRouter()
_MAX_FOUND = 20
_NUMBER = r"[-+]?\d{1,9}(?:\.\d*)?"
#: "458006.5 5428010", "49.005, 8.43", with the units or axis letters that people copy along.
_PAIR = re.compile(rf"\s*({_NUMBER})\s*(?:°|m|E|N)?\s*[\s,;]\s*({_NUMBER})\s*(?:°|m|E|N)?\s*", re.IGNORECASE)
#: Of two ways to read a pair, the one whose point is nearer to the map is meant, if the other one is farther than this.
_FAR_M = 100_000.0
#: Towns are found from this many characters on, up to this number and distance from the map's origin.
_LEAST_OF_TOWN, _MAX_TOWNS, _TOWN_WITHIN_M = 3, 5, 1_000_000.0
#: Those that tell where a place is.
_NEAR_M = 50_000.0
#: Half the side of the square in which the polynomials hold; the page asks for others beyond it.
RADIUS_M = 20_000.0
#: Largest error of both polynomials within RADIUS_M; for a CRS with larger ones there are no polynomials.
TOLERANCE_M = 0.01
_DEGREE = 5
_METRES_PER_DEGREE = 111_320.0
#: Points per side of the fitted and of the checked grid.
_FITTED, _CHECKED = 13, 8
Metres = Annotated[float, Query(ge=-5e6, le=5e6, allow_inf_nan=False)]


@router.get("/maps/{map_name}/search", tags=["search"])
def search(
    map_name: MapName,
    conn: Reader,
    origin: Origin,
    text: Annotated[str, Query(min_length=1, max_length=100)],
) -> m.SearchResult:
    """What a text may mean: the beginning of an id, a part of a drive's id, a day (2026-03-02), a town, a coordinate pair."""
    info = require_map(conn, map_name)
    wanted = text.strip()
    ids = []
    if re.fullmatch(r"[0-9a-fA-F-]{1,36}", wanted):
        ids = find_features(conn, wanted, map_name=map_name, max_rows=_MAX_FOUND + 1)
    drives = [
        m.FoundDrive(
            changeset_no=c.changeset_no, drive_id=c.drive_id, kind=c.kind, captured_from=utc_from_ns(c.captured_from_ns)
        )
        for c in list_changesets(conn, map_name=map_name)
        if wanted and wanted.casefold() in f"{c.drive_id}\n{utc_from_ns(c.captured_from_ns):%Y-%m-%d}".casefold()
    ]
    feature_ids, more_ids = cut(ids, _MAX_FOUND)
    found_drives, more_drives = cut(drives, _MAX_FOUND)
    return m.SearchResult(
        feature_ids=feature_ids, drives=found_drives,
        positions=_positions(wanted, info.srid, origin), towns=_named(wanted, info.srid, origin),
        truncated=more_ids or more_drives,
    )  # fmt: skip


def _positions(text: str, srid: int, origin: Vec3) -> list[m.FoundPosition]:
    """The point of a coordinate pair: lat, lon if both are small enough, else E N of the map's CRS; swapped if that is
    nearer."""
    pair = _PAIR.fullmatch(text)
    if pair is None:
        return []
    a, b = float(pair[1]), float(pair[2])
    readings = []
    for first, second, order in ((a, b, ""), (b, a, "swapped")):
        if abs(a) <= 180 and abs(b) <= 180:
            found = _at(srid, first, second, origin)
            label = "longitude, latitude" if order else "latitude, longitude"
        else:
            found = to.offset((first, second, origin[2]), origin)[:2]
            label = f"EPSG:{srid}, {'north, east' if order else 'east, north'}"
        if found is not None:
            readings.append(m.FoundPosition(label=label, xy_m=found, lat_lon_deg=_lat_lon(srid, found, origin)))
    near = [reading for reading in readings if np.hypot(*reading.xy_m) <= _FAR_M]
    return (near or readings)[:1]


def _named(text: str, srid: int, origin: Vec3) -> list[m.FoundPosition]:
    """Towns whose name begins with a text, the nearest to the map's origin first."""
    towns = _placed(towns_called(text) if len(text) >= _LEAST_OF_TOWN else [], srid, origin)
    near = sorted((float(np.hypot(*xy_m)), town, xy_m) for town, xy_m in towns)
    return [
        m.FoundPosition(label=town.label, xy_m=xy_m, lat_lon_deg=(town.lat_deg, town.lon_deg))
        for away_m, town, xy_m in near[:_MAX_TOWNS] if away_m <= _TOWN_WITHIN_M
    ]  # fmt: skip


def _placed(towns: Iterable[Town], srid: int, origin: Vec3) -> list[tuple[Town, tuple[float, float]]]:
    """Towns that the map's CRS can express, with their offsets from its origin."""
    placed = ((town, _at(srid, town.lat_deg, town.lon_deg, origin)) for town in towns)
    return [(town, xy_m) for town, xy_m in placed if xy_m is not None]


def _at(srid: int, lat_deg: float, lon_deg: float, origin: Vec3) -> tuple[float, float] | None:
    """Metres from the origin; None for a position that the map's CRS cannot express."""
    if abs(lat_deg) > 90 or abs(lon_deg) > 180:
        return None
    try:
        return to.offset(to_map(srid, lat_deg, lon_deg, 0.0).tolist(), origin)[:2]
    except ValueError:
        return None


def _lat_lon(srid: int, xy_m: tuple[float, float], origin: Vec3) -> tuple[float, float] | None:
    lat, lon = to_geodetic(srid, (xy_m[0] + origin[0], xy_m[1] + origin[1], 0.0))[:2].tolist()
    return (lat, lon) if np.isfinite([lat, lon]).all() else None


@router.get("/maps/{map_name}/projection", tags=["maps"])
def projection(
    map_name: MapName, conn: Reader, origin: Origin, x_m: Metres = 0.0, y_m: Metres = 0.0
) -> m.MapProjection:
    """Polynomials between offsets from the map's origin and WGS 84, around the offset (x_m, y_m)."""
    try:
        return fit_projection(require_map(conn, map_name).srid, origin, (x_m, y_m))
    except ValueError as error:
        raise HTTPException(404, f"Longitude and latitude of the map {map_name} are unknown here: {error}") from error


@lru_cache(maxsize=64)
def fit_projection(srid: int, origin_m: tuple[float, float, float], centre_m: tuple[float, float]) -> m.MapProjection:
    """The polynomials of EPSG:srid around origin_m + centre_m, by least squares on Chebyshev points.

    Raises ValueError where they are worse than TOLERANCE_M anywhere within RADIUS_M.
    """
    middle = np.add(origin_m[:2], centre_m)
    lat0, lon0 = to_geodetic(srid, [*middle, 0.0])[:2]
    if not np.isfinite([lat0, lon0]).all():
        raise ValueError(f"EPSG:{srid} has no longitude and latitude there")

    def pairs(unit: Floats) -> tuple[Floats, Floats]:
        """Coordinates in the unit square on both sides: of the map, and of the degrees around the middle."""
        geodetic = to_geodetic(srid, np.column_stack([middle + unit * RADIUS_M, np.zeros(len(unit))]))
        east = (geodetic[:, 1] - lon0 + 180.0) % 360.0 - 180.0
        return unit, np.column_stack([east, geodetic[:, 0] - lat0]) * _scale(lat0)

    map_unit, degree_unit = pairs(_square(np.cos(np.pi * (np.arange(_FITTED) + 0.5) / _FITTED)))
    to_degrees = np.linalg.lstsq(_terms(map_unit), degree_unit, rcond=None)[0]
    to_metres = np.linalg.lstsq(_terms(degree_unit), map_unit, rcond=None)[0]
    map_unit, degree_unit = pairs(_square(np.linspace(-1.0, 1.0, _CHECKED)))
    misses = (_terms(map_unit) @ to_degrees - degree_unit, _terms(degree_unit) @ to_metres - map_unit)
    worst_m = RADIUS_M * max(float(np.abs(miss).max()) for miss in misses)
    if not worst_m <= TOLERANCE_M:
        raise ValueError(f"EPSG:{srid} is too distorted there")
    towns = _placed(towns_near(float(lat0), float(lon0), within_m=_NEAR_M), srid, origin_m)
    return m.MapProjection(
        centre_m=list(centre_m), radius_m=RADIUS_M, lon_deg=float(lon0), lat_deg=float(lat0), degree=_DEGREE,
        unit_per_degree=_scale(lat0).tolist(), to_degrees=to_degrees.T.tolist(), to_metres=to_metres.T.tolist(),
        towns=[m.NearTown(label=town.label, xy_m=xy_m) for town, xy_m in towns],
    )  # fmt: skip


def _scale(lat_deg: float) -> Floats:
    """Units per degree of longitude and latitude, so that RADIUS_M is about 1."""
    return np.array([np.cos(np.radians(lat_deg)), 1.0]) * _METRES_PER_DEGREE / RADIUS_M


def _square(values: Floats) -> Floats:
    return np.stack(np.meshgrid(values, values), axis=-1).reshape(-1, 2)


def _terms(uv: Floats) -> Floats:
    """u^i v^j with i + j <= degree, in the order of i, then j: the same as in web/src/lonlat.ts."""
    u, v = uv.T
    return np.column_stack([u**i * v**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)])
