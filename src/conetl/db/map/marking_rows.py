"""Shapes of lane markings as columns for COPY, and as rows read back (unchecked), to the last bit."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from conetl.db import copy_binary as binary
from conetl.db.copy_binary import Column
from conetl.model.markings import Marking
from conetl.model.records import Cov3, sound

_EWKB_LINE_Z_SRID = 0x80000000 | 0x20000000 | 2
_DOUBLE_TYPE, _DOUBLE_BYTES = 701, 8
_DOUBLES = np.dtype([("length", ">i4"), ("value", ">f8")])
#: Bytes before the vertices in `ST_AsBinary`.
_WKB_HEAD = 9


def marking_of(row: tuple[Any, ...]) -> Marking:
    """Columns as in `map.features_as_of` from the line to gap_m."""
    vertices_m = np.frombuffer(row[0], "<f8", offset=_WKB_HEAD).reshape(-1, 3)
    return sound(
        Marking,
        vertices_m=tuple(map(tuple, vertices_m.tolist())),
        cov_m2=covariances(row[1]),
        width_m=row[2],
        width_sigma_m=row[3],
        colour=row[4],
        pattern=row[5],
        dash_m=row[6],
        gap_m=row[7],
    )


def marking_columns(srid: int, markings: Sequence[Marking | None]) -> dict[str, Column]:
    """Columns of the shape of lines; NULL in the rows of point objects."""
    if not any(markings):  # of the millions of versions that are no line, none is looked at a second time
        return dict.fromkeys(
            ("line", "line_cov", "width_m", "width_sigma_m", "colour", "pattern", "dash_m", "gap_m"),
            binary.nulls(len(markings)),
        )
    return {
        "line": binary.byteas([None if m is None else _line(m, srid) for m in markings]),
        "line_cov": matrices([None if m is None else m.cov_m2 for m in markings]),
        "width_m": binary.doubles([None if m is None else m.width_m for m in markings]),
        "width_sigma_m": binary.doubles([None if m is None else m.width_sigma_m for m in markings]),
        "colour": binary.texts([None if m is None else m.colour for m in markings]),
        "pattern": binary.texts([None if m is None else m.pattern for m in markings]),
        "dash_m": binary.doubles([None if m is None else m.dash_m for m in markings]),
        "gap_m": binary.doubles([None if m is None else m.gap_m for m in markings]),
    }


def matrices(covariances: Sequence[Sequence[Cov3] | None]) -> Column:
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
