"""The map as a CSV table: the GeoJSON's properties, with the place in degrees and in the map's own CRS."""

from __future__ import annotations

import csv
from datetime import datetime
from pathlib import Path

from conetl.io.db import Connection
from conetl.io.exports.atomic import atomic_text_file
from conetl.io.exports.feature_rows import PROPERTY_NAMES, export_rows

PLACE_NAMES = ("lon_deg", "lat_deg", "ellipsoidal_height_m", "easting_m", "northing_m")


def export_csv(
    conn: Connection,
    path: Path,
    *,
    map_name: str = "default",
    as_of: datetime | None = None,
    known_at: datetime | None = None,
) -> int:
    """Write one line per standing cone, by feature id; the number of lines. `valid_to` is empty while open."""
    count = 0
    rows = export_rows(conn, map_name=map_name, as_of=as_of, known_at=known_at)
    with atomic_text_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*PROPERTY_NAMES, *PLACE_NAMES])
        for row in rows:
            place = [f"{row.lon_deg:.9f}", f"{row.lat_deg:.9f}"]
            metres = [f"{value:.4f}" for value in (row.ellipsoidal_height_m, row.easting_m, row.northing_m)]
            writer.writerow([row.properties[name] for name in PROPERTY_NAMES] + place + metres)
            count += 1
    return count
