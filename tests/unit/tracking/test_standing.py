"""Objects that move while they are observed are no tracks; those that stand are, also where all seem to move."""

from __future__ import annotations

import numpy as np
import pytest

from conetl.geometry import pose as se3
from conetl.model.drive import Drive, Track
from conetl.model.params import TrajectoryParams
from conetl.model.rejections import Rejection, RejectionReason
from conetl.tracking.error_propagation import pose_cov
from conetl.tracking.standing import without_moving
from conetl.tracking.trajectory import RefinedTrajectory, refine_trajectory
from tests.synthetic.odometry import log_of, motions_of
from tests.unit.tracking.test_variance_components import PATH, RIG, drawn

PARAMS = TrajectoryParams()


@pytest.fixture(scope="module")
def trajectory() -> RefinedTrajectory:
    truth, rng = np.stack([se3.map_SE3_body(pair.pose) for pair in PATH]), np.random.default_rng(3)
    return refine_trajectory(log_of(truth, rng, 0.02, 0.001, PARAMS), RIG, motions_of(truth, RIG, rng, PARAMS), PARAMS)


def standing(
    trajectory: RefinedTrajectory, seed: int, speeds_ms: dict[int, tuple[float, float]]
) -> tuple[list[Track], list[Rejection]]:
    """What is left of eight cones, of which some move."""
    speeds = np.zeros((8, 3))
    for number, speed in speeds_ms.items():
        speeds[number, :2] = speed
    matches, tracks = drawn(np.random.default_rng(seed), (1.0, 1.0, 1.0), speeds_ms=speeds)
    drive = Drive.model_construct(frame_pairs=trajectory.frame_pairs, rig=RIG)
    return without_moving(drive, matches, tracks, pose_cov(trajectory, PARAMS))


def test_cones_that_stand_are_kept(trajectory: RefinedTrajectory) -> None:
    for seed in range(12):
        assert [t.track_index for t in standing(trajectory, seed, {})[0]] == list(range(8))


@pytest.mark.parametrize("speed_ms", [(0.3, 0.0), (0.0, -0.3), (-0.8, 0.5), (1.5, 0.0)])
def test_a_cone_that_moves_is_rejected_with_its_speed(
    trajectory: RefinedTrajectory, speed_ms: tuple[float, float]
) -> None:
    tracks, [rejection] = standing(trajectory, 1, {3: speed_ms})
    assert len(tracks) == 7 and [t.track_index for t in tracks] == list(range(7))
    assert rejection.reason is RejectionReason.MOVING and rejection.payload["track_index"] == 3
    assert float(rejection.detail.split()[2]) == pytest.approx(np.hypot(*speed_ms), rel=0.1)


def test_what_all_tracks_have_in_common_is_the_vehicles(trajectory: RefinedTrajectory) -> None:
    """As with a baseline that is 2 % wrong; a cone that moves beside is found all the same."""
    drift = dict.fromkeys(range(8), (0.3, 0.0))
    assert len(standing(trajectory, 2, drift)[0]) == 8
    tracks, [rejection] = standing(trajectory, 2, drift | {5: (0.3, 0.7)})
    assert len(tracks) == 7 and rejection.payload["track_index"] == 5
