"""Positions of single frame pairs -> chains, one per physical cone (or other object), by tracking each from frame to frame.

Absolute coordinates do not suffice: without a GNSS fix they drift by more than a metre. So a chain lives in the left camera's
frame and is predicted by the *relative* motion, whose error grows with the distance driven. The next position must fit the
prediction in three dimensions with its own covariance (narrow in bearing, long in range); the assignment is one-to-one with
least total cost (Kalman filter with global nearest neighbour, e.g. Bar-Shalom, Willett & Tian 2011, ch. 6).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from itertools import count
from math import dist, inf

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from conetl.geometry.packing import cov_matrices, cov_matrix
from conetl.model.arrays import Floats
from conetl.model.drive import Position
from conetl.model.feature_classes import mutually_exclusive
from conetl.model.params import TrackParams

#: Cost of a forbidden pair in the assignment; far above any gate.
_FORBIDDEN = 1e6
#: Iterations and tolerance of the largest distance between two positions of one cone.
_ROUNDS, _SETTLED_M = 50, 0.01
#: Rounding of coordinates of millions of metres is below this.
_ROUNDING_M = 1e-6


@dataclass(frozen=True)
class MotionError:
    """Error of a point that the relative motion transforms from frame to frame."""

    cov_m2: Callable[[int, int, Floats], Floats]
    """(start frame, end frame, point (3,) m in the left camera at start) -> (3, 3) m^2 added to its covariance, in the left
    camera's frame at the end."""
    most_m2: Callable[[float], float] = lambda _range_m: np.inf
    """Range (m) of a point at both ends -> upper bound of the trace of that covariance."""
    changed_cov_m2: Callable[[Floats, Sequence[Sequence[int]], Sequence[Floats]], Floats] | None = None
    """N points (N, 3) in the map, the frames of each, derivatives (F, 3, 3) of each by those of its frames -> (3N, 3N): how they
    err by changes of the poses' errors since the middle of the drive; None where cones err by more."""


@dataclass(frozen=True)
class CameraMotion:
    """How the left camera moved during one drive, and within which limits positions from two frames are one cone."""

    map_SE3_left: Mapping[int, Floats]
    """(4, 4) left camera -> map, by frame index."""
    params: TrackParams
    error: MotionError | None = None
    """Of the relative motion; without it the shares in `params` hold."""

    @cached_property
    def _left_SE3_map(self) -> Mapping[int, Floats]:
        inverse = np.linalg.inv(np.reshape([*self.map_SE3_left.values()], (-1, 4, 4)))
        return dict(zip(self.map_SE3_left, inverse, strict=True))

    def carry(self, mean: Floats, cov: Floats, start: int, end: int) -> tuple[Floats, Floats]:
        """A point (3,) with covariance (3, 3) in the left camera's frame at `start`, transformed to that at `end`."""
        end_SE3_start = self._left_SE3_map[end] @ self.map_SE3_left[start]
        rotation, translation = end_SE3_start[:3, :3], end_SE3_start[:3, 3]
        added = self.params.motion_sigma_m**2 * np.eye(3)
        if self.error is not None:
            added = self.error.cov_m2(start, end, mean) + added
        else:
            along = np.outer(translation, translation)  # (distance driven)^2 in its direction, nothing across it
            across = float(translation @ translation) * np.eye(3) - along
            added = added + self.params.motion_sigma_relative**2 * along + self.params.motion_sigma_aside**2 * across
        return rotation @ mean + translation, rotation @ cov @ rotation.T + added


@dataclass(frozen=True)
class Chain:
    """Positions of one cone so far; `mean` (3,) and `cov` (3, 3) in the left camera's frame of the last of them."""

    members: tuple[Position, ...]
    mean: Floats
    cov: Floats


def chain_positions(positions: Sequence[Position], camera: CameraMotion) -> list[tuple[Position, ...]]:
    """Group the positions of one drive by physical cone.

    Every position is in exactly one group; groups are sorted by frame index, with at most one position per frame.
    """
    by_frame: dict[int, list[Position]] = defaultdict(list)
    for position in positions:
        by_frame[position.frame_index].append(position)
    open_chains: list[Chain] = []
    closed: list[Chain] = []
    for frame_index in sorted(by_frame):
        oldest = frame_index - camera.params.max_gap_frames
        closed += [c for c in open_chains if c.members[-1].frame_index < oldest]
        open_chains = [c for c in open_chains if c.members[-1].frame_index >= oldest]
        open_chains = extend_chains(open_chains, by_frame[frame_index], frame_index, camera)
    return join_fragments([c.members for c in closed + open_chains], camera)


def extend_chains(
    chains: list[Chain], found: Sequence[Position], frame_index: int, camera: CameraMotion
) -> list[Chain]:
    """The open chains after one more frame: each position extends the chain it fits, or starts a new one."""
    carried = [camera.carry(c.mean, c.cov, c.members[-1].frame_index, frame_index) for c in chains]
    costs = _costs(chains, carried, found, camera.params)
    extended = {int(i): int(j) for i, j in zip(*linear_sum_assignment(costs), strict=True) if costs[i, j] < _FORBIDDEN}
    result = [
        _updated(chain, *carried[i], found[extended[i]]) if i in extended else chain for i, chain in enumerate(chains)
    ]
    new = [position for j, position in enumerate(found) if j not in set(extended.values())]
    return result + [Chain((p,), np.array(p.camera_xyz_m), cov_matrix(p.camera_cov_m2)) for p in new]


def _costs(
    chains: Sequence[Chain], carried: Sequence[tuple[Floats, Floats]], found: Sequence[Position], params: TrackParams
) -> Floats:
    """Cost of every chain (rows) for every position (columns); carried: mean and covariance of the chains in this frame."""
    if not chains or not found:
        return np.empty((len(chains), len(found)))
    means, covs = (np.stack(parts)[:, None] for parts in zip(*carried, strict=True))
    innovation = np.array([p.camera_xyz_m for p in found]) - means
    spread = covs + cov_matrices([p.camera_cov_m2 for p in found])
    distance2 = np.einsum("ijk,ijk->ij", innovation, np.linalg.solve(spread, innovation[..., None])[..., 0])
    alike = [[mutually_exclusive(c.members[-1].category, p.category) for p in found] for c in chains]
    near = np.linalg.norm(innovation, axis=2) <= params.max_innovation_m
    # The log-determinant prefers a precise chain to a vague one that fits as well.
    cost = distance2 + np.linalg.slogdet(spread)[1]
    return np.where(alike & near & (distance2 <= params.gate_chi2), cost, _FORBIDDEN)


def _updated(chain: Chain, mean: Floats, cov: Floats, position: Position) -> Chain:
    gain = cov @ np.linalg.inv(cov + cov_matrix(position.camera_cov_m2))
    new_cov = (np.eye(3) - gain) @ cov
    new_mean = mean + gain @ (np.array(position.camera_xyz_m) - mean)
    return Chain((*chain.members, position), new_mean, (new_cov + new_cov.T) / 2)


def join_fragments(groups: Sequence[tuple[Position, ...]], camera: CameraMotion) -> list[tuple[Position, ...]]:
    """Join groups of one cone observed again after a longer gap (hidden by a post, or missed by the detector).

    Two groups with a common frame are two cones. Otherwise the nearest pair of positions in time is compared, one transformed
    into the frame of the other; the best fitting groups are joined first.
    """
    alive = dict(enumerate(sorted(groups, key=lambda g: g[0].frame_index)))
    near = _near_groups(list(alive.values()), camera)
    waiting: list[tuple[float, int, int]] = []
    numbers = count(len(alive))

    def compare(i: int, j: int) -> None:
        if (misfit := misfit_of(alive[i], alive[j], camera)) is not None:
            heappush(waiting, (misfit, i, j))

    for i, others in near.items():
        for j in sorted(others):
            if i < j:
                compare(i, j)
    while waiting:
        _, i, j = heappop(waiting)
        if i not in alive or j not in alive:  # joined to a better fitting group meanwhile
            continue
        new = next(numbers)
        merged = tuple(sorted((*alive.pop(i), *alive.pop(j)), key=lambda p: p.frame_index))
        alive[new] = merged
        # Two groups far from a third are far from it together: one position of either is compared.
        near[new] = {k for k in near.pop(i) | near.pop(j) if k in alive and k != new}
        for k in sorted(near[new]):
            near[k].add(new)
            compare(k, new)
    return list(alive.values())


def _near_groups(groups: Sequence[tuple[Position, ...]], camera: CameraMotion) -> dict[int, set[int]]:
    """For each group those that may be the same cone, within the largest error of the motion.

    Without this bound every group of a drive would be compared with every other.
    """
    most_m = inf if camera.error is None else _most_reach_m(groups, camera.params, camera.error)
    if most_m == inf or not groups:
        return {i: set(range(len(groups))) - {i} for i in range(len(groups))}
    group_xyz_m = [np.array([p.xyz_m for p in group]) for group in groups]
    centres = np.array([own.mean(axis=0) for own in group_xyz_m])
    radii = np.array([np.linalg.norm(own - own.mean(axis=0), axis=1).max() for own in group_xyz_m])
    pairs = cKDTree(centres).query_pairs(most_m + 2 * radii.max(), output_type="ndarray")
    apart_m = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
    near: dict[int, set[int]] = {i: set() for i in range(len(groups))}
    for i, j in pairs[apart_m <= most_m + radii[pairs[:, 0]] + radii[pairs[:, 1]]].tolist():
        near[i].add(j)
        near[j].add(i)
    return near


def _most_reach_m(groups: Sequence[tuple[Position, ...]], params: TrackParams, error: MotionError) -> float:
    """Upper bound of the reach in `misfit_of`: a fixed point, because the range of a transformed point grows with it."""
    everything = [p for group in groups for p in group]
    range_m = max((float(np.linalg.norm(p.camera_xyz_m)) for p in everything), default=0.0)
    own_m2 = max((p.camera_cov_m2[0] + p.camera_cov_m2[3] + p.camera_cov_m2[5] for p in everything), default=0.0)
    most_m = 0.0
    for _ in range(_ROUNDS):
        further = _reach_m(own_m2 + error.most_m2(range_m + most_m) + 3 * params.motion_sigma_m**2, params)
        if further <= most_m + _SETTLED_M:
            return further + _SETTLED_M
        most_m = further
    return inf


def _reach_m(trace_m2: float, params: TrackParams) -> float:
    """How far apart two positions of one cone may be, by the trace of the carried one's covariance."""
    return params.join_gate_m + 3 * float(np.sqrt(trace_m2 / 3))


def misfit_of(a: tuple[Position, ...], b: tuple[Position, ...], camera: CameraMotion) -> float | None:
    """Squared Mahalanobis distance of two groups, or None if they cannot be one cone."""
    nearest = _nearest_in_time(a, b) if mutually_exclusive(a[0].category, b[0].category) else None
    if nearest is None or (camera.error is None and not _within_reach(*nearest, camera)):
        return None
    one, other = nearest
    own_cov = cov_matrix(one.camera_cov_m2)
    mean, cov = camera.carry(np.array(one.camera_xyz_m), own_cov, one.frame_index, other.frame_index)
    difference = np.array(other.camera_xyz_m) - mean
    spread = cov + cov_matrix(other.camera_cov_m2)
    distance2 = float(difference @ np.linalg.solve(spread, difference))
    # The covariance alone would join far, vague points over any distance along the line of sight.
    reach_m = _reach_m(float(np.trace(cov)), camera.params)
    return distance2 if distance2 <= camera.params.gate_chi2 and np.linalg.norm(difference) <= reach_m else None


def _nearest_in_time(a: tuple[Position, ...], b: tuple[Position, ...]) -> tuple[Position, Position] | None:
    """The pair of positions fewest frames apart; None where both groups have a position in one frame.

    Of several pairs the most precise: groups whose frames alternate have many, and one vague position among them says nothing.
    """
    if a[-1].frame_index < b[0].frame_index:
        return a[-1], b[0]
    if b[-1].frame_index < a[0].frame_index:
        return a[0], b[-1]
    frames_a, frames_b = np.array([p.frame_index for p in a]), np.array([p.frame_index for p in b])
    gaps = np.abs(frames_b - frames_a[:, None])
    if not gaps.min():
        return None
    pairs = [(a[i], b[j]) for i, j in np.argwhere(gaps == gaps.min()).tolist()]
    return min(pairs, key=lambda pair: sum(p.camera_cov_m2[0] + p.camera_cov_m2[3] + p.camera_cov_m2[5] for p in pair))


def _within_reach(one: Position, other: Position, camera: CameraMotion) -> bool:
    """Whether two positions are near enough for `misfit_of`, without a motion error.

    The trace of the carried covariance, which rotations do not change, computed without matrices: most groups are far apart,
    and all pairs are compared.
    """
    params = camera.params
    start, end = (camera.map_SE3_left[p.frame_index][:3, 3].tolist() for p in (one, other))
    driven_m2 = dist(start, end) ** 2
    own_m2 = one.camera_cov_m2[0] + one.camera_cov_m2[3] + one.camera_cov_m2[5] + 3 * params.motion_sigma_m**2
    shares = params.motion_sigma_relative**2 + 2 * params.motion_sigma_aside**2
    return dist(one.xyz_m, other.xyz_m) <= _reach_m(own_m2 + shares * driven_m2, params) + _ROUNDING_M
