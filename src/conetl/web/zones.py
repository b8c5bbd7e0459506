"""The route of work zones, which the page draws as areas."""

from __future__ import annotations

import numpy as np
from fastapi import APIRouter

from conetl.model.arrays import Floats
from conetl.model.base import Vec3, utc_from_ns
from conetl.model.work_zone_params import WorkZoneParams
from conetl.pipeline.maps.work_zones import read_zones
from conetl.web import layer_models as m
from conetl.web.parameters import Instant, MapName, Origin, Reader
from conetl.web.tiles import MapState
from conetl.workzones.zone_area import zone_area

router = APIRouter(tags=["work zones"])
#: Zones are chained from all features of a map, which takes seconds beyond this number.
MOST_FEATURES = 5_000
_DECIMALS = 2


@router.get("/maps/{map_name}/work-zones")
def work_zones(map_name: MapName, conn: Reader, origin: Origin, valid_at: Instant = None) -> m.WorkZoneAreas:
    """The work zones that stand at an instant, as the database knows them now; none, and `truncated`, where features are many."""
    counts = MapState(conn, map_name, valid_at, None).summary()
    if sum(row["feature_count"] for row in counts) > MOST_FEATURES:
        return m.WorkZoneAreas(origin_m=origin, zones=[], truncated=True)
    found = read_zones(conn, map_name=map_name, as_of=valid_at, lanes=None, params=WorkZoneParams())
    zones = [
        m.WorkZoneArea(
            zone_id=zone.history.zone_id, start=utc_from_ns(zone.history.start_ns), cone_count=len(zone.layout.cones),
            length_m=round(float(np.ptp(zone.layout.stations_m)), 1), closed_side=zone.closed_side,
            closed_lane_count=zone.closed_lane_count,
            ring_m=_on_ground(zone_area(zone), float(np.median(zone.line_m[:, 2])), origin),
        )
        for zone in found.zones
        if zone.history.end_ns is None
    ]  # fmt: skip
    return m.WorkZoneAreas(origin_m=origin, zones=zones, truncated=False)


def _on_ground(xy_m: Floats, height_m: float, origin: Vec3) -> list[float]:
    at = np.column_stack([xy_m, np.full(len(xy_m), height_m)]) - origin
    return [float(value) for value in at.round(_DECIMALS).ravel()]
