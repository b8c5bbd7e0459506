"""Findings of the layout check as GeoJSON: a point or a line for each, for a map layer."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pyproj import Transformer

from conetl.exports.geojson import LON_LAT_DECIMALS
from conetl.files.atomic import atomic_text_file
from conetl.model.work_zone_records import Finding


def finding_as_dict(finding: Finding) -> dict[str, Any]:
    """A finding as plain values; lengths in metres to the millimetre."""
    return {
        "work_zone_id": str(finding.zone_id),
        "rule": str(finding.rule),
        "level": str(finding.level),
        "norm": finding.norm,
        "text": finding.text,
        "value": round(finding.value, 3),
        "limit": round(finding.limit, 3),
        "sigma": round(finding.sigma, 3),
        "unit": finding.unit,
        "station_m": round(finding.station_m, 2),
        "feature_ids": [str(feature_id) for feature_id in finding.feature_ids],
    }


def export_layout_geojson(findings: Sequence[Finding], path: Path, *, srid: int) -> int:
    """Write one Feature per finding, in WGS 84 longitude and latitude; their number."""
    to_wgs84 = Transformer.from_crs(f"EPSG:{srid}", "EPSG:4326", always_xy=True)
    features = []
    for finding in findings:
        places = [
            [round(lon, LON_LAT_DECIMALS), round(lat, LON_LAT_DECIMALS)]
            for lon, lat in (to_wgs84.transform(*xy) for xy in finding.xy_m)
        ]
        geometry = (
            {"type": "Point", "coordinates": places[0]}
            if len(places) == 1
            else {"type": "LineString", "coordinates": places}
        )
        properties = finding_as_dict(finding) | {"feature_ids": ", ".join(map(str, finding.feature_ids))}
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    with atomic_text_file(path) as file:
        json.dump({"type": "FeatureCollection", "features": features}, file, allow_nan=False, indent=1)
        file.write("\n")
    return len(features)
