"""The map as a CSV table: the GeoJSON's properties, with the place in degrees and in the map's own CRS."""

from __future__ import annotations

import csv
from datetime import datetime
from pathlib import Path

from conetl.db.connection import Connection
from conetl.exports.feature_rows import names_of, rows_of
from conetl.exports.source import ExportRequest, Source, open_source
from conetl.files.atomic import atomic_files

PLACE_NAMES = ("lon_deg", "lat_deg", "ellipsoidal_height_m", "easting_m", "northing_m")


def export_csv(
    conn: Connection,
    path: Path,
    *,
    map_name: str = "default",
    as_of: datetime | None = None,
    known_at: datetime | None = None,
) -> int:
    """The standing cones as CSV alone, without a manifest; the number of lines. See `write`."""
    request = ExportRequest(map_name, as_of=as_of, believed_at=known_at)
    with open_source(conn, request) as source, atomic_files(path) as (file,):
        return write(source, file)


def write(source: Source, path: Path) -> int:
    """Write one line per row; the number of rows. What is null (`valid_to` while open) is empty."""
    count = 0
    names = names_of(source)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, *PLACE_NAMES])
        for row in rows_of(source):
            place = [f"{row.lon_deg:.9f}", f"{row.lat_deg:.9f}"]
            metres = [f"{value:.4f}" for value in (row.ellipsoidal_height_m, row.easting_m, row.northing_m)]
            writer.writerow([*row.properties.values(), *place, *metres])
            count += 1
    return count
