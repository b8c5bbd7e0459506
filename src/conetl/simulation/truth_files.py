"""Truth beside a rendered drive: truth.csv with the objects, truth_markings.geojson with the lane markings."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from conetl.geometry.linear_reference import resampled
from conetl.model.feature_classes import CONE
from conetl.simulation.classed_parts import true_shape
from conetl.simulation.scenario import PAINT_HEIGHT_M, RoadMarking, ScenarioPass
from conetl.simulation.trajectory import MAP_SRID, map_SE3_road

Array = NDArray[np.float64]

TRUTH_COLUMNS = (
    "cone_id", "easting_m", "northing_m", "height_ellipsoidal_m", "cone_height_m", "map_srid", "present", "change",
    "category",
)  # fmt: skip
_LINE_STEP_M = 10.0


def write_truth(folder: Path, scenario: ScenarioPass) -> None:
    """truth.csv: foot (of cones the centre of the base plate's underside, of plates the middle of their lower edge) and height of
    each object, present or removed, and, unless all are cones, `category`. truth_markings.geojson: centre lines of the paint (WGS
    84, ellipsoidal heights)."""
    place = map_SE3_road()
    cones = [(c, 1) for c in scenario.world.cones] + [(c, 0) for c in scenario.removed]
    rows = [(c.cone_id, (c.x_m, c.y_m, 0.0), c.height_m, present, CONE) for c, present in cones]
    for item in scenario.world.objects:
        if item.object_id:
            category, foot_m, height_m = true_shape(item)
            rows.append((item.object_id, (item.x_m, item.y_m, foot_m), height_m, 1, category))
    columns = len(TRUTH_COLUMNS) - (len(rows) == len(cones))
    with (folder / "truth.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(TRUTH_COLUMNS[:columns])
        for name, foot, height, present, category in rows:
            xyz = (f"{value:.4f}" for value in place[:3, :3] @ foot + place[:3, 3])
            row = (name, *xyz, f"{height:.3f}", MAP_SRID, present, scenario.changes[name], category)
            writer.writerow(row[:columns])
    markings = feature_collection(map(_marking_feature, scenario.world.road.markings))
    (folder / "truth_markings.geojson").write_text(markings, encoding="utf-8")


def _marking_feature(marking: RoadMarking) -> dict[str, Any]:
    properties = {
        "marking_id": marking.marking_id, "pattern": "solid" if marking.dash_m is None else "dashed",
        "colour": marking.colour, "width_m": marking.width_m, "dash_m": marking.dash_m, "gap_m": marking.gap_m,
        "dash_start_m": None if marking.dash_m is None else 0.0,
    }  # fmt: skip
    return line_feature(np.array(marking.points_m), PAINT_HEIGHT_M, properties)


def line_feature(points_m: Array, height_m: float, properties: dict[str, Any]) -> dict[str, Any]:
    """GeoJSON Feature of a level line (K, 2) of the road frame, height_m above the road."""
    if len(points_m) == 2:
        points_m = resampled(points_m, _LINE_STEP_M)
    motion = map_SE3_road()
    places = np.column_stack([points_m, np.full(len(points_m), height_m)]) @ motion[:3, :3].T + motion[:3, 3]
    lon, lat = Transformer.from_crs(MAP_SRID, 4326, always_xy=True).transform(places[:, 0], places[:, 1])
    coordinates = [
        [round(a, 9), round(b, 9), round(c, 3)] for a, b, c in zip(lon, lat, places[:, 2].tolist(), strict=True)
    ]
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "LineString", "coordinates": coordinates},
    }


def feature_collection(features: Iterable[dict[str, Any]]) -> str:
    """GeoJSON text (RFC 7946), one line per feature."""
    head = '{"type": "FeatureCollection", "features": [\n'
    return head + ",\n".join(json.dumps(feature) for feature in features) + "\n]}\n"
