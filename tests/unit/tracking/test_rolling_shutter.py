"""What is not known of the shutters of a drive: priors of video, and their part of the sigmas."""

from __future__ import annotations

import numpy as np
import pytest

from conetl.geometry.motion.rolling_shutter import camera_rates, points_at_stamp, shutter_of, with_shutters
from conetl.geometry.motion.stereo_tracks import cameras_of
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Shutter
from conetl.pipeline.odometry import params_of_drive
from conetl.tracking.rolling_shutter import matches_at_stamp, row_time_sigma_s, with_video_prior
from tests import records
from tests.synthetic.world import drive_of, make_path, make_rig

PARAMS, RIG, PAIRS = TrajectoryParams(), make_rig(), make_path(6, step_m=1.5)
DRIVE = drive_of(PAIRS, RIG)


def test_only_video_that_states_no_shutter_has_a_prior() -> None:
    assert with_video_prior(DRIVE, PARAMS, is_video=False).rig == RIG
    assert with_video_prior(DRIVE, PARAMS.model_copy(update={"video_readout_sigma_ms": 0.0}), is_video=True).rig == RIG
    stated = Shutter(readout_ms=12.0, stamp_row="last")
    drive = drive_of(PAIRS, with_shutters(RIG, None, stated))
    found = with_video_prior(drive, PARAMS, is_video=True).rig
    assert shutter_of(found, "left") == Shutter(readout_ms=0.0, readout_sigma_ms=10.0)
    assert shutter_of(found, "right") == stated


def test_what_is_not_known_of_shutters_is_in_the_sigmas_of_clock_and_scale() -> None:
    unknown = params_of_drive(with_video_prior(DRIVE, PARAMS, is_video=True), PARAMS)
    assert unknown.clock_sigma_s == pytest.approx(np.hypot(0.001, 0.005))
    assert unknown.scale_sigma == pytest.approx(np.hypot(0.003, 0.4 * 0.01))
    assert params_of_drive(DRIVE, PARAMS) == PARAMS
    timed = DRIVE.model_copy(update={"clock_sigma_s": 0.02})
    assert params_of_drive(timed, PARAMS).clock_sigma_s == 0.02


def test_the_time_of_rows_is_that_of_near_feet() -> None:
    """Rows of near cones are low and make the positions: a far cone at the middle row counts little."""
    middle = (RIG.left.height_px - 1) / 2
    near, far = (
        match.model_copy(update={"foot_left_uv_px": (600.0, row), "foot_right_uv_px": (600.0 - disparity, row)})
        for match, row, disparity in zip(records.matches(2), (middle + 150, middle), (60.0, 15.0), strict=True)
    )
    rig = with_video_prior(DRIVE, PARAMS, is_video=True).rig
    alone = 0.01 * 150 / (RIG.left.height_px - 1)
    assert row_time_sigma_s([near], rig) == pytest.approx(alone)
    assert row_time_sigma_s([near, far], rig) == pytest.approx(alone, rel=0.01)
    assert row_time_sigma_s([], rig) == row_time_sigma_s([near], RIG) == 0.0


def test_matches_are_moved_to_the_time_stamp_by_their_own_frame_pair() -> None:
    found = records.matches(3)
    shutter = Shutter(readout_ms=10.0, stamp_row="first")
    rig = with_shutters(RIG, shutter, shutter)
    assert matches_at_stamp(found, PAIRS, RIG) == list(found)
    rate = camera_rates(PAIRS, rig)[1]
    for before, after in zip(found, matches_at_stamp(found, PAIRS, rig), strict=True):
        for point in ("foot", "centre", "tip"):
            names = [f"{point}_{side}_uv_px" for side in ("left", "right")]
            seen, moved = (np.concatenate([getattr(match, name) for name in names]) for match in (before, after))
            assert moved == pytest.approx(points_at_stamp(rig, cameras_of(rig), seen[None], rate)[0], abs=1e-6)
            assert np.abs(moved - seen).max() > 0.1
