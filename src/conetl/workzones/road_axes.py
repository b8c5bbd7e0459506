"""Axes along which the stations of cones are counted: from the paths of drives, else through the cones themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from conetl.geometry.linear_reference import Floats, directions_at, project, smoothed, stations, without_standstill
from conetl.model.params import WorkZoneParams
from conetl.model.work_zone_records import AxisSource, DrivePath

Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
_STEP_M = 2.0
_LEAST_PASS_M = 5.0
#: Two passes belong to one road if they meet within this offset and direction.
_JOIN_OFFSET_M = 8.0
_JOIN_COS = 0.87


@dataclass(frozen=True, eq=False)
class RoadAxis:
    """A line and the cones (indices) along it."""

    line_m: Floats
    source: AxisSource
    members: Indices
    stations_m: Floats
    offsets_m: Floats


def passes_beside(paths: Sequence[DrivePath], cones_m: Floats, params: WorkZoneParams) -> list[DrivePath]:
    """The stretches of the paths beside cones (C, 2), smooth, by time; a drive that passes twice gives two."""
    tree = KDTree(cones_m)
    reach_m = params.max_path_offset_m + params.max_beyond_path_m
    found = []
    for path in paths:
        points = without_standstill(path.xy_m, 0.5)
        if len(points) < 2:
            continue
        line = smoothed(points, _STEP_M, params.axis_smoothing_m)
        near = tree.query(line, distance_upper_bound=reach_m)[0] < np.inf
        edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
        for start, end in edges.reshape(-1, 2):
            stretch = line[start:end]
            if len(stretch) > 1 and stations(stretch)[-1] >= _LEAST_PASS_M:
                found.append(replace(path, xy_m=stretch))
    return found


def axes_of(cones_m: Floats, passes: Sequence[DrivePath], params: WorkZoneParams) -> list[RoadAxis]:
    """Axes such that every cone (C, 2) is beside exactly one of them, those of drives first.

    The pass beside the most cones is the first axis, extended by others of the same road. Cones beside no pass get a straight
    line through themselves.
    """
    left = np.arange(len(cones_m))
    axes = []
    while len(left):
        best = _best_pass(cones_m[left], passes, params)
        if best is None:
            break
        line = _lengthened(best, cones_m[left], passes, params)
        s, o = project(line, cones_m[left])
        covered = _covered(line, s, o, params)
        axes.append(RoadAxis(line, "drives", left[covered], s[covered], o[covered]))
        left = left[~covered]
    if len(left):
        line = _through(cones_m[left])
        s, o = project(line, cones_m[left])
        axes.append(RoadAxis(line, "cones", left, s, o))
    return axes


def _covered(line_m: Floats, s: Floats, o: Floats, params: WorkZoneParams) -> Mask:
    beyond = params.max_beyond_path_m
    covered: Mask = (np.abs(o) <= params.max_path_offset_m) & (s >= -beyond) & (s <= stations(line_m)[-1] + beyond)
    return covered


def _best_pass(cones_m: Floats, passes: Sequence[DrivePath], params: WorkZoneParams) -> Floats | None:
    """The pass beside the most cones, then with the fewest beyond its ends, then the earliest; None if none covers a cone."""
    ranked = []
    for number, one in enumerate(passes):
        s, o = project(one.xy_m, cones_m)
        covered = _covered(one.xy_m, s, o, params)
        inside = covered & (s >= 0) & (s <= stations(one.xy_m)[-1])
        if covered.any():
            ranked.append((-covered.sum(), -inside.sum(), float(one.captured_from_ns), one.drive_id, number))
    return passes[min(ranked)[-1]].xy_m if ranked else None


def _lengthened(line_m: Floats, cones_m: Floats, passes: Sequence[DrivePath], params: WorkZoneParams) -> Floats:
    """The line extended at its ends by parts of other passes, shifted sideways to meet it, while that covers more cones."""
    for _ in range(len(passes)):
        covered = _covered(line_m, *project(line_m, cones_m), params)
        if covered.all():
            break
        both = (_joined(start, one.xy_m) for one in passes for start in (line_m, line_m[::-1]))
        longer = next((line for line in both if line is not None and _gains(line, cones_m, covered, params)), None)
        if longer is None:
            break
        # A line extended at its start was reversed for that.
        line_m = longer if np.allclose(longer[0], line_m[0]) else longer[::-1]
    return line_m


def _gains(line_m: Floats, cones_m: Floats, covered: Mask, params: WorkZoneParams) -> bool:
    """Whether a line covers more cones than those given, and all of these."""
    own = _covered(line_m, *project(line_m, cones_m), params)
    return bool((own & ~covered).any() and not (covered & ~own).any())


def _joined(line_m: Floats, other_m: Floats) -> Floats | None:
    """The line followed by the part of another beyond its end; None if there is none."""
    s, o = project(line_m, other_m)
    beyond = s > stations(line_m)[-1]
    if not beyond.any() or beyond.all() or np.abs(o[~beyond]).min() > _JOIN_OFFSET_M:
        return None
    going = other_m if beyond[-1] else other_m[::-1]
    ahead = beyond if beyond[-1] else beyond[::-1]
    first = int(np.flatnonzero(~ahead)[-1]) + 1
    tail = going[first:]
    if len(tail) < 2:
        return None
    end = directions_at(line_m, stations(line_m)[-1:])[0]
    start = (tail[1] - tail[0]) / np.hypot(*(tail[1] - tail[0]))
    if float(end @ start) < _JOIN_COS:
        return None
    aside = np.array([-end[1], end[0]])
    shift = float((tail[0] - line_m[-1]) @ aside)
    return np.concatenate([line_m, tail - shift * aside])


def _through(cones_m: Floats) -> Floats:
    """A straight line along the largest extent of the cones, towards larger easting (then northing)."""
    centre = cones_m.mean(axis=0)
    if len(cones_m) < 2:
        return np.array([[centre[0] - 0.5, centre[1]], [centre[0] + 0.5, centre[1]]])
    direction = np.linalg.svd(cones_m - centre)[2][0]
    if (direction[0], direction[1]) < (0.0, 0.0):
        direction = -direction
    along = (cones_m - centre) @ direction
    return np.stack([centre + (along.min() - 1.0) * direction, centre + (along.max() + 1.0) * direction])
