"""Rolling shutters at 15 m/s: stated ones cost nothing, unknown ones are estimated and in the sigmas."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from conetl.checks.verdict import judge
from conetl.geometry.motion.rolling_shutter import with_shutters
from conetl.model.health import Verdict
from conetl.model.rig import Shutter
from conetl.tracking.checks.poses import check_readout
from tests.cases import cases
from tests.synthetic.rolling_drive import PARAMS, Analysed, Readout, analysed
from tests.synthetic.world import make_rig

SEEDS, LOW_NOISE = (100,), 0.1
OF_VIDEO = Shutter(readout_ms=0.0, readout_sigma_ms=10.0)


def median_m(drives: Sequence[Analysed]) -> float:
    return float(np.median(np.concatenate([np.linalg.norm(drive.error_m[:, :2], axis=1) for drive in drives])))


@pytest.fixture(scope="module")
def without() -> list[Analysed]:
    """Of global shutters, with hardly any noise in the images: the errors are those of the log."""
    return [analysed(seed, Readout(0.0, 0.0), None, noise=LOW_NOISE) for seed in SEEDS]


@pytest.mark.parametrize(("left_ms", "right_ms"), cases((20.0, 22.0), release=[(10.0, 10.0)]))
def test_a_stated_readout_costs_no_accuracy(left_ms: float, right_ms: float, without: list[Analysed]) -> None:
    """Nor does a difference between both cameras, which displaces the right one."""
    left, right = (Shutter(readout_ms=ms, stamp_row="first") for ms in (left_ms, right_ms))
    shutter = Readout(left_ms * 1e-3, right_ms * 1e-3)
    drives = [analysed(seed, shutter, left, right=right, noise=LOW_NOISE) for seed in SEEDS]
    assert median_m(drives) < 1.2 * median_m(without)
    assert all(drive.calibration.readout_ms is None for drive in drives)


@pytest.mark.parametrize(
    ("readout_s", "stamp_share"), cases((0.01, 0.5), release=[(0.0, 0.0), (0.01, 0.0), (0.02, 0.0)])
)
def test_a_readout_that_is_not_stated_is_estimated(readout_s: float, stamp_share: float) -> None:
    drives = [analysed(seed, Readout(readout_s, readout_s, stamp_share), OF_VIDEO) for seed in SEEDS]
    for drive in drives:
        assert drive.rig.left.shutter is not None
        found = drive.rig.left.shutter
        assert found.readout_sigma_ms < 5.0
        assert abs(found.readout_ms - 1e3 * readout_s) < 2 * found.readout_sigma_ms
        assert "rolling shutter" in drive.calibration.detail
    assert np.concatenate([drive.chi2 for drive in drives]).mean() / 3 < 1.5


@pytest.mark.parametrize(("true_ms", "stated_ms"), cases((0.0, 10.0), release=[(10.0, 0.0), (20.0, 0.0)]))
def test_a_wrong_statement_is_reported_and_not_used(true_ms: float, stated_ms: float) -> None:
    """10 ms are 0.15 m along the road."""
    stated, true_s = Shutter(readout_ms=stated_ms, stamp_row="first"), true_ms * 1e-3
    drives = [analysed(seed, Readout(true_s, true_s), stated) for seed in SEEDS]
    for drive in drives:
        [finding] = check_readout(drive.calibration, with_shutters(drive.rig, stated, stated), PARAMS.trajectory)
        check = judge(finding)
        assert check.verdict is Verdict.CORRECTED and f"not within the {stated_ms:g} ms" in check.detail
        assert check.value == pytest.approx(true_ms - stated_ms, abs=3 * (check.sigma or 0.0))
    assert median_m(drives) < 0.08
    assert np.concatenate([drive.chi2 for drive in drives]).mean() / 3 < 1.5


@pytest.mark.parametrize("readout_ms", cases(10.0, release=[0.0]))
def test_a_correct_statement_is_used(readout_ms: float) -> None:
    stated = Shutter(readout_ms=readout_ms, stamp_row="first")
    for seed in SEEDS:
        calibration = analysed(seed, Readout(readout_ms * 1e-3, readout_ms * 1e-3), stated).calibration
        [finding] = check_readout(calibration, with_shutters(make_rig(), stated, stated), PARAMS.trajectory)
        assert judge(finding).verdict is Verdict.PASS and calibration.readout_ms is None
