"""Rows of a map file -> checked statements in the map's CRS. A file with a bad row is refused: no map is imported in part."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS, Transformer

from conetl.files.documents import input_errors
from conetl.files.parquet_store import file_sha256
from conetl.geometry.geodesy import check_map_srid, to_ellipsoidal, utm_srid
from conetl.model.arrays import Floats
from conetl.model.base import MAX_HEIGHT_M, MIN_HEIGHT_M, ns_from_utc, utc_from_ns
from conetl.model.errors import InputError
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.map_records import ImportedMap
from conetl.model.params import ImportParams
from conetl.readers.base_layers.georeferencing import in_area, parse_crs
from conetl.readers.maps.statements import EARLIEST_NS, NO_TIME, StatementRows
from conetl.readers.maps.tables import MapTable, add_heights, read_table
from conetl.readers.stated_sigmas import require_exact
from conetl.readers.trajectories.times import DAY_NS, clock_problem

#: Coordinates may be outside the area of use of their CRS by this much (degrees): maps at a zone's edge.
_MARGIN_DEG = 3.0
#: Columns that only exports of history and of changes have.
_HISTORY_COLUMNS = ("system_from", "change", "old_easting_m")
_WGS84 = CRS("OGC:CRS84")


def read_map_file(
    path: Path,
    params: ImportParams,
    *,
    crs: str | None = None,
    map_srid: int | None = None,
    stated_at: datetime | None = None,
    layer: str | None = None,
) -> ImportedMap:
    """Read and check a map file. Raises InputError naming the file, and the row (from 1, without a header).

    crs: of the file's coordinates; it must agree with that of the file, if it has one. map_srid: CRS of the map; None: the
    file's own, if it is suitable. stated_at: time of the survey; None: the latest `last_seen_at`. layer: the one to read of
    several.
    """
    table = read_table(path, layer)
    for name in _HISTORY_COLUMNS:
        if name in table.columns:
            raise InputError(
                f"{path} is an export of history or changes (column {name}); export features to import them"
            )
    file_crs = _file_crs(table, crs)
    add_heights(table, file_crs)
    if file_crs.is_compound:
        try:
            table.xyz[:] = to_ellipsoidal(table.xyz, file_crs)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        file_crs = file_crs.sub_crs_list[0]
    _require_all(table, file_crs, map_srid, params, stated_at)
    srid = _map_srid(table, file_crs, map_srid)
    xyz_m = _positions(table, file_crs, srid, params)
    sha256 = file_sha256(path)
    if table.layer not in (None, *table.layers[:1]):  # the hash identifies an import: of a later layer, that of both
        sha256 = hashlib.sha256(f"{sha256}/{table.layer}".encode()).hexdigest()
    rows = StatementRows(table, params)
    seen_ns = rows.instants_ns("last_seen_at")
    rows.require_all()
    latest_ns = None if (seen_ns == NO_TIME).all() else int(seen_ns.max())
    stated_ns = latest_ns if stated_at is None else ns_from_utc(stated_at)
    if stated_ns is None:
        raise InputError(f"{path} does not state times: give the time of the survey (--surveyed-at)")
    if problem := clock_problem(stated_ns, EARLIEST_NS):
        raise InputError(f"{path}: the time of the survey (--surveyed-at), {stated_at}, {problem}; nothing was written")
    if latest_ns is not None and stated_ns - latest_ns > 2 * DAY_NS:
        raise InputError(
            f"{path}: the time of the survey (--surveyed-at), {stated_at}, is more than two days after the latest last_seen_at, "
            f"{utc_from_ns(latest_ns)}: leave it out, or remove this column; nothing was written"
        )
    rows.check(xyz_m, stated_ns, seen_ns, sha256)
    _require_different_objects(path, xyz_m, rows.categories)
    require_exact(table, file_crs, rows.sigmas_m)
    name = f"{path.name}:{table.layer}" if len(table.layers) > 1 else path.name
    written = table.xyz[:, :2] if file_crs.is_projected else None
    classes, lines = Counter(rows.categories), table.lines_left_out
    return ImportedMap(name, str(path), sha256, srid, stated_ns, rows, classes, rows.new_ids, lines, written)


def _require_all(
    table: MapTable, file_crs: CRS, map_srid: int | None, params: ImportParams, stated_at: datetime | None
) -> None:
    """Raise one InputError where a file lacks more than one thing that the user has to state."""
    wanted = []
    if map_srid is None and file_crs.is_geographic:
        wanted.append("the CRS of the new map (--map-srid)")
    if params.ground_height_m is None and np.isnan(table.xyz[:, 2]).any():
        wanted.append("the ellipsoidal height of the ground (--ground-height-m)")
    if stated_at is None and "last_seen_at" not in table.columns:
        wanted.append("the time of the survey (--surveyed-at)")
    if len(wanted) > 1:
        raise InputError(
            f"{table.path} does not have {', '.join(wanted[:-1])} and {wanted[-1]}: state them"
            + (_zone_hint(table, file_crs) if map_srid is None and file_crs.is_geographic else "")
        )


def _file_crs(table: MapTable, stated: str | None) -> CRS:
    with input_errors("--crs"):
        wanted = None if stated is None else parse_crs(stated)
    crs = table.crs or wanted
    if crs is None:
        raise InputError(f"{table.path} does not state the CRS of its coordinates: give it with --crs EPSG:...")
    if table.crs is not None and wanted is not None and not _same(table.crs, wanted):
        raise InputError(f"{table.path} has the CRS {table.crs.name}, but --crs is {wanted.name}: which is right?")
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    if not (flat.is_geographic or flat.is_projected):
        raise InputError(f"{table.path}: {crs.name} is neither geographic nor projected")
    return crs


def _same(a: CRS, b: CRS) -> bool:
    both_wgs84 = all(crs.is_geographic and crs.to_2d().equals(_WGS84, ignore_axis_order=True) for crs in (a, b))
    return both_wgs84 or a.equals(b, ignore_axis_order=True)


def _map_srid(table: MapTable, crs: CRS, map_srid: int | None) -> int:
    srid = map_srid if map_srid is not None or not crs.is_projected else crs.to_epsg()
    if srid is None:
        raise InputError(f"{table.path} would create a new map: state its CRS (--map-srid){_zone_hint(table, crs)}")
    try:
        check_map_srid(srid)
    except ValueError as error:
        raise InputError(f"{error}: choose another one (--map-srid)") from error
    return srid


def _zone_hint(table: MapTable, crs: CRS) -> str:
    """The UTM zone of the first cone; empty outside of UTM."""
    lon, lat = _to_wgs84(crs, table.xyz[:1])[0]
    try:
        srid = utm_srid(float(lat), float(lon))
    except ValueError:
        return ""
    return f"; the first cone, at longitude {lon:.4f}, latitude {lat:.4f}, would be in EPSG:{srid}"


def _positions(table: MapTable, crs: CRS, srid: int, params: ImportParams) -> Floats:
    """(n, 3) in the map's CRS. Raises InputError naming the first row whose position is invalid or outside its area of use."""

    def require(good: Any, problem: Callable[[int], str]) -> None:
        for index in np.flatnonzero(~np.asarray(good, bool))[:1].tolist():
            raise InputError(f"{table.path}, row {index + 1}: {problem(index)}; nothing was written")

    xyz = table.xyz.copy()
    if params.ground_height_m is not None:
        xyz[np.isnan(xyz[:, 2]), 2] = params.ground_height_m
    no_height = np.isfinite(xyz[:, :2]).all(axis=1) & np.isnan(xyz[:, 2])
    require(~no_height, lambda _: "the cone has no height; state the ground's ellipsoidal one (--ground-height-m)")
    require(np.isfinite(xyz).all(axis=1), lambda i: f"the position {_text(xyz[i])} is not finite")
    if crs.is_geographic:
        require(
            (np.abs(xyz[:, 1]) <= 90) & (np.abs(xyz[:, 0]) <= 180),
            lambda i: f"{_text(xyz[i, :2])} is not longitude, latitude in degrees: swapped, or is --crs wrong?",
        )
    target = CRS.from_epsg(srid)
    lon_lat = _to_wgs84(crs, xyz)

    def outside(index: int) -> str:
        axes = "longitude and latitude" if crs.is_geographic else "easting and northing"
        swapped = in_area(target, _to_wgs84(crs, xyz[[index]][:, [1, 0, 2]]), _MARGIN_DEG)[0]
        hint = f"{axes} are swapped" if swapped else "is --crs the CRS of the file's coordinates?"
        name = f"EPSG:{srid} ({target.name})"
        return f"{_text(xyz[index, :2])} is outside the area of use of the map's CRS {name}: {hint}"

    require(in_area(target, lon_lat, _MARGIN_DEG), outside)
    east, north = Transformer.from_crs(crs, target, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    require(np.isfinite(east) & np.isfinite(north), lambda i: f"{_text(xyz[i])} cannot be expressed in EPSG:{srid}")
    heights = xyz[:, 2]
    require(
        (heights >= MIN_HEIGHT_M) & (heights <= MAX_HEIGHT_M),
        lambda i: f"a height of {heights[i]:g} m is not plausible for a road",
    )
    return np.stack([east, north, heights], axis=1)


def _to_wgs84(crs: CRS, xyz: Floats) -> Floats:
    lon, lat = Transformer.from_crs(crs, _WGS84, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    return np.stack([np.asarray(lon), np.asarray(lat)], axis=1)


def _require_different_objects(path: Path, xyz_m: Floats, categories: Sequence[str]) -> None:
    """Raise InputError where two rows are within a millimetre: one object written twice. Signs may be above others on a post."""
    on_road = {name: 0 for name, one in FEATURE_CLASSES.items() if one.on_road}
    numbers = {name: number for number, name in enumerate(sorted(set(categories)), 1)} | on_road
    on_post = np.array([numbers[name] for name in categories])
    east_mm, north_mm, up_mm = np.rint(1000 * xyz_m).T
    keys = np.stack([np.where(on_post > 0, up_mm, 0.0), on_post, north_mm, east_mm])
    order = np.lexsort(keys)
    same = np.flatnonzero((np.diff(keys[:, order], axis=1) == 0).all(axis=0))
    for at in same[np.argsort(order[same + 1])][:1]:
        row, first = order[at + 1] + 1, order[at] + 1
        raise InputError(f"{path}, row {row}: the same position as row {first}; nothing was written")


def _text(values: Floats) -> str:
    return ", ".join(f"{value:.6f}".rstrip("0").rstrip(".") for value in values)
