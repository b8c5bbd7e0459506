"""Points as well-known binary, and the columns of the files that are tables with geometry."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from conetl.exports.source import PLACE_NAMES, Source, numpy_of

GEOMETRY = "geometry"
#: ISO WKB of a point with z.
_POINT_Z = 1001


def point_arrays(source: Source) -> Iterator[tuple[pa.RecordBatch, NDArray[np.float64]]]:
    """Batches without the columns of the place, and the places (n, 3) in the map's CRS."""
    kept = source.property_names
    for batch in source.batches():
        xyz = np.stack([numpy_of(batch.column(name)) for name in PLACE_NAMES], axis=1)
        yield batch.select(kept), xyz


def property_schema(source: Source) -> pa.Schema:
    """The schema of the batches of `point_arrays`."""
    return pa.schema([field for field in source.schema if field.name not in PLACE_NAMES])


def wkb_points(xyz_m: NDArray[np.float64]) -> pa.Array:
    """(n, 3) as ISO well-known binary, little-endian (29 bytes each)."""
    wkb = np.empty(len(xyz_m), [("order", "u1"), ("type", "<u4"), ("xyz", "<f8", 3)])
    wkb["order"], wkb["type"], wkb["xyz"] = 1, _POINT_Z, xyz_m
    offsets = (np.arange(len(xyz_m) + 1) * wkb.dtype.itemsize).astype(np.int32)
    return pa.Array.from_buffers(pa.binary(), len(xyz_m), [None, pa.py_buffer(offsets), pa.py_buffer(wkb)])
