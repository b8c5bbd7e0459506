"""Which reader takes which file of lane boundaries."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from conetl.readers.base_layers.lanelet2 import read_lanelet2
from conetl.readers.base_layers.lines import LineFile
from conetl.readers.base_layers.opendrive_file import read_opendrive
from conetl.readers.base_layers.vector_file import read_vector_file

LINE_READERS: dict[str, Callable[[Path], LineFile]] = {
    ".osm": read_lanelet2, ".geojson": read_vector_file, ".json": read_vector_file, ".gpkg": read_vector_file,
    ".xodr": read_opendrive,
}  # fmt: skip
"""By the file's suffix; what else GDAL reads, `read_vector_file` reads too."""
