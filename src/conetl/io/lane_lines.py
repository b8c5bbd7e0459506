"""Lane boundaries out of a file that GDAL reads: GeoJSON, GeoPackage, FlatGeobuf, shapefile; Lanelet2 as OSM XML."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError, FeatureError
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from conetl.errors import InputError
from conetl.work_zone_records import LaneLine

#: Lanelet2 line strings that bound lanes or the road; others (stop lines, signs, fences) do not.
_LANELET2_TYPES = frozenset({"line_thin", "line_thick", "curbstone", "road_border", "guard_rail", "virtual"})
_LANELET2_LAYER = "lines"


def read_lane_lines(path: Path, *, srid: int) -> list[LaneLine]:
    """All lines of the file in the map's CRS; of Lanelet2 (.osm) those that bound lanes.

    Every vector layer is read; points and areas are left aside. Raises InputError where the file cannot be read, names no CRS
    that leads to the map's, holds coordinates that are no numbers, or has no line.
    """
    if not path.is_file():
        raise InputError(f"lanes {path}: there is no such file")
    try:
        layers = [str(name) for name, _ in pyogrio.list_layers(path)]
    except DataSourceError as error:
        raise InputError(f"lanes {path}: not a file of lines that GDAL can read ({error})") from error
    is_lanelet2 = path.suffix.lower() == ".osm"
    if is_lanelet2:
        # Editors of HD maps give ids that GDAL's own index does not hold.
        pyogrio.set_gdal_config_options({"OSM_USE_CUSTOM_INDEXING": "NO"})
    lines: list[LaneLine] = []
    for layer in [_LANELET2_LAYER] if is_lanelet2 else layers:
        lines += _layer(path, layer, srid, is_lanelet2)
    if not lines:
        kinds = f" of the types {', '.join(sorted(_LANELET2_TYPES))}" if is_lanelet2 else ""
        raise InputError(f"lanes {path}: holds no line{kinds}")
    return lines


def _layer(path: Path, layer: str, srid: int, is_lanelet2: bool) -> list[LaneLine]:
    options = {"CONFIG_FILE": _osm_config(path)} if is_lanelet2 else {}
    try:
        meta, _, geometries, fields = pyogrio.raw.read(path, layer=layer, **options)
    except (DataSourceError, DataLayerError, FeatureError, ValueError) as error:
        raise InputError(f"lanes {path}: layer {layer} cannot be read ({error})") from error
    if geometries is None:
        return []
    names = [str(name) for name in meta["fields"]]
    kinds = _kinds(names, fields, len(geometries))
    try:
        to_map = Transformer.from_crs(CRS.from_user_input(meta["crs"] or ""), f"EPSG:{srid}", always_xy=True)
    except CRSError as error:
        raise InputError(
            f"lanes {path}: layer {layer} names no coordinate reference system that can be used"
        ) from error
    lines = []
    for geometry, kind in zip(shapely.from_wkb(geometries), kinds, strict=True):
        if is_lanelet2 and kind.split("/")[0] not in _LANELET2_TYPES:
            continue
        for part in shapely.get_parts(geometry) if geometry is not None else ():
            if shapely.get_dimensions(part) != 1 or shapely.get_num_coordinates(part) < 2:
                continue
            xy = shapely.get_coordinates(part)
            place = np.stack(to_map.transform(xy[:, 0], xy[:, 1]), axis=1)
            if not np.isfinite(place).all():
                raise InputError(f"lanes {path}: layer {layer} has coordinates that EPSG:{srid} cannot express")
            lines.append(LaneLine(place, kind))
    return lines


def _kinds(names: list[str], fields: Any, count: int) -> list[str]:
    """`type/subtype` of each line where the file has these attributes."""
    chosen = [fields[names.index(name)] for name in ("type", "subtype") if name in names]
    return ["/".join(str(values[k]) for values in chosen if values[k]) for k in range(count)]


def _osm_config(path: Path) -> str:
    """GDAL keeps only attributes that its configuration names: the one beside this module names those of Lanelet2."""
    config = Path(__file__).with_name("lanelet2_osmconf.ini")
    if not config.is_file():
        raise InputError(f"lanes {path}: the file {config.name} is missing from this installation of conetl")
    return str(config)
