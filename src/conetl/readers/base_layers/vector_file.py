"""GeoJSON, GeoPackage and all other formats of GDAL (pyogrio): every line of every layer."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pyogrio.errors
import pyogrio.raw
import shapely
from pyproj import CRS
from pyproj.exceptions import CRSError

from conetl.model.errors import InputError
from conetl.readers.base_layers.lines import MAX_LINES, Line, LineFile, usable

#: Properties that may be the kind of a line; the first existing one counts.
_KIND_NAMES = ("kind", "type", "subtype", "class", "lane_type", "boundary_type")


def read_vector_file(path: Path) -> LineFile:
    """Lines and parts of multi-lines of a file. Raises InputError without any, or if its layers differ in CRS."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    lines: list[Line] = []
    refused: list[str] = []
    systems: dict[str, None] = {}
    try:
        for name, _ in pyogrio.list_layers(path):
            meta, fids, geometries, fields = pyogrio.raw.read(
                path, layer=name, return_fids=True, force_2d=False, datetime_as_string=True, max_features=MAX_LINES + 1
            )
            if geometries is None:
                continue
            if len(geometries) > MAX_LINES:
                raise InputError(f"{path}: more than {MAX_LINES:,} features in layer {name}: import it in parts")
            found = _lines(name, meta["fields"], fids, geometries, fields, refused)
            if found and meta["crs"]:
                systems[meta["crs"]] = None
            lines += found
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, pyogrio.errors.FieldError) as error:
        raise InputError(f"{path}: not a file of lines that GDAL can read ({_first(error)})") from error
    except (shapely.errors.ShapelyError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"{path}: a feature cannot be read ({_first(error)})") from error
    if not lines:
        reasons = f"; {refused[0]}" if refused else ""
        raise InputError(f"{path}: there is no line; expected LineString or MultiLineString features{reasons}")
    if len(systems) > 1:
        raise InputError(f"{path}: its layers have different CRSs ({', '.join(systems)}): write one file for each")
    try:
        return LineFile(lines, CRS.from_user_input(next(iter(systems))) if systems else None, refused)
    except CRSError:
        return LineFile(lines, None, refused)


def _lines(layer: str, names: Any, fids: Any, geometries: Any, fields: Any, refused: list[str]) -> list[Line]:
    lines = []
    for row, (fid, data) in enumerate(zip(fids, geometries, strict=True)):
        what = f"feature {fid} of layer {layer}"
        if data is None:
            refused.append(f"{what}: it has no geometry")
            continue
        geometry = shapely.from_wkb(data, on_invalid="ignore")
        if geometry is None or geometry.geom_type not in ("LineString", "MultiLineString"):
            refused.append(
                f"{what}: it is a {geometry.geom_type if geometry is not None else 'broken geometry'}, not a line"
            )
            continue
        attributes = {str(name): _plain(column[row]) for name, column in zip(names, fields, strict=True)}
        attributes = {name: value for name, value in attributes.items() if value is not None}
        kind = next((str(attributes[name]) for name in _KIND_NAMES if attributes.get(name)), "line")
        for part in shapely.get_parts(geometry):
            xyz = shapely.get_coordinates(part, include_z=True).astype(np.float64)
            line = Line(kind, xyz, attributes)
            problem = usable(line, what)
            if problem is None:
                lines.append(line)
            else:
                refused.append(problem)
    return lines


def _plain(value: Any) -> Any:
    """A property as a JSON value."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float) else str(value)


def _first(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
