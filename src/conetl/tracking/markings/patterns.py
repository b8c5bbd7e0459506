"""Where along a chain there is paint: solid and dashed pieces, lengths of dashes and gaps.

Of every row that a frame pair searched it is known where it crosses the chain and whether paint was found there. The share of
hits along the chain is the evidence for paint and, no less, for gaps.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtri

from conetl.geometry.linear_reference import locate
from conetl.geometry.small_arrays import robust_std
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.markings import MarkingPattern
from conetl.model.rig import Rig
from conetl.tracking.markings.located import LocatedPoints

#: Cells along the chain, and the sigma by which their shares of hits are smoothed.
_CELL_M, _SMOOTHING_M = 0.1, 0.15
#: There is paint where the share of hits is at least this part of what it is where there is most.
_PAINTED = 0.4
#: Shorter gaps and shorter runs of paint are noise.
_LEAST_GAP_M, _LEAST_RUN_M = 0.5, 0.4
#: No dash is as long (motorways: 6 m); no solid line has a longer worn hole.
_LONGEST_DASH_M, _LONGEST_HOLE_M = 8.0, 4.0
#: Gaps of one line have at most this relative scatter (median absolute deviation); dashes may be cut or worn.
_REGULAR = 0.3
#: Gaps of more than this many dashes are not gaps of a pattern (1 : 3 in North America is the longest in use).
_LONGEST_GAP = 4.0
#: Shorter gaps than this share of the longest one are worn holes in dashes.
_HOLE_SHARE = 0.4
#: About this many dashes are superimposed: with more, in bends, the period along the path changes.
_OVERLAID = 8
#: The period of dashes differs at most by this share from the median of their distances.
_PERIOD_SHARE = 0.05
#: A line with paint on more than this share of its length is solid, although worn.
_WORN = 0.75
#: The chain is drawn by points this far apart for its projection into the images.
_DRAWN_M = 0.25


class Searched(NamedTuple):
    """N rows of all frame pairs that cross a chain inside of both images, one array (N,) each."""

    station_m: Floats
    hit: Bools
    """Whether paint was found there."""
    weight: Floats
    """1 over the square of the depth (m): a row far away covers more of the road."""


class PatternPiece(NamedTuple):
    """Part of a chain with one pattern."""

    start_m: float
    end_m: float
    pattern: MarkingPattern
    painted_m: float
    """Length of paint."""
    hit_share: float
    """Share of hits where there is paint."""
    dash_m: float | None = None
    gap_m: float | None = None


def searched_rows(points: LocatedPoints, station_m: Floats, offset_m: Floats, height_m: Floats, rig: Rig) -> Searched:
    """The searched rows that cross a chain; points: those of the chain alone, the rest: its course (K,) by rising station."""
    camera, focal_base, margin_px = rig.left, rig.left.fx_px * rig.baseline_m, 0.02 * rig.left.width_px
    drawn = np.arange(station_m[0], station_m[-1] + _DRAWN_M, _DRAWN_M)
    across = locate(points.line_m, drawn, np.interp(drawn, station_m, offset_m))
    course = np.column_stack([across, np.interp(drawn, station_m, height_m)])
    found: list[Floats] = []
    for number, one in enumerate(points.frames):
        rows = one.searched()
        reach = rows[:, 1].max() if len(rows) else 0.0
        near = (drawn > points.frame_station_m[number]) & (drawn < points.frame_station_m[number] + reach + 5.0)
        if near.sum() < 2:
            continue
        pose = points.map_SE3_left[number]
        seen = (course[near] - pose[:3, 3]) @ pose[:3, :3]
        ahead = seen[:, 2] > 1.0
        seen, at = seen[ahead], drawn[near][ahead]
        if len(seen) < 2:
            continue
        u, v = (
            seen[:, k] / seen[:, 2] * f + c
            for k, f, c in ((0, camera.fx_px, camera.cx_px), (1, camera.fy_px, camera.cy_px))
        )
        order = np.argsort(v)
        own = points.frame == number
        row_u, row_depth, row_s = (
            np.interp(rows[:, 0], v[order], x[order], np.nan, np.nan) for x in (u, seen[:, 2], at)
        )
        with np.errstate(invalid="ignore"):
            inside = (row_u > margin_px) & (row_u < camera.width_px - margin_px)
            inside &= row_u - focal_base / row_depth > margin_px
        hit = np.isin(np.arange(len(rows)), points.columns.row[own])
        found.append(np.stack([row_s, hit, 1 / row_depth], axis=1)[inside])
    station, hit, weight = np.concatenate(found).T if found else np.zeros((3, 0))
    return Searched(station, hit > 0, weight**2)


def pieces_of(searched: Searched, min_length_m: float) -> list[PatternPiece]:
    """Pieces of a chain that have at least this length of paint, by increasing station."""
    if not len(searched.station_m):
        return []
    low = searched.station_m.min() - 1.0
    cell = ((searched.station_m - low) / _CELL_M).astype(np.intp)
    size = cell.max() + 11
    share, seen = _shares(cell, searched, size)
    known = seen > 0.02 * np.median(seen[seen > 0])
    share = np.where(known, share, 0.0)
    at = low + (np.arange(size) + 0.5) * _CELL_M
    runs = _runs(at, share, known, _PAINTED * _usual(share))
    pieces = [_piece(group, searched) for group in _groups(runs, searched)]
    return [piece for piece in pieces if piece is not None and piece.painted_m >= min_length_m]


def _shares(cell: Ints, searched: Searched, count: int) -> tuple[Floats, Floats]:
    """Smoothed share of hits in each of `count` cells, whose last is followed by the first, and the weight of the rows in it."""
    values = np.stack([np.bincount(cell, one, count) for one in (searched.weight, searched.weight * searched.hit)])
    seen, hits = gaussian_filter1d(values, _SMOOTHING_M / _CELL_M, mode="wrap")
    return hits / np.maximum(seen, 1e-12), seen


def _usual(share: Floats) -> float:
    """Share of hits where there is paint, of shares (C,) along a marking."""
    return float(np.percentile(share[share > 0.05], 75)) if (share > 0.05).any() else 0.0


def _lengths_m(runs: Floats) -> Floats:
    """(R,) of runs of paint (R, 2), from start to end, by rising station."""
    return np.asarray(runs[:, 1] - runs[:, 0])


def _gaps_m(runs: Floats) -> Floats:
    """(R - 1,) between runs (R, 2)."""
    return np.asarray(runs[1:, 0] - runs[:-1, 1])


def _parts(runs: Floats, together: Bools) -> list[Floats]:
    """Parts of runs (R, 2) in their order; together (R - 1,): whether a run is in the same part as the next."""
    return [part for part in np.split(runs, np.flatnonzero(~together) + 1) if len(part)]


def _joined(runs: Floats, together: Bools) -> Floats:
    """Every part as one run."""
    return np.array([(part[0, 0], part[-1, 1]) for part in _parts(runs, together)]).reshape(-1, 2)


def _runs(at: Floats, share: Floats, known: Bools, least: float) -> Floats:
    """Runs of paint (R, 2), their ends where the share of hits crosses `least`; where nothing was observed a run continues.

    at, share, known (C,): station of each cell, its share of hits, and whether it was observed.
    """
    above = (share >= least).astype(np.int8)
    begins, ends = np.flatnonzero(np.diff(above) == 1), np.flatnonzero(np.diff(above) == -1)
    starts_m = [np.interp(least, share[[i, i + 1]], at[[i, i + 1]]) for i in begins]
    ends_m = [np.interp(-least, -share[[j, j + 1]], at[[j, j + 1]]) for j in ends]
    runs = np.column_stack([starts_m, ends_m])
    unseen = [not known[(at > end) & (at < start)].all() for end, start in zip(ends_m[:-1], starts_m[1:], strict=True)]
    runs = _joined(runs, np.array(unseen, dtype=bool) | (_gaps_m(runs) < _LEAST_GAP_M))
    return runs[_lengths_m(runs) >= _LEAST_RUN_M]


def _groups(runs: Floats, searched: Searched) -> list[Floats]:
    """Runs that belong together: parts of a solid line with each other, dashes with dashes."""
    short = _lengths_m(runs) <= _LONGEST_DASH_M
    whole: list[Floats] = []
    for group in _parts(runs, short[:-1] & short[1:]):
        # One or two short runs beside a solid line are what is left between worn or hidden parts of it, more may be dashes.
        parts = (whole[-1], group) if whole else ()
        solid = [_dashes(part, searched) is None for part in parts]
        together = np.concatenate([*parts[:1], group])
        near = bool(whole) and _widest_gap_m(together) <= _LONGEST_HOLE_M
        if near and any(solid) and all(one or len(part) <= 2 for one, part in zip(solid, parts, strict=True)):
            whole[-1] = together
        else:
            whole.append(group)
    return whole


def _widest_gap_m(runs: Floats) -> float:
    return float(_gaps_m(runs).max(initial=0.0))


def _dashes(runs: Floats, searched: Searched) -> tuple[float, float] | None:
    """Lengths of dashes and gaps (m) of a dashed line; None of a solid one, which may be worn."""
    if len(runs) == 1 or (_lengths_m(runs) > _LONGEST_DASH_M).any():
        return None
    joined = _joined(runs, _gaps_m(runs) < _HOLE_SHARE * _widest_gap_m(runs))
    gaps, dashes = _gaps_m(joined), _lengths_m(joined)
    worn = dashes.sum() > _WORN * (joined[-1, 1] - joined[0, 0])
    dash, gap = float(np.median(dashes)), float(np.median(gaps))
    irregular = len(joined) > 2 and robust_std(gaps) / gap > _REGULAR
    if worn or irregular or gap > _LONGEST_GAP * dash:
        return None
    bounds = np.linspace(0, len(joined), max(round(len(joined) / _OVERLAID), 1) + 1).astype(int).tolist()
    parts = [_overlaid(joined[first:last], searched) for first, last in pairwise(bounds)]
    found = [lengths for lengths in parts if lengths is not None]
    if len(found) <= len(parts) / 2:
        return None
    dash, gap = np.median(found, axis=0).tolist()
    return dash, gap


def _overlaid(dashes: Floats, searched: Searched) -> tuple[float, float] | None:
    """Lengths of dashes and gaps (m), all periods superimposed; None if no part of the period is bare in all of them.

    So the end of a dash that is worn or hidden is known from the others. The period is the one with which paint, where its share
    of hits is at least `_PAINTED`, explains hits and misses best; where several do, as with two dashes, the one nearest to the
    median distance of dashes.
    """
    rough, (start, end) = float(np.median(np.diff(dashes, axis=0))), (dashes[0, 0], dashes[-1, 1])
    inside = (searched.station_m >= start) & (searched.station_m <= end)
    own = Searched(*(column[inside] for column in searched))

    def shares(period_m: float) -> tuple[Floats, Floats]:
        count = round(period_m / _CELL_M)
        return _shares(((own.station_m - start) / period_m % 1.0 * count).astype(np.intp), own, count)

    def explained(period_m: float) -> float:
        share, seen = shares(period_m)
        painted = np.maximum(share - least, 0.0)
        return float((painted * seen).sum() / own.weight.sum()) - (period_m / rough - 1.0) ** 2

    least = _PAINTED * _usual(shares(rough)[0])
    step = _CELL_M * rough / (end - start)
    period = max(np.arange((1 - _PERIOD_SHARE) * rough, (1 + _PERIOD_SHARE) * rough, step).tolist(), key=explained)
    bare = np.tile(shares(period)[0] < least, 2)
    edges = np.flatnonzero(np.diff(bare, prepend=False, append=False))
    # Smoothed, paint seems to begin where its share of hits is `_PAINTED`, a little before its edge.
    gap = float(2 * period / len(bare) * np.diff(edges)[::2].max(initial=0) - 2 * _SMOOTHING_M * ndtri(_PAINTED))
    return (period - gap, gap) if gap >= _LEAST_GAP_M else None


def _piece(runs: Floats, searched: Searched) -> PatternPiece | None:
    """The piece that runs make; None where they are too far apart for a solid line and too irregular for a dashed one."""
    painted = float(sum(_lengths_m(runs)))
    inside = np.zeros(len(searched.station_m), dtype=bool)
    for start, end in runs:
        inside |= (searched.station_m >= start) & (searched.station_m <= end)
    share = float(searched.hit[inside].mean()) if inside.any() else 0.0
    ends, dashes = (float(runs[0, 0]), float(runs[-1, 1])), _dashes(runs, searched)
    if dashes is not None:
        return PatternPiece(*ends, "dashed", painted, share, *dashes)
    if _widest_gap_m(runs) > _LONGEST_HOLE_M:
        return None
    return PatternPiece(*ends, "solid", painted, share)
