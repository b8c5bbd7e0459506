"""The map as tables with geometry: GeoParquet by Arrow, GeoPackage and FlatGeobuf by GDAL, all streamed in record batches."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import shapely
from pyogrio.errors import DataLayerError, DataSourceError, FieldError

from conetl.exports.source import POSITION_NAMES, ExportSource
from conetl.exports.text_files import iso_utc
from conetl.geometry.geodesy import compound_crs, to_crs
from conetl.model.arrays import Floats
from conetl.model.columns import COLUMNS
from conetl.model.errors import InputError

GEOMETRY = "geometry"
LINES_LAYER = "lane_markings"
_MILLISECONDS = pa.timestamp("ms", tz="UTC")
_SIDES = ("xmin", "ymin", "zmin", "xmax", "ymax", "zmax")
_BBOX = pa.struct([pa.field(side, pa.float64(), nullable=False) for side in _SIDES])
#: Columns of few different values. Parquet would also try a dictionary for the others, and discard it each time.
_VARIED = ("feature_id", "first_seen_at", "last_seen_at")
_REPEATED = tuple(one.name for one in COLUMNS if one.kind != "float8" and one.name not in _VARIED)


def write_geoparquet(sources: Sequence[ExportSource], path: Path) -> None:
    """Write GeoParquet 1.1 (https://geoparquet.org/releases/v1.1.0/), one row group per batch.

    Rows follow a Hilbert curve and carry their box in the column `bbox`, so that a reader finds a street through the statistics
    of the row groups.
    """
    [source] = sources
    schema = _property_schema(source).append(pa.field("bbox", _BBOX)).append(pa.field(GEOMETRY, pa.binary()))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    repeated = [name for name in _REPEATED if name in schema.names]
    with pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=repeated) as writer:
        for batch, wkb, lows_m, highs_m in _geometries_of(source):
            low, high = np.minimum(low, lows_m.min(axis=0)), np.maximum(high, highs_m.max(axis=0))
            sides = [pa.array(corner[:, k]) for corner in (lows_m, highs_m) for k in range(3)]
            boxes = pa.StructArray.from_arrays(sides, fields=list(_BBOX))
            writer.write_batch(pa.record_batch([*batch.columns, boxes, wkb], schema=schema), row_group_size=len(wkb))
        column: dict[str, Any] = {
            "encoding": "WKB",
            "geometry_types": [_geometry_type(source)],
            "crs": compound_crs(*source.epsg).to_json_dict(),
            "covering": {"bbox": {side: ["bbox", side] for side in _SIDES}},
        }
        if np.isfinite(low).all():
            column["bbox"] = [*low.tolist(), *high.tolist()]
        geo = {"version": "1.1.0", "primary_column": GEOMETRY, "columns": {GEOMETRY: column}}
        writer.add_key_value_metadata({"geo": json.dumps(geo)})


def write_geopackage(sources: Sequence[ExportSource], path: Path) -> None:
    """Write a GeoPackage (OGC 12-128r19), dated by its database state: equal maps give equal files. See `_write_layer`."""
    known_at = sources[0].request.known_at or sources[0].info.last_committed_at
    # Requirement 15: with a fraction of a second.
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": known_at and iso_utc(known_at, "milliseconds")})
    _write_by_gdal(sources, path, "GPKG", ".gpkg")


def write_flatgeobuf(sources: Sequence[ExportSource], path: Path) -> None:
    """Write FlatGeobuf. Its index takes about 100 bytes of memory per row. See `_write_layer`."""
    _write_by_gdal(sources, path, "FlatGeobuf", ".fgb")


def _write_by_gdal(sources: Sequence[ExportSource], path: Path, driver: str, suffix: str) -> None:
    """Write each source as a layer of a file of any name: of a name without its suffix GDAL makes a folder, or warns."""
    named = path.with_name(path.name + suffix)
    for source in sources:
        _write_layer(source, named, driver)
    named.rename(path)


def _write_layer(source: ExportSource, path: Path, driver: str) -> None:
    """Write one layer in the map's CRS with a spatial index.

    Points are in a layer named like the map, lines in `lane_markings` (of a map with this name, `lane_markings_lines`).

    GDAL stores times in milliseconds. Each time is therefore written twice: as date and time, for QGIS's temporal controller,
    and exactly in a column with the suffix `_us`, as microseconds since 1970 (UTC). Raises InputError if the file cannot be
    written.
    """
    failure: list[BaseException] = []
    fields = [pa.field(GEOMETRY, pa.binary())]
    for field in _property_schema(source):
        if pa.types.is_timestamp(field.type):
            fields += [pa.field(field.name, _MILLISECONDS), pa.field(f"{field.name}_us", pa.int64())]
        else:
            fields.append(field)
    schema = pa.schema(fields)

    def batches() -> Iterator[pa.RecordBatch]:
        try:
            for batch, wkb, _, _ in _geometries_of(source):
                columns = [wkb]
                for column in batch.columns:
                    if pa.types.is_timestamp(column.type):
                        columns += [column.cast(_MILLISECONDS, safe=False), column.cast(pa.int64())]
                    else:
                        columns.append(column)
                yield pa.record_batch(columns, schema=schema)
        except BaseException as error:
            failure.append(error)  # GDAL would replace it by an error of its own
            raise

    layer = source.request.map_name
    if source.lines:
        layer = f"{LINES_LAYER}_lines" if layer == LINES_LAYER else LINES_LAYER
    try:
        pyogrio.write_arrow(
            pa.RecordBatchReader.from_batches(schema, batches()), path, layer=layer, driver=driver,
            geometry_name=GEOMETRY, geometry_type=_geometry_type(source), crs=source.crs_text,
        )  # fmt: skip
    except (DataSourceError, DataLayerError, FieldError, pa.ArrowException, RuntimeError) as error:
        if failure:
            raise failure[0] from None
        raise InputError(f"{path.stem} cannot be written ({error}): free space or choose another file.") from error


def _property_schema(source: ExportSource) -> pa.Schema:
    return pa.schema([source.schema.field(name) for name in source.property_names])


def _geometry_type(source: ExportSource) -> str:
    return "LineString Z" if source.lines else "Point Z"


def _geometries_of(source: ExportSource) -> Iterator[tuple[pa.RecordBatch, pa.Array, Floats, Floats]]:
    """Batches of the properties alone, each with its geometries as well-known binary, and their lowest and highest coordinates,
    (n, 3) each, in the CRS of the source."""
    for batch in source.batches:
        if source.lines:
            vertices_m, rows = source.vertices_m(batch)
            vertices_m = to_crs(vertices_m, source.info.srid, *source.epsg)
            wkb = shapely.to_wkb(shapely.linestrings(vertices_m, indices=rows), flavor="iso")
            firsts = np.flatnonzero(np.diff(rows, prepend=-1))
            lows_m, highs_m = (extreme.reduceat(vertices_m, firsts) for extreme in (np.minimum, np.maximum))
        else:
            names = (*POSITION_NAMES[:2], "ground_height_m")
            lows_m = highs_m = np.stack([np.asarray(batch.column(name)) for name in names], axis=1)
            wkb = shapely.to_wkb(shapely.points(lows_m), flavor="iso")
        yield batch.select(source.property_names), pa.array(wkb, pa.binary()), lows_m, highs_m
