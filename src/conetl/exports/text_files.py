"""The map as CSV and as Lanelet2 points, and the rows of plain values that all text formats share."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import pyarrow as pa
import pyarrow.compute as pc

from conetl.exports.source import POSITION_NAMES, Source, What

#: Exported properties of a feature, in this order. They are part of the contract with users: never rename one.
PROPERTY_NAMES = (
    "feature_id", "version", "category", "existence_probability", "height_m", "sigma_e_m", "sigma_n_m", "sigma_u_m",
    "first_seen_at", "last_seen_at", "observation_count", "valid_from", "valid_to", "changeset_id", "seen_count", "missed_count",
    "object_height_m", "ground_height_m", "height_system",
)  # fmt: skip
#: Additional properties of histories and changes.
_CHANGE_NAMES = (
    "change", "shift_m", "present", "suppressed", "system_from", "system_to",
    "old_version", "old_easting_m", "old_northing_m", "old_height_m", "old_ground_height_m",
)  # fmt: skip
_CSV_POSITION = ("lon_deg", "lat_deg", "ellipsoidal_height_m", "easting_m", "northing_m")


@dataclass(frozen=True)
class ExportRow:
    """One feature: WGS 84 longitude and latitude (degrees), coordinates in the map's CRS, ellipsoidal height (m), properties."""

    lon_deg: float
    lat_deg: float
    easting_m: float
    northing_m: float
    ellipsoidal_height_m: float
    properties: dict[str, Any]
    """`names_of(source)`; `height_m` and `object_height_m` are the cone's own height, `ground_height_m` is in `height_system`.
    Times are ISO 8601 UTC, `valid_to` is None while open."""


def names_of(source: Source) -> list[str]:
    """Names of the properties of `rows_of(source)`."""
    allowed = PROPERTY_NAMES if source.request.what is What.FEATURES else (*PROPERTY_NAMES, *_CHANGE_NAMES)
    return [name for name in source.property_names if name in allowed]


def rows_of(source: Source) -> Iterator[ExportRow]:
    """The rows of a source: metres to 0.1 mm, probabilities to 6 decimals."""
    names = names_of(source)
    for batch in source.batches:
        degrees = [values.tolist() for values in source.lon_lat_deg(batch)]
        positions = zip(*degrees, *(batch.column(name).to_pylist() for name in POSITION_NAMES), strict=True)
        columns = [_plain(name, batch.column(name)) for name in names]
        for position, values in zip(positions, zip(*columns, strict=True), strict=True):
            yield ExportRow(*position, dict(zip(names, values, strict=True)))  # type: ignore[call-arg]


def write_csv(source: Source, path: Path) -> int:
    """Write one line per row; the number of rows. Null values (`valid_to` while open) are empty."""
    count = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names_of(source), *_CSV_POSITION])
        for row in rows_of(source):
            degrees = [f"{row.lon_deg:.9f}", f"{row.lat_deg:.9f}"]
            metres = [f"{value:.4f}" for value in (row.ellipsoidal_height_m, row.easting_m, row.northing_m)]
            writer.writerow([*row.properties.values(), *degrees, *metres])
            count += 1
    return count


def write_lanelet2(source: Source, path: Path) -> int:
    """Write one OSM node per row, for Lanelet2 and JOSM, with the properties as tags; the number of rows.

    Ids are negative, so they never collide with those of a lanelet map, and `upload='never'` keeps the cones out of
    OpenStreetMap. `ele` is the ellipsoidal height; `local_x` and `local_y` are easting and northing in the map's CRS.
    """
    count = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write("<?xml version='1.0' encoding='UTF-8'?>\n<osm version='0.6' generator='conetl' upload='never'>\n")
        for count, row in enumerate(rows_of(source), 1):
            tags = {
                "type": row.properties["category"],
                "ele": f"{row.ellipsoidal_height_m:.4f}",
                "local_x": f"{row.easting_m:.4f}",
                "local_y": f"{row.northing_m:.4f}",
                **{name: value for name, value in row.properties.items() if value is not None},
            }
            file.write(f"  <node id='-{count}' visible='true' lat='{row.lat_deg:.10f}' lon='{row.lon_deg:.10f}'>\n")
            for key, value in tags.items():
                file.write(f"    <tag k={quoteattr(key)} v={quoteattr(str(value))} />\n")
            file.write("  </node>\n")
        file.write("</osm>\n")
    return count


def iso_utc(instant: datetime) -> str:
    """ISO 8601 in UTC with microseconds and a final Z."""
    return instant.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def _plain(name: str, column: pa.Array) -> list[Any]:
    """Values of a column as JSON can hold them, rounded."""
    if pa.types.is_timestamp(column.type):
        return list(pc.strftime(column, "%Y-%m-%dT%H:%M:%SZ").to_pylist())
    values = column.to_pylist()
    if pa.types.is_floating(column.type):
        decimals = 6 if name == "existence_probability" else 4
        return [None if value is None else round(value, decimals) for value in values]
    return list(values)
