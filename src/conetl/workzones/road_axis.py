"""Stations and offsets along a line: the road seen as one coordinate along it and one across it.

A station is the way along the line in metres from its first point (negative before it), an offset the distance from the line,
positive to the left of its direction. Lines are (N, 2) arrays in metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

Floats = NDArray[np.float64]
_CHUNK = 256


def without_standstill(line_m: Floats, least_m: float) -> Floats:
    """The line without points nearer than `least_m` to the one kept before them: a car that waits, and noise while it does."""
    kept = [0]
    for index in range(1, len(line_m)):
        if np.hypot(*(line_m[index] - line_m[kept[-1]])) >= least_m:
            kept.append(index)
    return line_m[kept]


def stations(line_m: Floats) -> Floats:
    """(N,) way along the line to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line_m, axis=0).T))])


def resampled(line_m: Floats, step_m: float) -> Floats:
    """The line by points about `step_m` apart, both ends kept."""
    way = stations(line_m)
    at = np.linspace(0.0, way[-1], max(int(np.ceil(way[-1] / step_m)) + 1, 2))
    return np.stack([np.interp(at, way, line_m[:, k]) for k in range(2)], axis=1)


def smoothed(line_m: Floats, step_m: float, sigma_m: float) -> Floats:
    """The line resampled and freed from wiggles shorter than `sigma_m`; straight lines stay straight to their ends."""
    points = resampled(line_m, step_m)
    reach = min(int(np.ceil(3.0 * sigma_m / step_m)), len(points) - 1)
    if reach < 1:
        return points
    padded = np.pad(points, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(padded, sigma_m / step_m, axis=0, mode="nearest")[reach:-reach])


def project(line_m: Floats, points_m: Floats) -> tuple[Floats, Floats]:
    """Stations and offsets (M,) of points (M, 2); beyond its ends the line goes on straight.

    Where several parts of the line are equally near, the first counts. Raises ValueError for a line without length.
    """
    starts, steps = line_m[:-1], np.diff(line_m, axis=0)
    lengths = np.hypot(*steps.T)
    keep = lengths > 0
    starts, steps, lengths = starts[keep], steps[keep], lengths[keep]
    if not len(starts):
        raise ValueError("a line needs two different points")
    way = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    directions = steps / lengths[:, None]
    low, high = np.zeros(len(starts)), lengths.copy()
    low[0], high[-1] = -np.inf, np.inf
    found_s, found_o = np.empty(len(points_m)), np.empty(len(points_m))
    for first in range(0, len(points_m), _CHUNK):
        some = slice(first, first + _CHUNK)
        # (P, N) arrays a coordinate each: several times faster than (P, N, 2).
        x, y = (points_m[some, k, None] - starts[:, k] for k in range(2))
        foot = np.clip(x * directions[:, 0] + y * directions[:, 1], low, high)
        squared = (x - foot * directions[:, 0]) ** 2 + (y - foot * directions[:, 1]) ** 2
        best = np.argmin(squared, axis=1)
        each = np.arange(len(best))
        cross = directions[best, 0] * y[each, best] - directions[best, 1] * x[each, best]
        found_s[some] = way[best] + foot[each, best]
        found_o[some] = np.copysign(np.sqrt(squared[each, best]), cross)
    return found_s, found_o


def place(line_m: Floats, stations_m: Floats, offsets_m: Floats) -> Floats:
    """(M, 2) points at stations and offsets: the inverse of `project` where the line is not sharply bent."""
    way = stations(line_m)
    steps = np.diff(line_m, axis=0)
    index = np.clip(np.searchsorted(way, stations_m, side="right") - 1, 0, len(steps) - 1)
    directions = steps[index] / np.hypot(*steps[index].T)[:, None]
    normals = np.stack([-directions[:, 1], directions[:, 0]], axis=1)
    points: Floats = line_m[index] + (stations_m - way[index])[:, None] * directions + offsets_m[:, None] * normals
    return points


def directions_at(line_m: Floats, stations_m: Floats) -> Floats:
    """(M, 2) unit vectors along the line at stations; beyond the ends those of the ends."""
    way = stations(line_m)
    steps = np.diff(line_m, axis=0)
    index = np.clip(np.searchsorted(way, stations_m, side="right") - 1, 0, len(steps) - 1)
    directions: Floats = steps[index] / np.hypot(*steps[index].T)[:, None]
    return directions


def part(line_m: Floats, from_m: float, to_m: float) -> Floats:
    """The line between two stations; where they lie beyond its ends, it goes on straight."""
    way = stations(line_m)
    inside = (way > from_m) & (way < to_m)
    ends = place(line_m, np.array([from_m, to_m]), np.zeros(2))
    return np.concatenate([ends[:1], line_m[inside], ends[1:]])
