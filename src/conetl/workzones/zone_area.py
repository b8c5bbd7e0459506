"""The area that a work zone closes, as a polygon to be drawn: from its row of devices to the edge of the closed lanes."""

from __future__ import annotations

import numpy as np
import shapely

from conetl.model.arrays import Floats
from conetl.model.work_zone_records import WorkZone

#: Of a closed lane without lane lines (11 to 12 ft), and of a zone whose closed side is not known to either side of its devices.
_LANE_M, _UNKNOWN_M = 3.5, 1.0
#: Cones stand on the lane line or in the lane: what is left of each closed lane is at least so wide.
_NARROW_M = 2.0
#: Around the devices.
_MARGIN_M = 0.4


def zone_area(zone: WorkZone) -> Floats:
    """Ring (N, 2) in the map's CRS; the first point is not repeated."""
    line = shapely.LineString(zone.line_m[:, :2])
    parts = [line.buffer(_MARGIN_M if zone.closed_side else _UNKNOWN_M)]
    if zone.closed_side is not None and line.length:
        side = 1.0 if zone.closed_side == "left" else -1.0
        parts.append(line.buffer(side * _width_m(zone), single_sided=True, join_style="mitre"))
    area = shapely.union_all(parts)
    whole = max(shapely.get_parts(area), key=shapely.area)
    return np.asarray(shapely.get_coordinates(whole.exterior.simplify(0.05))[:-1])


def _width_m(zone: WorkZone) -> float:
    """From the row to the lane line beyond the closed lanes; without it as many lanes as are closed, at least one."""
    lanes, bands = max(zone.closed_lane_count or 1, 1), zone.layout.bands
    if bands is not None:
        row = float(np.median(zone.layout.offsets_m))
        lines = np.nanmedian(bands.offsets_m, axis=0) if np.isfinite(bands.offsets_m).any() else np.empty(0)
        beyond = np.sort((lines - row) * (1.0 if zone.closed_side == "left" else -1.0))
        wide = beyond[beyond >= _NARROW_M * lanes]
        if len(wide):
            return float(wide[0])
    return _LANE_M * lanes
