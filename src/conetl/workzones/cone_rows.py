"""The cones of one work zone as rows of tapers and tangents; cones in no row are strays.

A row is the straightest chain of cones by station: dynamic programming over pairs of cones, where each cone gains
`row_skip_cost` and each bend costs its squared deviation in tolerances. A row is split into straight pieces by optimal
partitioning of its offsets (Bellman 1961; Killick, Fearnhead & Eckley 2012, without pruning); sloping pieces are tapers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from conetl.model.arrays import Floats
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import ConeRow, Knot, Taper

_WINDOW = 8
_LEAST_STEP_M = 1.0
#: Largest slope of a row across the road (a short taper at a flagger is 1:4).
_MAX_SLOPE = 0.5
_PRIOR_FREEDOM = 4.0
#: Search for the knot of two pieces: cones beyond the gap between them, steps, and the limit in sigmas.
_KNOT_CONES, _KNOT_STEPS, _KNOT_SIGMAS = 2, 81, 3.0


@dataclass(frozen=True)
class _Piece:
    """A straight piece of a row: positions first..last, offset = a + b (station - centre), and the variance of b."""

    first: int
    last: int
    centre_m: float
    a_m: float
    b: float
    var_b: float
    level: bool = False
    """Parallel to the axis: b is not estimated."""

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
    """The rows of cones (C,), longest first; stations_m must not decrease.

    axis_sigma_m: lateral sigma of the axis; smaller shifts are not tapers. traffic_sign: +1 if traffic passes to the left of
    the row, -1 to the right, 0 unknown (then converging means to the left).
    """
    left = np.arange(len(stations_m))
    rows: list[ConeRow] = []
    while True:
        chosen = left[_straightest(stations_m[left], offsets_m[left], sigmas_o_m[left], params)]
        if len(chosen) < (params.min_row_cones if rows else 2):
            return rows
        variances = params.placement_sigma_m**2 + sigmas_o_m[chosen] ** 2
        row = (stations_m[chosen], offsets_m[chosen], sigmas_s_m[chosen], variances)
        tapers = _tapers(*row, params, traffic_sign or 1.0, axis_sigma_m)
        rows.append(ConeRow(tuple(chosen.tolist()), tuple(tapers)))
        left = np.setdiff1d(left, chosen)


def _straightest(s: Floats, o: Floats, sigmas_o: Floats, params: WorkZoneParams) -> list[int]:
    """Indices of the best chain among cones sorted by station."""
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
    variances: Floats,
    params: WorkZoneParams,
    traffic_sign: float,
    axis_sigma_m: float,
) -> list[Taper]:
    """Tapers of one row of cones (C,); variances: prior variances of the offsets, before the scatter of the row is known."""
    pieces = _pieces(s, o, 1.0 / variances, params.segment_penalty)
    scale = _variance_factor(pieces, o, s, variances)
    variances = scale * variances
    pieces = [replace(piece, var_b=piece.var_b * scale) for piece in pieces]
    least_shift_m = max(params.min_taper_shift_m, 2.0 * axis_sigma_m)
    if axis_sigma_m <= params.lane_axis_sigma_m:
        # Tangents are parallel to lane lines; free slopes would only make the ends of tapers less certain.
        flat = [abs(piece.b) * (s[piece.last] - s[piece.first]) < params.min_taper_shift_m for piece in pieces]
        pieces = [
            replace(p, b=0.0, var_b=0.0, level=True) if level else p for p, level in zip(pieces, flat, strict=True)
        ]
    knots = [_knot(one, other, s, o, variances) for one, other in pairwise(pieces)]
    ends = [_end(s, sigmas_s, 0), *knots, _end(s, sigmas_s, -1)]
    tapers: list[Taper] = []
    for piece, (start, end) in zip(pieces, pairwise(ends), strict=True):
        length_m = end.station_m - start.station_m
        shift_m = abs(piece.b) * length_m
        steep = abs(piece.b) >= params.min_taper_slope and abs(piece.b) > 3.0 * piece.var_b**0.5
        if not steep or shift_m < least_shift_m:
            continue
        tapers.append(
            Taper(
                first=piece.first,
                last=piece.last,
                start=start,
                end=end,
                shift_m=shift_m,
                shift_sigma_m=length_m * piece.var_b**0.5,
                converging=piece.b * traffic_sign > 0,
            )
        )
    return tapers


def _pieces(s: Floats, o: Floats, weights: Floats, penalty: float) -> list[_Piece]:
    """The straight pieces of the row with the least chi-square plus a penalty per piece."""
    count = len(s)
    # Cumulative sums give the chi-square of the line through any part; centred for precision.
    x, y = s - s.mean(), o - o.mean()
    moments = [weights, weights * x, weights * y, weights * x * x, weights * x * y, weights * y * y]
    sums = np.concatenate([np.zeros((6, 1)), np.cumsum(np.stack(moments), axis=1)], axis=1)
    cost = np.array([0.0, *([np.inf] * count)])
    cut = [0] * (count + 1)
    for j in range(1, count + 1):
        # A piece has at least three cones, unless the row has fewer.
        starts = np.arange(max(j - 2, 1)) if count >= 3 else np.array([0])
        values = cost[starts] + _chi2(sums[:, [j]] - sums[:, starts]) + penalty
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
    """(K,) weighted residual squares of straight lines, from sums (6, K) of w, wx, wy, wxx, wxy, wyy."""
    w, wx, wy, wxx, wxy, wyy = moments
    spread, mixed, rest = wxx - wx**2 / w, wxy - wx * wy / w, wyy - wy**2 / w
    return np.asarray(np.maximum(rest - np.where(spread > 0, mixed**2 / np.where(spread > 0, spread, 1.0), 0.0), 0.0))


def _variance_factor(pieces: list[_Piece], o: Floats, s: Floats, variances: Floats) -> float:
    """Factor on the prior variances from the scatter of the row; the prior has the weight of `_PRIOR_FREEDOM` cones."""
    chi2 = sum(
        (o[k] - piece.at(float(s[k]))) ** 2 / variances[k]
        for piece in pieces
        for k in range(piece.first, piece.last + 1)
    )
    freedom = max(len(o) - 2 * len(pieces), 0)
    return float((_PRIOR_FREEDOM + chi2) / (_PRIOR_FREEDOM + freedom))


def _fit(s: Floats, o: Floats, w: Floats, first: int, last: int) -> _Piece:
    total = float(w.sum())
    centre = float((w * s).sum() / total)
    mean = float((w * o).sum() / total)
    spread = float((w * (s - centre) ** 2).sum())
    slope = float((w * (s - centre) * o).sum()) / spread if spread > 0 else 0.0
    var_b = 1.0 / spread if spread > 0 else np.inf
    return _Piece(first, last, centre, mean, slope, var_b)


def _end(s: Floats, sigmas_s: Floats, at: int) -> Knot:
    """The end of a row, at its last cone."""
    return Knot(float(s[at]), (float(sigmas_s[at]), float(sigmas_s[at])), (float(s[at]),))


def _knot(one: _Piece, other: _Piece, s: Floats, o: Floats, variances: Floats) -> Knot:
    """The station at which two pieces meet. Its sigmas are a third of the distances at which chi-square of the best two lines
    that meet there is larger by nine (profile likelihood, Venzon & Moolgavkar 1988): near the end of a taper they are
    asymmetric, and error propagation would overestimate one. The cones are those at which the lines may meet with a chi-square
    within nine of the best.
    """
    low = float(s[max(one.last - _KNOT_CONES, one.first)])
    high = float(s[min(other.first + _KNOT_CONES, other.last)])
    stations = np.linspace(low, high, _KNOT_STEPS)
    some = slice(one.first, other.last + 1)

    def chi2_at(station_m: float) -> float:
        return _chi2_of_knot(station_m, s[some], o[some], variances[some], one.level, other.level)

    chi2 = np.array([chi2_at(at) for at in stations])
    best = int(np.argmin(chi2))
    rise = chi2 - chi2[best] - _KNOT_SIGMAS**2
    first, last = _crossing(stations, rise, best, -1), _crossing(stations, rise, best, 1)
    meet = float(stations[best])
    cones = s[(s >= low) & (s <= high)]
    at_cones = np.array([chi2_at(at) for at in cones])
    likely = cones[at_cones - at_cones.min() <= _KNOT_SIGMAS**2]
    return Knot(meet, ((meet - first) / _KNOT_SIGMAS, (last - meet) / _KNOT_SIGMAS), tuple(likely.tolist()))


def _crossing(stations: Floats, rise: Floats, best: int, step: int) -> float:
    """Station at which `rise` becomes positive, starting from the best one; the outermost if it never does."""
    at = best
    while 0 <= at + step < len(stations):
        if rise[at + step] > 0:
            share = -rise[at] / (rise[at + step] - rise[at])
            return float(stations[at] + share * (stations[at + step] - stations[at]))
        at += step
    return float(stations[at])


def _chi2_of_knot(at_m: float, s: Floats, o: Floats, variances: Floats, first_level: bool, other_level: bool) -> float:
    """Chi-square of the best two lines that meet at a station; level ones are parallel to the axis."""
    columns = [np.ones(len(s))]
    columns += [] if first_level else [np.minimum(s - at_m, 0.0)]
    columns += [] if other_level else [np.maximum(s - at_m, 0.0)]
    design = np.stack(columns, axis=1) / np.sqrt(variances)[:, None]
    observed = o / np.sqrt(variances)
    solution = np.linalg.lstsq(design, observed, rcond=None)[0]
    return float(((observed - design @ solution) ** 2).sum())
