"""Input of work zones: the map's versions over time, and the paths of its drives."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np
import shapely
from numpy.typing import NDArray

from conetl.db.connection import Connection, database_errors, load_sql, stream
from conetl.db.map.rows import version_of
from conetl.model.map_records import FeatureVersion
from conetl.model.work_zone_records import DrivePath, LaneLine
from conetl.readers.base_layers.lines import bounds_lanes, full_kind

_PATH_TOLERANCE_M = 0.05
#: Distance around the cones of a work zone for lane lines, more than the width of a road.
_LANE_REACH_M = 60.0


def read_versions(conn: Connection, *, map_name: str, until: datetime | None = None) -> list[FeatureVersion]:
    """Every current version that began until then (None: all), by feature; [] without such a map."""
    parameters = {"map_name": map_name, "feature_id": None, "valid_until": until.isoformat() if until else "infinity"}
    with database_errors(f"The history of map {map_name} cannot be read"):
        return [version_of(row) for row in stream(conn, load_sql("map.current_versions"), parameters)]


def read_paths(conn: Connection, *, map_name: str, until: datetime | None = None) -> list[DrivePath]:
    """The paths of the active drives that began until then (None: all), by time."""
    parameters = {
        "map_name": map_name,
        "valid_until": until.isoformat() if until else "infinity",
        "tolerance_m": _PATH_TOLERANCE_M,
    }
    with database_errors(f"The drives of map {map_name} cannot be read"):
        return [
            DrivePath(row[0], row[1], np.stack([np.array(row[2]), np.array(row[3])], axis=1))
            for row in stream(conn, load_sql("drives.paths_of_map"), parameters)
        ]


def read_lanes_near(
    conn: Connection, places_m: Sequence[NDArray[np.float64]], *, map_name: str
) -> tuple[list[list[LaneLine]], list[str]]:
    """Lane lines of the map's base layers near each set of positions, and the names of these layers.

    places_m: (N, 2) each, in the map's CRS. Near: inside their box, widened by `_LANE_REACH_M`.
    """
    found: list[list[LaneLine]] = [[] for _ in places_m]
    layers: set[str] = set()
    low = [places.min(axis=0) - _LANE_REACH_M for places in places_m]
    high = [places.max(axis=0) + _LANE_REACH_M for places in places_m]
    parameters = {
        "map_name": map_name,
        "west_m": [float(corner[0]) for corner in low],
        "south_m": [float(corner[1]) for corner in low],
        "east_m": [float(corner[0]) for corner in high],
        "north_m": [float(corner[1]) for corner in high],
    }
    with database_errors(f"The base layers of map {map_name} cannot be read"):
        for box, layer, kind, attributes, wkb in stream(conn, load_sql("base_layers.lines_near"), parameters):
            if bounds_lanes(kind, attributes):
                line = shapely.get_coordinates(shapely.from_wkb(bytes(wkb)))
                found[box].append(LaneLine(line, full_kind(kind, attributes)))
                layers.add(layer)
    return found, sorted(layers)
