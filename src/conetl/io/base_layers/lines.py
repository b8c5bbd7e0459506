"""What every reader of lane boundaries gives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

MAX_LINES = 500_000


class Line(NamedTuple):
    """One boundary, marking, kerb or reference line."""

    kind: str
    """The file's own word: line_thin, curbstone, road_border, solid, ..."""
    xyz: NDArray[np.float64]
    """(N, 3) in the file's CRS and units, N >= 2; heights are NaN where the file has none."""
    attributes: Mapping[str, Any]


class LineFile(NamedTuple):
    """The lines of one file."""

    lines: list[Line]
    crs: CRS | None
    refused: list[str]
    """What could not be used, one sentence each."""


def usable(line: Line, what: str) -> str | None:
    """Why a line cannot be used; None where it can."""
    xy = line.xyz[:, :2]
    if len(line.xyz) < 2 or not np.any(np.ptp(xy[np.isfinite(xy).all(axis=1)], axis=0) if len(xy) else 0):
        return f"{what}: fewer than two different points"
    if not np.isfinite(xy).all():
        return f"{what}: a coordinate is no number"
    if np.isinf(line.xyz[:, 2]).any():
        return f"{what}: a height is no number"
    return None
