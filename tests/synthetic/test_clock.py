"""The offset of the clocks on simulated drives with turns: found, with an honest sigma."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from conetl.geometry import pose as se3
from conetl.model.params import TrajectoryParams
from conetl.tracking.clock import ClockOffset, estimate_clock
from conetl.tracking.trajectory import measured_motions, read_log
from tests.cases import cases
from tests.synthetic.odometry import STEP_S, log_of, motions_of
from tests.synthetic.world import ORIGIN_M, make_rig

PARAMS, RIG = TrajectoryParams(), make_rig()
FRAMES, FINE_S = 150, 0.002


def poses_at(times_s: NDArray[np.float64], rng: np.random.Generator, *, straight: bool) -> NDArray[np.float64]:
    """(K, 4, 4) of a car that turns and brakes by chance, or goes straight at constant speed."""
    fine_s = np.arange(times_s[0] - 1.0, times_s[-1] + 1.0, FINE_S)
    phases = rng.uniform(0, 2 * np.pi, (2, 3))
    rates = np.array([0.05, 0.15, 0.4]) * 2 * np.pi
    waves = 0.0 if straight else np.array([0.15, 0.08, 0.02]) @ np.sin(rates[:, None] * fine_s + phases[0][:, None])
    speed = 9.0 + (
        0.0 if straight else np.array([1.5, 0.7, 0.2]) @ np.sin(rates[:, None] * fine_s + phases[1][:, None])
    )
    yaw = 0.4 + waves + np.zeros_like(fine_s)
    steps = np.stack([np.cos(yaw) * speed, np.sin(yaw) * speed, np.zeros_like(yaw)], axis=1) * FINE_S
    places = np.cumsum(steps, axis=0)
    at = np.stack([np.interp(times_s, fine_s, column) for column in (*places.T, yaw)], axis=1)
    return se3.se3(se3.rotation_from_rpy(0 * times_s, 0 * times_s, at[:, 3]), at[:, :3] + ORIGIN_M)


def estimated(seed: int, offset_s: float, sigma_m: float, *, straight: bool = False) -> ClockOffset | None:
    times_s = np.arange(FRAMES) * STEP_S
    truth, stamped = (
        poses_at(times_s + lag, np.random.default_rng(seed), straight=straight) for lag in (0.0, offset_s)
    )
    rng = np.random.default_rng(1000 + seed)
    log, motions = log_of(stamped, rng, sigma_m, 0.0009, PARAMS), motions_of(truth, RIG, rng, PARAMS)
    return estimate_clock(log, read_log(log, RIG, PARAMS), measured_motions(log, motions, PARAMS))


@pytest.mark.parametrize("sigma_m", cases(0.4, release=[0.02]))
def test_an_offset_is_found_with_an_honest_sigma(sigma_m: float) -> None:
    offsets = np.random.default_rng(7).uniform(-0.2, 0.2, 16)
    found = [estimated(seed, float(offset), sigma_m) for seed, offset in enumerate(offsets)]
    assert None not in found
    errors_s = np.array([each.offset_s for each in found if each]) - offsets
    assert np.abs(errors_s).max() < 0.005
    nees = float(((errors_s / np.array([each.sigma_s for each in found if each])) ** 2).sum())
    assert chi2.ppf(0.001, 16) < nees < chi2.ppf(0.999, 16)


def test_a_straight_drive_does_not_show_it() -> None:
    found = [estimated(seed, 0.1, 0.02, straight=True) for seed in range(5)]
    assert found == [None] * 5
