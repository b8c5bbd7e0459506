"""Matching of a drive's lane markings with the stretches on the map: feet of perpendiculars, the lateral offset, claims."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from conetl.mapping.association import near_pairs
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.params import ReconcileParams

#: Lines that differ by more in direction are not the same marking.
_LEAST_COSINE = float(np.cos(np.radians(20.0)))
#: A line counts as continuing this far straight beyond its ends; and beyond its inner vertices, outside of a bend.
_END_M, _JOIN_M = 1.0, 0.1
#: Two stretches lie side by side, not one after the other, if they share more than this of a line.
_SHARED_M = 0.6
#: Limits of the search for the lateral offset: samples, candidates, and the cell in which candidates are one.
_MAX_SAMPLES, _MAX_CANDIDATES, _CANDIDATE_CELL_M = 1000, 100, 0.05
#: Cost of a sample that fits nothing, in squared sigmas; and samples that must fit.
_MISFIT, _LEAST_SAMPLES = 9.0, 4
#: Least mean square of a direction's share in the normals of the lines for the offset along it to be estimated: on a straight
#: road nothing shows the offset along the road.
_LEAST_SPREAD = 0.05


class Lines(NamedTuple):
    """Polylines, the vertices of all in one array."""

    vertices_m: Floats
    """(V, 3)"""
    line: Ints
    """(V,) number of the line of each vertex."""
    station_m: Floats
    """(V,) from the line's first vertex, horizontal."""
    tangents: Floats
    """(V, 2) unit vectors, horizontal."""

    @property
    def normals(self) -> Floats:
        """(V, 2) unit vectors to the left."""
        return np.stack([-self.tangents[:, 1], self.tangents[:, 0]], axis=1)


class Feet(NamedTuple):
    """Feet (K,) of perpendiculars from points to lines, at most one per point and line."""

    point: Ints
    line: Ints
    segment: Ints
    """First vertex of the segment of the line, in `Lines`."""
    share: Floats
    """Of the foot along the segment, 0 to 1."""
    station_m: Floats
    lateral_m: Floats
    """Of the line from the point, to the left of the point's direction."""

    def at(self, values: Floats) -> Floats:
        """Values at the feet, interpolated linearly between those of the vertices of `Lines` (V, ...)."""
        share = self.share.reshape(-1, *(1,) * (values.ndim - 1))
        found: Floats = (1 - share) * values[self.segment] + share * values[self.segment + 1]
        return found

    def only(self, rows: Ints | Bools) -> Feet:
        return Feet(*(values[rows] for values in self))  # type: ignore[arg-type]


def lines_of(polylines: Sequence[Floats]) -> Lines:
    """polylines: (n, 3) each, n >= 2."""
    if not polylines:
        return Lines(np.empty((0, 3)), np.empty(0, np.int64), np.empty(0), np.empty((0, 2)))
    vertices_m = np.concatenate(polylines)
    line = np.repeat(np.arange(len(polylines)), [len(one) for one in polylines])
    first = np.concatenate([[True], line[1:] != line[:-1]])
    last = np.concatenate([first[1:], [True]])
    number = np.arange(len(line))
    before, after = np.where(first, number, number - 1), np.where(last, number, number + 1)
    lengths_m = np.where(first, 0.0, np.hypot(*(vertices_m - vertices_m[before])[:, :2].T))
    total_m = np.cumsum(lengths_m)
    direction = (vertices_m[after] - vertices_m[before])[:, :2]
    tangents = direction / np.maximum(np.hypot(*direction.T), 1e-9)[:, None]
    return Lines(vertices_m, line, total_m - total_m[np.flatnonzero(first)][line], tangents)


def feet(points: Lines, lines: Lines, reach_m: float) -> Feet:
    """Feet of the vertices of `points` on lines of similar direction, at most `reach_m` beside them."""
    inner = np.flatnonzero(lines.line[1:] == lines.line[:-1])
    start, step = lines.vertices_m[inner, :2], (lines.vertices_m[inner + 1] - lines.vertices_m[inner])[:, :2]
    length = np.hypot(*step.T)
    inner, start, step, length = (values[length > 0] for values in (inner, start, step, length))
    if not len(points.line) or not len(inner):
        return Feet(*(np.empty(0, np.int64),) * 3, *(np.empty(0),) * 3)
    unit = step / length[:, None]
    p, s = near_pairs(points.vertices_m[:, :2], start + step / 2, reach_m + float(length.max()) / 2 + _END_M)
    along = ((points.vertices_m[p, :2] - start[s]) * unit[s]).sum(axis=1)
    ends = np.concatenate([[True], lines.line[1:] != lines.line[:-1], [True]])
    low = np.where(ends[inner], -_END_M, -_JOIN_M)[s]
    high = length[s] + np.where(ends[inner + 2], _END_M, _JOIN_M)[s]
    apart = start[s] + along[:, None] * unit[s] - points.vertices_m[p, :2]
    tangent = points.tangents[p]
    lateral = tangent[:, 0] * apart[:, 1] - tangent[:, 1] * apart[:, 0]
    alike = np.abs((tangent * unit[s]).sum(axis=1)) >= _LEAST_COSINE
    kept = np.flatnonzero(alike & (along >= low) & (along <= high) & (np.hypot(*apart.T) <= reach_m))
    line = lines.line[inner[s]]
    order = kept[np.lexsort((np.abs(lateral[kept]), line[kept], p[kept]))]
    one = np.ones(len(order), bool)
    one[1:] = (np.diff(p[order]) != 0) | (np.diff(line[order]) != 0)
    k = order[one]
    share = np.clip(along[k] / length[s[k]], 0.0, 1.0)
    station_m = lines.station_m[inner[s[k]]] + share * length[s[k]]
    return Feet(p[k], line[k], inner[s[k]], share, station_m, lateral[k])


def lateral_offset(
    own: Lines, on_map: Lines, own_var_m2: float, map_var_m2: float, params: ReconcileParams
) -> tuple[Floats, float]:
    """Offset (3,) of a drive's lines against those of the map in metres, and the share of it that the drive's variance explains.

    As `association.common_offset`, with the distances across the lines; along a straight road the offset is 0.
    """
    nothing = np.zeros(3), 0.0
    total_var = own_var_m2 + map_var_m2
    if not len(own.line) or not len(on_map.line):
        return nothing
    allowed_m = min(params.max_offset_m, 4 * float(np.sqrt(total_var)))
    step = 1 + len(own.line) // _MAX_SAMPLES
    samples = Lines(*(values[::step] for values in own))  # type: ignore[arg-type]
    found = feet(samples, on_map, allowed_m + params.marking_gate_m)
    if not len(found.point):
        return nothing
    sample_m, normal = samples.vertices_m[found.point], samples.normals[found.point]
    misfit_m = -found.lateral_m
    rise_m = sample_m[:, 2] - found.at(on_map.vertices_m[:, 2])
    starts = np.flatnonzero(np.concatenate([[True], np.diff(found.point) != 0]))
    scale_m = params.marking_gate_m / 3

    cells = np.round(misfit_m[:, None] * normal / _CANDIDATE_CELL_M).astype(np.int64)
    cells, counts = np.unique(np.concatenate([np.zeros((1, 2), np.int64), cells]), axis=0, return_counts=True)
    candidates = cells[np.lexsort((np.abs(cells).sum(axis=1), -counts))[:_MAX_CANDIDATES]] * _CANDIDATE_CELL_M
    candidates = candidates[np.hypot(*candidates.T) <= allowed_m]
    left = np.minimum(((misfit_m - candidates @ normal.T) / scale_m) ** 2, _MISFIT)
    costs = np.minimum.reduceat(left, starts, axis=1).sum(axis=1) + (candidates**2).sum(axis=1) / total_var
    offset = candidates[int(np.argmin(costs))] if len(candidates) else np.zeros(2)
    values, vectors = np.linalg.eigh(normal.T @ normal / len(normal))
    across = vectors[:, values >= _LEAST_SPREAD]
    fits = np.zeros(len(misfit_m), bool)
    for _ in range(3):  # least squares of the samples that fit; they may change with the offset
        fits = np.abs(misfit_m - normal @ offset) <= params.marking_gate_m
        if np.count_nonzero(fits) < _LEAST_SAMPLES:
            return nothing
        design = normal[fits] @ across
        weight = design.T @ design / scale_m**2 + np.eye(across.shape[1]) / total_var
        offset = across @ np.linalg.solve(weight, design.T @ misfit_m[fits] / scale_m**2)
    if float(np.hypot(*offset)) > allowed_m:
        return nothing
    return np.array([*offset, np.median(rise_m[fits])]), own_var_m2 / total_var


class Claims:
    """Assignment of the vertices of the map's stretches to points of the drive's lines: each vertex once, and no part of a line
    to two stretches side by side."""

    def __init__(self, found: Feet, stretch: Ints) -> None:
        """stretch: (V,) number of the stretch of each vertex of the map."""
        self._found, self._stretch = found, stretch
        self._parts: dict[int, list[tuple[float, float]]] = {}
        self._taken: set[int] = set()

    def claim(self, rows: Ints, penalty_m: Floats, least: Callable[[int], int]) -> Ints:
        """Claim feet and return their rows, out of `rows` (K,).

        Whole stretches are claimed by mean distance and penalty (K,), the nearest first; at least `least(stretch)` vertices on
        one line.
        """
        found, stretch = self._found, self._stretch[self._found.point[rows]]
        groups: dict[tuple[int, int], list[int]] = {}
        for k, key in enumerate(zip(stretch.tolist(), found.line[rows].tolist(), strict=True)):
            groups.setdefault(key, []).append(k)
        cost = np.abs(found.lateral_m[rows]) + penalty_m
        claimed: list[int] = []
        for _, (number, line), members in sorted((float(cost[m].mean()), key, m) for key, m in groups.items()):
            own = [int(rows[k]) for k in members if self._is_free(int(rows[k]), line)]
            if len(own) >= least(number):
                stations_m = found.station_m[own]
                self._parts.setdefault(line, []).append((float(stations_m.min()), float(stations_m.max())))
                self._taken.update(found.point[own].tolist())
                claimed += own
        return np.array(sorted(claimed), np.int64)

    def free_parts(self, line: int, length_m: float, least_m: float) -> list[tuple[float, float]]:
        """The parts of a line, by stations, that no stretch has claimed; at least `least_m` long."""
        free, at_m = [], 0.0
        for low, high in [*sorted(self._parts.get(line, ())), (length_m, length_m)]:
            if low - at_m >= least_m:
                free.append((at_m, low))
            at_m = max(at_m, high)
        return free

    def _is_free(self, row: int, line: int) -> bool:
        station_m = self._found.station_m[row]
        return int(self._found.point[row]) not in self._taken and not any(
            low + _SHARED_M < station_m < high - _SHARED_M for low, high in self._parts.get(line, ())
        )
