"""The map as GeoParquet 1.1 (https://geoparquet.org/releases/v1.1.0/): for geopandas, DuckDB, BigQuery, QGIS.

Rows lie along a Hilbert curve, and each has its box in the column `bbox`: with the statistics of the row groups a reader
finds a street without reading the town.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from conetl.exports.geometry_columns import GEOMETRY, point_arrays, property_schema, wkb_points
from conetl.exports.source import Source

_SIDES = ("xmin", "ymin", "zmin", "xmax", "ymax", "zmax")
_BBOX = pa.struct([pa.field(side, pa.float64(), nullable=False) for side in _SIDES])

#: Columns in which values come again and again. Parquet would try a dictionary for all others, too, and give it up each time.
_REPEATED = ("version", "category", "height_m", "observation_count", "valid_from", "valid_to", "changeset_id", "seen_count",
    "missed_count", "height_sigma_m", "change", "present", "suppressed", "system_from", "system_to", "old_version")  # fmt: skip


def write(source: Source, path: Path) -> int:
    """Write points in the map's CRS, a row group a batch; the number of rows."""
    schema = property_schema(source).append(pa.field("bbox", _BBOX)).append(pa.field(GEOMETRY, pa.binary()))
    count = 0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    repeated = [name for name in _REPEATED if name in schema.names]
    with pq.ParquetWriter(path, schema, compression="zstd", use_dictionary=repeated) as writer:
        for batch, xyz_m in point_arrays(source):
            low, high = np.minimum(low, xyz_m.min(axis=0)), np.maximum(high, xyz_m.max(axis=0))
            arrays = [*batch.columns, _boxes(xyz_m), wkb_points(xyz_m)]
            writer.write_batch(pa.record_batch(arrays, schema=schema), row_group_size=len(xyz_m))
            count += len(xyz_m)
        bounds = [*low.tolist(), *high.tolist()] if count else None
        writer.add_key_value_metadata({"geo": json.dumps(_geo(source, bounds))})
    return count


def _boxes(xyz_m: NDArray[np.float64]) -> pa.Array:
    corners = [pa.array(xyz_m[:, axis]) for axis in (0, 1, 2, 0, 1, 2)]
    return pa.StructArray.from_arrays(corners, fields=list(_BBOX))


def _geo(source: Source, bounds: list[float] | None) -> dict[str, Any]:
    column = {
        "encoding": "WKB",
        "geometry_types": ["Point Z"],
        "crs": source.crs.to_json_dict(),
        "covering": {"bbox": {side: ["bbox", side] for side in _SIDES}},
    }
    if bounds is not None:
        column["bbox"] = bounds
    return {"version": "1.1.0", "primary_column": GEOMETRY, "columns": {GEOMETRY: column}}
