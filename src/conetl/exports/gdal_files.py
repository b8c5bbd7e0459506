"""The map in file formats that GDAL writes, streamed to it as Arrow record batches.

GDAL's own date and time holds milliseconds. So each time stands there twice: as date and time, for QGIS's temporal
controller and the like, and as a whole number of microseconds since 1970 (UTC) in a column with `_us` at its end, exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyogrio
from pyogrio.errors import DataLayerError, DataSourceError, FieldError

from conetl.exports.geometry_columns import GEOMETRY, point_arrays, property_schema, wkb_points
from conetl.exports.source import Source
from conetl.model.errors import InputError

_MILLISECONDS = pa.timestamp("ms", tz="UTC")


def write_with_gdal(source: Source, path: Path, driver: str, **options: str) -> int:
    """Write points in the map's CRS as one layer with a spatial index; the number of rows. options: of the driver."""
    schema = pa.schema([pa.field(GEOMETRY, pa.binary()), *_fields(property_schema(source))])
    counted = 0
    failure: list[BaseException] = []

    def batches() -> Iterator[pa.RecordBatch]:
        nonlocal counted
        try:
            for batch, xyz_m in point_arrays(source):
                counted += len(xyz_m)
                yield pa.record_batch([wkb_points(xyz_m), *_values(batch)], schema=schema)
        except BaseException as error:
            failure.append(error)  # GDAL would make another error of it
            raise

    try:
        pyogrio.write_arrow(
            pa.RecordBatchReader.from_batches(schema, batches()),
            path,
            layer=source.request.map_name,
            driver=driver,
            geometry_name=GEOMETRY,
            geometry_type="Point Z",
            crs=f"EPSG:{source.info.srid}",
            **options,
        )
    except (DataSourceError, DataLayerError, FieldError, pa.ArrowException, RuntimeError) as error:
        if failure:
            raise failure[0] from None
        raise InputError(f"{path.name} cannot be written ({error}): free space or choose another file.") from error
    return counted


def _fields(schema: pa.Schema) -> list[pa.Field]:
    fields = []
    for field in schema:
        if pa.types.is_timestamp(field.type):
            fields += [pa.field(field.name, _MILLISECONDS), pa.field(f"{field.name}_us", pa.int64())]
        else:
            fields.append(field)
    return fields


def _values(batch: pa.RecordBatch) -> list[pa.Array]:
    values = []
    for column in batch.columns:
        if pa.types.is_timestamp(column.type):
            values += [column.cast(_MILLISECONDS, safe=False), column.cast(pa.int64())]
        else:
            values.append(column)
    return values
