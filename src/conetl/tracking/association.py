"""Positions of single frame pairs -> chains, one per physical cone, by following each cone from image to image.

Absolute coordinates will not do: where GNSS has no fix they slide by more than a metre while the cones stand still, and any
fixed radius then doubles or merges cones. So a chain lives in the left camera's frame. From one frame pair to the next it is
carried by the *relative* motion, whose error grows only with the way driven in between, and the next position must fit it in
three dimensions with its own covariance (narrow in bearing, long in range). One-to-one, cheapest in total (Kalman filter with
global nearest neighbour, e.g. Bar-Shalom, Willett & Tian 2011, ch. 6).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from math import dist, inf

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from conetl.geometry.packing import cov_matrix
from conetl.model.params import TrackParams
from conetl.model.records import Position

Floats = NDArray[np.float64]
#: Cost of an impossible pairing in the assignment; far above any gate.
_FORBIDDEN = 1e6
#: Of the search for the farthest that two positions of one cone may be apart.
_ROUNDS, _SETTLED_M = 50, 0.01
#: Coordinates of millions of metres are rounded to less than this.
_ROUNDING_M = 1e-6


@dataclass(frozen=True)
class MotionError:
    """How vague a point gets when the relative motion carries it from frame to frame."""

    cov_m2: Callable[[int, int, Floats], Floats]
    """(start frame, end frame, point (3,) m in the left camera at start) -> (3, 3) m^2 that the motion adds to its covariance,
    in the left camera's frame at the end."""
    most_m2: Callable[[float], float] = lambda _range_m: np.inf
    """Range (m) from which a point is seen at both ends -> what the trace of that covariance never exceeds."""

    def __call__(self, start: int, end: int, point_m: Floats) -> Floats:
        return self.cov_m2(start, end, point_m)


@dataclass(frozen=True)
class Chain:
    """Positions of one cone so far; `mean` (3,) and `cov` (3, 3) place it in the left camera's frame of the last of them."""

    members: tuple[Position, ...]
    mean: Floats
    cov: Floats


def chain_positions(
    positions: Sequence[Position],
    map_SE3_left: Mapping[int, Floats],
    params: TrackParams,
    motion: MotionError | None = None,
) -> list[tuple[Position, ...]]:
    """Group the positions of one drive by physical cone.

    map_SE3_left: (4, 4) left camera -> map, by frame index. motion: error of the relative motion where it is known; without it
    the shares in `params` hold. Returns the groups, each by rising frame index and with at most one
    position per frame; every position is in exactly one group.
    """
    by_frame: dict[int, list[Position]] = defaultdict(list)
    for position in positions:
        by_frame[position.frame_index].append(position)
    open_chains: list[Chain] = []
    closed: list[Chain] = []
    for frame_index in sorted(by_frame):
        still_open = [c for c in open_chains if frame_index - c.members[-1].frame_index <= params.max_gap_frames]
        closed += [c for c in open_chains if frame_index - c.members[-1].frame_index > params.max_gap_frames]
        open_chains = extend_chains(still_open, by_frame[frame_index], frame_index, map_SE3_left, params, motion)
    return join_fragments([c.members for c in closed + open_chains], map_SE3_left, params, motion)


def carry(
    mean: Floats,
    cov: Floats,
    start: int,
    end: int,
    map_SE3_left: Mapping[int, Floats],
    params: TrackParams,
    motion: MotionError | None = None,
) -> tuple[Floats, Floats]:
    """A point (3,) with covariance (3, 3) of the left camera's frame at `start`, in that of `end`."""
    end_SE3_start = np.linalg.inv(map_SE3_left[end]) @ map_SE3_left[start]
    rotation, translation = end_SE3_start[:3, :3], end_SE3_start[:3, 3]
    if motion is not None:
        error = motion(start, end, mean) + params.motion_sigma_m**2 * np.eye(3)
        return rotation @ mean + translation, rotation @ cov @ rotation.T + error
    along = np.outer(translation, translation)  # (way driven)^2 in its direction, nothing across it
    across = float(translation @ translation) * np.eye(3) - along
    error = (
        params.motion_sigma_m**2 * np.eye(3)
        + params.motion_sigma_relative**2 * along
        + params.motion_sigma_aside**2 * across
    )
    return rotation @ mean + translation, rotation @ cov @ rotation.T + error


def extend_chains(
    chains: list[Chain],
    found: Sequence[Position],
    frame_index: int,
    map_SE3_left: Mapping[int, Floats],
    params: TrackParams,
    motion: MotionError | None,
) -> list[Chain]:
    """The open chains after one more frame: each position extends the chain it fits, or starts one."""
    carried = [
        carry(c.mean, c.cov, c.members[-1].frame_index, frame_index, map_SE3_left, params, motion) for c in chains
    ]
    costs = np.full((len(chains), len(found)), _FORBIDDEN)
    for i, (mean, cov) in enumerate(carried):
        for j, position in enumerate(found):
            innovation = np.array(position.camera_xyz_m) - mean
            spread = cov + cov_matrix(position.camera_cov_m2)
            distance2 = float(innovation @ np.linalg.solve(spread, innovation))
            if distance2 <= params.gate_chi2 and np.linalg.norm(innovation) <= params.max_innovation_m:
                # The log-determinant keeps a vague chain from stealing what a sharp one explains as well.
                costs[i, j] = distance2 + float(np.linalg.slogdet(spread)[1])
    extended = {int(i): int(j) for i, j in zip(*linear_sum_assignment(costs), strict=True) if costs[i, j] < _FORBIDDEN}
    result = [
        _updated(chain, *carried[i], found[extended[i]]) if i in extended else chain for i, chain in enumerate(chains)
    ]
    taken = set(extended.values())
    result += [
        Chain((position,), np.array(position.camera_xyz_m), cov_matrix(position.camera_cov_m2))
        for j, position in enumerate(found)
        if j not in taken
    ]
    return result


def _updated(chain: Chain, mean: Floats, cov: Floats, position: Position) -> Chain:
    gain = cov @ np.linalg.inv(cov + cov_matrix(position.camera_cov_m2))
    new_cov = (np.eye(3) - gain) @ cov
    new_mean = mean + gain @ (np.array(position.camera_xyz_m) - mean)
    return Chain((*chain.members, position), new_mean, (new_cov + new_cov.T) / 2)


def join_fragments(
    groups: Sequence[tuple[Position, ...]],
    map_SE3_left: Mapping[int, Floats],
    params: TrackParams,
    motion: MotionError | None = None,
) -> list[tuple[Position, ...]]:
    """Join groups that are one cone seen again after a longer gap (hidden by a post, or missed by the detector).

    Two groups with a common frame are two cones, however near. Otherwise the nearest pair of positions in time is compared,
    one carried into the frame of the other; the best fitting groups are joined first.
    """
    alive = dict(enumerate(sorted(groups, key=lambda g: g[0].frame_index)))
    near = _near_groups(list(alive.values()), params, motion)
    waiting: list[tuple[float, int, int]] = []
    numbers = count(len(alive))

    def compare(i: int, j: int) -> None:
        if (misfit := misfit_of(alive[i], alive[j], map_SE3_left, params, motion)) is not None:
            heappush(waiting, (misfit, i, j))

    for i, others in near.items():
        for j in sorted(others):
            if i < j:
                compare(i, j)
    while waiting:
        _, i, j = heappop(waiting)
        if i not in alive or j not in alive:  # one of them was joined to a better fitting one meanwhile
            continue
        new = next(numbers)
        merged = tuple(sorted((*alive.pop(i), *alive.pop(j)), key=lambda p: p.frame_index))
        alive[new] = merged
        # Two groups that are far from a third are so together: what is compared is one position of either.
        near[new] = {k for k in near.pop(i) | near.pop(j) if k in alive and k != new}
        for k in sorted(near[new]):
            near[k].add(new)
            compare(k, new)
    return list(alive.values())


def _near_groups(
    groups: Sequence[tuple[Position, ...]], params: TrackParams, motion: MotionError | None
) -> dict[int, set[int]]:
    """For each group those that may be the same cone: no error that the motion can have spans a longer distance.

    Without it every group of a drive would be compared with every other, though most stand kilometres apart.
    """
    most_m = inf if motion is None else _most_reach_m(groups, params, motion)
    if most_m == inf or not groups:
        return {i: set(range(len(groups))) - {i} for i in range(len(groups))}
    places = [np.array([p.xyz_m for p in group]) for group in groups]
    centres = np.array([own.mean(axis=0) for own in places])
    radii = np.array([np.linalg.norm(own - own.mean(axis=0), axis=1).max() for own in places])
    pairs = cKDTree(centres).query_pairs(most_m + 2 * radii.max(), output_type="ndarray")
    apart_m = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
    near: dict[int, set[int]] = {i: set() for i in range(len(groups))}
    for i, j in pairs[apart_m <= most_m + radii[pairs[:, 0]] + radii[pairs[:, 1]]].tolist():
        near[i].add(j)
        near[j].add(i)
    return near


def _most_reach_m(groups: Sequence[tuple[Position, ...]], params: TrackParams, motion: MotionError) -> float:
    """An upper bound of `misfit_of`'s reach: of a fixed point, because a carried point may be seen from as much farther away."""
    everything = [p for group in groups for p in group]
    range_m = max((float(np.linalg.norm(p.camera_xyz_m)) for p in everything), default=0.0)
    own_m2 = max((p.camera_cov_m2[0] + p.camera_cov_m2[3] + p.camera_cov_m2[5] for p in everything), default=0.0)
    most_m = 0.0
    for _ in range(_ROUNDS):
        further = _reach_m(own_m2 + motion.most_m2(range_m + most_m) + 3 * params.motion_sigma_m**2, params)
        if further <= most_m + _SETTLED_M:
            return further + _SETTLED_M
        most_m = further
    return inf


def _reach_m(trace_m2: float, params: TrackParams) -> float:
    """How far apart two positions of one cone may be, by the trace of the carried one's covariance."""
    return params.join_gate_m + 3 * float(np.sqrt(trace_m2 / 3))


def misfit_of(
    a: tuple[Position, ...],
    b: tuple[Position, ...],
    map_SE3_left: Mapping[int, Floats],
    params: TrackParams,
    motion: MotionError | None,
) -> float | None:
    """Squared Mahalanobis distance of two groups, or None where they cannot be one cone."""
    nearest = _nearest_in_time(a, b)
    if nearest is None or (motion is None and not _within_reach(*nearest, map_SE3_left, params)):
        return None
    one, other = nearest
    mean, cov = carry(
        np.array(one.camera_xyz_m),
        cov_matrix(one.camera_cov_m2),
        one.frame_index,
        other.frame_index,
        map_SE3_left,
        params,
        motion,
    )
    difference = np.array(other.camera_xyz_m) - mean
    spread = cov + cov_matrix(other.camera_cov_m2)
    distance2 = float(difference @ np.linalg.solve(spread, difference))
    # The covariance alone would join far, vague points over any distance along the line of sight.
    reach_m = _reach_m(float(np.trace(cov)), params)
    return distance2 if distance2 <= params.gate_chi2 and np.linalg.norm(difference) <= reach_m else None


def _nearest_in_time(a: tuple[Position, ...], b: tuple[Position, ...]) -> tuple[Position, Position] | None:
    """The position of either group that are the fewest frames apart; None where one frame has both groups."""
    if a[-1].frame_index < b[0].frame_index:
        return a[-1], b[0]
    if b[-1].frame_index < a[0].frame_index:
        return a[0], b[-1]
    frames_a, frames_b = np.array([p.frame_index for p in a]), np.array([p.frame_index for p in b])
    # Of each of a's frames, b's last one before it and its first one after it (or at it).
    after = np.searchsorted(frames_b, frames_a)
    candidates = np.stack([np.maximum(after - 1, 0), np.minimum(after, len(b) - 1)], axis=1)
    gaps = np.abs(frames_b[candidates] - frames_a[:, None])
    if not gaps.all():
        return None
    i, side = divmod(int(gaps.argmin()), 2)
    return a[i], b[int(candidates[i, side])]


def _within_reach(one: Position, other: Position, map_SE3_left: Mapping[int, Floats], params: TrackParams) -> bool:
    """Whether two positions are at most as far apart as `misfit_of` allows, where the motion's error is a share of the way.

    The same trace as that of `carry`'s covariance, which turns do not change, without matrices: most groups of a drive stand far
    from each other, and all are compared with all.
    """
    start, end = map_SE3_left[one.frame_index], map_SE3_left[other.frame_index]
    apart_m = dist(
        (start[:3, :3] @ one.camera_xyz_m + start[:3, 3]).tolist(),
        (end[:3, :3] @ other.camera_xyz_m + end[:3, 3]).tolist(),
    )
    way_m2 = dist(start[:3, 3].tolist(), end[:3, 3].tolist()) ** 2
    own_m2 = one.camera_cov_m2[0] + one.camera_cov_m2[3] + one.camera_cov_m2[5] + 3 * params.motion_sigma_m**2
    shares = params.motion_sigma_relative**2 + 2 * params.motion_sigma_aside**2
    return apart_m <= _reach_m(own_m2 + shares * way_m2, params) + _ROUNDING_M
