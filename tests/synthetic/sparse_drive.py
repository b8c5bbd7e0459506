"""Good drives whose trajectory is a receiver's alone: seldom, without attitude, by another clock; longer than the images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.model.drive import FramePair
from conetl.readers.drives.poses import Samples
from conetl.readers.drives.sparse_poses import pose_reader
from conetl.tracking.clock_search import ImageClock, find_clock_offset, rates_of
from tests.synthetic.good_drives import PARAMS, RIG, Path
from tests.synthetic.odometry import STEP_S, motions_of
from tests.synthetic.world import START_NS

Floats = NDArray[np.float64]
BEFORE_S = 40.0
SIGMA_RAD = 0.003 * np.array([1.0, 1.0, 3.0])


@dataclass(frozen=True)
class Recording:
    """Images and trajectory, each by its own clock."""

    truth: Floats
    """(K, 4, 4) body -> map at the images."""
    image_ns: list[int]
    motions: list[RelativeMotion]
    track: Samples
    has_attitude: bool

    def offset(self) -> ImageClock | None:
        """Of the clocks, as turns and speeds show it."""
        poses = self.track.map_SE3_body
        return find_clock_offset(
            rates_of(self.motions, dict(enumerate(self.image_ns)), RIG), self.image_ns[0], self.track.times_ns,
            poses[:, :3, 3], poses[:, :3, :3] if self.has_attitude else None, self.track.sigma[:, :3],
        )  # fmt: skip

    def frame_pairs(self, offset_s: float, every: int = 1) -> list[FramePair]:
        """With the poses of the trajectory, given the offset of the clocks."""
        exposures = [t + round(offset_s * 1e9) for t in self.image_ns]
        pose_at = pose_reader(self.track, exposures, from_course=not self.has_attitude)
        return [
            FramePair(frame_index=k, left_path="", right_path="", captured_at_ns=t, pose=pose_at(exposure))
            for k, (t, exposure) in enumerate(zip(self.image_ns, exposures, strict=True))
        ][::every]


def record(
    seed: int,
    *,
    offset_s: float = 0.0,
    rate_hz: float = 1.0,
    sigma_m: float = 0.02,
    has_attitude: bool = False,
    seconds: float = 30.0,
    path_seed: int | None = None,
    straight: bool = False,
) -> Recording:
    """A drive of so many seconds; the trajectory begins 40 s before and ends 40 s after it.

    path_seed: of another drive, whose the trajectory is. straight: at constant speed.
    """
    rng = np.random.default_rng(seed)
    path = Path(rng, seconds + 2 * BEFORE_S, turns=True)

    def poses_at(times_s: Floats, of: Path) -> Floats:
        if straight:
            return se3.se3(np.eye(3), times_s[:, None] * np.array([9.0, 0.0, 0.0]))
        return of.poses_at(times_s)

    images_s = np.arange(round(seconds / STEP_S)) * STEP_S
    truth = poses_at(images_s + BEFORE_S, path)
    motions = motions_of(truth, RIG, rng, PARAMS)
    times_s = np.arange(0.0, seconds + 2 * BEFORE_S - 0.5, 1 / rate_hz)
    recorded = path if path_seed is None else Path(np.random.default_rng(path_seed), seconds + 2 * BEFORE_S, turns=True)
    poses = poses_at(times_s, recorded)
    lasts_s = np.repeat([PARAMS.gnss_correlation_s, PARAMS.attitude_correlation_s], 3)
    share = np.repeat([PARAMS.gnss_white_share, PARAMS.attitude_white_share], 3)
    sigma = np.concatenate([sigma_m * np.array([1.0, 1.0, 1.5]), SIGMA_RAD])
    slow, keep = rng.normal(0, 1, (len(times_s), 6)), np.exp(-1 / rate_hz / lasts_s)
    for k in range(1, len(times_s)):
        slow[k] = keep * slow[k - 1] + np.sqrt(1 - keep**2) * slow[k]
    error = sigma * (np.sqrt(1 - share**2) * slow + share * rng.normal(0, 1, slow.shape))
    rotations = poses[:, :3, :3] @ Rotation.from_rotvec(error[:, 3:]).as_matrix() if has_attitude else np.eye(3)
    stamps = (START_NS + np.round((times_s - BEFORE_S + offset_s) * 1e9)).astype(np.int64)
    samples = Samples(
        "gnss.csv", stamps.tolist(), se3.se3(rotations, poses[:, :3, 3] + error[:, :3]), np.tile(sigma, (len(times_s), 1)), {}
    )  # fmt: skip
    image_ns = [START_NS + round(t * 1e9) for t in images_s]
    return Recording(truth, image_ns, motions, samples, has_attitude)


def offset_bound_s(drive: Recording, offset_s: float) -> float:
    """Cramer-Rao bound of the offset of the clocks: the sigma (s) of the best unbiased estimator in the plane.

    offset_s: the true one. Measured are the records while there are images, whose errors are those of `record`; beside the offset
    a common shift, turn and scale are unknown, where there is attitude the boresight too. The drawn path and how visual odometry
    errs along it are known.
    """
    image_s = np.array(drive.image_ns) * 1e-9 - START_NS * 1e-9
    record_s = np.array(drive.track.times_ns) * 1e-9 - START_NS * 1e-9 - offset_s
    at_s = record_s[(record_s >= image_s[0]) & (record_s <= image_s[-1])]
    yaw = np.unwrap(np.arctan2(drive.truth[:, 1, 0], drive.truth[:, 0, 0]))
    way = CubicSpline(image_s, np.column_stack([drive.truth[:, :2, 3], yaw]))
    at, rate, count = way(at_s), way(at_s, 1), len(at_s)
    apart = at[:, :2] - at[:, :2].mean(axis=0)
    # Rows: east, north and yaw of every record; columns: offset, shift, turn, scale, boresight.
    by = np.zeros((3, count, 6))
    by[..., 0] = rate.T
    by[0, :, 1] = by[1, :, 2] = by[2, :, 5] = by[2, :, 3] = 1.0
    by[:2, :, 3], by[:2, :, 4] = np.stack([-apart[:, 1], apart[:, 0]]), apart.T
    sigma = np.array([drive.track.sigma[0, 0], drive.track.sigma[0, 1], drive.track.sigma[0, 5]])
    lasts_s = np.array([PARAMS.gnss_correlation_s] * 2 + [PARAMS.attitude_correlation_s])
    white = np.array([PARAMS.gnss_white_share] * 2 + [PARAMS.attitude_white_share]) ** 2
    cov = np.zeros((3, count, 3, count))
    for k in range(3):
        alike = np.exp(-np.abs(at_s[:, None] - at_s) / lasts_s[k])
        cov[k, :, k] = sigma[k] ** 2 * ((1 - white[k]) * alike + white[k] * np.eye(count))
    # Every interval of the odometry turns and shifts all that follows.
    before, after = drive.truth[:-1, :2, 3], at_s[:, None] >= image_s[1:] - 1e-9
    turn = np.hypot(5e-5, PARAMS.floor_rad)
    steps = np.linalg.norm(np.diff(drive.truth[:, :2, 3], axis=0), axis=1)
    shift = np.sqrt(0.002**2 + PARAMS.floor_m**2 + (PARAMS.floor_relative * steps) ** 2)
    turned = np.stack([before[:, 1] - at[:, None, 1], at[:, None, 0] - before[:, 0], np.ones(after.shape)])
    errors = np.zeros((3, count, 3, len(steps)))
    errors[:, :, 2] = turn * turned * after
    errors[0, :, 0] = errors[1, :, 1] = shift * after
    rows = 3 if drive.has_attitude else 2
    jacobian, noise = by[:rows].reshape(-1, 6), errors[:rows].reshape(rows * count, -1)
    total = cov[:rows, :, :rows].reshape(rows * count, rows * count) + noise @ noise.T
    prior = np.diag([0.0, 0.0, 0.0, 0.0, PARAMS.scale_sigma**-2, 0.03**-2])
    information = jacobian.T @ np.linalg.solve(total, jacobian) + prior
    return float(np.linalg.inv(information)[0, 0] ** 0.5)
