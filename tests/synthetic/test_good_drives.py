"""Drives that are what they say they are: none is held, their positions and clocks are as good as stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from conetl.geometry import pose as se3
from conetl.geometry.pose import to_pose
from conetl.model.health import hold_reason
from conetl.tracking.trajectory import RefinementOutcome
from tests.cases import cases
from tests.synthetic.good_drives import checked, clock_of, draw_drive, failed


def test_good_drives_are_not_held() -> None:
    for seed in range(2):
        refined, checks = checked(draw_drive(np.random.default_rng(seed)))
        assert refined.outcome is RefinementOutcome.REFINED
        assert hold_reason(checks) is None


def test_a_part_of_a_drive_whose_images_cannot_be_followed_is_held() -> None:
    """The right camera is mirrored from there on, say."""
    drive = draw_drive(np.random.default_rng(14), lasts_s=10.0)
    first = len(drive.motions) * 6 // 10
    motions = [*drive.motions[:first], *map(failed, drive.motions[first:])]
    reason = hold_reason(checked(replace(drive, motions=motions))[1])
    assert reason is not None and f"from frame pair {drive.logged[first].frame_index} on, although" in reason


@pytest.mark.parametrize(
    ("roll_deg", "ahead_m", "found"),
    cases((3.0, 0.0, "rolled by -3."), (0.0, 0.0, None), release=[(0.0, 2.0, "mounted by -1.9")]),
)
def test_turns_show_a_wrong_mount_of_the_cameras(roll_deg: float, ahead_m: float, found: str | None) -> None:
    """Poses of a body that is rolled, or farther ahead, are not those of the body that the calibration means."""
    drive = draw_drive(np.random.default_rng(7), turns=True, lasts_s=25.0)
    off = se3.se3(se3.rotation_from_rpy(np.radians(roll_deg), 0.0, 0.0), (ahead_m, 0.0, 0.0))
    poses = se3.compose(np.stack([se3.map_SE3_body(pair.pose) for pair in drive.logged]), off)
    logged = [
        pair.model_copy(update={"pose": to_pose(pose, (*pair.pose.sigma_enu_m, *pair.pose.sigma_rpy_rad))})
        for pair, pose in zip(drive.logged, poses, strict=True)
    ]
    reason = hold_reason(checked(replace(drive, logged=logged))[1])
    assert reason is None if found is None else found in str(reason)


@pytest.mark.release
def test_motions_that_only_the_stated_heading_errors_turn_are_kept() -> None:
    """A heading that is off by half a degree, as stated, turns every measured motion to the side, by far more than its noise."""
    for seed in (135, 193):
        drive = draw_drive(np.random.default_rng(seed), turns=True)
        assert "0 rejected" in checked(drive)[0].detail


@pytest.mark.release
def test_the_sigma_of_the_clock_counts_noisy_attitudes_and_gaps() -> None:
    """Noise of the log makes its slopes steep: they must not count as turns that tell the offset."""
    z2 = []
    for seed in range(12):
        drive = draw_drive(np.random.default_rng(500 + seed), offset_s=0.03, turns=True, lasts_s=20.0, sigma_rad=0.003)
        found = clock_of(drive)
        if found is not None:
            z2.append(((found.offset_s - 0.03) / found.sigma_s) ** 2)
    assert len(z2) > 8
    assert chi2.ppf(0.001, len(z2)) < sum(z2) < chi2.ppf(0.999, len(z2))
