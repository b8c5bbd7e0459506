"""The closed area of a work zone, as it is drawn."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from conetl.model.work_zone_params import WorkZoneParams
from conetl.workzones.zone_area import zone_area
from conetl.workzones.zone_layout import describe, layout_of
from tests.synthetic.tapers import LANE_M, closure

PARAMS = WorkZoneParams()


@pytest.mark.parametrize("seed", range(8))
def test_the_area_is_the_closed_lane_from_the_first_device_to_the_last(seed):
    made = closure(seed, "none", sigma_m=0.02)
    zone = describe(made.zone, layout_of(made.zone, made.paths, made.lanes, PARAMS), PARAMS)
    area = shapely.Polygon(zone_area(zone))
    line = shapely.LineString(zone.line_m[:, :2])
    assert area.is_valid
    assert all(area.covers(shapely.Point(cone.xyz_m[:2])) for cone in (zone.first, zone.last))
    assert 0.5 * LANE_M * line.length < area.area < 1.6 * LANE_M * line.length
    # Nearly all of it is on the closed side of the row.
    side = line.buffer(10.0 if zone.closed_side == "left" else -10.0, single_sided=True)
    assert area.intersection(side).area > 0.75 * area.area


def test_without_lanes_a_taper_closes_one_lane_and_a_row_of_unknown_side_is_a_strip():
    made = closure(1, "none", sigma_m=0.02)
    zone = describe(made.zone, layout_of(made.zone, made.paths, [], PARAMS), PARAMS)
    line = shapely.LineString(zone.line_m[:, :2])
    strip = shapely.Polygon(zone_area(zone))
    assert zone.layout.bands is None
    assert strip.hausdorff_distance(line) == pytest.approx(1.0 if zone.closed_side is None else 3.5, abs=0.8)
    alone = describe(made.zone, layout_of(made.zone, [], [], PARAMS), PARAMS)
    if alone.closed_side is None:
        ring = zone_area(alone)
        assert np.isfinite(ring).all()
        assert shapely.Polygon(ring).covers(shapely.LineString(alone.line_m[:, :2]))
