"""The map as GeoJSON (RFC 7946): what QGIS, a browser or another map database reads."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Any

from conetl.db.connection import Connection
from conetl.exports.feature_rows import ExportRow, rows_of
from conetl.exports.source import ExportRequest, Source, What, open_source
from conetl.files.atomic import atomic_files

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
    """The standing cones as GeoJSON alone, without a manifest; the number of features. See `write`."""
    request = ExportRequest(map_name, as_of=as_of, believed_at=known_at)
    with open_source(conn, request) as source, atomic_files(path) as (file,):
        return write(source, file)


def write(source: Source, path: Path) -> int:
    """Write one Feature per row, one per line; the number of rows.

    Coordinates are WGS 84 longitude, latitude (degrees) and ellipsoidal height (m). The same map gives the same bytes. A
    feature's id is that of the cone, but in a history, where a cone has several rows.
    """
    count = 0
    with_id = source.request.what is not What.HISTORY
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        for row in rows_of(source):
            file.write(",\n" if count else "\n")
            file.write(json.dumps(_feature(row, with_id), allow_nan=False))
            count += 1
        file.write("\n]}\n")
    return count


def _feature(row: ExportRow, with_id: bool) -> dict[str, Any]:
    lon_deg, lat_deg = round(row.lon_deg, LON_LAT_DECIMALS), round(row.lat_deg, LON_LAT_DECIMALS)
    coordinates = [lon_deg, lat_deg, round(row.ellipsoidal_height_m, HEIGHT_DECIMALS)]
    return {
        "type": "Feature",
        **({"id": row.properties["feature_id"]} if with_id else {}),
        "geometry": {"type": "Point", "coordinates": coordinates},
        "properties": row.properties,
    }
