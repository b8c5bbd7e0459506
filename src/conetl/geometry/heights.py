"""Height systems: ellipsoidal heights, which maps store, into those above a geoid or of a national network, by PROJ's grids."""

from __future__ import annotations

import re
import warnings
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS, Transformer
from pyproj.crs import CompoundCRS
from pyproj.datadir import get_user_data_dir  # type: ignore[attr-defined]
from pyproj.exceptions import CRSError, ProjError
from pyproj.transformer import AreaOfInterest, TransformerGroup

from conetl.geometry.geodesy import check_map_srid
from conetl.model.errors import InputError

#: Name of the height system of a map that states none.
ELLIPSOIDAL = "ellipsoidal"
_CODES = re.compile(r"(?:EPSG:)?(\d{4,6})(?:\+(?:EPSG:)?(\d{4,6}))?", re.IGNORECASE)


def system_name(vertical_srid: int | None) -> str:
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
    """`parse_crs` of a CRS that a map can have: projected, in metres, and heights for which the grids are installed."""
    srid, vertical_srid = parse_crs(text)
    try:
        check_map_srid(srid)
    except ValueError as error:
        raise InputError(f"{error}: choose another one, for example EPSG:25832") from error
    if vertical_srid is not None:
        _transformer(srid, srid, vertical_srid)
    return srid, vertical_srid


def compound_crs(srid: int, vertical_srid: int | None) -> CRS:
    """The CRS of both codes; of the first one alone where there is no height system."""
    flat = _known(srid)
    if vertical_srid is None:
        return flat
    vertical = _known(vertical_srid)
    return CompoundCRS(f"{flat.name} + {vertical.name}", [flat, vertical])


def to_crs(xyz_m: ArrayLike, source_srid: int, srid: int, vertical_srid: int | None) -> NDArray[np.float64]:
    """Positions (N, 3) with ellipsoidal heights in metres -> (N, 3) in EPSG:srid with heights of the system.

    Geographic CRS have longitude, latitude in degrees. Raises InputError where a grid is missing, which it names, or a position
    is outside of the area.
    """
    xyz = np.asarray(xyz_m, dtype=np.float64).reshape(-1, 3)
    if (source_srid == srid and vertical_srid is None) or not len(xyz):
        return xyz
    try:
        done = np.column_stack(_transformer(source_srid, srid, vertical_srid).transform(*xyz.T))
    except ProjError as error:
        raise InputError(f"positions cannot be transformed into {_named(srid, vertical_srid)}: {error}") from error
    lost = int((~np.isfinite(done).all(axis=1)).sum())
    if lost:
        raise InputError(f"{lost} of {len(xyz)} positions are outside of the area of {_named(srid, vertical_srid)}")
    return done


def to_ellipsoidal(xyz_m: ArrayLike, crs: CRS) -> NDArray[np.float64]:
    """Positions (N, 3) in a compound CRS -> the same with ellipsoidal heights. Raises InputError, which names a missing grid."""
    srid, vertical_srid = (part.to_epsg() for part in crs.sub_crs_list)
    if srid is None or vertical_srid is None:
        raise InputError(f"the CRS {crs.name} has no EPSG codes of its parts: convert the file to ellipsoidal heights")
    transformer = _transformer(srid, srid, vertical_srid)
    xyz = np.asarray(xyz_m, dtype=np.float64).reshape(-1, 3)
    return np.column_stack(transformer.transform(xyz[:, 0], xyz[:, 1], xyz[:, 2], direction="INVERSE"))


def turns(xyz_m: ArrayLike, source_srid: int, srid: int) -> NDArray[np.float64]:
    """Rotations (N, 2, 2) of the axes of EPSG:source_srid into those of EPSG:srid at positions (N, 3), for covariances.

    Both are conformal to a few parts in a thousand, so their axes differ by the convergence of the grids; scale is left out.
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


def _named(srid: int, vertical_srid: int | None) -> str:
    return f"EPSG:{srid}" + (f"+{vertical_srid}" if vertical_srid else "")


def _known(code: int) -> CRS:
    try:
        return CRS.from_epsg(code)
    except CRSError as error:
        raise InputError(f"EPSG:{code} is not known to PROJ: check the code") from error


def operations(source: CRS, target: CRS, area: AreaOfInterest | None) -> TransformerGroup:
    """PROJ's transformations, the best first; never one that leaves heights as they are for want of a grid.

    Raises ProjError or CRSError.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a missing grid is an error of the caller
        return TransformerGroup(source, target, True, area, allow_ballpark=False)


def missing_grids(group: TransformerGroup) -> list[str]:
    """Names of the grids that the best transformation lacks of those that PROJ cannot do."""
    lacking = ([g.short_name for g in op.grids if not g.available] for op in group.unavailable_operations)
    return next(filter(None, lacking), [])


def around(lon: float, lat: float) -> AreaOfInterest | None:
    """Where a file begins (degrees), for PROJ's choice between its transformations; None near a pole or the antimeridian."""
    if not (abs(lon) < 179 and abs(lat) < 89):
        return None
    return AreaOfInterest(lon - 0.05, lat - 0.05, lon + 0.05, lat + 0.05)


@cache
def _transformer(source_srid: int, srid: int, vertical_srid: int | None) -> Transformer:
    """From EPSG:source_srid with ellipsoidal heights."""
    source, flat = _known(source_srid).to_3d(), _known(srid)
    target = flat.to_3d() if vertical_srid is None else compound_crs(srid, vertical_srid)
    use = _known(source_srid).area_of_use
    area = AreaOfInterest(*use.bounds) if use is not None and use.west < use.east else None
    try:
        group = operations(source, target, area)
    except (ProjError, CRSError) as error:
        raise InputError(f"no transformation to {_named(srid, vertical_srid)}: {error}") from error
    missing = missing_grids(group)
    if vertical_srid is not None and missing and not (group.transformers and group.best_available):
        raise InputError(
            f"heights of EPSG:{vertical_srid} ({_known(vertical_srid).name}) need the grid {missing[0]}, which is not installed: "
            f"put it into {get_user_data_dir()} (`projsync --file {missing[0]}` does)"
        )
    if not group.transformers:
        raise InputError(f"PROJ has no transformation from EPSG:{source_srid} to {_named(srid, vertical_srid)}")
    return group.transformers[0]
