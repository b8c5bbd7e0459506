"""What work zones are made from: the map's versions over time, and the paths of the drives that made them."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from conetl.io.db import Connection, database_errors, load_sql, stream
from conetl.io.stores.map_rows import version_of
from conetl.map_records import BelievedVersion
from conetl.work_zone_records import DrivePath

_PATH_TOLERANCE_M = 0.05


def read_versions(conn: Connection, *, map_name: str, until: datetime | None = None) -> list[BelievedVersion]:
    """Every believed version that began until then (None: all), by feature; [] where there is no such map."""
    parameters = {"map_name": map_name, "valid_until": until.isoformat() if until else "infinity"}
    with database_errors(f"The history of map {map_name} cannot be read"):
        return [version_of(row) for row in stream(conn, load_sql("map/believed_versions"), parameters)]


def read_paths(conn: Connection, *, map_name: str, until: datetime | None = None) -> list[DrivePath]:
    """The paths of the drives that count and began until then (None: all), by time."""
    parameters = {
        "map_name": map_name,
        "valid_until": until.isoformat() if until else "infinity",
        "tolerance_m": _PATH_TOLERANCE_M,
    }
    with database_errors(f"The drives of map {map_name} cannot be read"):
        return [
            DrivePath(row[0], row[1], np.stack([np.array(row[2]), np.array(row[3])], axis=1))
            for row in stream(conn, load_sql("map/drive_paths"), parameters)
        ]
