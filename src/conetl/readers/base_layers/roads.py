"""Points of OpenDRIVE roads: of the reference lines and lane borders of many roads at once.

ASAM OpenDRIVE 1.8, on geometries of the reference line, elevation, superelevation, lane offset, lane sections, lane width
and border. s runs along the reference line in plan, t to its left. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from conetl.model.arrays import Floats, Ints
from conetl.readers.base_layers.lines import Line

#: Between samples of a curve; headings are integrated over steps of this length at most.
STEP_M = 1.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_ARC_LENGTH_SAMPLES = 512

#: Lengths (M,) and parameters (M, K) of geometries of one kind, the geometry of each sample (N,), and its distance from the
#: beginning (N,) -> positions (N, 2) and turns (N,), from an origin and heading 0.
Curve = Callable[[Floats, Floats, Ints, Floats], tuple[Floats, Floats]]

#: Start, a, b, c, d of each piece.
Cubics = Sequence[Sequence[float]]


class Piece(NamedTuple):
    """One geometry of the reference line from `start_m` on."""

    start_m: float
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    curve: Curve
    shape: tuple[float, ...]


class Border(NamedTuple):
    """The outer border of a lane, the centre line, or the reference line."""

    kind: str | None
    """None: others need it, but it is no line."""
    attributes: dict[str, Any]
    number: int | None
    """From the centre line, 0, outwards; None of the reference line."""
    side: int = 0
    """1 on the left of the centre line, -1 on the right."""
    inner: int = 0
    """Of the next one inwards, by its number in the span."""
    widths: Cubics = ()
    """From the beginning of the lane section on."""
    borders: Cubics = ()
    """t itself, where there are no widths."""


class RoadSpan(NamedTuple):
    """A lane section; or the whole road, for its reference line."""

    start_m: float
    end_m: float
    borders: list[Border]


class RoadShape(NamedTuple):
    """What the points of a road are computed from."""

    pieces: list[Piece]
    """In order."""
    elevation: Cubics
    superelevation: Cubics
    """Counter-clockwise seen along s."""
    offset: Cubics
    """t of the centre line."""
    spans: list[RoadSpan]


def lines_of(roads: Sequence[RoadShape]) -> list[list[Line]]:
    """The lines of each road. Coordinates may be infinite or no numbers."""
    if not roads:
        return []
    pieces = [piece for road in roads for piece in road.pieces]
    spans = [span for road in roads for span in road.spans]
    borders = [border for span in spans for border in span.borders]
    road_of_piece = np.repeat(np.arange(len(roads)), [len(road.pieces) for road in roads])
    road_of_span = np.repeat(np.arange(len(roads)), [len(road.spans) for road in roads])
    span_of_line = np.repeat(np.arange(len(spans)), [len(span.borders) for span in spans])
    starts, ends = np.array([span[:2] for span in spans]).T
    with np.errstate(over="ignore", invalid="ignore"):
        s, span_of = samples_m(_keys(road_of_piece, [piece.start_m for piece in pieces]), road_of_span, starts, ends)
        road_of = road_of_span[span_of]
        xy, heading = reference_line(pieces, road_of_piece, s, road_of)
        elevation, roll, offset = (
            cubics_at([getattr(road, name) for road in roads], road_of, s)
            for name in ("elevation", "superelevation", "offset")
        )
        base = np.column_stack([xy, elevation])
        left = np.column_stack([-np.sin(heading) * np.cos(roll), np.cos(heading) * np.cos(roll), np.sin(roll)])
        counts = np.bincount(span_of, minlength=len(spans))
        sample = ranges((np.cumsum(counts) - counts)[span_of_line], counts[span_of_line])
        t = _across(borders, span_of_line, counts[span_of_line], offset[sample], (s - starts[span_of])[sample])
        xyz = base[sample] + t[:, None] * left[sample]
    found: list[list[Line]] = [[] for _ in roads]
    parts = np.split(xyz, np.cumsum(counts[span_of_line])[:-1])
    for border, part, road in zip(borders, parts, road_of_span[span_of_line].tolist(), strict=True):
        if border.kind is not None:
            found[road].append(Line(border.kind, part, border.attributes))
    return found


def _across(borders: Sequence[Border], span_of: Ints, counts: Ints, centre_m: Floats, ds: Floats) -> Floats:
    """t (N,) of the points of all lines, each with so many; ds: from the beginning of the lane section on."""
    line = np.repeat(np.arange(len(borders)), counts)
    first = np.cumsum(counts) - counts
    widths_m = np.maximum(cubics_at([border.widths for border in borders], line, ds), 0.0)
    t = cubics_at([border.borders for border in borders], line, ds)
    number = np.array([-1 if border.number is None else border.number for border in borders])
    t[number[line] == 0] = centre_m[number[line] == 0]
    side = np.array([border.side for border in borders])
    inner = np.searchsorted(span_of, span_of) + [border.inner for border in borders]
    added = (number > 0) & [bool(border.widths) or not border.borders for border in borders]
    order = np.flatnonzero(added)[np.argsort(number[added], kind="stable")]
    for some in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        points, before = ranges(first[some], counts[some]), ranges(first[inner[some]], counts[some])
        t[points] = t[before] + side[line[points]] * widths_m[points]
    return t


def ranges(starts: Ints, counts: Ints) -> Ints:
    """The whole numbers from each start on, one range after the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - ends + counts, counts)


def _keys(owners: Ints, positions: Any) -> Any:
    """Numbers that are in the order of owner and position."""
    keys = np.empty(len(owners), np.complex128)
    keys.real, keys.imag = owners, positions
    return keys


def cubics_at(cubics: Sequence[Cubics], owner: Ints, s_m: Floats) -> Floats:
    """Value (N,) at s of the owner's piecewise cubics: a + b ds + c ds^2 + d ds^3 from a start on.

    cubics: of each owner. 0 where there are none or before the first.
    """
    owners = np.repeat(np.arange(len(cubics)), [len(some) for some in cubics])
    if not len(owners):
        return np.zeros(len(s_m))
    table = np.array([cubic for some in cubics for cubic in some])
    order = np.lexsort((table[:, 0], owners))
    owners, table = owners[order], table[order]
    at = np.searchsorted(_keys(owners, table[:, 0]), _keys(owner, s_m), side="right") - 1
    start, a, b, c, d = table[at].T
    ds = s_m - start
    return np.where((at >= 0) & (owners[at] == owner), a + ds * (b + ds * (c + ds * d)), 0.0)


def samples_m(joints: Any, road_of: Ints, from_m: Floats, to_m: Floats) -> tuple[Floats, Ints]:
    """s (N,) within spans, and the span of each: the ends, where a geometry begins, and every STEP_M between.

    joints: `_keys` of the geometries by their roads.
    """
    spans = np.arange(len(from_m))
    steps = np.maximum(np.ceil((to_m - from_m) / STEP_M), 1).astype(np.int64)
    span, step = np.repeat(spans, steps + 1), ranges(np.zeros_like(steps), steps + 1)
    s = np.where(step == steps[span], to_m[span], from_m[span] + step * ((to_m - from_m) / steps)[span])
    first = np.searchsorted(joints, _keys(road_of, from_m), side="right")
    counts = np.maximum(np.searchsorted(joints, _keys(road_of, to_m)) - first, 0)
    s = np.concatenate([s, joints[ranges(first, counts)].imag])
    span = np.concatenate([span, np.repeat(spans, counts)])
    order = np.lexsort((s, span))
    s, span = s[order], span[order]
    apart = (np.diff(s, prepend=-np.inf) > 1e-6) | (np.diff(span, prepend=-1) > 0)
    return s[apart], span[apart]


def reference_line(pieces: Sequence[Piece], road_of_piece: Ints, s_m: Floats, road_of: Ints) -> tuple[Floats, Floats]:
    """Positions (N, 2) and headings (N,) of the roads' reference lines at s; of the nearest end outside of the pieces."""
    numbers = np.array([piece[:5] for piece in pieces])
    at = np.searchsorted(_keys(road_of_piece, numbers[:, 0]), _keys(road_of, s_m), side="right") - 1
    at = np.maximum(at, np.searchsorted(road_of_piece, road_of))
    start, x, y, heading, length = numbers[at].T
    ds = np.clip(s_m - start, 0.0, length)
    local, turn = np.empty((len(s_m), 2)), np.empty(len(s_m))
    curves = [piece.curve for piece in pieces]
    for curve in set(curves):
        chosen = np.array([one is curve for one in curves])
        here = np.flatnonzero(chosen[at])
        shapes = np.array([piece.shape for piece in pieces if piece.curve is curve])
        local[here], turn[here] = curve(numbers[chosen, 4], shapes, (np.cumsum(chosen) - 1)[at[here]], ds[here])
    cos, sin = np.cos(heading), np.sin(heading)
    return np.column_stack(
        [cos * local[:, 0] - sin * local[:, 1] + x, sin * local[:, 0] + cos * local[:, 1] + y]
    ), heading + turn


def arc(_length_m: Floats, curvature: Floats, of: Ints, ds: Floats) -> tuple[Floats, Floats]:
    """A line or an arc: its chord, in the direction of its middle."""
    turn = curvature[of, 0] * ds
    chord = ds * np.sinc(turn / (2 * np.pi))
    return np.column_stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2)]), turn


def spiral(length_m: Floats, curvatures: Floats, of: Ints, ds: Floats) -> tuple[Floats, Floats]:
    """A spiral, whose curvature changes linearly (1/m): the heading is a quadratic of s; its unit vector is integrated by
    Gauss-Legendre over short steps.

    (Fresnel integrals are the closed form, but lose all digits where the curvature hardly changes.)
    """
    k0 = curvatures[:, 0]
    rate = np.divide(curvatures[:, 1] - k0, length_m, out=np.zeros_like(k0), where=length_m > 0)
    steps = (length_m / STEP_M).astype(np.int64) + 1
    step_m = length_m / steps

    def moved(of: Ints, from_m: Floats, to_m: Floats) -> Floats:
        half = (to_m - from_m)[:, None] / 2
        at = from_m[:, None] + half * (1 + _NODES)
        turn = k0[of, None] * at + rate[of, None] * at**2 / 2
        return half * np.column_stack([np.cos(turn) @ _WEIGHTS, np.sin(turn) @ _WEIGHTS])

    whole, step = np.repeat(np.arange(len(steps)), steps), ranges(np.zeros_like(steps), steps)
    track = np.concatenate(
        [np.zeros((1, 2)), np.cumsum(moved(whole, step * step_m[whole], (step + 1) * step_m[whole]), axis=0)]
    )
    begins = (np.cumsum(steps) - steps)[of]
    before = np.minimum(
        np.divide(ds, step_m[of], out=np.zeros_like(ds), where=step_m[of] > 0).astype(np.int64), steps[of] - 1
    )
    xy = track[begins + before] - track[begins] + moved(of, before * step_m[of], ds)
    return xy, k0[of] * ds + rate[of] * ds**2 / 2


def poly3(length_m: Floats, v: Floats, of: Ints, ds: Floats) -> tuple[Floats, Floats]:
    """v is a polynomial of u, and s the length of the curve: find u(s)."""
    p = np.empty_like(ds)
    for k in np.unique(of).tolist():
        u = np.linspace(0.0, length_m[k], _ARC_LENGTH_SAMPLES)
        slope = np.abs(np.hypot(1.0, polyval(u, polyder(v[k]))))
        length = np.concatenate([[0.0], np.cumsum(np.diff(u) * (slope[1:] + slope[:-1]) / 2)])
        p[of == k] = np.interp(ds[of == k], length, u)
    value, slope = _cubic(v[of], p)
    return np.column_stack([p, value]), np.arctan(slope)


def param_poly3(_length_m: Floats, shape: Floats, of: Ints, ds: Floats) -> tuple[Floats, Floats]:
    """u and v are polynomials of the distance in a unit: shape has the unit (m), four numbers of u and four of v."""
    p = ds / shape[of, 0]
    (u, du), (v, dv) = _cubic(shape[of, 1:5], p), _cubic(shape[of, 5:], p)
    return np.column_stack([u, v]), np.arctan2(dv, du)


def _cubic(coefficients: Floats, p: Floats) -> tuple[Floats, Floats]:
    """Values and slopes (N,) of polynomials (N, 4)."""
    a, b, c, d = coefficients.T
    return a + p * (b + p * (c + p * d)), b + p * (2 * c + p * 3 * d)
