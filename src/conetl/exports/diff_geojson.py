"""The difference of two maps as GeoJSON: a point per changed feature, a line where one was moved."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pyproj import Transformer

from conetl.exports.geojson import HEIGHT_DECIMALS, LON_LAT_DECIMALS
from conetl.files.atomic import atomic_text_file
from conetl.model.map_records import DeltaKind, FeatureChange, MapFeature


def export_diff_geojson(changes: Sequence[FeatureChange], path: Path, *, srid: int) -> int:
    """Write one Feature per change, in WGS 84 longitude, latitude and ellipsoidal height; their number."""
    to_wgs84 = Transformer.from_crs(f"EPSG:{srid}", "EPSG:4326", always_xy=True)

    def place(feature: MapFeature) -> list[float]:
        lon_deg, lat_deg = to_wgs84.transform(*feature.xyz_m[:2])
        return [
            round(lon_deg, LON_LAT_DECIMALS),
            round(lat_deg, LON_LAT_DECIMALS),
            round(feature.xyz_m[2], HEIGHT_DECIMALS),
        ]

    def geometry(change: FeatureChange) -> dict[str, Any]:
        ends = [place(feature) for feature in (change.old, change.new) if feature is not None]
        if change.kind is DeltaKind.MOVED:
            return {"type": "LineString", "coordinates": ends}
        return {"type": "Point", "coordinates": ends[-1]}

    features = [
        {
            "type": "Feature",
            "id": str(change.feature_id),
            "geometry": geometry(change),
            "properties": {
                "feature_id": str(change.feature_id),
                "change": str(change.kind),
                "shift_m": change.shift_m,
                "old_version": change.old.version if change.old else None,
                "new_version": change.new.version if change.new else None,
            },
        }
        for change in changes
    ]
    with atomic_text_file(path) as file:
        json.dump({"type": "FeatureCollection", "features": features}, file, allow_nan=False)
        file.write("\n")
    return len(features)
