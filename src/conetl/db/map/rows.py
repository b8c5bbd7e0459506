"""Rows of the map's tables as records, without checking them again: they were checked before they were written."""

from __future__ import annotations

from typing import Any

from conetl.db.map.jacobian_arrays import jacobian_from_wire
from conetl.model.map_records import FeatureVersion, MapFeature
from conetl.model.records import sound


def feature_of(row: tuple[Any, ...]) -> MapFeature:
    """Columns as in `map/current_features`, more may follow."""
    return sound(
        MapFeature,
        feature_id=row[0],
        version=row[1],
        category=row[2],
        xyz_m=row[3:6],
        cov_m2=row[6:12],
        centre_xyz_m=row[12:15],
        cone_height_m=row[15],
        cone_height_sigma_m=row[16],
        existence_probability=row[17],
        observation_count=row[18],
        first_seen_ns=row[19],
        last_seen_ns=row[20],
        shared_jacobian=None if row[21] is None else jacobian_from_wire(row[21]),
    )


def version_of(row: tuple[Any, ...]) -> FeatureVersion:
    """Columns as in `map/standing_around`, more may follow."""
    return sound(
        FeatureVersion,
        feature=feature_of(row),
        changeset_id=row[22],
        present=row[23],
        suppressed=row[24],
        valid_from_ns=row[25],
        valid_to_ns=row[26],
    )
