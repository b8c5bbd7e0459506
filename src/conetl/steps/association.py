"""Positions of single frame pairs -> chains, one per physical cone, by following each cone from picture to picture.

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
from itertools import combinations, count

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from conetl.geometry.packing import cov_matrix
from conetl.params import TrackParams
from conetl.records import Position

Floats = NDArray[np.float64]
#: (start frame, end frame, point (3,) m in the left camera at start) -> (3, 3) m^2 that the motion adds to its covariance.
MotionError = Callable[[int, int, Floats], Floats]
#: Cost of an impossible pairing in the assignment; far above any gate.
_FORBIDDEN = 1e6


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
    joined = dict(enumerate(sorted(groups, key=lambda g: g[0].frame_index)))
    misfits: dict[tuple[int, int], float] = {}

    def compare(i: int, j: int) -> None:
        misfit = misfit_of(joined[i], joined[j], map_SE3_left, params, motion)
        if misfit is not None:
            misfits[i, j] = misfit

    for i, j in combinations(joined, 2):
        compare(i, j)
    # Only what was just joined is compared anew: to compare all again each time takes hours on a drive of many cones.
    for number in count(len(joined)):
        if not misfits:
            break
        i, j = min(misfits, key=lambda pair: (misfits[pair], pair))
        merged = tuple(sorted((*joined.pop(i), *joined.pop(j)), key=lambda p: p.frame_index))
        misfits = {pair: misfit for pair, misfit in misfits.items() if i not in pair and j not in pair}
        others = list(joined)
        joined[number] = merged
        for other in others:
            compare(other, number)
    return list(joined.values())


def misfit_of(
    a: tuple[Position, ...],
    b: tuple[Position, ...],
    map_SE3_left: Mapping[int, Floats],
    params: TrackParams,
    motion: MotionError | None,
) -> float | None:
    """Squared Mahalanobis distance of two groups, or None where they cannot be one cone."""
    apart = np.abs(np.subtract.outer([p.frame_index for p in a], [p.frame_index for p in b]))
    i, j = divmod(int(apart.argmin()), len(b))
    if apart[i, j] == 0:
        return None
    one, other = a[i], b[j]
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
    reach_m = params.join_gate_m + 3 * float(np.sqrt(np.trace(cov) / 3))
    return distance2 if distance2 <= params.gate_chi2 and np.linalg.norm(difference) <= reach_m else None
