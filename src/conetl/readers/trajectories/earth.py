"""Positions and heights of a trajectory file in its coordinate reference system (CRS) -> WGS 84, ellipsoidal heights, by PROJ.

Heights above a geoid need PROJ's grid of that geoid. Without it PROJ would leave the heights as they are; here it is an error
that names the grid.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path, PurePath

import numpy as np
from pyproj import CRS, Transformer
from pyproj.crs import CompoundCRS
from pyproj.datadir import get_data_dir, get_user_data_dir  # type: ignore[attr-defined]
from pyproj.exceptions import ProjError

from conetl.files.documents import library_errors, shown
from conetl.geometry import geodesy
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.base_layers.georeferencing import parse_crs
from conetl.readers.trajectories.recorded import VERTICAL_FACTOR, Axes, Reading, Records
from conetl.readers.trajectories.settings import TrajectoryFile

UNSTATED_HEIGHT_SIGMA_M = 100.0
"""Sigma of heights that may be ellipsoidal or above the sea: the geoid is up to 107 m from the ellipsoid."""
_NOMINAL_M = 2.0
"""Datum shifts without a grid that PROJ states to be at least this accurate (ETRS89 or NAD83 to WGS 84, 1 to 2 m) are names of
the same frame for the receivers of a region; their accuracy is not added to the sigmas."""
_YEAR_NS = 365.2425 * 86400e9
_GRID_SUFFIXES = (".tif", ".gtx")


def unstated_heights(path: Path) -> str:
    """What to say of a file whose heights may be of either kind."""
    return (
        f"{path}: does not state whether its heights are above sea level or the ellipsoid: vertical sigma "
        f"{UNSTATED_HEIGHT_SIGMA_M:g} m. Put into drive.yaml, below trajectory, heights: 'EPSG:5773' (sea level, EGM96) or "
        "heights: ellipsoidal"
    )


def in_wgs84(reading: Reading, settings: TrajectoryFile, path: Path) -> Iterator[Records]:
    """The records with latitude, longitude (degrees) and ellipsoidal height (m). Raises InputError.

    Sigmas are increased by the stated accuracy of a geoid model or datum shift.
    """
    steps: list[Transformer] = []
    accuracy_m = 0.0
    shift: Transformer | None = None
    unstated = reading.heights == "unstated" and settings.heights is None and settings.crs is None
    for piece in reading.pieces:
        if not steps and _needs_transformation(reading, settings, path):
            usable = np.flatnonzero(np.isfinite(piece.positions).all(axis=1))
            if not len(usable):
                yield piece
                continue
            steps, accuracy_m = _transformers(reading.axes, settings, piece.positions[usable[0]], path)
        if unstated or accuracy_m:
            vertical_m = UNSTATED_HEIGHT_SIGMA_M if unstated else accuracy_m
            piece = piece._replace(sigma=_increased(piece.sigma, accuracy_m, vertical_m))  # noqa: PLW2901
        found = _transformed(steps, reading.axes, piece, settings) if steps else piece
        if settings.frame is not None or settings.map_frame is not None:
            usable = np.flatnonzero(np.isfinite(found.positions).all(axis=1))
            if shift is None and len(usable):
                shift = _between_frames(settings, found.positions[usable[0]])
            found = found if shift is None else _shifted(shift, found)
        yield found


def _between_frames(settings: TrajectoryFile, start: Floats) -> Transformer:
    """From the frame of the positions to that of the map, where a file begins (3,). Raises InputError."""
    if settings.frame is None or settings.map_frame is None:
        raise InputError(
            "drive.yaml: trajectory.frame (of the positions, like ITRF2020) and trajectory.map_frame (of the map's coordinates, "
            "like ETRF2000) belong together: state both"
        )
    known = {key: _crs(getattr(settings, key), key) for key in ("frame", "map_frame")}
    for key, crs in known.items():
        if not crs.is_geographic:
            raise InputError(f"drive.yaml: trajectory.{key}: {shown(crs.name)} is not the name of a frame")
    source, target = (crs.to_3d() for crs in known.values())
    lat, lon = (float(value) for value in start[:2])
    with library_errors("drive.yaml: trajectory.frame, map_frame", ProjError, ValueError):
        group = geodesy.operations(source, target, geodesy.area_of_interest(lon, lat))
    if not group.transformers or not group.best_available:
        raise InputError(
            f"drive.yaml: trajectory.frame, map_frame: PROJ has no transformation from {shown(source.name)} to "
            f"{shown(target.name)} at {lat:.1f}, {lon:.1f} degrees: transform the positions first"
        )
    return group.transformers[0]


def _shifted(shift: Transformer, piece: Records) -> Records:
    """The records in another frame, each at its own time."""
    years = 1970 + piece.times_ns / _YEAR_NS
    lat, lon, height = piece.positions.T
    with library_errors("drive.yaml: trajectory.frame, map_frame", ProjError, ValueError):
        lon, lat, height = shift.transform(lon, lat, height, years)[:3]
    positions = np.column_stack([lat, lon, height])
    positions[~np.isfinite(positions)] = np.nan
    return piece._replace(positions=positions)


def _increased(sigma: Floats, horizontal_m: float, vertical_m: float) -> Floats:
    """Sigmas (N, 6) with the error of a datum shift or geoid. A height without one has 1.5 times the horizontal one."""
    sigma = sigma.copy()
    sigma[~(sigma > 0.0)] = np.nan
    own_up = np.where(np.isnan(sigma[:, 2]), VERTICAL_FACTOR * sigma[:, :2].max(axis=1), sigma[:, 2])
    sigma[:, :2] = np.hypot(sigma[:, :2], horizontal_m)
    sigma[:, 2] = np.hypot(np.where(np.isnan(own_up), 0.0, own_up), vertical_m)
    return sigma


def _transformed(steps: list[Transformer], axes: Axes, piece: Records, settings: TrajectoryFile) -> Records:
    """The same records in WGS 84; those that a step cannot express are wrong."""
    x, y, z = piece.positions.T
    if axes == "geodetic":
        x, y = y, x
    with library_errors("trajectory.crs, heights", ProjError, ValueError):
        for step in steps:
            x, y, z = step.transform(x, y, z)
    positions = np.column_stack([y, x, z])
    lost = np.isfinite(piece.positions).all(axis=1) & ~np.isfinite(positions).all(axis=1)
    positions[~np.isfinite(positions)] = np.nan
    text = f"the position is outside the area of {shown(settings.heights or settings.crs or 'EPSG:4978')}"
    return piece._replace(positions=positions, wrong=dict.fromkeys(np.flatnonzero(lost).tolist(), text) | piece.wrong)


def _needs_transformation(reading: Reading, settings: TrajectoryFile, path: Path) -> bool:
    """Raises InputError where the settings lack what the file requires."""
    if reading.axes == "projected" and settings.crs is None:
        raise InputError(
            f"{path}: has easting and northing, but does not state their coordinate reference system: put "
            "trajectory: {crs: 'EPSG:25832'} into drive.yaml"
        )
    stated = settings.heights is not None or (settings.crs is not None and _crs(settings.crs, "crs").is_compound)
    if reading.heights == "sea level" and not stated:
        raise InputError(
            f"{path}: its heights are above sea level, the map's are above the WGS 84 ellipsoid: put the geoid into drive.yaml, "
            "trajectory: {heights: 'EPSG:5773'} (EGM96), or export ellipsoidal heights"
        )
    geoid = settings.heights not in {None, "ellipsoidal"}
    return geoid or settings.crs is not None or reading.axes in {"projected", "geocentric"}


def is_geocentric(settings: TrajectoryFile) -> bool:
    """Whether the CRS of the settings has its origin in the earth's centre. Raises InputError if PROJ does not know it."""
    return settings.crs is not None and _crs(settings.crs, "crs").is_geocentric


def _crs(text: str, key: str) -> CRS:
    try:
        return parse_crs(text)
    except ValueError as error:
        example = {"crs": "EPSG:25832", "frame": "ITRF2020", "map_frame": "ETRF2000"}.get(
            key, "ellipsoidal, EPSG:5773 or the name of a geoid grid"
        )
        raise InputError(
            f"drive.yaml: trajectory.{key}: {shown(text)} is not known to PROJ; expected for example {example}"
        ) from error


def _transformers(axes: Axes, settings: TrajectoryFile, start: Floats, path: Path) -> tuple[list[Transformer], float]:
    """Steps to longitude, latitude, ellipsoidal height (WGS 84) for a file that begins at `start` (3,); their accuracy (m)."""
    source = _crs(settings.crs or ("EPSG:4978" if axes == "geocentric" else "EPSG:4979"), "crs")
    flat = source.sub_crs_list[0] if source.is_compound else source
    kinds = {"geodetic": flat.is_geographic, "geocentric": flat.is_geocentric, "projected": flat.is_projected}
    if not kinds.get(axes, False):
        raise InputError(f"{path}: has {axes} coordinates; trajectory.crs in drive.yaml, {shown(source.name)}, has not")
    after: list[Transformer] = []
    geoid = settings.heights if settings.heights != "ellipsoidal" and axes != "geocentric" else None
    if geoid is not None and source.is_compound:
        raise InputError("drive.yaml: trajectory.crs has heights of its own: leave out trajectory.heights")
    if geoid is not None and not geoid.lower().endswith(_GRID_SUFFIXES):
        vertical = _crs(geoid, "heights")
        if not vertical.is_vertical:
            raise InputError(
                f"drive.yaml: trajectory.heights: {shown(vertical.name)} is not a CRS of heights; EPSG:5773 (EGM96) is one"
            )
        source = CompoundCRS(
            f"{flat.name} + {vertical.name}", [flat.to_2d() if len(flat.axis_info) > 2 else flat, vertical]
        )
    elif not source.is_compound and not source.is_geocentric:
        source = source.to_3d()
    if geoid is not None and geoid.lower().endswith(_GRID_SUFFIXES):
        after.append(_grid(geoid, path))
    with library_errors(f"{path}: no transformation from {shown(source.name)} to WGS 84", ProjError, ValueError):
        x, y = (start[1], start[0]) if axes == "geodetic" else (start[0], start[1])
        lon, lat = Transformer.from_crs(
            flat, CRS(4979) if flat.is_geocentric else flat.geodetic_crs, always_xy=True
        ).transform(x, y, start[2])[:2]
        group = geodesy.operations(source, CRS(4979), geodesy.area_of_interest(lon, lat))
    missing = geodesy.missing_grids(group)
    if not group.transformers or (missing and not group.best_available):
        raise InputError(_missing(path, source.name, missing))
    # Steps that are more than a change of names.
    shifts = [one for one in group.transformers[0].operations or () if one.grids or one.accuracy > _NOMINAL_M]
    return [group.transformers[0], *after], math.hypot(*(one.accuracy for one in shifts if one.accuracy > 0))


def _grid(name: str, path: Path) -> Transformer:
    """From heights above a geoid to ellipsoidal ones, by a grid beside the file or in PROJ's folders; in degrees."""
    if PurePath(name).name != name or not all(c.isalnum() or c in "._-" for c in name):
        raise InputError(
            f"drive.yaml: trajectory.heights: {shown(name)}: expected the name of a grid file (letters, digits, . _ -) without a "
            f"folder; put the file beside {path.name} or into {get_user_data_dir()}"
        )
    folders = [
        path.resolve().parent,
        Path(get_user_data_dir()),
        *map(Path, get_data_dir().split(os.pathsep)),
    ]
    found = next((folder / name for folder in folders if (folder / name).is_file()), None)
    if found is None:
        raise InputError(_missing(path, f"the geoid {name}", [name]))
    steps = (
        "unitconvert +xy_in=deg +xy_out=rad",
        f'vgridshift +grids="{found}" +multiplier=1',
        "unitconvert +xy_in=rad +xy_out=deg",
    )
    with library_errors(f"{found}: PROJ cannot read this geoid grid", ProjError, ValueError):
        return Transformer.from_pipeline("+proj=pipeline " + " ".join(f"+step +proj={step}" for step in steps))


def _missing(path: Path, what: str, grids: list[str]) -> str:
    if not grids:
        return (
            f"{path}: PROJ has no transformation from {shown(what)} to WGS 84 at the first position: check this CRS and the "
            "order of the coordinates, or export latitude, longitude and ellipsoidal height"
        )
    named = ", ".join(grids)
    return (
        f"{path}: heights or positions of {shown(what)} need the grid {named}, which is not installed: put it into "
        f"{get_user_data_dir()} (`pyproj sync --file {grids[0]}` does)"
    )
