"""Cones of one work zone as rows of tapers and tangents, and what stands beside them.

A row is the chain of cones, by station, that bends least: dynamic programming over pairs of cones, where each cone taken in
earns `row_skip_cost` and each bend costs its squared deviation in tolerances. A row then falls into straight pieces by optimal
partitioning of its offsets (Bellman 1961; Killick, Fearnhead & Eckley 2012, without pruning); sloping pieces are tapers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from conetl.geometry.road_axis import Floats
from conetl.params import WorkZoneParams
from conetl.work_zone_records import ConeRow, Taper

_WINDOW = 8
_LEAST_STEP_M = 1.0
#: Rows may run this steeply across the road (a short taper at a flagger is 1:4).
_MAX_SLOPE = 0.5
_PRIOR_FREEDOM = 4.0


@dataclass(frozen=True)
class _Piece:
    """A straight piece of a row: positions first..last, offset = a + b (station - centre), and the covariance of a and b."""

    first: int
    last: int
    centre_m: float
    a_m: float
    b: float
    var_a: float
    var_b: float

    def sigma_at(self, station_m: float) -> float:
        return float(np.sqrt(self.var_a + self.var_b * (station_m - self.centre_m) ** 2))

    def at(self, station_m: float) -> float:
        return self.a_m + self.b * (station_m - self.centre_m)


def find_rows(
    stations_m: Floats,
    offsets_m: Floats,
    sigmas_s_m: Floats,
    sigmas_o_m: Floats,
    params: WorkZoneParams,
    *,
    traffic_sign: float,
    axis_sigma_m: float,
) -> list[ConeRow]:
    """The rows that cones (C,) make, longest first; cones in none are strays. stations_m must not fall.

    axis_sigma_m: how far the axis itself may bend where the road does not; lesser shifts are no tapers.
    traffic_sign: +1 where traffic passes to the left of the row, -1 to the right, 0 unknown (converging then means to the left).
    """
    left = np.arange(len(stations_m))
    rows: list[ConeRow] = []
    while len(left) >= (params.min_row_cones if rows else 2):
        chosen = left[_straightest(stations_m[left], offsets_m[left], sigmas_o_m[left], params)]
        if len(chosen) < (params.min_row_cones if rows else 2):
            break
        some = (stations_m[chosen], offsets_m[chosen], sigmas_s_m[chosen], sigmas_o_m[chosen])
        tapers = _tapers(*some, params, traffic_sign or 1.0, axis_sigma_m)
        rows.append(ConeRow(tuple(int(k) for k in chosen), tuple(tapers)))
        left = np.setdiff1d(left, chosen)
    return rows


def _straightest(s: Floats, o: Floats, sigmas_o: Floats, params: WorkZoneParams) -> list[int]:
    """Positions of the best chain among cones by station."""
    count = len(s)
    tolerance = params.row_tolerance_m**2 + sigmas_o**2
    gain = params.row_skip_cost
    best: dict[tuple[int, int], float] = {}
    before: dict[tuple[int, int], int] = {}
    for j in range(count):
        for i in range(max(j - _WINDOW, 0), j):
            if s[j] - s[i] < _LEAST_STEP_M or abs(o[j] - o[i]) > _MAX_SLOPE * (s[j] - s[i]) + params.row_tolerance_m:
                continue
            value, link = 2 * gain, -1
            for k in range(max(i - _WINDOW, 0), i):
                if (k, i) not in best:
                    continue
                chord = o[k] + (o[j] - o[k]) * (s[i] - s[k]) / (s[j] - s[k])
                with_k = best[k, i] + gain - (o[i] - chord) ** 2 / tolerance[i]
                if with_k > value:
                    value, link = with_k, k
            best[i, j], before[i, j] = value, link
    if not best:
        return [0] if count else []
    pair = max(best, key=lambda key: (best[key], -key[0], -key[1]))
    chain = [pair[1], pair[0]]
    while (link := before[chain[-1], chain[-2]]) >= 0:
        chain.append(link)
    return chain[::-1]


def _tapers(
    s: Floats,
    o: Floats,
    sigmas_s: Floats,
    sigmas_o: Floats,
    params: WorkZoneParams,
    traffic_sign: float,
    axis_sigma_m: float,
) -> list[Taper]:
    pieces = _scaled(_pieces(s, o, sigmas_o, params), o, s, sigmas_o, params)
    least_shift_m = max(params.min_taper_shift_m, 2.0 * axis_sigma_m)
    if axis_sigma_m <= params.lane_axis_sigma_m:
        # Tangents run along lane lines: that they may slope a little would only make the tapers' ends vague.
        flat = [abs(piece.b) * (s[piece.last] - s[piece.first]) < params.min_taper_shift_m for piece in pieces]
        pieces = [replace(p, b=0.0, var_b=0.0) if level else p for p, level in zip(pieces, flat, strict=True)]
    knots = [_knot(one, other, s) for one, other in pairwise(pieces)]
    tapers: list[Taper] = []
    for index, piece in enumerate(pieces):
        start_m, start_sigma = (float(s[piece.first]), float(sigmas_s[piece.first])) if index == 0 else knots[index - 1]
        end_m, end_sigma = (
            (float(s[piece.last]), float(sigmas_s[piece.last])) if index == len(pieces) - 1 else knots[index]
        )
        shift_m = abs(piece.b) * (end_m - start_m)
        steep = abs(piece.b) >= params.min_taper_slope and abs(piece.b) > 3.0 * piece.var_b**0.5
        if not steep or shift_m < least_shift_m:
            continue
        tapers.append(
            Taper(
                first=piece.first,
                last=piece.last,
                start_m=start_m,
                end_m=end_m,
                shift_m=shift_m,
                shift_sigma_m=(end_m - start_m) * piece.var_b**0.5,
                start_sigma_m=start_sigma,
                end_sigma_m=end_sigma,
                converging=piece.b * traffic_sign > 0,
            )
        )
    return tapers


def _pieces(s: Floats, o: Floats, sigmas_o: Floats, params: WorkZoneParams) -> list[_Piece]:
    """The row in straight pieces with the least chi-square plus a penalty for every piece."""
    count = len(s)
    weights = 1.0 / (params.placement_sigma_m**2 + sigmas_o**2)
    # Sums up to every cone give the chi-square of the line through any stretch at once; counted from the middle for precision.
    x, y = s - s.mean(), o - o.mean()
    moments = [weights, weights * x, weights * y, weights * x * x, weights * x * y, weights * y * y]
    sums = np.concatenate([np.zeros((6, 1)), np.cumsum(np.stack(moments), axis=1)], axis=1)
    cost = np.array([0.0, *([np.inf] * count)])
    cut = [0] * (count + 1)
    for j in range(1, count + 1):
        # Fewer than three cones show no line of their own, unless the row has no more.
        starts = np.arange(max(j - 2, 1)) if count >= 3 else np.array([0])
        values = cost[starts] + _chi2(sums[:, [j]] - sums[:, starts]) + params.segment_penalty
        best = int(np.argmin(values))
        if j >= 3 or j == count:
            cost[j], cut[j] = values[best], int(starts[best])
    pieces = []
    end = count
    while end > 0:
        some = slice(cut[end], end)
        pieces.append(_fit(s[some], o[some], weights[some], cut[end], end - 1))
        end = cut[end]
    return pieces[::-1]


def _chi2(moments: Floats) -> Floats:
    """(K,) weighted squares of what straight lines leave, from sums (6, K) of w, wx, wy, wxx, wxy, wyy."""
    w, wx, wy, wxx, wxy, wyy = moments
    spread, mixed, rest = wxx - wx**2 / w, wxy - wx * wy / w, wyy - wy**2 / w
    chi2: Floats = np.maximum(rest - np.where(spread > 0, mixed**2 / np.where(spread > 0, spread, 1.0), 0.0), 0.0)
    return chi2


def _scaled(pieces: list[_Piece], o: Floats, s: Floats, sigmas_o: Floats, params: WorkZoneParams) -> list[_Piece]:
    """The pieces with variances that fit the scatter of the row, the assumed one weighing as much as `_PRIOR_FREEDOM` cones."""
    variances = params.placement_sigma_m**2 + sigmas_o**2
    chi2 = sum(
        (o[k] - piece.at(float(s[k]))) ** 2 / variances[k]
        for piece in pieces
        for k in range(piece.first, piece.last + 1)
    )
    freedom = max(len(o) - 2 * len(pieces), 0)
    scale = float((_PRIOR_FREEDOM + chi2) / (_PRIOR_FREEDOM + freedom))
    return [replace(piece, var_a=piece.var_a * scale, var_b=piece.var_b * scale) for piece in pieces]


def _fit(s: Floats, o: Floats, w: Floats, first: int, last: int) -> _Piece:
    total = float(w.sum())
    centre = float((w * s).sum() / total)
    mean = float((w * o).sum() / total)
    spread = float((w * (s - centre) ** 2).sum())
    slope = float((w * (s - centre) * o).sum()) / spread if spread > 0 else 0.0
    var_b = 1.0 / spread if spread > 0 else np.inf
    return _Piece(first, last, centre, mean, slope, 1.0 / total, var_b)


def _knot(one: _Piece, other: _Piece, s: Floats) -> tuple[float, float]:
    """Station where two pieces meet, and its sigma; kept within one cone of the gap between them."""
    low, high = float(s[max(one.last - 1, one.first)]), float(s[min(other.first + 1, other.last)])
    turn = one.b - other.b
    if turn == 0.0:
        return (low + high) / 2, (high - low) / 4
    meet = float(np.clip((other.at(0.0) - one.at(0.0)) / turn, low, high))
    sigma = np.hypot(one.sigma_at(meet), other.sigma_at(meet)) / abs(turn)
    return meet, float(min(sigma, (high - low) / 4))


def row_offset(row: Sequence[int], stations_m: Floats, offsets_m: Floats, at_m: float) -> float:
    """Offset of a row at a station: straight between its cones, beyond its ends that of the end."""
    return float(np.interp(at_m, stations_m[list(row)], offsets_m[list(row)]))
