"""Files of lane boundaries: their reader by suffix, and their lines in the map's CRS for the layout of work zones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from pyproj import Transformer

from conetl.model.errors import InputError
from conetl.model.work_zone_records import LaneLine
from conetl.readers.base_layers.lanelet2 import read_lanelet2
from conetl.readers.base_layers.lines import LANELET2_BOUNDARIES, LineFile, bounds_lanes, full_kind
from conetl.readers.base_layers.opendrive_file import read_opendrive
from conetl.readers.base_layers.vector_file import read_vector_file

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
        raise InputError(f"lanes {path}: there is no coordinate reference system that can be used")
    to_map = Transformer.from_crs(file.crs, f"EPSG:{srid}", always_xy=True)
    found = []
    for line in lines:
        xy_m = np.stack(to_map.transform(line.xyz[:, 0], line.xyz[:, 1]), axis=1)
        if not np.isfinite(xy_m).all():
            raise InputError(f"lanes {path}: there are coordinates that EPSG:{srid} cannot express")
        found.append(LaneLine(xy_m, full_kind(line.kind, line.attributes)))
    return found
