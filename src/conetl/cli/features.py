"""Tables of features on standard output, with the columns of `model/columns.py`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from math import dist
from typing import Any

from conetl.cli.console import print_records
from conetl.exports.kind_marks import kind_label
from conetl.geometry.packing import horizontal_sigma_m
from conetl.mapping.reasons import probability_text
from conetl.model.base import utc_from_ns
from conetl.model.columns import BY_NAME, TABLES, FeatureColumn, stored_names
from conetl.model.feature_classes import CONE
from conetl.model.map_records import MapFeature


def print_features(table: str, rows: Sequence[Mapping[str, Any]], *, numbers_from: int = 1, **more: Any) -> None:
    """A table of features, of a name in `TABLES`. rows: values by the name of the column. more: further columns, as for
    `print_records`, by heading with _ for a space."""
    mixed = {row.get("category", CONE) for row in rows} - {CONE}
    chosen = [BY_NAME[name] for name in TABLES[table] if name != "category" or mixed]
    columns: dict[str, Any] = {column.heading: partial(_shown, column) for column in chosen}
    print_records(
        "",
        {**columns, **{name.replace("_", " "): read for name, read in more.items()}},
        rows,
        numbers_from=numbers_from,
    )


def _shown(column: FeatureColumn, row: Mapping[str, Any]) -> object:
    value = row.get(column.name)
    match column.name:
        case _ if value is None:
            return None
        case "existence_probability":
            return probability_text(value)
        case "change":
            return kind_label(value)
        case "missed_count":
            return value or ""
    return f"{value:.{column.decimals}f}" if isinstance(value, float) else value


def row_of(feature: MapFeature, **more: object) -> dict[str, Any]:
    """Values of a feature by the name of the column, with others."""
    shape = feature.marking
    own = set(stored_names()).difference(stored_names("lines")) | {"feature_id", "version"}
    values: dict[str, Any] = {name: getattr(feature, name) for name in own}
    values |= dict(zip(("easting_m", "northing_m", "ellipsoidal_height_m"), feature.xyz_m, strict=True))
    values |= {"sigma_m": horizontal_sigma_m(feature.cov_m2), "sigma_u_m": feature.cov_m2[5] ** 0.5}
    values["first_seen_at"] = utc_from_ns(feature.first_seen_ns)
    if shape is not None:
        values |= {name: getattr(shape, name) for name in stored_names("lines")}
        values["length_m"] = sum(dist(a, b) for a, b in pairwise(shape.vertices_m))
    return values | more
