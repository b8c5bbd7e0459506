"""How the path of a log differs from the one that the images show, and how other errors than the log's change that difference."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry.motion.pose_graph import POSE, LoggedPoses, MeasuredMotions, motion_residuals
from conetl.model.arrays import Floats, Ints
from conetl.model.params import TrajectoryParams

#: Columns of `path_changes`: images show longer distances (share); cameras look to the left, or up (rad); they are mounted
#: forward, left and up of where the lever arm says (m); the stamps of the log lag (s).
SCALE, ASIDE, UP, LEVER, CLOCK = 0, 1, 2, slice(3, 6), 6
#: Variance of what is not known at all: of a gap between measured motions (m^2, rad^2), or in units of the largest stated one.
UNKNOWN = 1e4
#: Least time between two records.
LEAST_APART_S = 1e-3


class PathDifference(NamedTuple):
    """Logged minus measured path of K frames, since the first: of the left camera (m, map frame), and of the attitude (rad, axes
    of the body)."""

    off: Floats
    """(K, 6)"""
    measured_var: Floats
    """(K, 6): variance of the measured path."""
    path_m: Floats
    """(K, 3): the measured one."""
    shape_m: Floats
    """(K, 3): adjusted to both, if they could be: the noise of the measured path would look like a scale of one."""
    velocity: Floats
    """(K, 3) m/s"""
    rotations: Floats
    """(K, 3, 3) of the body."""
    driven_m: Floats
    """(K,) along the direction of the cameras."""


def path_difference(
    log: LoggedPoses, rotations: Floats, positions: Floats | None, motions: MeasuredMotions, times_s: Floats,
    params: TrajectoryParams,
) -> PathDifference:  # fmt: skip
    """The difference of the log from the path that the motions show; a gap between them is bridged by the log.

    rotations: (K, 3, 3) of the body, adjusted to both; what they differ by from the log in the mean is left out, since it may be
    adjusted to an error of the path. positions: (K, 3), adjusted likewise, if they could be. motions: without those that are
    implausible.
    """
    turned = Rotation.from_matrix(np.swapaxes(log.rotations, 1, 2) @ rotations).as_rotvec().mean(axis=0)
    rotations = rotations @ Rotation.from_rotvec(-turned).as_matrix()
    body_R_left, lever = log.body_SE3_left[:3, :3], log.body_SE3_left[:3, 3]
    count, k = len(times_s), motions.start
    path = log.positions + rotations @ lever
    left = rotations @ body_R_left
    off, var = np.zeros((count, POSE)), np.zeros((count, POSE))
    var[1:] = UNKNOWN
    shifts = -np.einsum("mij,mj->mi", left[k + 1], motions.next_SE3_first[:, :3, 3])
    off[k + 1, :3] = path[k + 1] - path[k] - shifts
    turns, _, _ = motion_residuals(log, log.rotations, log.positions, motions, 0.0)
    off[k + 1, 3:] = turns[:, :3] @ body_R_left.T
    lengths_m = np.linalg.norm(shifts, axis=1)
    var[k + 1, :3] = np.einsum("mij,mjk,mik->mi", left[k + 1], motions.cov[:, 3:, 3:], left[k + 1])
    var[k + 1, :3] += (params.floor_rad * lengths_m[:, None]) ** 2
    var[k + 1, 3:] = np.einsum("ij,mjk,ik->mi", body_R_left, motions.cov[:, :3, :3], body_R_left)
    off = np.cumsum(off, axis=0)
    path = (
        path - path[0] - off[:, :3]
    )  # as measured: noise of the log would make changes in proportion to the path too small
    velocity = np.gradient(path, rising(times_s), axis=0)
    steps_m = np.diff(path, axis=0, prepend=path[:1])
    driven_m = np.cumsum((steps_m[:, :2] * left[:, :2, 2]).sum(axis=1))
    shape = path if positions is None else positions - positions[0] + (rotations - rotations[0]) @ lever
    return PathDifference(off, np.cumsum(var, axis=0), path, shape, velocity, rotations, driven_m)


def rising(times_s: Floats) -> Floats:
    """(K,): the times, each later than the one before."""
    return np.asarray(np.maximum.accumulate(times_s + LEAST_APART_S * np.arange(len(times_s))))


def path_changes(difference: PathDifference) -> Floats:
    """(K, 3, 7) m: by how much the logged path differs from the measured one for each unit of `SCALE` to `CLOCK`."""
    path = difference.shape_m
    changes = np.zeros((len(path), 3, 7))
    changes[:, :, SCALE] = -path
    changes[:, 0, ASIDE], changes[:, 1, ASIDE] = -path[:, 1], path[:, 0]
    changes[:, 2, UP] = -difference.driven_m
    changes[:, :, LEVER] = -(difference.rotations - difference.rotations[0])
    changes[:, :, CLOCK] = -(difference.velocity - difference.velocity[0])
    return changes


def measured_cov(difference: PathDifference, stated: Floats, frames: Ints, axis: int) -> Floats:
    """(N, N): covariance of the measured path at some frames, also by the errors of the turns that the images show.

    stated (K, 6): sigmas of the log, by which the images are turned where they show nothing.
    """
    var = difference.measured_var[frames, axis]
    cov = np.minimum.outer(var, var)
    if axis >= 3:
        return np.asarray(cov)
    aside = (-difference.path_m[:, 1], difference.path_m[:, 0], difference.driven_m)[axis]
    aside = aside - aside.mean()
    attitude = 4 if axis == 2 else 5
    turn_var = np.diff(difference.measured_var[:, attitude], prepend=0.0)
    turn_var = np.minimum(turn_var, np.median(stated[:, attitude]) ** 2)
    # The sum of what each turn before both frames moves them by.
    before = np.minimum.outer(frames, frames)
    turned, moved, squared = (np.append(0.0, np.cumsum(turn_var * aside**power))[before] for power in range(3))
    beside = aside[frames]
    return np.asarray(cov + np.outer(beside, beside) * turned - np.add.outer(beside, beside) * moved + squared)
