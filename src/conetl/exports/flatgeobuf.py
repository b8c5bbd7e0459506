"""The map as FlatGeobuf: one file with a spatial index that web maps read in part over HTTP."""

from __future__ import annotations

from pathlib import Path

from conetl.exports.gdal_files import write_with_gdal
from conetl.exports.source import Source


def write(source: Source, path: Path) -> int:
    """Write one layer named like the map; the number of rows. The index needs some 100 bytes of memory a row."""
    return write_with_gdal(source, path, "FlatGeobuf")
