"""Permits of work zones in GeoJSON, GeoPackage and CSV, whose columns have common names or are named by the user."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
import pyogrio.raw
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from conetl.files.documents import encoding_of, library_errors, read_bytes, shown
from conetl.files.names import printable
from conetl.model.errors import InputError
from conetl.model.planned_zones import PlanFile, PlannedZone
from conetl.readers.base_layers.georeferencing import parse_crs
from conetl.readers.plans.wzdx import features_of, parts_of, used_and_unused

#: Field of `PlannedZone` -> common names of its column, small letters.
_COLUMNS = {
    "plan_id": ("plan_id", "permit_id", "permit", "id", "number", "reference"),
    "version": ("version", "revision", "updated_at", "update_date"),
    "group_id": ("group_id",),
    "kind": ("kind", "type", "work_type"),
    "starts_at": ("starts_at", "start", "start_date", "start_time", "from", "valid_from", "begin"),
    "ends_at": ("ends_at", "end", "end_date", "end_time", "to", "until", "valid_to", "valid_until"),
    "status": ("status",),
    "carriageways": ("carriageways", "carriageway", "direction"),
    "lanes": ("lanes", "lane", "closed_lanes"),
    "closed_lane_count": ("closed_lane_count", "lane_count"),
    "road_names": ("road_names", "road_name", "road", "street"),
    "description": ("description", "comment", "remarks"),
    "source": ("source", "authority", "applicant"),
}
#: Columns of positions of CSV files: as well-known text, or of one end and perhaps the other one.
_TEXT = ("wkt", "geometry", "geom")
_ENDS = (
    (("lon_deg", "lat_deg"), ("lon", "lat"), ("longitude", "latitude"), ("easting_m", "northing_m"), ("x", "y")),
    (("lon_end", "lat_end"), ("lon_to", "lat_to"), ("easting_end_m", "northing_end_m"), ("x_end", "y_end")),
)
_LISTS = frozenset({"carriageways", "lanes", "road_names"})
_DATE = re.compile(r"\d{4}-\d\d-\d\d")


Row = tuple[dict[str, Any], Any]
"""Properties by small name, and the geometry: GeoJSON, well-known text or binary, or coordinates of one or two ends."""


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
    if document is not None:
        if stated.crs:
            raise InputError(f"{path}: GeoJSON has longitudes and latitudes (RFC 7946): leave out --crs")
        return used_and_unused(
            features_of(path, document),
            lambda one: _permit(_small(one["properties"]), parts_of(one["geometry"]), stated.columns, zone),
        )
    rows, crs = _read_csv(path) if path.suffix.lower() == ".csv" else _read_layers(path)
    try:
        crs = parse_crs(stated.crs) if stated.crs is not None else crs
        if crs is None:
            raise ValueError("the file states no coordinate reference system, expected --crs, like --crs EPSG:25832")
        to_degrees = Transformer.from_crs(crs, "OGC:CRS84", always_xy=True)
    except (ValueError, ProjError) as error:
        raise InputError(f"{path}: {error}") from error

    def zone_of(row: Row) -> PlannedZone:
        rough = isinstance(row[1], list) and len(row[1]) > 1  # two ends: the road between them is not known
        return _permit(row[0], _parts_in_degrees(row[1], to_degrees), stated.columns, zone, rough)

    return used_and_unused(rows, zone_of, "row")


def _small(properties: Any) -> dict[str, Any]:
    return {str(name).strip().lower(): value for name, value in properties.items() if value not in (None, "")}


def _permit(
    properties: dict[str, Any], parts: Any, columns: Mapping[str, str], zone: ZoneInfo | None, is_rough: bool = False
) -> PlannedZone:
    values: dict[str, Any] = {"kind": "permit", "parts": parts, "approximate": is_rough}
    for field, names in _COLUMNS.items():
        name = next(
            (one for one in ([columns[field].lower()] if field in columns else names) if one in properties), None
        )
        if name is None:
            continue
        value = properties[name]
        text = printable(str(value)).strip()
        if field in ("starts_at", "ends_at"):
            values[field] = _instant(name, text, zone, is_end=field == "ends_at")
        elif field in _LISTS:
            values[field] = value if isinstance(value, list) else [one for one in re.split(r"\s*[,;|]\s*", text) if one]
        else:
            values[field] = value if isinstance(value, int) and field == "closed_lane_count" else text
    if missing := [field for field in ("plan_id", "starts_at") if field not in values]:
        raise ValueError(
            f"it has no {missing[0]}: expected a column {' or '.join(_COLUMNS[missing[0]][:3])}, or --column"
        )
    return PlannedZone.model_validate(values)


def _instant(name: str, text: str, zone: ZoneInfo | None, *, is_end: bool) -> datetime:
    """A time with its zone, or of the stated one; a date is all of its day. Raises ValueError."""
    try:
        found = datetime.fromisoformat(text.replace("/", "-") if _DATE.fullmatch(text.replace("/", "-")) else text)
    except ValueError:
        raise ValueError(f"{name}: expected a time like 2026-03-02T10:00:00Z, found {shown(text)}") from None
    if found.tzinfo is None and zone is None:
        raise ValueError(f"{name}: {shown(text)} states no time zone, expected one, or --time-zone")
    found = found if found.tzinfo is not None else found.replace(tzinfo=zone)
    return found + timedelta(days=1) if is_end and len(text) == len("2026-03-02") else found


def _parts_in_degrees(geometry: Any, to_degrees: Transformer) -> list[list[tuple[float, float]]]:
    """Raises ValueError for a geometry that is missing, broken or outside of the area of its CRS."""
    if isinstance(geometry, list):
        try:
            parts = [[(float(x), float(y)) for x, y in geometry]]
        except ValueError:
            raise ValueError(f"its position is {shown(geometry)}, expected numbers") from None
    else:
        made = shapely.from_wkb(geometry, on_invalid="ignore") if isinstance(geometry, bytes) else None
        made = shapely.from_wkt(geometry, on_invalid="ignore") if isinstance(geometry, str) else made
        if made is None or made.is_empty:
            raise ValueError(f"it has no geometry, or a broken one, expected points, lines or areas: {shown(geometry)}")
        parts = parts_of(shapely.geometry.mapping(shapely.force_2d(made)))
    try:
        xy = [np.array(part, np.float64) for part in parts]
        axes = [to_degrees.transform(one[:, 0], one[:, 1], errcheck=True) for one in xy]
    except ProjError as error:
        raise ValueError("its coordinates are outside of the area of their CRS") from error
    return [list(zip(*(axis.tolist() for axis in part), strict=True)) for part in axes]


def _read_layers(path: Path) -> tuple[list[Row], CRS | None]:
    """Rows of all layers with geometry, and their CRS. Raises InputError."""
    rows: list[Row] = []
    systems = set()
    with library_errors(f"{path}: not a file that GDAL can read"):
        for name, kind in pyogrio.list_layers(path):
            if kind is None:
                continue
            meta, _, geometries, fields = pyogrio.raw.read(path, layer=name, datetime_as_string=True)
            systems.add(meta["crs"])
            for number, geometry in enumerate(geometries):
                values = {key: column[number] for key, column in zip(meta["fields"], fields, strict=True)}
                rows.append((_small({key: _plain(value) for key, value in values.items()}), geometry))
    if len(systems) > 1:
        raise InputError(f"{path}: its layers have different CRSs: write one file for each")
    crs = next(iter(systems), None)
    return rows, None if crs is None else parse_crs(crs)


def _plain(value: Any) -> Any:
    """A value of a column; numbers with a fraction, which GDAL makes of missing whole ones too, as None or whole."""
    value = value.item() if hasattr(value, "item") else value
    if isinstance(value, float):
        return None if math.isnan(value) else int(value) if value.is_integer() else value
    return value


def _read_csv(path: Path) -> tuple[Iterator[Row], CRS | None]:
    """Rows, and WGS 84 where columns are degrees. Raises InputError for a file without columns of positions."""
    data = read_bytes(path)
    with library_errors(f"{path}: this is not a table of text", UnicodeError, csv.Error):
        lines = data.decode(encoding_of([data])).splitlines()
        header = (lines[0] if lines else "").lower()
        table = csv.DictReader([header, *lines[1:]], delimiter=max(",;\t", key=header.count), restkey="")
        names = [name.strip() for name in table.fieldnames or ()]
        table.fieldnames = names
        found = list(table)
    text = next((name for name in _TEXT if name in names), None)
    ends = [pair for pairs in _ENDS for pair in pairs if set(pair) <= set(names)]
    if text is None and not ends:
        raise InputError(f"{path}: no column wkt, nor lon and lat or easting_m and northing_m; found: {shown(names)}")

    def geometry(row: dict[str, str]) -> Any:
        if text is not None:
            return row[text] or None
        return [(row[a], row[b]) for a, b in ends if (a, b) == ends[0] or row[a] or row[b]]

    degrees = text is not None or ends[0][0].startswith("lon")
    return ((_small(row), geometry(row)) for row in found), CRS("OGC:CRS84") if degrees else None
