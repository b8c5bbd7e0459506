"""Lane lines beside an axis as offsets by station, and the lanes that a row of cones closes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from conetl.geometry.linear_reference import Floats, locate, project, resampled
from conetl.model.params import WorkZoneParams
from conetl.model.work_zone_records import LaneBands, LaneLine

_STEP_M = 2.0
_LEAST_STATIONS = 3
#: Sources cut lane lines into pieces and dashes; pieces this near to each other, along and across, are one line.
_JOIN_STATIONS = 5
_JOIN_OFFSET_M = 0.7
#: Lines with a larger slope cross the road (stop lines) or leave it.
_MAX_SLOPE = 0.35
#: A cone on a lane line may stand this far to either side of it.
_ON_LINE_M = 0.5


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
    bands = _joined([piece for line_m in near for piece in _along(axis_m, line_m, at, reach_m)])
    if not bands:
        return None
    order = np.argsort([float(np.nanmedian(band)) for band in bands], kind="stable")
    return LaneBands(at, np.stack([bands[k] for k in order], axis=1))


def _along(axis_m: Floats, line_m: Floats, at: Floats, reach_m: float) -> list[Floats]:
    """Offsets of one line by station, one array per stretch along the axis."""
    points = resampled(line_m, _STEP_M)
    s, o = project(axis_m, points)
    if s[-1] < s[0]:
        s, o = s[::-1], o[::-1]
    step_s, step_o = np.diff(s), np.diff(o)
    steady = (step_s > 0) & (np.abs(step_o) <= _MAX_SLOPE * step_s)
    ahead = np.concatenate([steady, [False]])
    behind = np.concatenate([[False], steady])
    good = (ahead | behind) & (np.abs(o) <= reach_m) & (s >= at[0] - _STEP_M) & (s <= at[-1] + _STEP_M)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int))).reshape(-1, 2)
    found = [
        np.interp(at, s[start:end], o[start:end], left=np.nan, right=np.nan) for start, end in edges if end - start > 1
    ]
    return [offsets for offsets in found if np.isfinite(offsets).any()]


def _joined(pieces: Sequence[Floats]) -> list[Floats]:
    """Pieces that continue or overlap each other as one line each; small gaps are interpolated."""
    ordered = sorted(pieces, key=lambda piece: (int(np.flatnonzero(np.isfinite(piece))[0]), float(np.nanmean(piece))))
    bands: list[Floats] = []
    for piece in ordered:
        known = np.flatnonzero(np.isfinite(piece))
        best, distance = None, _JOIN_OFFSET_M
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

    stations_m, offsets_m, sigmas_o_m: (C,) of the row's cones; traffic_sign as in `find_rows`. A cone closes a lane if it
    leaves less of it than `min_open_lane_m`, by more than two sigmas. A lane wholly behind the row counts as closed only where
    the row has crossed it: otherwise its direction is unknown.
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
