"""How lane markings are drawn: the paint's colour, and dashes in their true lengths."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: #rrggbb of the paint by `Marking.colour`. A test compares them with web/src/markings.ts.
PAINT = {"white": "#ffffff", "yellow": "#f2b705", "other": "#9aa5b0"}
#: Around the paint, so that white is seen on white paper.
CASING = "#4a5560"


def dashes_of(vertices_m: ArrayLike, dash_m: float | None, gap_m: float | None) -> list[NDArray[np.float64]]:
    """The parts of a line (N, 2 or 3) that are painted: one of solid lines, dash_m and gap_m None.

    Where along the road the dashes begin is not known: one dash has its middle in the middle of the line.
    """
    line = np.asarray(vertices_m, np.float64)
    if dash_m is None or gap_m is None:
        return [line]
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    length_m, period_m = station[-1], dash_m + gap_m
    first = (length_m / 2 - dash_m / 2) % period_m - period_m
    parts = []
    for start in np.arange(first, length_m, period_m):
        low, high = max(start, 0.0), min(start + dash_m, length_m)
        if low < high:
            at = np.concatenate([[low], station[(station > low) & (station < high)], [high]])
            parts.append(np.stack([np.interp(at, station, axis) for axis in line.T], axis=1))
    return parts
