"""The map as a GeoPackage (OGC 12-128r19): for QGIS, ArcGIS and whatever reads SQLite."""

from __future__ import annotations

from pathlib import Path

from conetl.exports.gdal_files import write_with_gdal
from conetl.exports.source import Source


def write(source: Source, path: Path) -> int:
    """Write one layer named like the map; the number of rows."""
    return write_with_gdal(source, path, "GPKG")
