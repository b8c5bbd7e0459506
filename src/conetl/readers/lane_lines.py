"""Lane boundaries out of a file, in the map's CRS, for the layout of work zones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pyproj import Transformer

from conetl.model.errors import InputError
from conetl.model.work_zone_records import LaneLine
from conetl.readers.base_layers.line_files import LINE_READERS
from conetl.readers.base_layers.lines import LANELET2_BOUNDARIES, bounds_lanes, full_kind
from conetl.readers.base_layers.vector_file import read_vector_file


def read_lane_lines(path: Path, *, srid: int) -> list[LaneLine]:
    """All lines of the file in the map's CRS; of Lanelet2 (.osm) those that bound lanes.

    Reads what `base import` reads, and what else GDAL reads. Points, areas and broken lines are left aside. Raises InputError
    where the file cannot be read, names no CRS that leads to the map's, holds coordinates that the map's CRS cannot express, or
    has no line.
    """
    suffix = path.suffix.lower()
    if not path.is_file():
        raise InputError(f"lanes {path}: there is no such file")
    file = LINE_READERS.get(suffix, read_vector_file)(path)
    lines = [line for line in file.lines if bounds_lanes(line.kind, line.attributes)]
    if not lines:
        raise InputError(f"lanes {path}: holds no line of the types {', '.join(sorted(LANELET2_BOUNDARIES))}")
    if file.crs is None:
        raise InputError(f"lanes {path}: names no coordinate reference system that can be used")
    to_map = Transformer.from_crs(file.crs, f"EPSG:{srid}", always_xy=True)
    found = []
    for line in lines:
        place = np.stack(to_map.transform(line.xyz[:, 0], line.xyz[:, 1]), axis=1)
        if not np.isfinite(place).all():
            raise InputError(f"lanes {path}: has coordinates that EPSG:{srid} cannot express")
        found.append(LaneLine(place, full_kind(line.kind, line.attributes)))
    return found
