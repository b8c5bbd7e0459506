"""The map as GeoJSON (RFC 7946): what QGIS, a browser or another map database reads."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Any

from conetl.io.db import Connection
from conetl.io.exports.atomic import atomic_text_file
from conetl.io.exports.feature_rows import ExportRow, export_rows

LON_LAT_DECIMALS = 9  # 0.1 mm
HEIGHT_DECIMALS = 4


def export_geojson(
    conn: Connection,
    path: Path,
    *,
    map_name: str = "default",
    as_of: datetime | None = None,
    known_at: datetime | None = None,
) -> int:
    """Write one Feature per standing cone, one per line, by feature id; the number of features.

    Coordinates are WGS 84 longitude, latitude (degrees) and ellipsoidal height (m). The same map gives the same bytes.
    """
    count = 0
    rows = export_rows(conn, map_name=map_name, as_of=as_of, known_at=known_at)
    with atomic_text_file(path) as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for row in rows:
            file.write(",\n" if count else "\n")
            file.write(json.dumps(_feature(row), allow_nan=False))
            count += 1
        file.write("\n]}\n")
    return count


def _feature(row: ExportRow) -> dict[str, Any]:
    lon_deg, lat_deg = round(row.lon_deg, LON_LAT_DECIMALS), round(row.lat_deg, LON_LAT_DECIMALS)
    coordinates = [lon_deg, lat_deg, round(row.ellipsoidal_height_m, HEIGHT_DECIMALS)]
    return {
        "type": "Feature",
        "id": row.properties["feature_id"],
        "geometry": {"type": "Point", "coordinates": coordinates},
        "properties": row.properties,
    }
