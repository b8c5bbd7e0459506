"""The map as files for other programs: one line a format in `FORMATS`, one module each with a function `write(source, path)`.

The modules are imported when they are needed: GDAL, Arrow and the rest take their time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from conetl.exports.source import Source


class Order(StrEnum):
    """In which order a format gets its rows; with equal rows equal files."""

    BY_ID = "feature id"
    SPATIAL = "Hilbert curve"
    BY_TIME = "time on the road"


@dataclass(frozen=True)
class Format:
    """A file format of `conetl map export`."""

    suffix: str
    order: Order
    module: str
    """Module of this package with `write(source, path) -> int`: writes all of `source` to `path` and returns the number of
    rows."""
    geographic: bool = False
    """Whether the file is in WGS 84 longitude and latitude, else in the map's CRS."""
    with_change: bool = False
    """Whether the format tells of standing features, too, what change made them so."""


FORMATS = {
    "geojson": Format(".geojson", Order.BY_ID, "geojson", geographic=True),
    "csv": Format(".csv", Order.BY_ID, "csv_table"),
    "geoparquet": Format(".parquet", Order.SPATIAL, "geoparquet"),
    "gpkg": Format(".gpkg", Order.BY_ID, "geopackage"),
    "flatgeobuf": Format(".fgb", Order.BY_ID, "flatgeobuf"),
    "mcap": Format(".mcap", Order.BY_TIME, "mcap_scene", with_change=True),
    "lanelet2": Format(".osm", Order.BY_ID, "lanelet2", geographic=True),
}


def writer_of(file_format: str) -> Callable[[Source, Path], int]:
    """The function that writes a format of `FORMATS`."""
    module = import_module(f"conetl.exports.{FORMATS[file_format].module}")
    return cast("Callable[[Source, Path], int]", module.write)
