"""Surveyed points of a file of any map format: control points of a drive, check points of a map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from conetl.files.documents import input_errors, shown
from conetl.files.names import printable
from conetl.geometry import geodesy
from conetl.model.arrays import Floats
from conetl.model.drive import SurveyedPoint
from conetl.model.errors import InputError
from conetl.readers.base_layers.georeferencing import parse_crs
from conetl.readers.maps.tables import HEIGHTS, MapTable, add_heights, numbers_of, read_table
from conetl.readers.stated_sigmas import require_exact
from conetl.readers.trajectories.earth import in_wgs84
from conetl.readers.trajectories.recorded import Reading, Records
from conetl.readers.trajectories.settings import TrajectoryFile

#: A surveyor measures a hundredth of them.
MOST_POINTS = 50_000
_NAMES = ("name", "id", "point", "point_id", "cone_id", "nr", "no")
_SIGMAS = ("sigma_e_m", "sigma_n_m", "sigma_u_m")


def read_surveyed_points(
    path: Path, srid: int, *, crs: str | None = None, heights: str | None = None, sigma_m: float | None = None
) -> list[SurveyedPoint]:
    """Points of a CSV, GeoJSON, GeoPackage, FlatGeobuf or GeoParquet file, in the CRS of a map (srid).

    crs: of the file, unless it states one; heights: `ellipsoidal`, or their system, such as EPSG:5773. sigma_m: of the survey,
    unless the columns sigma_e_m, sigma_n_m, sigma_u_m state it. Raises InputError.
    """
    table = read_table(path, most_rows=MOST_POINTS)
    source = crs or (table.crs.to_wkt() if table.crs is not None else None)
    if source is None:
        raise InputError(f"{path}: does not state a coordinate reference system; give its crs (--crs), like EPSG:25832")
    settings = TrajectoryFile(crs=source, heights=heights)
    with input_errors(f"{path}: crs"):
        own_crs = parse_crs(source)
    add_heights(table, own_crs, of_points=True)
    xyz, geographic = table.xyz, own_crs.is_geographic
    _require_finite(path, xyz, f"a point needs east, north and a height ({', '.join(HEIGHTS)})")
    own = xyz[:, [1, 0, 2]] if geographic else xyz
    count = len(own)
    records = Records(np.zeros(count, np.int64), own, None, np.full((count, 6), np.nan), {})
    with input_errors(path):
        reading = Reading(iter([records]), axes="geodetic" if geographic else "projected")
        lat, lon, height = np.vstack([piece.positions for piece in in_wgs84(reading, settings, path)]).T
        xyz = geodesy.to_map(srid, lat, lon, height)
    _require_finite(path, xyz, f"the point is outside the area of {shown(source)} or of EPSG:{srid}")
    sigmas = _sigmas(table, sigma_m, path)
    require_exact(table, own_crs, sigmas)
    names = next((table.columns[name].to_pylist() for name in _NAMES if name in table.columns), range(1, count + 1))
    return [
        SurveyedPoint(name=printable(str(name))[:60], xyz_m=tuple(p), sigma_m=tuple(s))
        for name, p, s in zip(names, xyz.tolist(), sigmas.tolist(), strict=True)
    ]


def _require_finite(path: Path, xyz: Floats, problem: str) -> None:
    for row in np.flatnonzero(~np.isfinite(xyz).all(axis=1))[:1]:
        raise InputError(f"{path}, row {row + 1}: {problem}")


def _sigmas(table: MapTable, sigma_m: float | None, path: Path) -> Floats:
    """(N, 3). Raises InputError."""
    if sigma_m is None and not all(name in table.columns for name in _SIGMAS):
        raise InputError(
            f"{path}: does not state the sigmas of the survey ({', '.join(_SIGMAS)}); give one sigma_m (--sigma-m)"
        )
    stated = [
        np.full(len(table), sigma_m) if sigma_m is not None else numbers_of(path, name, table.columns[name])
        for name in _SIGMAS
    ]
    found = np.column_stack(stated)
    if not ((found > 0) & np.isfinite(found)).all():
        raise InputError(f"{path}: sigmas must be above 0 m")
    return found
