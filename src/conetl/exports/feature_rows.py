"""One row per exported feature as plain values, for the formats that are text."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pyarrow as pa

from conetl.exports.source import PLACE_NAMES, Source, What

#: Names and order of the exported properties of features; part of the contract with users, never rename one.
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
#: What history and changes tell besides, and to how many decimals numbers are written.
_MORE_NAMES = (
    "change",
    "shift_m",
    "present",
    "suppressed",
    "system_from",
    "system_to",
    "old_version",
    "old_easting_m",
    "old_northing_m",
    "old_height_m",
)
_DECIMALS = {"existence_probability": 6}
_METRE_DECIMALS = 4


@dataclass(frozen=True)
class ExportRow:
    """One feature: WGS 84 longitude and latitude (degrees), ellipsoidal height (m), the map's own coordinates, properties."""

    lon_deg: float
    lat_deg: float
    easting_m: float
    northing_m: float
    ellipsoidal_height_m: float
    properties: dict[str, Any]
    """`names_of(source)`; `height_m` is the cone's own height, times are ISO 8601 UTC, `valid_to` None while open."""


def names_of(source: Source) -> list[str]:
    """Names of the properties of `rows_of(source)`."""
    more = () if source.request.what is What.FEATURES else _MORE_NAMES
    return [name for name in source.property_names if name in PROPERTY_NAMES or name in more]


def rows_of(source: Source) -> Iterator[ExportRow]:
    """The rows of a source."""
    names = names_of(source)
    for batch in source.batches():
        degrees = [values.tolist() for values in source.lon_lat_deg(batch)]
        places = [*degrees, *(batch.column(name).to_pylist() for name in PLACE_NAMES)]
        columns = [_plain(name, batch.column(name)) for name in names]
        for place, values in zip(zip(*places, strict=True), zip(*columns, strict=True), strict=True):
            yield ExportRow(*place, dict(zip(names, values, strict=True)))  # type: ignore[call-arg]


def iso_utc(instant: datetime) -> str:
    """ISO 8601 in UTC with microseconds and a final Z."""
    return instant.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def iso_texts(times: pa.Array) -> list[str | None]:
    """As `iso_utc`, of a column of timestamps in microseconds; None for null."""
    instants = np.asarray(times.cast(pa.int64()).fill_null(0)).astype("datetime64[us]")
    texts = np.char.add(np.datetime_as_string(instants), "Z").tolist()
    if times.null_count:
        return [text if valid else None for text, valid in zip(texts, times.is_valid().to_pylist(), strict=True)]
    return list(texts)


def _plain(name: str, column: pa.Array) -> list[Any]:
    """Values of a column, rounded to what is meant, as JSON can hold them."""
    if pa.types.is_timestamp(column.type):
        return iso_texts(column)
    values = column.to_pylist()
    if pa.types.is_floating(column.type):
        decimals = _DECIMALS.get(name, _METRE_DECIMALS)
        return [None if value is None else round(value, decimals) for value in values]
    return list(values)
