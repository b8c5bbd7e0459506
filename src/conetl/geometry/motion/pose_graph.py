"""Poses of a body from logged poses with slowly varying errors and measured motions, in one adjustment.

The unknowns of each frame are its pose, the slow error of the log (first-order Gauss-Markov) and its smooth error (Matern process
of order 3/2: value and rate). Measured motions of the
left camera tie each frame to the next; observations of static points tie all frames that show them. A scale common to all
measured motions models the error of the rig's calibration, a turn about the optical axis per metre that of followed points.
Gauss-Newton with Huber's weights; normal equations of `chain_solver.py`.

A small pose error is (p, a): map_t_body = t_true + p in metres, map_R_body = R_true exp([a]x), a in radians about the body's
axes; for a car roll, pitch and yaw are about those axes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.motion import chain_solver
from conetl.geometry.motion.chain_solver import ChainNormal, ChainPoints, EliminatedChain
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.arrays import Floats, Ints

#: Unknowns of a frame: six of the pose come first, then six of the log's slow error, and its smooth error with its rate.
POSE, STATE = 6, 18
_Chain = TypeVar("_Chain", EliminatedChain, None)
_MAX_ITERATIONS = 40
_CONVERGED = 1e-4
#: Least variance by which the smooth error is new in the next frame.
_LEAST_FRESH = 1e-10


@dataclass(frozen=True)
class LoggedPoses:
    """The logged trajectory and the model of its errors: smooth ones, drift (first-order Gauss-Markov) and white noise."""

    rotations: Floats
    positions: Floats
    sigma_p: Floats
    """(K, 3): sigma of the whole error of a position."""
    white: Floats
    """(K, 6): sigma of the error that counts as independent in every frame, position and attitude; errors that last for some
    frames are scaled up so that their mean is as uncertain as it is."""
    drift: Floats
    """(K, 6): sigma of the slowly varying part."""
    correlation: Floats
    """(K - 1, 6): of the drift between a frame and the next."""
    body_SE3_left: Floats
    noise: Floats
    """(K, 6): sigma of the error that changes between neighbouring frames apart from the drift: the white part, or far less
    where poses are interpolated."""
    own: Floats
    """(K, 6): sigma of all of a frame's error but the drift."""
    smooth: Floats
    """(3,): sigma of the smooth error of a position (Matern process of order 3/2)."""
    smooth_step: Floats
    """(K - 1, 3): time to the next frame in its length scales, times the root of 3."""
    renewed: Floats
    """(K,): how often the errors have changed by a step since the first record."""

    @property
    def change(self) -> Floats:
        """(K - 1, 6): variance by which the smooth error changes to the next frame."""
        kept = (1 + self.smooth_step) * np.exp(-self.smooth_step)
        return np.hstack([2 * self.smooth**2 * (1 - kept), np.zeros_like(kept)])


class MeasuredMotions(NamedTuple):
    """M measured intervals: each from frame `start` to the next."""

    start: Ints
    """(M,), each once."""
    next_SE3_first: Floats
    """(M, 4, 4) of the left camera."""
    cov: Floats
    """(M, 6, 6) of (rotation rad, translation m) in the second frame."""


class LandmarkObservation(NamedTuple):
    """One cone in one frame: the foot in the left camera's frame, (3,) m and (3, 3) inverse covariance."""

    cone: int
    frame: int
    xyz: Floats
    information: Floats


class LandmarkPrior(NamedTuple):
    """Prior knowledge of one cone: the foot in the map's frame, (3,) m and (3, 3) inverse covariance."""

    cone: int
    xyz: Floats
    information: Floats


class Measurements(NamedTuple):
    """What is adjusted."""

    log: LoggedPoses
    motions: MeasuredMotions
    sightings: Sequence[LandmarkObservation]
    robust_sigmas: float
    common_sigmas: Sequence[float]
    """Prior sigmas of the errors common to all motions: of their scale and, if it is estimated, of their turn about the optical
    axis (rad per metre)."""
    priors: Sequence[LandmarkPrior] = ()


class _State(NamedTuple):
    """The unknowns."""

    rotations: Floats
    positions: Floats
    bias: Floats
    """(K, 6): drift of the log."""
    smooth: Floats
    """(K, 6): smooth error of a position in sigmas, and its rate in sigmas per length scale over the root of 3."""
    shared: Floats
    """Errors common to the measured motions (`adjust`)."""
    feet: Floats
    """(C, 3) of the cones, in the map's frame."""


def adjust(measured: Measurements) -> tuple[Floats, Floats, EliminatedChain] | None:
    """Rotations (K, 3, 3), positions (K, 3) and the last normal equations, eliminated; None if the iteration does not converge.

    Takes memory for each frame and cone; see `adjust_with_cones`.
    """

    def solve(normal: ChainNormal, cones: ChainPoints) -> tuple[Floats, Floats, Floats, EliminatedChain]:
        known = len(normal.right_shared)
        chain = chain_solver.eliminate(chain_solver.with_points(normal, cones))
        step, shared = chain_solver.solve(chain)
        return step, shared[:known], shared[known:].reshape(-1, 3), chain

    found = _iterated(measured, solve)
    return None if found is None else (found[0].rotations, found[0].positions, found[1])


def adjust_with_cones(measured: Measurements) -> tuple[Floats, Floats] | None:
    """As `adjust`, for any number of cones, without what the covariance needs."""
    found = _iterated(measured, lambda normal, cones: (*chain_solver.solve_with_points(normal, cones), None))
    return None if found is None else (found[0].rotations, found[0].positions)


def _iterated(
    measured: Measurements, solve: Callable[[ChainNormal, ChainPoints], tuple[Floats, Floats, Floats, _Chain]]
) -> tuple[_State, _Chain] | None:
    """The unknowns, and the chain of the last solution; None if the iteration does not converge."""
    log, motions, sightings, robust_sigmas, common_sigmas, priors = measured
    left = se3.compose(se3.se3(log.rotations, log.positions), log.body_SE3_left)
    still = np.zeros((len(log.positions), POSE))
    seen = defaultdict[int, list[Floats]](list)
    for s in sightings:
        seen[s.cone].append(se3.apply(left[s.frame], s.xyz))
    feet = np.zeros((1 + max(seen, default=-1), 3))
    for cone, places in seen.items():
        feet[cone] = np.median(places, axis=0)
    state = _State(log.rotations, log.positions, still, still, np.zeros(len(common_sigmas)), feet)
    for _ in range(_MAX_ITERATIONS):
        normal = _normal_equations(log, state, np.array(common_sigmas))
        _add_motions(normal, log, state, motions, robust_sigmas)
        cones = _add_sightings(normal, log, state, sightings, robust_sigmas)
        for prior in priors:
            cones.corner[prior.cone] += prior.information
            cones.right[prior.cone] += prior.information @ (prior.xyz - state.feet[prior.cone])
        try:
            step, step_shared, step_feet, chain = solve(normal, cones)
        except np.linalg.LinAlgError:
            return None
        state = _State(
            state.rotations @ Rotation.from_rotvec(step[:, 3:6]).as_matrix(), state.positions + step[:, :3],
            state.bias + step[:, POSE : 2 * POSE], state.smooth + step[:, 2 * POSE :], state.shared + step_shared,
            state.feet + step_feet,
        )  # fmt: skip
        if float(np.abs(step[:, :3] / log.sigma_p).max()) < _CONVERGED:
            return state, chain
        del normal, cones, chain  # before the next ones: a long drive has gigabytes of them
    return None


def _normal_equations(log: LoggedPoses, state: _State, common_sigmas: Floats) -> ChainNormal:
    """Normal equations of the log and of what is known of the motions' common errors."""
    rotations, positions, bias, smooth, shared, _ = state
    count = len(positions)
    diagonal, upper = np.zeros((count, STATE, STATE)), np.zeros((count - 1, STATE, STATE))
    border, corner = np.zeros((count, STATE, len(shared))), np.zeros((len(shared), len(shared)))
    right, right_shared = np.zeros((count, STATE)), np.zeros(len(shared))
    slow = np.arange(POSE, 2 * POSE)
    # The logged pose is the true one plus the smooth, the slow and the white error.
    turn = Rotation.from_matrix(np.swapaxes(log.rotations, 1, 2) @ rotations).as_rotvec()
    gap = np.hstack([positions - log.positions - log.smooth * smooth[:, :3], turn]) - bias
    weight = 1 / log.white**2
    by_pose = np.tile(np.eye(POSE), (count, 1, 1))
    by_pose[:, 3:, 3:] = _turn_jacobian(turn)
    weighted = np.swapaxes(by_pose, 1, 2) * weight[:, None, :]
    diagonal[:, :POSE, :POSE] += weighted @ by_pose
    diagonal[:, slow, slow] += weight
    diagonal[:, :POSE, POSE : 2 * POSE] -= weighted
    diagonal[:, POSE : 2 * POSE, :POSE] -= np.swapaxes(weighted, 1, 2)
    right[:, :POSE] -= (weighted @ gap[:, :, None])[:, :, 0]
    right[:, slow] += weight * gap
    # The slow error: stationary at the first frame, then from frame to frame.
    diagonal[0, slow, slow] += 1 / log.drift[0] ** 2
    right[0, slow] -= bias[0] / log.drift[0] ** 2
    ratio = log.correlation * log.drift[1:] / log.drift[:-1]  # the stated sigma may change from frame to frame
    fresh = 1 / (log.drift[1:] ** 2 * (1 - log.correlation**2))
    jump = bias[1:] - ratio * bias[:-1]
    diagonal[1:, slow, slow] += fresh
    diagonal[:-1, slow, slow] += ratio**2 * fresh
    upper[:, slow, slow] -= ratio * fresh
    right[1:, slow] -= fresh * jump
    right[:-1, slow] += ratio * fresh * jump
    normal = ChainNormal(diagonal, upper, border, corner, right, right_shared)
    _add_smooth(normal, log, smooth, weight[:, :3], gap[:, :3])
    common = np.arange(len(common_sigmas))
    normal.corner[common, common] += 1 / common_sigmas**2
    normal.right_shared[common] -= shared[common] / common_sigmas**2
    return normal


def _turn_jacobian(turn: Floats) -> Floats:
    """(K, 3, 3): derivatives of rotation vectors (K, 3) by turns about the body's axes.

    The inverse of the right Jacobian (Chirikjian 2012).
    """
    angle = np.maximum(np.linalg.norm(turn, axis=1), 1e-4)[:, None, None]
    cross = cross_matrix(turn)
    return np.asarray(np.eye(3) + cross / 2 + (1 / angle**2 - 1 / (2 * angle * np.tan(angle / 2))) * cross @ cross)


def _add_smooth(normal: ChainNormal, log: LoggedPoses, smooth: Floats, weight: Floats, gap: Floats) -> None:
    """Add the smooth error: in the log, of weight (K, 3) and residual (K, 3), and from frame to frame."""
    place = np.arange(3)
    value, slow = place + 2 * POSE, place + POSE
    weighted = weight * log.smooth
    normal.diagonal[:, value, value] += weighted * log.smooth
    for other, sign in ((place, -1), (slow, 1)):
        normal.diagonal[:, other, value] += sign * weighted
        normal.diagonal[:, value, other] += sign * weighted
    normal.right[:, value] += weighted * gap
    own = np.arange(2 * POSE, STATE)
    normal.diagonal[0, own, own] += 1.0
    normal.right[0, own] -= smooth[0]
    # Hartikainen & Sarkka 2010, with value and rate in units in which both have a variance of 1.
    step = log.smooth_step
    moves = np.exp(-step)[..., None, None] * np.stack([1 + step, step, -step, 1 - step], axis=-1).reshape(
        *step.shape, 2, 2
    )
    information = np.linalg.inv(np.eye(2) * (1 + _LEAST_FRESH) - moves @ np.swapaxes(moves, -1, -2))
    both = np.stack([smooth[:, :3], smooth[:, 3:]], axis=-1)
    jump = both[1:] - (moves @ both[:-1, :, :, None])[..., 0]
    forward = np.swapaxes(moves, -1, -2) @ information
    for axis in place:
        at = np.array([axis, axis + 3]) + 2 * POSE
        rows, columns = at[:, None], at[None, :]
        normal.diagonal[1:, rows, columns] += information[:, axis]
        normal.diagonal[:-1, rows, columns] += (forward @ moves)[:, axis]
        normal.upper[:, rows, columns] -= forward[:, axis]
        normal.right[1:, at] -= (information[:, axis] @ jump[:, axis, :, None])[..., 0]
        normal.right[:-1, at] += (forward[:, axis] @ jump[:, axis, :, None])[..., 0]


def _add_motions(
    normal: ChainNormal, log: LoggedPoses, state: _State, motions: MeasuredMotions, robust_sigmas: float
) -> None:
    """Add visual odometry to the normal equations; its common errors are the first shared unknowns."""
    common = len(state.shared)
    residual, from_first, from_second = motion_residuals(log, *state[:2], motions, state.shared[0])
    driven_m = np.linalg.norm(motions.next_SE3_first[:, :3, 3], axis=1)
    if common > 1:
        residual[:, 2] -= state.shared[1] * driven_m
    information = np.linalg.inv(motions.cov)
    misfit2 = np.einsum("mi,mij,mj->m", residual, information, residual) / 6
    information *= _huber(misfit2, robust_sigmas)[:, None, None]
    from_common = np.zeros((len(residual), 6, common))
    from_common[:, 3:, 0] = motions.next_SE3_first[:, :3, 3] - residual[:, 3:]
    from_common[:, 2, 1:] = driven_m[:, None]
    wide_first = np.swapaxes(from_first, 1, 2) @ information
    wide_second = np.swapaxes(from_second, 1, 2) @ information
    wide_common = np.swapaxes(from_common, 1, 2) @ information
    k = motions.start
    normal.diagonal[k, :POSE, :POSE] += wide_first @ from_first
    normal.diagonal[k + 1, :POSE, :POSE] += wide_second @ from_second
    normal.upper[k, :POSE, :POSE] += wide_first @ from_second
    normal.border[k, :POSE, :common] += wide_first @ from_common
    normal.border[k + 1, :POSE, :common] += wide_second @ from_common
    normal.corner[:common, :common] += (wide_common @ from_common).sum(axis=0)
    normal.right[k, :POSE] += (wide_first @ residual[:, :, None])[:, :, 0]
    normal.right[k + 1, :POSE] += (wide_second @ residual[:, :, None])[:, :, 0]
    normal.right_shared[:common] += (wide_common @ residual[:, :, None]).sum(axis=0)[:, 0]


def _add_sightings(
    normal: ChainNormal, log: LoggedPoses, state: _State, sightings: Sequence[LandmarkObservation], robust_sigmas: float
) -> ChainPoints:
    """Add cones as landmarks to the poses; the normal equations of their feet."""
    frame, cone = (np.array([getattr(s, name) for s in sightings], dtype=int) for name in ("frame", "cone"))
    feet = len(state.feet)
    found = ChainPoints(frame, cone, np.zeros((len(frame), POSE, 3)), np.zeros((feet, 3, 3)), np.zeros((feet, 3)))
    if not len(frame):
        return found
    measured = np.stack([s.xyz for s in sightings])
    body_R_left, lever = log.body_SE3_left[:3, :3], log.body_SE3_left[:3, 3]
    rotations = state.rotations[frame]
    camera_R_map = np.swapaxes(rotations @ body_R_left, 1, 2)
    centre = state.positions[frame] + rotations @ lever
    local = (camera_R_map @ (state.feet[cone] - centre)[:, :, None])[:, :, 0]
    residual = measured - local
    information = np.stack([s.information for s in sightings])
    misfit2 = np.einsum("si,sij,sj->s", residual, information, residual) / 3
    information = information * _huber(misfit2, robust_sigmas)[:, None, None]
    by_turn = camera_R_map @ rotations @ cross_matrix(lever) + cross_matrix(local) @ body_R_left.T
    by_pose = np.concatenate([-camera_R_map, by_turn], axis=2)
    wide, wide_foot = np.swapaxes(by_pose, 1, 2) @ information, np.swapaxes(camera_R_map, 1, 2) @ information
    np.add.at(normal.diagonal[:, :POSE, :POSE], frame, wide @ by_pose)
    np.add.at(normal.right[:, :POSE], frame, (wide @ residual[:, :, None])[:, :, 0])
    np.add.at(found.corner, cone, wide_foot @ camera_R_map)
    np.add.at(found.right, cone, (wide_foot @ residual[:, :, None])[:, :, 0])
    found.border[:] = wide @ camera_R_map
    return found


def motion_residuals(
    log: LoggedPoses, rotations: Floats, positions: Floats, motions: MeasuredMotions, scale: float
) -> tuple[Floats, Floats, Floats]:
    """Measured minus computed motions (M, 6), and the derivatives (M, 6, 6) of the computed ones by the two poses' errors."""
    left = se3.compose(se3.se3(rotations, positions), log.body_SE3_left)
    first, second = left[motions.start], left[motions.start + 1]
    computed = se3.compose(se3.invert(second), first)
    measured = motions.next_SE3_first
    turn = Rotation.from_matrix(measured[:, :3, :3] @ np.swapaxes(computed[:, :3, :3], 1, 2)).as_rotvec()
    residual = np.hstack([turn, measured[:, :3, 3] - (1 + scale) * computed[:, :3, 3]])
    from_first, from_second = motion_jacobians(first, second, log.body_SE3_left)
    return residual, from_first, from_second


def motion_jacobians(map_SE3_first: Floats, map_SE3_second: Floats, body_SE3_left: Floats) -> tuple[Floats, Floats]:
    """Derivatives (..., 6, 6) of second_SE3_first (rotation, translation in the second camera) by both bodies' (p, a)."""
    second_R_map = np.swapaxes(map_SE3_second[..., :3, :3], -1, -2)
    motion = se3.compose(se3.invert(map_SE3_second), map_SE3_first)
    left_R_body, lever = body_SE3_left[:3, :3].T, cross_matrix(body_SE3_left[:3, 3])
    by_first = np.zeros((*motion.shape[:-2], 6, 6))
    by_second = np.zeros_like(by_first)
    by_first[..., :3, 3:] = motion[..., :3, :3] @ left_R_body
    by_second[..., :3, 3:] = -left_R_body
    by_first[..., 3:, :3], by_second[..., 3:, :3] = second_R_map, -second_R_map
    # The camera is offset from the body: turning the body moves it.
    by_first[..., 3:, 3:] = -motion[..., :3, :3] @ left_R_body @ lever
    by_second[..., 3:, 3:] = left_R_body @ lever + cross_matrix(motion[..., :3, 3]) @ left_R_body
    return by_first, by_second


def _huber(misfit2: Floats, bound: float) -> Floats:
    """Weights of measurements whose mean squared misfits are `misfit2` (1 where they fit)."""
    return np.minimum(1.0, bound / np.sqrt(np.maximum(misfit2, 1e-12)))
