"""Permits of work zones in GeoJSON, GeoPackage and CSV, whose columns have common names or are named by the user."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
import pyogrio
import pyogrio.raw
import shapely
from pyproj import Transformer

from conetl.files.documents import input_errors, library_errors, shown
from conetl.files.names import printable
from conetl.model.errors import InputError
from conetl.model.planned_zones import PlanFile, PlannedZone
from conetl.readers.base_layers.georeferencing import geometries_of, parse_crs
from conetl.readers.plans.wzdx import MOST_RECORDS, features_of, parts_of, used_and_unused
from conetl.readers.vector_layers import layers_of

#: Field of `PlannedZone` -> common names of its column, small letters.
_COLUMNS = {
    "plan_id": ("plan_id", "permit_id", "permit", "id", "number", "reference"),
    "version": ("version", "revision", "updated_at", "update_date"),
    "kind": ("kind", "type", "work_type"),
    "starts_at": ("starts_at", "start", "start_date", "start_time", "from", "valid_from", "begin"),
    "ends_at": ("ends_at", "end", "end_date", "end_time", "to", "until", "valid_to", "valid_until"),
    "status": ("status",),
    "lanes": ("lanes", "lane", "closed_lanes"),
    "closed_lane_count": ("closed_lane_count", "lane_count"),
    "road_names": ("road_names", "road_name", "road", "street"),
    "description": ("description", "comment", "remarks"),
    "source": ("source", "authority", "applicant"),
}
#: Rows times columns of a table.
_MOST_VALUES = 2_000_000
_DATE = re.compile(r"\d{4}[-/]\d\d[-/]\d\d")
_LISTS = frozenset({"lanes", "road_names"})
#: Of GDAL: names of the columns of positions in CSV files, which it keeps: 3.12 dies where it drops one of two of a name.
_CSV = {
    "X_POSSIBLE_NAMES": "lon,lon_deg,longitude,x,easting,easting_m", "KEEP_GEOM_COLUMNS": "YES",
    "Y_POSSIBLE_NAMES": "lat,lat_deg,latitude,y,northing,northing_m", "GEOM_POSSIBLE_NAMES": "wkt,geometry,geom",
}  # fmt: skip


class Permits(NamedTuple):
    """What a user states about a file of permits."""

    crs: str | None
    time_zone: str | None
    columns: Mapping[str, str]


def read_permits(path: Path, document: Any, stated: Permits) -> PlanFile:
    """Permits of a file, in its order, and why each other row is not used. document: of a JSON file. Raises InputError."""
    if unknown := stated.columns.keys() - _COLUMNS:
        raise InputError(f"--column {min(unknown)}=...: expected one of {', '.join(_COLUMNS)}")
    try:
        zone = ZoneInfo(stated.time_zone) if stated.time_zone else None
    except (ValueError, OSError, LookupError) as error:
        raise InputError(f"--time-zone {shown(stated.time_zone)}: expected a name like Europe/Berlin") from error
    if document is not None and stated.crs:
        raise InputError(f"{path}: GeoJSON has longitudes and latitudes (RFC 7946): leave out --crs")
    if document is not None:
        features = features_of(path, document)
        return used_and_unused(
            features, lambda one: _permit(one["properties"], parts_of(one["geometry"]), stated, zone)
        )
    rows, crs = _read_by_gdal(path)
    with input_errors(path):
        to_degrees = Transformer.from_crs(parse_crs(stated.crs or crs), "OGC:CRS84", always_xy=True)
    parts = _parts_in_degrees([binary for _, binary in rows], to_degrees)
    return used_and_unused(zip(rows, parts, strict=True), lambda row: _permit(row[0][0], row[1], stated, zone), "row")


def _permit(properties: Mapping[str, Any], parts: Any, stated: Permits, zone: ZoneInfo | None) -> PlannedZone:
    if isinstance(parts, str):
        raise ValueError(parts)
    values: dict[str, Any] = {}
    for field, name, column in _fields_of(tuple(properties), tuple(sorted(stated.columns.items()))):
        value, text = properties[column], str(properties[column])
        if field in values or text in ("None", "", "nan"):
            continue
        text = printable(text).strip()
        if field in ("starts_at", "ends_at"):
            values[field] = _instant(name, text, zone, is_end=field == "ends_at")
        elif field in _LISTS:
            values[field] = value if isinstance(value, list) else [one for one in re.split(r"\s*[,;|]\s*", text) if one]
        else:
            values[field] = text.removesuffix(".0") if isinstance(value, float) else text
    if missing := [field for field in ("plan_id", "starts_at") if field not in values]:
        raise ValueError(
            f"it has no {missing[0]}: expected a column {' or '.join(_COLUMNS[missing[0]][:3])}, or --column"
        )
    return PlannedZone.model_validate({"kind": "permit", "parts": parts, **values})


@lru_cache(maxsize=100)
def _fields_of(columns: tuple[str, ...], stated: tuple[tuple[str, str], ...]) -> list[tuple[str, str, str]]:
    """Fields of `PlannedZone` with a name and a column of a record that may state it; the first one with a value counts."""
    own = {field: (name.lower(),) for field, name in stated}
    spelled: dict[str, list[str]] = {}
    for column in reversed(columns):
        spelled.setdefault(str(column).strip().lower(), []).append(column)
    fields = [(field, name) for field, names in _COLUMNS.items() for name in own.get(field, names)]
    return [(field, name, column) for field, name in fields for column in spelled.get(name, ())]


def _instant(name: str, text: str, zone: ZoneInfo | None, *, is_end: bool) -> datetime:
    """A time with its zone, or of the stated one; a date is all of its day. Raises ValueError."""
    is_date = _DATE.fullmatch(text) is not None
    try:
        found = datetime.fromisoformat(text.replace("/", "-"))
    except ValueError:
        raise ValueError(f"{name}: expected a time like 2026-03-02T10:00:00Z, found {shown(text)}") from None
    if found.tzinfo is None and zone is None:
        raise ValueError(f"{name}: {shown(text)} states no time zone, expected one, or --time-zone")
    found = found if found.tzinfo is not None else found.replace(tzinfo=zone)
    return found + timedelta(days=1) if is_end and is_date else found


def _parts_in_degrees(binary: Sequence[bytes | None], to_degrees: Transformer) -> list[Any]:
    """The parts of each geometry, or why one has none: it is missing, broken or outside of the area of its CRS."""
    shapes, part_at, vertex_at, xyz = geometries_of(binary)
    lon_lat = np.column_stack(to_degrees.transform(xyz[:, 0], xyz[:, 1]))
    places = list(map(tuple, lon_lat.tolist()))
    parts = [places[start:end] for start, end in pairwise(vertex_at.tolist())]
    found: dict[int, Any] = {k: parts[start:end] for k, (start, end) in enumerate(pairwise(part_at.tolist()))}
    of_vertices = np.searchsorted(vertex_at[part_at], np.arange(len(xyz)), side="right") - 1
    metres = "its coordinates are no degrees: state their CRS with --crs, like --crs EPSG:25832"  # taken for degrees
    missing = np.flatnonzero(shapely.is_missing(shapes) | shapely.is_empty(shapes))
    found |= dict.fromkeys(of_vertices[(np.abs(lon_lat) > 360).any(axis=1)].tolist(), metres)
    found |= dict.fromkeys(
        of_vertices[np.isinf(lon_lat).any(axis=1)].tolist(), "its coordinates are outside of the area of their CRS"
    )
    found |= dict.fromkeys(missing.tolist(), "it has no geometry, or a broken one: expected points, lines or areas")
    return list(found.values())


def _read_by_gdal(path: Path) -> tuple[list[tuple[dict[str, Any], bytes | None]], str]:
    """Properties and well-known binary of the features of all layers, and their CRS; degrees if a table states none."""
    is_table = path.suffix.lower() == ".csv"
    rows: list[tuple[dict[str, Any], bytes | None]] = []
    systems = set()
    most_rows = MOST_RECORDS
    with library_errors(f"{path}: not a file that GDAL can read"):
        if is_table:
            most_rows = min(most_rows, sum(map(path.read_bytes().count, (b"\n", b"\r"))))
            count = len(pyogrio.read_info(path)["fields"])
            if count * most_rows > _MOST_VALUES:
                raise InputError(f"{path} has {count:,} columns in {most_rows:,} lines: leave out columns")
        for layer in (None,) if is_table else layers_of(path):
            meta, _, geometries, fields = pyogrio.raw.read(
                path,
                layer=layer,
                max_features=most_rows + 1,  # memory is reserved for so many
                datetime_as_string=True,
                force_2d=True,
                **(_CSV if is_table else {}),
            )
            if geometries is None:
                raise InputError(f"{path}: no column wkt, nor lon and lat; found: {shown(meta['fields'].tolist())}")
            systems.add(meta["crs"])
            columns = {name: column.tolist() for name, column in zip(meta["fields"], fields, strict=True)}
            rows += [({name: some[k] for name, some in columns.items()}, one) for k, one in enumerate(geometries)]
    if len(systems) > 1:
        raise InputError(f"{path}: its layers have different CRSs: write one file for each")
    return rows, next(iter(systems), None) or "OGC:CRS84"
