"""The displacement after which most cones of a drive fit those of the map, by their arrangement."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from conetl.model.arrays import Floats

#: Two tracks that are tried are at most this far from each other.
_LONGEST_BASE_M = 60.0
#: A fit is distinct if no other one, this many gates apart, fits this share as many.
_APART_GATES, _RIVAL_SHARE = 2.0, 0.8
#: Tracks from which the search starts, how far two lengths may differ, and how many features and displacements are tried.
_STARTS, _LENGTH_TOLERANCE_M = 10, 0.3
_MAX_NEAR, _MAX_TRIED = 150, 300


class ArrangementFit(NamedTuple):
    """A displacement of a whole drive after which its cones fit the map's."""

    agreeing: int
    residual_m: float
    """Root mean square distance of the tracks that fit to their features, after the displacement."""
    middle_m: float
    """Median and largest displacement of the tracks."""
    largest_m: float
    turn: float
    """Radians, counter-clockwise."""
    beside: bool
    """Whether the displaced row still lies along at least half of its length beside where it was."""
    distinct: bool
    """Whether no other displacement fits nearly as well, as along a row of equal distances."""


def best_fit(t: Floats, f: Floats, gate_m: float, within_m: float, max_turn: float) -> ArrangementFit | None:
    """The displacement with which most tracks fit, of all that put two tracks onto two features; of several the smallest.

    t (N, 2), f (M, 2): tracks and features; gate_m: of a fit; within_m, max_turn: largest displacement (m) and rotation (rad).
    Two tracks far from each other are tried with all features at their distance.
    """
    along = np.linalg.svd(t - t.mean(axis=0), full_matrices=False)[2][0]
    extent_m = float(np.ptp(t @ along))
    tree = cKDTree(f)
    tried: list[tuple[int, float, Floats, Floats, float]] = []
    for i in range(0, len(t), 1 + len(t) // _STARTS):
        lengths = np.hypot(*(t - t[i]).T)
        j = int(np.argmax(np.where(lengths <= _LONGEST_BASE_M, lengths, 0.0)))
        first, second = (np.array(tree.query_ball_point(t[k], within_m, return_sorted=True), np.intp) for k in (i, j))
        first, second = (near[:: 1 + len(near) // _MAX_NEAR] for near in (first, second))
        a, b = (grid.ravel() for grid in np.meshgrid(first, second))
        base, others = t[j] - t[i], f[b] - f[a]
        turns = np.arctan2(others[:, 1], others[:, 0]) - np.arctan2(base[1], base[0])
        turns = (turns + np.pi) % (2 * np.pi) - np.pi
        alike = np.abs(np.hypot(*others.T) - lengths[j]) <= _LENGTH_TOLERANCE_M
        candidates = np.flatnonzero(alike & (np.abs(turns) <= max_turn) & (lengths[j] > 0))
        for k in candidates[:: 1 + len(candidates) // _MAX_TRIED]:
            rotation = Rotation.from_rotvec((0, 0, turns[k])).as_matrix()[:2, :2]
            placed = (t - t[i]) @ rotation.T + f[a[k]]
            agreeing = int(np.count_nonzero(tree.query(placed)[0] <= gate_m))
            moved = placed - t
            tried.append((agreeing, -float(np.hypot(*moved.T).mean()), moved.mean(axis=0), moved, float(-turns[k])))
    if not tried:
        return None
    agreeing, _, mean, moved, turn = max(tried, key=lambda one: one[:2])
    moved_m = np.hypot(*moved.T)
    rivals = (other for other in tried if other[0] >= _RIVAL_SHARE * agreeing)
    distinct = not any(float(np.hypot(*(other[2] - mean))) > _APART_GATES * gate_m for other in rivals)
    beside = abs(float(np.median(moved @ along))) <= extent_m / 2
    left_m = np.asarray(tree.query(t + moved)[0])
    residual_m = float(np.sqrt(np.mean(left_m[left_m <= gate_m] ** 2)))
    return ArrangementFit(agreeing, residual_m, float(np.median(moved_m)), float(moved_m.max()), turn, beside, distinct)
