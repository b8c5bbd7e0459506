"""Lines of a file, the result of every reader of lane boundaries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

MAX_LINES = 500_000
#: Lanelet2 line strings that bound lanes or the road; others (stop lines, signs, walls) do not.
LANELET2_BOUNDARIES = frozenset({"line_thin", "line_thick", "curbstone", "road_border", "guard_rail", "virtual"})


class Line(NamedTuple):
    """One boundary, marking, kerb or reference line."""

    kind: str
    """As in the file: line_thin, curbstone, road_border, solid, ..."""
    xyz: NDArray[np.float64]
    """(N, 3) in the file's CRS and units, N >= 2; heights are NaN where the file has none."""
    attributes: Mapping[str, Any]


class LineFile(NamedTuple):
    """The lines of one file."""

    lines: list[Line]
    crs: CRS | None
    refused: list[str]
    """What could not be used, one message each."""


def add_line(line: Line, what: str, lines: list[Line], refused: list[str]) -> None:
    """Append a line to `lines`, or to `refused` why it cannot be used."""
    xy = line.xyz[:, :2]
    if len(line.xyz) < 2 or not np.any(np.ptp(xy[np.isfinite(xy).all(axis=1)], axis=0) if len(xy) else 0):
        refused.append(f"{what}: fewer than two different points")
    elif not np.isfinite(xy).all():
        refused.append(f"{what}: a coordinate is not a number")
    elif np.isinf(line.xyz[:, 2]).any():
        refused.append(f"{what}: a height is not a number")
    else:
        lines.append(line)


def bounds_lanes(kind: str, attributes: Mapping[str, Any]) -> bool:
    """Whether lanes are beside a line: in Lanelet2 by its type, in other files always."""
    return "bounds_a_lanelet" not in attributes or kind in LANELET2_BOUNDARIES


def full_kind(kind: str, attributes: Mapping[str, Any]) -> str:
    """`type/subtype` where a line has these attributes, for example `line_thin/dashed`."""
    return "/".join(str(attributes[name]) for name in ("type", "subtype") if attributes.get(name)) or kind
