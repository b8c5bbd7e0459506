"""Lines along the road: axes for the stations of cones (paths of drives, else lines through the cones), and lane lines beside an
axis as offsets by station, with the lanes that a row of cones closes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree

from conetl.geometry.linear_reference import directions_at, locate, project, resampled, smoothed, spaced, stations
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import AxisSource, DrivePath, LaneBands, LaneLine

_STEP_M = 2.0
_LEAST_PASS_M = 5.0
#: Two passes belong to one road if they meet within this offset and direction.
_JOIN_OFFSET_M = 8.0
_JOIN_COS = 0.87
_LEAST_STATIONS = 3
#: Sources cut lane lines into pieces and dashes; pieces this near to each other, along and across, are one line.
_JOIN_STATIONS = 5
_JOIN_LINE_OFFSET_M = 0.7
#: Lines with a larger slope cross the road (stop lines) or leave it.
_MAX_SLOPE = 0.35
#: A cone on a lane line may stand this far to either side of it.
_ON_LINE_M = 0.5


@dataclass(frozen=True, eq=False)
class RoadAxis:
    """A line and the cones (indices) along it."""

    line_m: Floats
    source: AxisSource
    members: Ints
    stations_m: Floats
    offsets_m: Floats


def passes_beside(paths: Sequence[DrivePath], cones_m: Floats, params: WorkZoneParams) -> list[DrivePath]:
    """The parts of the paths beside cones (C, 2), smoothed, by time; a drive that passes twice gives two."""
    tree = KDTree(cones_m)
    reach_m = params.max_path_offset_m + params.max_beyond_path_m
    found = []
    for path in paths:
        points = path.xy_m[spaced(path.xy_m, 0.5)]
        if len(points) < 2:
            continue
        line = smoothed(points, _STEP_M, params.axis_smoothing_m)
        near = tree.query(line, distance_upper_bound=reach_m)[0] < np.inf
        for start, end in np.flatnonzero(np.diff(near, prepend=False, append=False)).reshape(-1, 2):
            stretch = line[start:end]
            if len(stretch) > 1 and stations(stretch)[-1] >= _LEAST_PASS_M:
                found.append(replace(path, xy_m=stretch))
    return found


def axes_of(cones_m: Floats, passes: Sequence[DrivePath], params: WorkZoneParams) -> list[RoadAxis]:
    """Axes such that every cone (C, 2) is beside exactly one of them; those from drives come first.

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


def _covered(line_m: Floats, s: Floats, o: Floats, params: WorkZoneParams) -> Bools:
    beyond = params.max_beyond_path_m
    return np.asarray((np.abs(o) <= params.max_path_offset_m) & (s >= -beyond) & (s <= stations(line_m)[-1] + beyond))


def _best_pass(cones_m: Floats, passes: Sequence[DrivePath], params: WorkZoneParams) -> Floats | None:
    """The pass beside the most cones, then with the fewest beyond its ends, then the earliest; None if no cone is beside any."""
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
        longer = next(
            (line for line in both if line is not None and _covers_more(line, cones_m, covered, params)), None
        )
        if longer is None:
            break
        # Lines are reversed to be extended at their start.
        line_m = longer if np.allclose(longer[0], line_m[0]) else longer[::-1]
    return line_m


def _covers_more(line_m: Floats, cones_m: Floats, covered: Bools, params: WorkZoneParams) -> bool:
    """Whether a line covers the given cones and at least one more."""
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


def lane_bands(
    axis_m: Floats, lines: Sequence[LaneLine], *, from_m: float, to_m: float, reach_m: float
) -> LaneBands | None:
    """Lines along the axis between two stations and nearer to it than reach_m; None if there is none."""
    at = np.arange(from_m, to_m + _STEP_M, _STEP_M)
    corners = locate(axis_m, np.array([from_m, (from_m + to_m) / 2, to_m]), np.zeros(3))
    low = corners.min(axis=0) - reach_m - (to_m - from_m) / 2
    high = corners.max(axis=0) + reach_m + (to_m - from_m) / 2
    near = [
        line.xy_m for line in lines if (line.xy_m.max(axis=0) >= low).all() and (line.xy_m.min(axis=0) <= high).all()
    ]
    bands = _joined_bands([piece for line_m in near for piece in _offsets_along(axis_m, line_m, at, reach_m)])
    if not bands:
        return None
    order = np.argsort([float(np.nanmedian(band)) for band in bands], kind="stable")
    return LaneBands(at, np.stack([bands[k] for k in order], axis=1))


def _offsets_along(axis_m: Floats, line_m: Floats, at: Floats, reach_m: float) -> list[Floats]:
    """Offsets of one line by station: one array for each stretch along the axis."""
    points = resampled(line_m, _STEP_M)
    s, o = project(axis_m, points)
    if s[-1] < s[0]:
        s, o = s[::-1], o[::-1]
    step_s, step_o = np.diff(s), np.diff(o)
    steady = (step_s > 0) & (np.abs(step_o) <= _MAX_SLOPE * step_s)
    ahead = np.concatenate([steady, [False]])
    behind = np.concatenate([[False], steady])
    good = (ahead | behind) & (np.abs(o) <= reach_m) & (s >= at[0] - _STEP_M) & (s <= at[-1] + _STEP_M)
    edges = np.flatnonzero(np.diff(good, prepend=False, append=False)).reshape(-1, 2)
    found = [
        np.interp(at, s[start:end], o[start:end], left=np.nan, right=np.nan) for start, end in edges if end - start > 1
    ]
    return [offsets for offsets in found if np.isfinite(offsets).any()]


def _joined_bands(pieces: Sequence[Floats]) -> list[Floats]:
    """Pieces that continue or overlap each other as one line each; small gaps are interpolated."""
    ordered = sorted(pieces, key=lambda piece: (int(np.flatnonzero(np.isfinite(piece))[0]), float(np.nanmean(piece))))
    bands: list[Floats] = []
    for piece in ordered:
        known = np.flatnonzero(np.isfinite(piece))
        best, distance = None, _JOIN_LINE_OFFSET_M
        for index, band in enumerate(bands):
            there = np.flatnonzero(np.isfinite(band))
            both = np.intersect1d(known, there)
            if len(both):
                apart = float(np.abs(piece[both] - band[both]).max())
            elif known[0] - there[-1] <= _JOIN_STATIONS:
                apart = abs(float(piece[known[0]] - band[there[-1]]))
            else:
                continue
            if apart < distance:
                best, distance = index, apart
        if best is None:
            bands.append(piece.copy())
        else:
            fresh = known[~np.isfinite(bands[best][known])]
            bands[best][fresh] = piece[fresh]
    return [_bridged(band) for band in bands if np.isfinite(band).sum() >= _LEAST_STATIONS]


def _bridged(band: Floats) -> Floats:
    known = np.flatnonzero(np.isfinite(band))
    inside = np.arange(known[0], known[-1] + 1)
    band[inside] = np.interp(inside, known, band[known])
    return band


def lanes_at(bands: LaneBands, station_m: float, params: WorkZoneParams) -> list[tuple[float, float]]:
    """Right and left offset of every lane at a station, from right to left."""
    lines = np.sort([np.interp(station_m, bands.stations_m, line) for line in bands.offsets_m.T])
    lines = lines[np.isfinite(lines)]
    least, most = params.lane_width_m
    return [(float(a), float(b)) for a, b in pairwise(lines) if least <= b - a <= most]


def closed_lanes(
    bands: LaneBands,
    stations_m: Floats,
    offsets_m: Floats,
    sigmas_o_m: Floats,
    traffic_sign: float,
    params: WorkZoneParams,
) -> tuple[int, int]:
    """How many lanes a row closes, and how many it narrows or may close: the maximum over its cones.

    stations_m, offsets_m, sigmas_o_m: (C,) of the row's cones; traffic_sign as in `find_rows`. A cone closes a lane if it leaves
    less of it than `min_open_lane_m`, by more than two sigmas. A lane wholly behind the row counts as closed only if the row has
    crossed it: otherwise its direction is unknown.
    """
    toward = offsets_m * traffic_sign
    swept_from = float(toward.min()) - _ON_LINE_M
    closed = narrowed = 0
    for station_m, offset_m, sigma_m in zip(stations_m, toward, sigmas_o_m, strict=True):
        sigma = float(np.hypot(sigma_m, params.lane_axis_sigma_m))
        here_closed = here_narrowed = 0
        for right, left in lanes_at(bands, float(station_m), params):
            low, high = sorted((right * traffic_sign, left * traffic_sign))
            rest = high - max(offset_m, low)
            if rest <= _ON_LINE_M and low >= swept_from:
                here_closed += 1
            elif offset_m > low + _ON_LINE_M and rest > _ON_LINE_M:
                if rest + 2 * sigma < params.min_open_lane_m:
                    here_closed += 1
                else:
                    here_narrowed += 1
        closed, narrowed = max(closed, here_closed), max(narrowed, here_narrowed)
    return closed, narrowed
