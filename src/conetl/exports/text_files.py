"""The map as GeoJSON (RFC 7946), as CSV and for Lanelet2, with the rows of plain values that all text formats share; also the
difference of two maps, and findings of the layout check, as GeoJSON."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count, repeat
from pathlib import Path
from typing import Any, TextIO
from xml.sax.saxutils import quoteattr

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike

from conetl.db.connection import Connection
from conetl.exports.source import POSITION_NAMES, ExportContent, ExportRequest, ExportSource, open_source
from conetl.files.atomic import atomic_files, write_json
from conetl.geometry.geodesy import ELLIPSOIDAL, to_geodetic
from conetl.model.columns import BY_NAME
from conetl.model.map_records import DeltaKind, FeatureChange
from conetl.model.work_zone_records import LayoutFinding

#: Longitude, latitude (degrees) and ellipsoidal height (m) of each vertex.
Line = list[tuple[float, float, float]]
Tags = Mapping[str, Any]
_CSV_POSITION = ("lon_deg", "lat_deg", "ellipsoidal_height_m", "easting_m", "northing_m")
LON_LAT_DECIMALS = 9  # 0.1 mm
HEIGHT_DECIMALS = 4
_DECIMALS = (LON_LAT_DECIMALS, LON_LAT_DECIMALS, HEIGHT_DECIMALS)
_SIGMAS = {"sigma_e_m": 0, "sigma_n_m": 3, "sigma_u_m": 5}
#: By unit. Sigmas and covariances are exact enough to form a covariance matrix again.
_DECIMALS_OF = {"0 to 1": 6, "m^2": 10}
Object = dict[str, Any]


@dataclass(frozen=True)
class ExportRow:
    """One feature: WGS 84 longitude and latitude (degrees), coordinates in the map's CRS, ellipsoidal height (m), properties.

    For a lane marking, these are of its middle vertex.
    """

    lon_deg: float
    lat_deg: float
    easting_m: float
    northing_m: float
    ellipsoidal_height_m: float
    properties: dict[str, Any]
    """`ExportSource.property_names` (model/columns.py). Times are ISO 8601 UTC, `valid_to` is None while open."""
    line: Line | None = None
    """Of a lane marking."""


def rows_of(source: ExportSource) -> Iterator[ExportRow]:
    """The rows of a source: metres to 0.1 mm, sigmas to 1 micrometre, probabilities to 6 decimals."""
    names = source.property_names
    for batch in source.batches:
        degrees = [values.tolist() for values in source.lon_lat_deg(batch)]
        positions = zip(*degrees, *(batch.column(name).to_pylist() for name in POSITION_NAMES), strict=True)
        columns = [_plain(name, batch.column(name)) for name in names]
        lines = _lines_of(source, batch) if source.lines else repeat(None, len(batch))
        for position, values, line in zip(positions, zip(*columns, strict=True), lines, strict=True):
            yield ExportRow(*position, dict(zip(names, values, strict=True)), line)  # type: ignore[call-arg]


def _lines_of(source: ExportSource, batch: pa.RecordBatch) -> list[Line]:
    vertices_m, rows = source.vertices_m(batch)
    lat_lon = to_geodetic(source.info.srid, vertices_m)
    lines: list[Line] = [[] for _ in range(len(batch))]
    for row, (lat_deg, lon_deg, height_m) in zip(rows.tolist(), lat_lon.tolist(), strict=True):
        lines[row].append((lon_deg, lat_deg, height_m))
    return lines


def write_csv(sources: Sequence[ExportSource], path: Path) -> None:
    """Write one line per row. Null values (`valid_to` while open) are empty.

    Lane markings have their line in the column `WKT`, as GDAL and QGIS read it.
    """
    [source] = sources
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*source.property_names, *_CSV_POSITION, *(["WKT"] if source.lines else [])])
        for row in rows_of(source):
            degrees = [f"{row.lon_deg:.9f}", f"{row.lat_deg:.9f}"]
            metres = [f"{value:.4f}" for value in (row.ellipsoidal_height_m, row.easting_m, row.northing_m)]
            vertices = [f"{lon:.9f} {lat:.9f} {height:.4f}" for lon, lat, height in row.line or ()]
            wkt = [f"LINESTRING Z ({', '.join(vertices)})"] if vertices else []
            writer.writerow([*row.properties.values(), *degrees, *metres, *wkt])


def write_lanelet2(sources: Sequence[ExportSource], path: Path) -> None:
    """Write one OSM node per point, for Lanelet2 and JOSM, with the properties as tags.

    A lane marking is a way: type `line_thin`, subtype `solid` or `dashed`, and `width`, as Lanelet2 tags linestrings. Ids are
    negative, so they never collide with those of a lanelet map, and `upload='never'` keeps the cones out of OpenStreetMap.
    `ele` is the ellipsoidal height; `local_x` and `local_y` are easting and northing in the map's CRS.
    """
    ids = count(1)
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write("<?xml version='1.0' encoding='UTF-8'?>\n<osm version='0.6' generator='conetl' upload='never'>\n")
        for source in sources:
            for row in rows_of(source):
                tags = {name: value for name, value in row.properties.items() if value is not None}
                if row.line is None:
                    place = {"local_x": f"{row.easting_m:.4f}", "local_y": f"{row.northing_m:.4f}"}
                    position = (row.lon_deg, row.lat_deg, row.ellipsoidal_height_m)
                    _write_node(file, next(ids), position, {"type": tags["category"]}, place | tags)
                else:
                    nodes = [next(ids) for _ in row.line]
                    for node, vertex in zip(nodes, row.line, strict=True):
                        _write_node(file, node, vertex, {}, {})
                    file.write(f"  <way id='-{next(ids)}' visible='true'>\n")
                    file.writelines(f"    <nd ref='-{node}' />\n" for node in nodes)
                    kind = {"type": "line_thin", "subtype": tags["pattern"], "width": tags["width_m"]}
                    _write_tags(file, kind | tags)
                    file.write("  </way>\n")
        file.write("</osm>\n")


def _write_node(file: TextIO, number: int, position: Sequence[float], kind: Tags, tags: Tags) -> None:
    lon_deg, lat_deg, height_m = position
    file.write(f"  <node id='-{number}' visible='true' lat='{lat_deg:.10f}' lon='{lon_deg:.10f}'>\n")
    _write_tags(file, {**kind, "ele": f"{height_m:.4f}", **tags})
    file.write("  </node>\n")


def _write_tags(file: TextIO, tags: Tags) -> None:
    for key, value in tags.items():
        file.write(f"    <tag k={quoteattr(key)} v={quoteattr(str(value))} />\n")


def iso_utc(instant: datetime, timespec: str = "microseconds") -> str:
    """ISO 8601 in UTC with a final Z, with microseconds or truncated to seconds."""
    return instant.astimezone(UTC).isoformat(timespec=timespec).replace("+00:00", "Z")


def _plain(name: str, column: pa.Array) -> list[Any]:
    """Values of a column as JSON can hold them, rounded."""
    if pa.types.is_timestamp(column.type):
        return list(pc.strftime(column, "%Y-%m-%dT%H:%M:%SZ").to_pylist())
    values = column.to_pylist()
    if pa.types.is_floating(column.type):
        decimals = _DECIMALS_OF.get(BY_NAME[name].unit, 6 if "sigma" in name else HEIGHT_DECIMALS)
        return [None if value is None else round(value, decimals) for value in values]
    return list(values)


def export_geojson(conn: Connection, path: Path, *, map_name: str = "default") -> int:
    """Write the standing features as GeoJSON without a manifest. Returns their number. See `write_features`."""
    with open_source(conn, ExportRequest(map_name)) as sources, atomic_files(path) as (file,):
        write_features(sources, file)
        return sum(source.counts.total() for source in sources)


def write_features(sources: Sequence[ExportSource], path: Path) -> None:
    """Write one Feature per row and line of the file. The same map gives the same bytes.

    Coordinates are WGS 84 longitude, latitude (degrees) and ellipsoidal height (m). The id of a Feature is that of the cone,
    except in a history, because there a cone has several rows. Lane markings are lines.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write('{"type": "FeatureCollection", "features": [')
        separator = "\n"
        for source in sources:
            with_id = source.request.what is not ExportContent.HISTORY
            for row in rows_of(source):
                place = [(row.lon_deg, row.lat_deg, row.ellipsoidal_height_m)] if row.line is None else row.line
                feature = {
                    "type": "Feature",
                    **({"id": row.properties["feature_id"]} if with_id else {}),
                    "geometry": _line_or_point([list(map(round, vertex, _DECIMALS)) for vertex in place]),
                    "properties": row.properties,
                }
                file.write(separator + json.dumps(feature, allow_nan=False))
                separator = ",\n"
        file.write("\n]}\n")


def export_diff_geojson(changes: Sequence[FeatureChange], path: Path, *, srid: int) -> int:
    """Write the difference of two states of a map: a point per changed feature, a line if it moved. Returns their number."""
    features = []
    for change in changes:
        last = change.state_after
        sides = coordinates([side.xyz_m for side in (change.old, change.new) if side is not None], srid)
        features.append(
            {
                "type": "Feature",
                "id": str(change.feature_id),
                "geometry": _line_or_point(sides if change.kind is DeltaKind.MOVED else sides[-1:]),
                "properties": {
                    "feature_id": str(change.feature_id),
                    "change": str(change.kind),
                    "shift_m": change.shift_m,
                    "old_version": change.old.version if change.old else None,
                    "new_version": change.new.version if change.new else None,
                    "changed_at": change.changed_at and iso_utc(change.changed_at),
                    "drive_id": change.drive_id,
                    "changeset_no": change.changeset_no,
                    "existence_probability": round(last.existence_probability, 6),
                    "observation_count": last.observation_count,
                    "object_height_m": round(last.object_height_m, 4),
                    "ground_height_m": round(last.xyz_m[2], 4),
                    "height_system": ELLIPSOIDAL,
                    **{name: round(last.cov_m2[i] ** 0.5, 4) for name, i in _SIGMAS.items()},
                },
            }
        )
    return _write_collection(features, path)


def export_layout_geojson(findings: Sequence[LayoutFinding], path: Path, *, srid: int) -> int:
    """Write one point or line per finding of the layout check. Returns the number of features."""
    features = [
        {
            "type": "Feature",
            "geometry": _line_or_point(coordinates(finding.xy_m, srid)),
            "properties": finding_as_dict(finding) | {"feature_ids": ", ".join(map(str, finding.feature_ids))},
        }
        for finding in findings
    ]
    return _write_collection(features, path, indent=1)


def finding_as_dict(finding: LayoutFinding) -> Object:
    """A finding as plain values; lengths in metres to the millimetre."""
    return {
        "work_zone_id": str(finding.zone_id),
        "rule": str(finding.rule),
        "level": str(finding.level),
        "norm": finding.norm,
        "text": finding.text,
        "value": round(finding.value, 3),
        "limit": round(finding.limit, 3),
        "sigma": round(finding.sigma, 3),
        "unit": finding.unit,
        "station_m": round(finding.station_m, 2),
        "feature_ids": [str(feature_id) for feature_id in finding.feature_ids],
    }


def coordinates(points_m: ArrayLike, srid: int) -> list[list[float]]:
    """Points (n, 2 or 3) of a map's CRS as WGS 84 longitude and latitude (degrees) with the unchanged height (m); rounded."""
    points = np.asarray(points_m, float)
    degrees = to_geodetic(srid, points[:, [0, 1, -1]])[:, 1::-1].round(LON_LAT_DECIMALS)
    return np.hstack([degrees, points[:, 2:].round(HEIGHT_DECIMALS)]).tolist()  # type: ignore[no-any-return]


def _line_or_point(points: list[list[float]]) -> Object:
    if len(points) == 1:
        return {"type": "Point", "coordinates": points[0]}
    return {"type": "LineString", "coordinates": points}


def _write_collection(features: list[Object], path: Path, *, indent: int | None = None) -> int:
    write_json(path, {"type": "FeatureCollection", "features": features}, indent=indent, allow_nan=False)
    return len(features)
