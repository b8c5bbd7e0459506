"""Longitude and latitude in the browser: polynomials of the map's projection around a place, exact to 1 cm.

The page computes the coordinates under the cursor, and places the tiles of a base map, without a request for each.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

import numpy as np
from fastapi import APIRouter, HTTPException, Query
from numpy.typing import NDArray

from conetl.db.map.map_store import find_map
from conetl.geometry.geodesy import to_geodetic
from conetl.web.models import Projection
from conetl.web.parameters import MapName, Reader, origin_of

#: Half the side of the square in which the polynomials hold; the page asks for others beyond it.
RADIUS_M = 20_000.0
#: Largest error of both polynomials within RADIUS_M; a CRS that bends more has none.
TOLERANCE_M = 0.01
_DEGREE = 5
_METRES_PER_DEGREE = 111_320.0
#: Points per side of the fitted and of the checked grid.
_FITTED, _CHECKED = 13, 8
Metres = Annotated[float, Query(ge=-5e6, le=5e6, allow_inf_nan=False)]
Floats = NDArray[np.float64]
router = APIRouter(tags=["maps"])


@router.get("/maps/{map_name}/projection")
def projection(map_name: MapName, conn: Reader, x_m: Metres = 0.0, y_m: Metres = 0.0) -> Projection:
    """Polynomials between offsets from the map's origin and WGS 84, around the offset (x_m, y_m)."""
    origin = origin_of(conn, map_name)
    info = find_map(conn, map_name)
    try:
        return fit_projection(info.srid if info else 0, origin, (x_m, y_m))
    except ValueError as error:
        raise HTTPException(404, f"Longitude and latitude of the map {map_name} are unknown here: {error}") from error


@lru_cache(maxsize=64)
def fit_projection(srid: int, origin_m: tuple[float, float, float], centre_m: tuple[float, float]) -> Projection:
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
        raise ValueError(f"EPSG:{srid} bends too much there")
    return Projection(
        centre_m=list(centre_m), radius_m=RADIUS_M, lon_deg=float(lon0), lat_deg=float(lat0), degree=_DEGREE,
        unit_per_degree=_scale(lat0).tolist(), to_degrees=to_degrees.T.tolist(), to_metres=to_metres.T.tolist(),
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
