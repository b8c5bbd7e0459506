"""Surveyed check points against the cones of a map: residuals and RMSE of each axis (ASPRS Positional Accuracy Standards, 2023).

Check points take part in nothing: they only judge the map.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError
from scipy.stats import chi2

from conetl.evaluation.truth import paired
from conetl.geometry import geodesy
from conetl.geometry.packing import cov_matrix
from conetl.model.errors import DriveFolderError, InputError
from conetl.model.map_records import MapFeature
from conetl.readers.maps.tables import MapTable, read_table
from conetl.readers.trajectories.earth import in_wgs84
from conetl.readers.trajectories.recorded import Reading, Records
from conetl.readers.trajectories.settings import TrajectoryFile

Floats = NDArray[np.float64]
_NAMES = ("name", "id", "point", "point_id", "cone_id", "nr", "no")
_HEIGHTS = ("height_m", "height", "h", "z")
_SIGMAS = ("sigma_e_m", "sigma_n_m", "sigma_u_m")
#: Probability below which residuals contradict the stated sigmas.
_CONTRADICTS = 1e-3


class CheckPoint(NamedTuple):
    """A surveyed point in the CRS of the map, with ellipsoidal height; a cone's foot stands on it."""

    name: str
    xyz_m: Floats
    """(3,)"""
    sigma_m: Floats
    """(3,) east, north, up."""


class PointResidual(NamedTuple):
    """A check point and the cone that stands on it, None where the map has none."""

    point: CheckPoint
    feature: MapFeature | None
    difference_m: Floats | None
    """(3,) map minus point: east, north, up."""


class CheckedMap(NamedTuple):
    """The residuals of all points, and what they say together."""

    residuals: list[PointResidual]
    rmse_m: Floats | None
    """(5,) of east, north, up, horizontal, 3D; None without a point on a cone."""
    mean_m: Floats | None
    """(3,) of east, north, up: a systematic part, such as that of another datum."""
    nees: float | None
    """Mean squared residual in stated sigmas of map and point, per axis: 1 where they are true."""
    contradicts: bool
    """Whether that is improbable (below 0.1 %) with the stated sigmas. Residuals of one drive are correlated: no proof."""


def read_check_points(
    path: Path, srid: int, *, crs: str | None = None, heights: str | None = None, sigma_m: float | None = None
) -> list[CheckPoint]:
    """Check points of a CSV, GeoJSON, GeoPackage, FlatGeobuf or GeoParquet file, in the CRS of a map (srid).

    crs: of the file, unless it states one; heights: `ellipsoidal`, or their system, such as EPSG:5773. sigma_m: of the survey,
    unless the columns sigma_e_m, sigma_n_m, sigma_u_m state it. Raises InputError.
    """
    table = read_table(path)
    source = crs or (table.crs.to_wkt() if table.crs is not None else None)
    if source is None:
        raise InputError(f"{path}: states no coordinate reference system; give it with --crs, like EPSG:25832")
    xyz = _with_heights(table)
    if not np.isfinite(xyz).all():
        row = int(np.flatnonzero(~np.isfinite(xyz).all(axis=1))[0]) + 1
        raise InputError(f"{path}, row {row}: a check point needs east, north and a height ({', '.join(_HEIGHTS)})")
    settings = TrajectoryFile(crs=source, heights=heights)
    try:
        geographic = CRS.from_user_input(source).is_geographic
    except CRSError as error:
        raise InputError(f"{path}: --crs {source[:60]} is not known to PROJ; expected one like EPSG:25832") from error
    own = xyz[:, [1, 0, 2]] if geographic else xyz
    count = len(own)
    records = Records(np.zeros(count, np.int64), own, None, np.full((count, 6), np.nan), {})
    try:
        reading = Reading(iter([records]), axes="geodetic" if geographic else "projected")
        lat, lon, height = np.vstack([piece.positions for piece in in_wgs84(reading, settings, path)]).T
        xyz = geodesy.to_map(srid, lat, lon, height)
    except DriveFolderError as error:
        raise InputError(str(error)) from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    sigmas = _sigmas(table, sigma_m, path)
    names = next((table.columns[name] for name in _NAMES if name in table.columns), None) or range(1, count + 1)
    return [CheckPoint(str(name), p, s) for name, p, s in zip(names, xyz, sigmas, strict=True)]


def _with_heights(table: MapTable) -> Floats:
    """(N, 3) positions of the rows, with heights of their geometry or else of a column; NaN where there are none."""
    xyz, column = table.xyz.copy(), next((table.columns[name] for name in _HEIGHTS if name in table.columns), None)
    if column is not None and np.isnan(xyz[:, 2]).all():
        try:
            xyz[:, 2] = [np.nan if value is None else float(value) for value in column]
        except (TypeError, ValueError) as error:
            raise InputError(f"{table.path}: a height is no number: {error}") from error
    return xyz


def _sigmas(table: MapTable, sigma_m: float | None, path: Path) -> Floats:
    """(N, 3). Raises InputError."""
    if sigma_m is None and not all(name in table.columns for name in _SIGMAS):
        raise InputError(f"{path}: states no sigmas of the survey ({', '.join(_SIGMAS)}); give one with --sigma-m")
    try:
        found = (
            np.full((len(table), 3), sigma_m)
            if sigma_m is not None
            else np.array([[float(v) for v in table.columns[name]] for name in _SIGMAS]).T
        )
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: a sigma is no number: {error}") from error
    if not (found > 0).all():
        raise InputError(f"{path}: sigmas must be above 0 m")
    return found


def check_map(points: Sequence[CheckPoint], features: Sequence[MapFeature], *, within_m: float = 0.75) -> CheckedMap:
    """Residuals of a map at check points. A cone stands on a point if it is nearest to it, and at most within_m away in 3D."""
    truth = np.array([point.xyz_m for point in points]).reshape(-1, 3)
    found = np.array([feature.xyz_m for feature in features]).reshape(-1, 3)
    pairs = paired(truth, found, within_m)
    residuals = [
        PointResidual(point, features[pairs[i]], found[pairs[i]] - truth[i])
        if i in pairs
        else PointResidual(point, None, None)
        for i, point in enumerate(points)
    ]
    if not pairs:
        return CheckedMap(residuals, None, None, None, contradicts=False)
    d = np.array([r.difference_m for r in residuals if r.difference_m is not None])
    squares = (d**2).mean(axis=0)
    rmse = np.sqrt([*squares, squares[0] + squares[1], squares.sum()])
    total = sum(
        float(
            r.difference_m @ np.linalg.solve(cov_matrix(r.feature.cov_m2) + np.diag(r.point.sigma_m**2), r.difference_m)
        )
        for r in residuals
        if r.feature is not None and r.difference_m is not None
    )
    contradicts = bool(chi2.sf(total, 3 * len(d)) < _CONTRADICTS)
    return CheckedMap(residuals, rmse, d.mean(axis=0), total / (3 * len(d)), contradicts=contradicts)
