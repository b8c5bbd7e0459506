"""GeoJSON (RFC 7946): features of the map, the difference of two maps, and findings of the layout check."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from uuid import UUID

import numpy as np
from numpy.typing import ArrayLike
from pyproj import Transformer

from conetl.db.connection import Connection
from conetl.exports.source import ExportRequest, Source, What, open_source
from conetl.exports.text_files import iso_utc, rows_of
from conetl.files.atomic import atomic_files, atomic_text_file
from conetl.geometry.heights import ELLIPSOIDAL
from conetl.model.map_records import DeltaKind, FeatureChange
from conetl.model.work_zone_records import Finding

LON_LAT_DECIMALS = 9  # 0.1 mm
HEIGHT_DECIMALS = 4
_SIGMAS = {"sigma_e_m": 0, "sigma_n_m": 3, "sigma_u_m": 5}
Object = dict[str, Any]


def export_geojson(conn: Connection, path: Path, *, map_name: str = "default") -> int:
    """Write the standing features as GeoJSON without a manifest; their number. See `write_features`."""
    with open_source(conn, ExportRequest(map_name)) as sources, atomic_files(path) as (file,):
        write_features(sources, file)
        return sum(source.counts.total() for source in sources)


def write_features(sources: Sequence[Source], path: Path) -> None:
    """Write one Feature per row and line of the file. The same map gives the same bytes.

    Coordinates are WGS 84 longitude, latitude (degrees) and ellipsoidal height (m). A feature's id is that of the cone, except in
    a history, where a cone has several rows. Lane markings are lines.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        separator = "\n"
        for source in sources:
            with_id = source.request.what is not What.HISTORY
            for row in rows_of(source):
                place = [(row.lon_deg, row.lat_deg, row.ellipsoidal_height_m)] if row.line is None else row.line
                feature = {
                    "type": "Feature",
                    **({"id": row.properties["feature_id"]} if with_id else {}),
                    "geometry": _line_or_point([_rounded(*vertex) for vertex in place]),
                    "properties": row.properties,
                }
                file.write(separator + json.dumps(feature, allow_nan=False))
                separator = ",\n"
        file.write("\n]}\n")


class ChangeOrigin(NamedTuple):
    """When a feature changed on the road, and by which drive."""

    changed_at: datetime
    drive_id: str
    changeset_no: int


def export_diff_geojson(
    changes: Sequence[FeatureChange], path: Path, *, srid: int, origins: Mapping[UUID, ChangeOrigin] | None = None
) -> int:
    """Write the difference of two maps: a point per changed feature, a line where it moved; the number of features.

    origins: by feature id; without one the time and the drive are null.
    """
    features = []
    for change in changes:
        last, origin = change.state_after, (origins or {}).get(change.feature_id)
        sides = coordinates([side.xyz_m for side in (change.old, change.new) if side is not None], srid)
        features.append(
            {
                "type": "Feature",
                "id": str(change.feature_id),
                "geometry": _line_or_point(sides if change.kind is DeltaKind.MOVED else sides[-1:]),
                "properties": {
                    "feature_id": str(change.feature_id),
                    "change": str(change.kind),
                    "shift_m": change.shift_m,
                    "old_version": change.old.version if change.old else None,
                    "new_version": change.new.version if change.new else None,
                    "changed_at": iso_utc(origin.changed_at) if origin else None,
                    "drive_id": origin.drive_id if origin else None,
                    "changeset_no": origin.changeset_no if origin else None,
                    "existence_probability": round(last.existence_probability, 6),
                    "observation_count": last.observation_count,
                    "object_height_m": round(last.cone_height_m, 4),
                    "ground_height_m": round(last.xyz_m[2], 4),
                    "height_system": ELLIPSOIDAL,
                    **{name: round(last.cov_m2[i] ** 0.5, 4) for name, i in _SIGMAS.items()},
                },
            }
        )
    return _write_collection(features, path)


def export_layout_geojson(findings: Sequence[Finding], path: Path, *, srid: int) -> int:
    """Write one point or line per finding of the layout check; the number of features."""
    features = [
        {
            "type": "Feature",
            "geometry": _line_or_point(coordinates(finding.xy_m, srid)),
            "properties": finding_as_dict(finding) | {"feature_ids": ", ".join(map(str, finding.feature_ids))},
        }
        for finding in findings
    ]
    return _write_collection(features, path, indent=1)


def finding_as_dict(finding: Finding) -> Object:
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


def coordinates(points_m: ArrayLike, srid: int) -> list[list[float]]:
    """Points (n, 2 or 3) of a map's CRS as WGS 84 longitude and latitude (degrees), the height (m) unchanged; rounded."""
    points = np.asarray(points_m, float)
    degrees = np.column_stack(_to_wgs84(srid).transform(points[:, 0], points[:, 1])).round(LON_LAT_DECIMALS)
    return np.hstack([degrees, points[:, 2:].round(HEIGHT_DECIMALS)]).tolist()  # type: ignore[no-any-return]


def _rounded(lon_deg: float, lat_deg: float, height_m: float) -> list[float]:
    return [round(lon_deg, LON_LAT_DECIMALS), round(lat_deg, LON_LAT_DECIMALS), round(height_m, HEIGHT_DECIMALS)]


@cache
def _to_wgs84(srid: int) -> Transformer:
    return Transformer.from_crs(f"EPSG:{srid}", "EPSG:4326", always_xy=True)


def _line_or_point(points: list[list[float]]) -> Object:
    if len(points) == 1:
        return {"type": "Point", "coordinates": points[0]}
    return {"type": "LineString", "coordinates": points}


def _write_collection(features: list[Object], path: Path, *, indent: int | None = None) -> int:
    with atomic_text_file(path) as file:
        json.dump({"type": "FeatureCollection", "features": features}, file, allow_nan=False, indent=indent)
        file.write("\n")
    return len(features)
