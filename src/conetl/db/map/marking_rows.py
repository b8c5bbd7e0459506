"""Shapes of lane markings as columns for COPY, and as rows read back (unchecked), to the last bit."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from conetl.db import copy_binary as binary
from conetl.db.copy_binary import CopyColumn
from conetl.model.base import Cov3, sound
from conetl.model.markings import Marking

Row = Mapping[str, Any]
_EWKB_LINE_Z_SRID = 0x80000000 | 0x20000000 | 2
_DOUBLE_TYPE, _DOUBLE_BYTES = 701, 8
_DOUBLES = np.dtype([("length", ">i4"), ("value", ">f8")])
#: Columns that are named as the attributes.
_ATTRIBUTES: dict[str, Callable[[list[Any]], CopyColumn]] = {
    "width_m": binary.doubles, "width_sigma_m": binary.doubles, "colour": binary.texts, "pattern": binary.texts,
    "dash_m": binary.doubles, "gap_m": binary.doubles,
}  # fmt: skip
#: Bytes before the vertices in `ST_AsBinary`.
_WKB_HEAD = 9


def marking_of(row: Row) -> Marking | None:
    """Columns as in `map.features_as_of` from the line to gap_m; None of point objects."""
    if row["line"] is None:
        return None
    vertices_m = np.frombuffer(row["line"], "<f8", offset=_WKB_HEAD).reshape(-1, 3)
    return sound(
        Marking,
        vertices_m=tuple(map(tuple, vertices_m.tolist())),
        cov_m2=covariances(row["line_cov"]),
        **{name: row[name] for name in _ATTRIBUTES},
    )


def marking_columns(srid: int, markings: Sequence[Marking | None]) -> dict[str, CopyColumn]:
    """Columns of the shape of lines; NULL in the rows of point objects."""
    if not any(markings):  # of the millions of versions that are not lines, none is looked at a second time
        return dict.fromkeys(("line", "line_cov", *_ATTRIBUTES), binary.nulls(len(markings)))
    return {
        "line": binary.byteas([None if m is None else _line(m, srid) for m in markings]),
        "line_cov": matrices([None if m is None else m.cov_m2 for m in markings]),
        **{
            name: encode([None if m is None else getattr(m, name) for m in markings])
            for name, encode in _ATTRIBUTES.items()
        },
    }


def matrices(covariances: Sequence[Sequence[Cov3] | None]) -> CopyColumn:
    """float8[][6] from the covariances of the vertices of each line; None becomes NULL."""
    return binary.byteas([None if rows is None else _matrix(rows) for rows in covariances])


def covariances(rows: list[list[float]]) -> tuple[Cov3, ...]:
    """Covariances as `matrices` wrote them."""
    return tuple((xx, xy, xz, yy, yz, zz) for xx, xy, xz, yy, yz, zz in rows)


def _line(marking: Marking, srid: int) -> bytes:
    """As extended well-known binary."""
    vertices_m = np.array(marking.vertices_m, "<f8")
    return struct.pack("<BIII", 1, _EWKB_LINE_Z_SRID, srid, len(vertices_m)) + vertices_m.tobytes()


def _matrix(rows: Sequence[Cov3]) -> bytes:
    """float8[][6], as `array_send` makes it."""
    items = np.empty(6 * len(rows), _DOUBLES)
    items["length"], items["value"] = _DOUBLE_BYTES, np.ravel(rows)
    return struct.pack(">7i", 2, 0, _DOUBLE_TYPE, len(rows), 1, 6, 1) + items.tobytes()
