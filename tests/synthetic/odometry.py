"""A drive with ground truth for trajectory refinement: true poses, a log with slowly varying errors, measured motions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.model.drive import FramePair, Pose
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig
from tests.synthetic.world import ORIGIN_M, START_NS

Floats = NDArray[np.float64]
STEP_S = 0.1


def true_poses(frames: int, speed_m_s: float = 8.0) -> Floats:
    """(K, 4, 4) body -> map of a car on a bend, with a little roll and pitch."""
    times = np.arange(frames) * STEP_S
    yaw = 0.4 + 0.15 * np.sin(0.3 * times)
    places = np.cumsum(
        np.stack([np.cos(yaw), np.sin(yaw), 0.01 * np.ones(frames)], axis=1) * speed_m_s * STEP_S, axis=0
    )
    return se3.se3(se3.rotation_from_rpy(0.01 * np.sin(times), 0.01 * np.cos(times), yaw), places + ORIGIN_M)


def gauss_markov(rng: np.random.Generator, frames: int, sigmas: Floats, correlation_s: float) -> Floats:
    """(K, n) samples of a stationary first-order process."""
    keep = np.exp(-STEP_S / correlation_s)
    errors = np.empty((frames, len(sigmas)))
    errors[0] = rng.normal(0, sigmas)
    for k in range(1, frames):
        errors[k] = keep * errors[k - 1] + rng.normal(0, sigmas * np.sqrt(1 - keep**2))
    return errors


def log_of(
    truth: Floats,
    rng: np.random.Generator,
    sigma_m: float | Floats,
    sigma_rad: float,
    params: TrajectoryParams,
    constant_m: float = 0.0,
) -> list[FramePair]:
    """What a GNSS/INS writes down whose errors are as `params` say.

    sigma_m: of the whole drive, or (K,) of each record. constant_m: sigma of the part of the position error, at most the least
    `sigma_m`, that stays the same over the drive.
    """
    count, axes = len(truth), np.array([1, 1, 1.5])
    sigma_p = np.broadcast_to(np.reshape(sigma_m, (-1, 1)) * axes, (count, 3))
    sigma_a = np.broadcast_to(sigma_rad * np.array([1, 1, 3.0]), (count, 3))

    def error(sigmas: Floats, share: float, correlation_s: float, constant: Floats) -> Floats:
        constant = np.minimum(constant, np.sqrt(1 - share**2) * sigmas.min(axis=0))
        slow = gauss_markov(rng, count, np.ones(3), correlation_s)
        slow *= np.sqrt(np.maximum((1 - share**2) * sigmas**2 - constant**2, 0.0))
        drawn = slow + rng.normal(0, 1, (count, 3)) * share * sigmas
        return drawn + rng.normal(0, constant) if constant.any() else drawn

    places = truth[:, :3, 3] + error(sigma_p, params.gnss_white_share, params.gnss_correlation_s, constant_m * axes)
    turns = error(sigma_a, params.attitude_white_share, params.attitude_correlation_s, np.zeros(3))
    rotations = truth[:, :3, :3] @ Rotation.from_rotvec(turns).as_matrix()
    return [
        FramePair(
            frame_index=k,
            left_path=f"{k}.png",
            right_path=f"{k}.png",
            captured_at_ns=START_NS + round(k * STEP_S * 1e9),
            pose=Pose(
                map_R_body=se3.to_matrix3(rotations[k]),
                map_t_body_m=tuple(places[k].tolist()),
                sigma_enu_m=tuple(sigma_p[k].tolist()),
                sigma_rpy_rad=tuple(sigma_a[k].tolist()),
            ),
        )
        for k in range(count)
    ]


def motions_of(truth: Floats, rig: Rig, rng: np.random.Generator, params: TrajectoryParams) -> list[RelativeMotion]:
    """What visual odometry measures of it: own noise, what its residuals do not show, and a common scale error."""
    left = se3.compose(truth, np.array(rig.body_SE3_left))
    shown = np.diag([5e-5**2] * 3 + [0.002**2] * 3)
    scale = 1 + rng.normal(0, params.scale_sigma)
    result = []
    for k in range(len(truth) - 1):
        motion = se3.compose(se3.invert(left[k + 1]), left[k])
        way_m = float(np.linalg.norm(motion[:3, 3]))
        turn = rng.normal(0, np.hypot(5e-5, params.floor_rad), 3)
        shift_sigma = np.sqrt(0.002**2 + params.floor_m**2 + (params.floor_relative * way_m) ** 2)
        pose = motion.copy()
        pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ motion[:3, :3]
        pose[:3, 3] = scale * motion[:3, 3] + rng.normal(0, shift_sigma, 3)
        result.append(
            RelativeMotion(
                first_frame_index=k,
                second_frame_index=k + 1,
                second_SE3_first=se3.to_matrix4(pose),
                cov=tuple(shown[np.triu_indices(6)].tolist()),
                inlier_count=200,
                point_count=250,
                reason="ok",
            )
        )
    return result


def pose_errors(pairs: tuple[FramePair, ...] | list[FramePair], truth: Floats) -> Floats:
    """(K, 6): place (m) and turn (rad, body axes) of the poses against the truth."""
    poses = np.stack([se3.map_SE3_body(pair.pose) for pair in pairs])
    turn = Rotation.from_matrix(np.swapaxes(truth[:, :3, :3], 1, 2) @ poses[:, :3, :3]).as_rotvec()
    return np.hstack([poses[:, :3, 3] - truth[:, :3, 3], turn])
