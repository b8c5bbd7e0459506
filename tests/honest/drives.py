"""Honest drives without images: simulated motions, logs of all shapes (`logs.py`), and how far cones beside the path are off.

Roads, odometry and their errors are those of `tests/synthetic/good_drives.py`.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from conetl.checks.verdict import judge_all
from conetl.evaluation.accuracy import pose_parts
from conetl.geometry import pose as se3
from conetl.geometry.consistency import Consistency, consistency
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.model.drive import FramePair, Pose
from conetl.model.health import HealthCheck
from conetl.model.params import IngestParams
from conetl.tracking.checks.poses import check_trajectory
from conetl.tracking.drive_refinement import refine_with_cones
from conetl.tracking.error_propagation import moved_by_poses, pose_cov
from conetl.tracking.trajectory import RefinedTrajectory
from tests.honest.logs import PARAMS, Log, LogShape, logged
from tests.honest.outcomes import Outcome
from tests.synthetic.good_drives import RIG, Path, failed
from tests.synthetic.odometry import STEP_S, motions_of
from tests.synthetic.world import START_NS

Floats = NDArray[np.float64]
#: Cones on both sides of the path, in the body's axes; each is seen once, from a frame pair of its own, with an error of its own.
_CONES_M = np.array([[8.0, 3.0, 0.0], [12.0, -3.0, 0.0], [10.0, 2.0, 0.0], [9.0, -2.0, 0.0], [11.0, 3.0, 0.0]])
_OWN_SIGMA_M = 0.005
#: The path begins so long before the images, for records before them.
_BEFORE_S = 15.0


@dataclass(frozen=True)
class HonestDrive:
    """A drawn drive and the truth about it."""

    truth: Floats
    """(K, 4, 4) body -> map at the images."""
    log: Log
    motions: list[RelativeMotion]
    rng: np.random.Generator


def rng_of(seed: int, *names: object) -> np.random.Generator:
    """Of one recording, another one for each of its names."""
    return np.random.default_rng([seed, zlib.crc32(" ".join(map(str, names)).encode())])


def draw_drive(seed: int, shape: LogShape, sigma_m: float) -> HonestDrive:
    """A drive of 6 to 40 s."""
    rng = rng_of(seed, shape.name, sigma_m)
    images_s = np.arange(int(rng.uniform(6.0, 40.0) / STEP_S)) * STEP_S
    path = Path(rng, float(images_s[-1]) + 2 * _BEFORE_S, turns=bool(rng.uniform() < 0.6))
    truth = path.poses_at(images_s + _BEFORE_S)
    pairs = [
        FramePair(
            frame_index=k, left_path=f"{k}.png", right_path=f"{k}.png", captured_at_ns=START_NS + round(t * 1e9), detail=10.0,
            pose=se3.to_pose(pose, np.ones(6)),
        )
        for k, (t, pose) in enumerate(zip(images_s, truth, strict=True))
    ]  # fmt: skip
    log = logged(pairs, lambda seconds: path.poses_at(seconds + _BEFORE_S), rng, shape, sigma_m)
    lost = rng.uniform(size=len(pairs) - 1) < rng.uniform(0.0, 0.1)
    motions = [failed(m) if gone else m for m, gone in zip(motions_of(truth, RIG, rng, PARAMS), lost, strict=True)]
    return HonestDrive(truth, log, motions, rng)


def checked(drive: HonestDrive) -> tuple[RefinedTrajectory, list[HealthCheck]]:
    """The refined trajectory of a drive, and the checks of it."""
    params = PARAMS.model_copy(update={"clock_sigma_s": drive.log.clock_sigma_s or PARAMS.clock_sigma_s})
    refined = refine_with_cones(drive.log.frame_pairs, RIG, drive.motions, [], IngestParams(trajectory=params))
    seen = [pair.model_copy(update={"detail": 10.0}) for pair in refined.logged or drive.log.frame_pairs]
    return refined, judge_all(check_trajectory(seen, RIG, drive.motions, refined, params))


def outcome_of(seed: int, shape: LogShape, sigma_m: float) -> Outcome:
    """Draws a drive and checks it."""
    drive = draw_drive(seed, shape, sigma_m)
    refined, checks = checked(drive)
    return (
        Outcome(shape.name, "simulated motions", sigma_m, seed)
        .with_checks(checks)
        .with_cones(*cone_errors(drive, refined))
    )


def cone_errors(drive: HonestDrive, refined: RefinedTrajectory) -> tuple[Floats, Floats, Consistency]:
    """Errors (N, 3) of cones that are seen from evenly spaced frame pairs, their covariance (3N, 3N) by that of the refined
    poses, and the NEES."""
    pairs, rng = refined.frame_pairs, drive.rng
    seen = np.linspace(0, len(pairs) - 1, len(_CONES_M)).round().astype(int)
    true_m = (drive.truth[seen, :3, :3] @ _CONES_M[:, :, None])[:, :, 0] + drive.truth[seen, :3, 3]
    poses: list[Pose] = [pairs[k].pose for k in seen]
    own = np.stack([se3.map_SE3_body(pose) for pose in poses])
    xyz_m = (own[:, :3, :3] @ _CONES_M[:, :, None])[:, :, 0] + own[:, :3, 3]
    off_m = xyz_m - true_m + rng.normal(0, _OWN_SIGMA_M, xyz_m.shape)
    jacobian = moved_by_poses(xyz_m, poses)
    cov = pose_cov(refined, PARAMS)
    constant, change = pose_parts(jacobian, [pairs[k].frame_index for k in seen], np.zeros((len(seen), 6)), cov)
    own_cov = change + _OWN_SIGMA_M**2 * np.eye(xyz_m.size)
    flat = jacobian.reshape(-1, 6)
    return off_m, own_cov + flat @ constant @ flat.T, consistency(off_m, own_cov, jacobian, constant)
