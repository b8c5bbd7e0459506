"""Good drives whose trajectory is a receiver's alone: seldom, without attitude, by another clock; longer than the images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
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
