"""Linear referencing: stations along a line and offsets across it.

A station is the distance in metres along the line from its first point (negative before it), an offset the distance from the
line, positive to the left of its direction. Lines are (N, 2) arrays in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import TypeVar

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import KDTree

from conetl.model.arrays import Floats, Ints

_CHUNK = 256
_Item = TypeVar("_Item")


def spaced(points_m: Floats, least_m: float) -> list[int]:
    """Row numbers of points (N, D): the first one, and each that is at least `least_m` from the last chosen one."""
    chosen: list[int] = []
    for row, at_m in enumerate(points_m):
        if not chosen or float(np.linalg.norm(at_m - points_m[chosen[-1]])) >= least_m:
            chosen.append(row)
    return chosen


def evenly_spaced(items: Sequence[_Item], most: int) -> list[_Item]:
    """At most `most` items, evenly spaced, with the first and the last."""
    if len(items) <= most:
        return list(items)
    return [items[round(k * (len(items) - 1) / (most - 1))] for k in range(most)]


def stations(line_m: Floats) -> Floats:
    """(N,) station of each point of the line."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line_m, axis=0).T))])


def resampled(line_m: Floats, step_m: float) -> Floats:
    """The line (N, D) with points about `step_m` apart in plan (x, y); both ends are kept."""
    station = stations(line_m[:, :2])
    at = np.linspace(0.0, station[-1], max(int(np.ceil(station[-1] / step_m)) + 1, 2))
    return np.stack([np.interp(at, station, column) for column in line_m.T], axis=1)


def smoothed(line_m: Floats, step_m: float, sigma_m: float) -> Floats:
    """The line resampled and smoothed by a Gaussian of `sigma_m`; straight lines stay straight to their ends."""
    points = resampled(line_m, step_m)
    reach = min(int(np.ceil(3.0 * sigma_m / step_m)), len(points) - 1)
    if reach < 1:
        return points
    padded = np.pad(points, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(padded, sigma_m / step_m, axis=0, mode="nearest")[reach:-reach])


def project(line_m: Floats, points_m: Floats) -> tuple[Floats, Floats]:
    """Stations and offsets (M,) of points (M, 2); the line continues straight beyond its ends.

    Of equally near parts of the line the first counts. Raises ValueError for a line without length.
    """
    starts, steps = line_m[:-1], np.diff(line_m, axis=0)
    lengths = np.hypot(*steps.T)
    keep = lengths > 0
    starts, steps, lengths = starts[keep], steps[keep], lengths[keep]
    if not len(starts):
        raise ValueError("a line needs two different points")
    station = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    directions = steps / lengths[:, None]
    low, high = np.zeros(len(starts)), lengths.copy()
    low[0], high[-1] = -np.inf, np.inf
    # A segment is at most half a length nearer than its middle (and rounding). The outer ones have no end.
    tree, outer = KDTree(starts + steps / 2), (0, len(starts) - 1)
    reach_m = tree.query(points_m)[0] + lengths.max() / 2 + 1e-6
    found_s, found_o = np.empty(len(points_m)), np.empty(len(points_m))
    for first in range(0, len(points_m), _CHUNK):
        some = slice(first, first + _CHUNK)
        near = [sorted({*outer, *found}) for found in tree.query_ball_point(points_m[some], reach_m[some])]
        counts = np.array([len(found) for found in near])
        k = np.fromiter(chain.from_iterable(near), np.intp, counts.sum())
        x, y = (np.repeat(points_m[some], counts, axis=0) - starts[k]).T
        east, north = directions[k].T
        foot = np.clip(x * east + y * north, low[k], high[k])
        squared = (x - foot * east) ** 2 + (y - foot * north) ** 2
        rows = np.cumsum(counts) - counts
        least = np.flatnonzero(squared == np.repeat(np.minimum.reduceat(squared, rows), counts))
        best = least[np.searchsorted(least, rows)]
        found_s[some] = station[k[best]] + foot[best]
        found_o[some] = np.copysign(np.sqrt(squared[best]), east[best] * y[best] - north[best] * x[best])
    return found_s, found_o


def locate(line_m: Floats, stations_m: Floats, offsets_m: Floats) -> Floats:
    """(M, 2) points at stations and offsets: the inverse of `project` away from sharp bends."""
    index, along_m, directions = _segments(line_m, stations_m)
    normals = np.stack([-directions[:, 1], directions[:, 0]], axis=1)
    return np.asarray(line_m[index] + along_m[:, None] * directions + offsets_m[:, None] * normals)


def directions_at(line_m: Floats, stations_m: Floats) -> Floats:
    """(M, 2) unit vectors along the line at stations; beyond the ends those of the ends."""
    return _segments(line_m, stations_m)[2]


def _segments(line_m: Floats, stations_m: Floats) -> tuple[Ints, Floats, Floats]:
    """(M,) number of the line's segment at each station, (M,) metres from its start, (M, 2) its direction."""
    station = stations(line_m)
    steps = np.diff(line_m, axis=0)
    index = np.clip(np.searchsorted(station, stations_m, side="right") - 1, 0, len(steps) - 1)
    directions: Floats = steps[index] / np.hypot(*steps[index].T)[:, None]
    return index, stations_m - station[index], directions


def spacing_beside(gaps_m: Floats, index: int, *, alone: float = 0.0) -> float:
    """Local spacing at a gap: the larger of the medians of up to three gaps before it and after it. So a tangent may follow a
    taper with half its spacing. `alone` if there are no other gaps."""
    beside = gaps_m[max(index - 3, 0) : index], gaps_m[index + 1 : index + 4]
    return max((float(np.median(some)) for some in beside if len(some)), default=alone)
