"""Points of lane markings -> chains: lines that are followed along the drive's path, through the gaps between dashes.

Along the path the points of each half metre are sorted by their offset; where they are dense is a node. Nodes are linked to the
chain whose extrapolation they meet, so that chains may drift across the path, as when the vehicle changes lanes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from conetl.model.arrays import Ints
from conetl.tracking.markings.located import LocatedPoints

_BIN_M, _CELL_M = 0.5, 0.02
#: Smoothing of the density across the path: what points of one marking scatter.
_SPREAD_M = 0.03
#: Nodes have at least the weight of this many points of usual weight, and this share of the densest one within `_BESIDE_M`.
_LEAST_POINTS, _LEAST_SHARE, _BESIDE_M = 1.0, 0.2, 0.15
#: Nodes are at least this far apart: two lines of paint and the road between them.
_APART_M = 0.12
#: A chain is continued by the line through its nodes of this length; shorter than `_LEAST_FIT_M` it runs along the path.
_FIT_M, _LEAST_FIT_M = 6.0, 1.5
#: Largest distance of a node from it: at once, and more for every metre of a gap, with and without a known direction.
_GATE_M, _GATE_PER_M, _GATE_PER_M_WITHOUT, _WIDEST_GATE_M = 0.1, 0.02, 0.08, 0.4
#: Of two chains the one that was lost for longer has to be nearer by this much per metre.
_PER_GAP = 0.03
#: Points belong to the chain that is nearest, at most this far.
_MEMBER_M = 0.15


@dataclass
class _Line:
    """Nodes of one line, in the order of their stations."""

    station_m: list[float] = field(default_factory=list)
    offset_m: list[float] = field(default_factory=list)

    def expected_m(self, station_m: float) -> tuple[float, float]:
        """Offset at a station beyond its last node, and how far from it a node may be."""
        s, d = np.array(self.station_m), np.array(self.offset_m)
        recent = s >= s[-1] - _FIT_M
        s, d, gap = s[recent], d[recent], station_m - s[-1]
        if s[-1] - s[0] < _LEAST_FIT_M:
            return float(d.mean()), min(_GATE_M + _GATE_PER_M_WITHOUT * gap, _WIDEST_GATE_M)
        slope, start = np.polyfit(s - s[-1], d, 1)
        return float(start + slope * gap), min(_GATE_M + _GATE_PER_M * gap, _WIDEST_GATE_M)


def chains_of(points: LocatedPoints, max_gap_m: float) -> list[Ints]:
    """Numbers of the points of each chain, by rising station."""
    closed: list[_Line] = []
    active: list[_Line] = []
    for station, offsets in _nodes(points):
        closed += [chain for chain in active if station - chain.station_m[-1] > max_gap_m]
        active = [chain for chain in active if station - chain.station_m[-1] <= max_gap_m]
        expected = [chain.expected_m(station) for chain in active]
        pairs = sorted(
            (abs(offset - at) + _PER_GAP * (station - active[k].station_m[-1]), k, n)
            for k, (at, gate) in enumerate(expected)
            for n, offset in enumerate(offsets)
            if abs(offset - at) <= gate
        )
        chains: set[int] = set()
        nodes: set[int] = set()
        for _, k, n in pairs:
            if k not in chains and n not in nodes:
                chains.add(k)
                nodes.add(n)
                active[k].station_m.append(station)
                active[k].offset_m.append(offsets[n])
        active += [_Line([station], [offset]) for n, offset in enumerate(offsets) if n not in nodes]
    lines = [chain for chain in (*closed, *active) if len(chain.station_m) > 1]
    return _members(points, lines)


def _nodes(points: LocatedPoints) -> list[tuple[float, list[float]]]:
    """Station of each bin with points, and the offsets at which they are dense."""
    low, half = points.road_station_m.min(), np.abs(points.road_offset_m).max() + 0.5
    row = ((points.road_station_m - low) / _BIN_M).astype(np.intp)
    column = ((points.road_offset_m + half) / _CELL_M).astype(np.intp)
    weight = points.weight[:, 1]
    density = np.zeros((row.max() + 1, int(2 * half / _CELL_M) + 2))
    np.add.at(density, (row, column), weight / np.median(weight))
    sigma = _SPREAD_M / _CELL_M
    # So that one point alone has its own weight at its peak.
    density = gaussian_filter1d(density, sigma, axis=1, mode="constant") * sigma * np.sqrt(2 * np.pi)
    highest = maximum_filter1d(density, 2 * int(_BESIDE_M / _CELL_M) + 1, axis=1)
    peaks = (density >= maximum_filter1d(density, 2 * int(_APART_M / _CELL_M) + 1, axis=1)) & (
        density >= np.maximum(_LEAST_POINTS, _LEAST_SHARE * highest)
    )
    found = []
    for number in np.flatnonzero(peaks.any(axis=1)):
        offsets = (np.flatnonzero(peaks[number]) + 0.5) * _CELL_M - half
        found.append((float(low + (number + 0.5) * _BIN_M), offsets.tolist()))
    return found


def _members(points: LocatedPoints, lines: list[_Line]) -> list[Ints]:
    """Numbers of the points of each line, each point in at most one."""
    nearest = np.full(len(points.road_station_m), _MEMBER_M)
    owner = np.full(len(points.road_station_m), -1)
    for number, line in enumerate(lines):
        s, d = np.array(line.station_m), np.array(line.offset_m)
        inside = np.flatnonzero((points.road_station_m >= s[0] - _BIN_M) & (points.road_station_m <= s[-1] + _BIN_M))
        apart = np.abs(points.road_offset_m[inside] - np.interp(points.road_station_m[inside], s, d))
        better = apart < nearest[inside]
        nearest[inside[better]], owner[inside[better]] = apart[better], number
    order = np.argsort(points.road_station_m, kind="stable")
    return [order[owner[order] == number] for number in range(len(lines)) if (owner == number).any()]
