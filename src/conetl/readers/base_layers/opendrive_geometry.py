"""The plan view of OpenDRIVE roads as points: reference line, and the borders of lanes beside it.

ASAM OpenDRIVE 1.8, on geometries of the reference line, elevation, superelevation, lane offset, lane sections, lane width
and border. s runs along the reference line in plan, t to its left. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Between samples of a curve; headings are integrated over steps of this length at most.
STEP_M = 1.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_ARC_LENGTH_SAMPLES = 512


class Cubic(NamedTuple):
    """a + b ds + c ds^2 + d ds^3 from `start_m` on."""

    start_m: float
    a: float
    b: float = 0.0
    c: float = 0.0
    d: float = 0.0


class Piece(NamedTuple):
    """One geometry of the reference line from `start_m` on. Line, arc, spiral: curvature changes linearly from k0 to k1 (1/m)."""

    shape: Literal["curvature", "poly3", "paramPoly3"]
    start_m: float
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    k0: float = 0.0
    k1: float = 0.0
    u: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 0.0)
    v: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    normalised: bool = False
    """paramPoly3 with p from 0 to 1 instead of 0 to the length."""


class Lane(NamedTuple):
    """A lane of a section: either widths, or borders (t of its outer edge), from the section's start on."""

    lane_id: int
    widths: tuple[Cubic, ...]
    borders: tuple[Cubic, ...] = ()


def cubic_at(pieces: Sequence[Cubic], s_m: Array) -> Array:
    """Value (N,) of piecewise cubics at s; 0 where there are none or before the first."""
    s = np.asarray(s_m, np.float64)
    value = np.zeros_like(s)
    for piece in sorted(pieces, key=lambda p: p.start_m):
        here = s >= piece.start_m
        ds = s[here] - piece.start_m
        value[here] = piece.a + ds * (piece.b + ds * (piece.c + ds * piece.d))
    return value


def samples_m(pieces: Sequence[Piece], from_m: float, to_m: float) -> Array:
    """Sorted s from from_m to to_m: the ends, where a geometry begins, and every STEP_M between."""
    count = max(int(np.ceil((to_m - from_m) / STEP_M)), 1)
    joints = [p.start_m for p in pieces if from_m < p.start_m < to_m]
    s = np.sort(np.concatenate([np.linspace(from_m, to_m, count + 1), joints]))
    return np.asarray(s[np.concatenate([[True], np.diff(s) > 1e-6])])


def reference_line(pieces: Sequence[Piece], s_m: Array) -> tuple[Array, Array]:
    """Positions (N, 2) and headings (N,) of the reference line at s; of its nearest end outside of the pieces."""
    ordered = sorted(pieces, key=lambda p: p.start_m)
    starts = np.array([p.start_m for p in ordered])
    s = np.asarray(s_m, np.float64)
    owner = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(ordered) - 1)
    xy, heading = np.empty((len(s), 2)), np.empty(len(s))
    for index in np.unique(owner):
        piece, here = ordered[index], owner == index
        ds = np.clip(s[here] - piece.start_m, 0.0, piece.length_m)
        local, turn = _curvature(piece, ds) if piece.shape == "curvature" else _polynomial(piece, ds)
        cos, sin = np.cos(piece.heading_rad), np.sin(piece.heading_rad)
        xy[here] = local @ np.array([[cos, sin], [-sin, cos]]) + [piece.x_m, piece.y_m]
        heading[here] = piece.heading_rad + turn
    return xy, heading


def lane_borders(
    lanes: Sequence[Lane], offset: Sequence[Cubic], section_start_m: float, s_m: Array
) -> dict[int, Array]:
    """Lane id -> t (N,) of its outer border at s; id 0 is the centre line. Left lanes have positive ids."""
    centre = cubic_at(offset, s_m)
    ds = np.asarray(s_m, np.float64) - section_start_m
    found = {0: centre}
    for side in (1, -1):
        t = centre
        for lane in sorted((lane for lane in lanes if lane.lane_id * side > 0), key=lambda lane: abs(lane.lane_id)):
            if lane.widths or not lane.borders:
                t = t + side * np.maximum(cubic_at(lane.widths, ds), 0.0)
            else:
                t = cubic_at(lane.borders, ds)  # borders are signed distances from the reference line
            found[lane.lane_id] = t
    return found


def offset_line(
    pieces: Sequence[Piece], elevation: Sequence[Cubic], superelevation: Sequence[Cubic], s_m: Array, t_m: Array
) -> Array:
    """Points (N, 3) at (s, t): across the reference line, tilted by the superelevation (counter-clockwise seen along s)."""
    xy, heading = reference_line(pieces, s_m)
    roll = cubic_at(superelevation, s_m)
    across = t_m * np.cos(roll)
    left = np.column_stack([-np.sin(heading), np.cos(heading)])
    return np.column_stack([xy + across[:, None] * left, cubic_at(elevation, s_m) + t_m * np.sin(roll)])


def _curvature(piece: Piece, ds: Array) -> tuple[Array, Array]:
    """Line, arc, spiral: the heading is a quadratic of s; its unit vector is integrated by Gauss-Legendre over short steps.

    (Fresnel integrals are the closed form, but lose all digits where the curvature hardly changes.)
    """
    grid = np.unique(np.concatenate([np.linspace(0.0, piece.length_m, int(piece.length_m / STEP_M) + 2), ds]))
    rate = (piece.k1 - piece.k0) / piece.length_m if piece.length_m > 0 else 0.0
    half = np.diff(grid) / 2
    at = grid[:-1, None] + half[:, None] * (1 + _NODES)
    turn = piece.k0 * at + rate * at**2 / 2
    steps = half[:, None] * np.column_stack([np.cos(turn) @ _WEIGHTS, np.sin(turn) @ _WEIGHTS])
    track = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return track[np.searchsorted(grid, ds)], piece.k0 * ds + rate * ds**2 / 2


def _polynomial(piece: Piece, ds: Array) -> tuple[Array, Array]:
    if piece.shape == "poly3":  # v is a polynomial of u, and s the length of the curve: find u(s)
        u = np.linspace(0.0, piece.length_m, _ARC_LENGTH_SAMPLES)
        slope = np.abs(np.hypot(1.0, _derivative(piece.v, u)))
        length = np.concatenate([[0.0], np.cumsum(np.diff(u) * (slope[1:] + slope[:-1]) / 2)])
        p = np.interp(ds, length, u)
        return np.column_stack([p, _value(piece.v, p)]), np.arctan(_derivative(piece.v, p))
    p = ds / piece.length_m if piece.normalised and piece.length_m > 0 else ds
    turn = np.arctan2(_derivative(piece.v, p), _derivative(piece.u, p))
    return np.column_stack([_value(piece.u, p), _value(piece.v, p)]), turn


def _value(c: tuple[float, float, float, float], p: Array) -> Array:
    return np.asarray(c[0] + p * (c[1] + p * (c[2] + p * c[3])))


def _derivative(c: tuple[float, float, float, float], p: Array) -> Array:
    return np.asarray(c[1] + p * (2 * c[2] + p * 3 * c[3]))
