"""Files of lane boundaries, by suffix, and their lines in the map's CRS for the layout of work zones.

Of GeoJSON, GeoPackage and all other formats of GDAL every line of every layer is read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pyogrio.raw
import shapely
from pyproj import Transformer

from conetl.files.documents import library_errors, require_few_features, shown
from conetl.model.errors import InputError
from conetl.model.work_zone_records import LaneLine
from conetl.readers.base_layers.georeferencing import geometries_of, parse_crs
from conetl.readers.base_layers.lines import (
    LANELET2_BOUNDARIES,
    MAX_LINES,
    Line,
    LineFile,
    add_lines,
    bounds_lanes,
    full_kind,
    read_lanelet2,
)
from conetl.readers.base_layers.opendrive import read_opendrive
from conetl.readers.vector_layers import layers_of

#: GEOS's numbers of the types of lines and multi-lines.
_LINES = (1, 5)
#: Features of which objects of Python exist at once.
_BATCH = 20_000
#: Properties that may be the kind of a line; the first existing one counts.
_KIND_NAMES = ("kind", "type", "subtype", "class", "lane_type", "boundary_type")


def read_vector_file(path: Path) -> LineFile:
    """Lines and parts of multi-lines of a file. Raises InputError without any, or if its layers differ in CRS."""
    if path.suffix.lower() in (".geojson", ".json"):
        require_few_features(path, MAX_LINES)
    lines: list[Line] = []
    refused: list[str] = []
    systems: dict[str, None] = {}
    with library_errors(f"{path}: not a file of lines that GDAL can read"):
        for name in layers_of(path):
            if pyogrio.read_info(path, layer=name, force_feature_count=True)["features"] > MAX_LINES:
                raise InputError(f"{path}: more than {MAX_LINES:,} features in layer {shown(name)}: import it in parts")
            meta, fids, geometries, fields = pyogrio.raw.read(
                path, layer=name, return_fids=True, force_2d=False, datetime_as_string=True
            )
            before = len(lines)
            for start in range(0, len(fids), _BATCH):
                own = slice(start, start + _BATCH)
                columns = {str(key): _plain(column[own]) for key, column in zip(meta["fields"], fields, strict=True)}
                add_lines([*_lines(shown(name), columns, fids[own], geometries[own])], lines, refused)
            if len(lines) > before and meta["crs"]:
                systems[meta["crs"]] = None
    if not lines:
        reasons = f"; {refused[0]}" if refused else ""
        raise InputError(f"{path}: there is no line; expected LineString or MultiLineString features{reasons}")
    if len(systems) > 1:
        raise InputError(f"{path}: its layers have different CRSs ({shown([*systems])}): write one file for each")
    try:
        return LineFile(lines, parse_crs(next(iter(systems))) if systems else None, refused)
    except ValueError as error:
        return LineFile(lines, None, refused, str(error))


def _lines(layer: str, columns: dict[str, list[Any]], fids: Any, binary: Any) -> Iterator[tuple[str, Line | str]]:
    """Each feature, with its lines or why it has none, for `add_lines`."""
    shapes, part_at, vertex_at, xyz = geometries_of(binary)
    is_line = np.isin(shapely.get_type_id(shapes), _LINES).tolist()
    kinds = ["line"] * len(fids)
    for name in reversed([name for name in _KIND_NAMES if name in columns]):
        kinds = [str(value) if value else kind for value, kind in zip(columns[name], kinds, strict=True)]
    for row, (start, end) in enumerate(pairwise(part_at.tolist())):
        what = f"feature {fids[row]} of layer {layer}"
        if binary[row] is None:
            yield what, "it has no geometry"
        elif not is_line[row]:
            yield what, f"it is a {getattr(shapes[row], 'geom_type', 'broken geometry')}, not a line"
        else:
            attributes = {name: values[row] for name, values in columns.items() if values[row] is not None}
            for first, last in pairwise(vertex_at[start : end + 1].tolist()):
                yield what, Line(kinds[row], xyz[first:last], attributes)


def _plain(column: Any) -> list[Any]:
    """Properties as JSON values."""
    return [
        value
        if isinstance(value, bool | int) or (isinstance(value, float) and math.isfinite(value))
        else None
        if value is None or isinstance(value, float)
        else str(value)
        for value in column.tolist()
    ]


#: By suffix; `read_vector_file` reads all other formats that GDAL supports.
LINE_READERS: dict[str, Callable[[Path], LineFile]] = {
    ".osm": read_lanelet2, ".geojson": read_vector_file, ".json": read_vector_file, ".gpkg": read_vector_file,
    ".xodr": read_opendrive,
}  # fmt: skip


def read_lane_lines(path: Path, *, srid: int) -> list[LaneLine]:
    """All lines of the file in the map's CRS; of Lanelet2 (.osm) those that bound lanes.

    Points, areas and broken lines are skipped. Raises InputError where the file cannot be read, has no usable CRS, has
    coordinates that the map's CRS cannot express, or has no line.
    """
    if not path.is_file():
        raise InputError(f"lanes {path}: there is no such file")
    file = LINE_READERS.get(path.suffix.lower(), read_vector_file)(path)
    lines = [line for line in file.lines if bounds_lanes(line.kind, line.attributes)]
    if not lines:
        raise InputError(f"lanes {path}: there is no line of the types {', '.join(sorted(LANELET2_BOUNDARIES))}")
    if file.crs is None:
        raise InputError(f"lanes {path}: it has no usable coordinate reference system: {file.why_no_crs}")
    to_map = Transformer.from_crs(file.crs, f"EPSG:{srid}", always_xy=True)
    found = []
    for line in lines:
        xy_m = np.stack(to_map.transform(line.xyz[:, 0], line.xyz[:, 1]), axis=1)
        if not np.isfinite(xy_m).all():
            raise InputError(f"lanes {path}: some coordinates are outside of the area of EPSG:{srid}")
        found.append(LaneLine(xy_m, full_kind(line.kind, line.attributes)))
    return found
