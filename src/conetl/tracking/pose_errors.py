"""How the errors of a drive's poses hang together over time, and what of them is one error of the whole drive.

Poses of neighbouring frames err nearly alike, those of its two ends less so: the adjustment of the trajectory knows by how much
(`geometry/motion/chain_solver.py`), and of a log that was not refined its Gauss-Markov processes say it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from conetl.geometry.jacobians import pose_jacobian
from conetl.geometry.motion.chain_solver import joint_covariance
from conetl.geometry.motion.pose_graph import POSE
from conetl.model.params import TrajectoryParams
from conetl.model.records import Pose
from conetl.tracking.trajectory import RefinedTrajectory, log_errors

Floats = NDArray[np.float64]
#: F frame indices, rising and each once -> (6F, 6F) covariance of their poses' errors: easting, northing, height (m), roll,
#: pitch, yaw (rad) of the first frame, of the second ...
PoseCov = Callable[[Sequence[int]], Floats]
#: Correlations of poses that err alike to the last digit leave nothing to divide by.
_LEAST_SHARE = 1e-10
#: A pose without any error in one of its six has this one (m, rad).
_LEAST_SIGMA = 1e-9


def pose_cov(trajectory: RefinedTrajectory, params: TrajectoryParams) -> PoseCov:
    """Joint covariance of the poses of a drive: that of the adjustment, or of the log where nothing was adjusted.

    The adjustment's attitude errors are about the body's axes, which for a car are those of roll, pitch and yaw.
    """
    rank = {pair.frame_index: k for k, pair in enumerate(trajectory.frame_pairs)}
    refined = trajectory.covariance

    def of_frames(frame_indices: Sequence[int]) -> Floats:
        states = [rank[index] for index in frame_indices]
        if refined is not None:
            return joint_covariance(refined, states, POSE)
        return log_errors([trajectory.frame_pairs[k] for k in states], params)

    return of_frames


def constant_and_change(cov: Floats) -> tuple[Floats, Floats]:
    """Covariance (6F, 6F) of the poses of F frames as that of one constant error (6, 6) plus that of what changes (6F, 6F).

    The best estimate of a constant from errors with that covariance (generalised least squares, e.g. Koch 1999, ch. 3.2) is
    uncorrelated with what it leaves over. So the two parts are independent and add up exactly.
    """
    count = len(cov) // POSE
    sigma = np.maximum(np.sqrt(np.diagonal(cov)), _LEAST_SIGMA)
    correlation = cov / np.outer(sigma, sigma) + _LEAST_SHARE * np.eye(len(cov))
    alike = np.tile(np.eye(POSE), (count, 1))
    scaled = alike / sigma[:, None]
    constant = np.linalg.inv(scaled.T @ cho_solve(cho_factor(correlation), scaled))
    constant = (constant + constant.T) / 2
    return np.asarray(constant), np.asarray(cov - np.tile(constant, (count, count)))


def moved_by_poses(xyz_m: Floats, poses: Sequence[Pose]) -> Floats:
    """(N, 3, 6): how points (N, 3) move with the errors of their own poses; see `pose_jacobian`."""
    return pose_jacobian(
        xyz_m,
        np.array([pose.map_R_body for pose in poses]).reshape(-1, 3, 3),
        np.array([pose.map_t_body_m for pose in poses]).reshape(-1, 3),
    )


def moved_cov(jacobian: Floats, rank: NDArray[np.intp], cov: Floats) -> Floats:
    """(3N, 3N) m^2: how N points move together with errors of F poses.

    jacobian (N, 3, 6): of each point by the pose of its own frame; rank (N,): which of the F frames that is; cov (6F, 6F).
    """
    count = len(jacobian)
    by_pose = np.zeros((count, 3, len(cov) // POSE, POSE))
    by_pose[np.arange(count), :, rank] = jacobian
    flat = by_pose.reshape(3 * count, -1)
    return np.asarray(flat @ cov @ flat.T)
