"""Truth and base layers beside a rendered drive: truth.csv with the objects, truth_markings.geojson with the lane markings; a
LiDAR survey of the street without cones, and its lane boundaries."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from conetl.geometry.geodesy import to_geodetic
from conetl.geometry.linear_reference import resampled
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE
from conetl.readers.base_layers.point_tiles import first_in_voxels
from conetl.simulation.parts import true_shape
from conetl.simulation.scenario import (
    KERB_HEIGHT_M,
    PAINT_HEIGHT_M,
    PAVEMENT_HEIGHT_M,
    Road,
    RoadMarking,
    ScenarioPass,
    scenario_pass,
)
from conetl.simulation.scene import build_scene, load_mitsuba
from conetl.simulation.trajectory import MAP_SRID, map_SE3_road

TRUTH_COLUMNS = (
    "cone_id", "easting_m", "northing_m", "height_ellipsoidal_m", "cone_height_m", "map_srid", "present", "change",
    "category",
)  # fmt: skip
_LINE_STEP_M = 10.0
POINTS_FILE = "street.laz"
LINES_FILE = "lane_boundaries.geojson"
#: A roof scanner with 32 beams, one revolution every two metres.
_SCANNER_HEIGHT_M = 1.9
_BEAMS_DEG = np.linspace(-24.0, 12.0, 32)
_AZIMUTH_STEP_DEG = 0.5
_SCAN_EVERY_M = 2.0
_RANGE_M = 45.0
_RANGE_SIGMA_M = 0.015
_VOXEL_M = 0.22


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
            rows.append((item.object_id, (item.x_m, item.y_m, item.ground_m + foot_m), height_m, 1, category))
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


def line_feature(points_m: Floats, height_m: float, properties: dict[str, Any]) -> dict[str, Any]:
    """GeoJSON Feature of a level line (K, 2) of the road frame, height_m above the road."""
    if len(points_m) == 2:
        points_m = resampled(points_m, _LINE_STEP_M)
    motion = map_SE3_road()
    places = np.column_stack([points_m, np.full(len(points_m), height_m)]) @ motion[:3, :3].T + motion[:3, 3]
    lat_lon = to_geodetic(MAP_SRID, places).tolist()
    coordinates = [[round(lon, 9), round(lat, 9), round(height, 3)] for lat, lon, height in lat_lon]
    return {"type": "Feature", "properties": properties, "geometry": {"type": "LineString", "coordinates": coordinates}}


def feature_collection(features: Iterable[dict[str, Any]]) -> str:
    """GeoJSON text (RFC 7946), one line per feature."""
    head = '{"type": "FeatureCollection", "features": [\n'
    return head + ",\n".join(json.dumps(feature) for feature in features) + "\n]}\n"


def simulate_base_layers(folder: Path, *, seed: int) -> tuple[Path, Path]:
    """Write street.laz (points, EPSG:32632) and lane_boundaries.geojson (WGS 84) into `folder`; returns their paths.

    Equal seeds give equal files. Raises InputError without Mitsuba, and if a file exists.
    """
    points, lines = folder / POINTS_FILE, folder / LINES_FILE
    for path in (points, lines):
        if path.exists():
            raise InputError(f"{path}: exists; choose another folder")
    load_mitsuba()
    folder.mkdir(parents=True, exist_ok=True)
    xyz, intensity = _scan(seed)
    _write_las(points, xyz, intensity)
    lines.write_text(_boundaries(scenario_pass(1).world.road), encoding="utf-8")
    return points, lines


def _scan(seed: int) -> tuple[Floats, NDArray[np.uint16]]:
    """Points (N, 3) on the map and their intensities (N,), thinned by voxel."""
    mi = load_mitsuba()
    scenario = scenario_pass(1)
    scene = build_scene(replace(scenario.world, cones=()))
    rng = np.random.default_rng([seed, 99])
    directions = _directions()
    found: list[Floats] = []
    bright: list[float] = []
    for x in np.arange(scenario.start_x_m - 8.0, scenario.end_x_m + 25.0, _SCAN_EVERY_M):
        origin = np.array([x, -1.0, _SCANNER_HEIGHT_M])
        for direction in directions:
            ray = mi.Ray3f(mi.ScalarPoint3f(origin.tolist()), mi.ScalarVector3f(direction.tolist()))
            hit = scene.ray_intersect(ray)
            if not hit.is_valid() or not float(hit.t) <= _RANGE_M:
                continue
            reach = float(hit.t) + rng.normal(0.0, _RANGE_SIGMA_M)
            found.append(origin + reach * direction)
            bright.append(float(np.mean(np.array(hit.bsdf().eval_diffuse_reflectance(hit)))))
    road = np.array(found)
    first = first_in_voxels(road, _VOXEL_M)
    motion = map_SE3_road()
    intensity = np.clip(np.rint(np.array(bright) * 255.0 / 0.8), 0, 255).astype(np.uint16)
    return road[first] @ motion[:3, :3].T + motion[:3, 3], intensity[first]


def _directions() -> Floats:
    """Unit vectors (N, 3) of one revolution of the scanner, in the road frame."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0.0, 360.0, _AZIMUTH_STEP_DEG)), np.radians(_BEAMS_DEG))
    cos = np.cos(elevation)
    return np.stack([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)


def _write_las(path: Path, xyz: Floats, intensity: NDArray[np.uint16]) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.01)
    header.offsets = np.floor(xyz.min(axis=0))
    header.add_crs(CRS.from_epsg(MAP_SRID))
    header.creation_date = scenario_pass(1).start_utc.date()
    header.generating_software = "conetl simulate"
    las = laspy.LasData(header)
    order = np.lexsort(np.floor(xyz / 4.0).T)  # neighbours together compress better
    las.x, las.y, las.z = xyz[order].T
    las.intensity = intensity[order]
    las.write(path)


def _boundaries(road: Road) -> str:
    """GeoJSON (RFC 7946) of painted lines and kerbs, with ellipsoidal heights."""
    features = []

    def add(kind: str, subtype: str, points_m: ArrayLike, z: float) -> None:
        features.append(line_feature(np.asarray(points_m, dtype=float), z, {"kind": kind, "subtype": subtype}))

    for line in road.markings:
        add("line_thin", "solid" if line.dash_m is None else "dashed", line.points_m, PAINT_HEIGHT_M)
    for y in (road.right_m, road.left_m):
        add("curbstone", "high", ((road.start_m, y), (road.end_m, y)), KERB_HEIGHT_M)
    y = road.pavement_edge_m
    add("road_border", "pavement", ((road.start_m, y), (road.end_m, y)), PAVEMENT_HEIGHT_M)
    return feature_collection(features)
