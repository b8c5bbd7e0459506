"""One row per standing feature, in longitude and latitude, with the properties that outsiders rely on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from typing import Any

from pyproj import Transformer

from conetl.errors import InputError
from conetl.io.db import Connection
from conetl.io.map_results import FeatureVersion
from conetl.io.map_store import find_map, read_features_as_of
from conetl.records import utc_from_ns

#: Names and order of the exported properties; part of the contract with users, never rename one.
PROPERTY_NAMES = (
    "feature_id",
    "version",
    "category",
    "existence_probability",
    "height_m",
    "sigma_e_m",
    "sigma_n_m",
    "sigma_u_m",
    "first_seen_at",
    "last_seen_at",
    "observation_count",
    "valid_from",
    "valid_to",
    "changeset_id",
    "seen_count",
    "missed_count",
)
_BATCH = 10_000


@dataclass(frozen=True)
class ExportRow:
    """One feature: WGS 84 longitude and latitude (degrees), ellipsoidal height (m), the map's own coordinates, properties."""

    lon_deg: float
    lat_deg: float
    ellipsoidal_height_m: float
    easting_m: float
    northing_m: float
    properties: dict[str, Any]
    """`PROPERTY_NAMES`; `height_m` is the cone's own height, times are ISO 8601 UTC, `valid_to` None while open."""


def export_rows(
    conn: Connection, *, map_name: str = "default", as_of: datetime | None = None, known_at: datetime | None = None
) -> Iterator[ExportRow]:
    """The map of `as_of` (on the road; None: latest) as the database knew it at `known_at` (None: now), by feature id.

    Raises InputError where there is no such map.
    """
    info = find_map(conn, map_name)
    if info is None:
        raise InputError(f"there is no map named {map_name} in this database: ingest a drive first.")
    return _rows(read_features_as_of(conn, as_of, known_at=known_at, map_name=map_name), info.srid)


def _rows(versions: Iterator[FeatureVersion], srid: int) -> Iterator[ExportRow]:
    to_wgs84 = Transformer.from_crs(f"EPSG:{srid}", "EPSG:4326", always_xy=True)
    while batch := list(islice(versions, _BATCH)):
        eastings, northings, heights = zip(*(version.feature.xyz_m for version in batch), strict=True)
        lons, lats = to_wgs84.transform(eastings, northings)
        for version, lon, lat, height in zip(batch, lons, lats, heights, strict=True):
            feature = version.feature
            yield ExportRow(lon, lat, height, feature.xyz_m[0], feature.xyz_m[1], _properties(version))


def _properties(version: FeatureVersion) -> dict[str, Any]:
    feature = version.feature
    return {
        "feature_id": str(feature.feature_id),
        "version": feature.version,
        "category": feature.category,
        "existence_probability": round(feature.existence_probability, 6),
        "height_m": round(feature.cone_height_m, 4),
        "sigma_e_m": round(feature.cov_m2[0] ** 0.5, 4),
        "sigma_n_m": round(feature.cov_m2[3] ** 0.5, 4),
        "sigma_u_m": round(feature.cov_m2[5] ** 0.5, 4),
        "first_seen_at": iso_utc(utc_from_ns(feature.first_seen_ns)),
        "last_seen_at": iso_utc(utc_from_ns(feature.last_seen_ns)),
        "observation_count": feature.observation_count,
        "valid_from": iso_utc(version.valid_from),
        "valid_to": iso_utc(version.valid_to) if version.valid_to else None,
        "changeset_id": str(version.changeset_id),
        "seen_count": version.seen_count,
        "missed_count": version.missed_count,
    }


def iso_utc(instant: datetime) -> str:
    """ISO 8601 in UTC with microseconds and a final Z."""
    return instant.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
