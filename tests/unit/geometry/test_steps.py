"""Steps that neighbouring speeds do not explain: driving is explained, jumps are not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry.motion.steps import unexplained_step_m

Floats = NDArray[np.float64]
TIMES_S = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 1.5, 1.6, 1.7, 1.8, 1.9])
GAP = 4
ERRORS_M = np.array([0.1, 0.15])


def unexplained_m(positions_m: Floats) -> float:
    steps_m = np.diff(positions_m, axis=0)
    speeds = steps_m / np.diff(TIMES_S)[:, None]
    speeds[GAP] = np.nan
    return unexplained_step_m(steps_m, speeds, TIMES_S, GAP, ERRORS_M)


@pytest.mark.parametrize("gap_s", [3.0, 4.5])
@pytest.mark.parametrize("before_s", np.arange(0.0, 2.0, 0.1).tolist())
def test_a_stop_within_a_long_gap_is_no_jump(gap_s: float, before_s: float) -> None:
    """Braking from 8 m/s at 2.5 m/s^2, and pulling away at once at the same rate."""
    times_s = np.concatenate([np.arange(6) * 0.1 - 0.5, gap_s + np.arange(6) * 0.1])
    rate, stop_s = 2.5, before_s + 8.0 / 2.5
    fine_s = np.arange(-1.0, 20.0, 0.001)
    speed = np.where(
        fine_s < stop_s, np.clip(rate * (stop_s - fine_s), 0, 8.0), np.clip(rate * (fine_s - stop_s), 0, 8.0)
    )
    along = np.interp(times_s, fine_s, np.cumsum(speed) * 0.001)
    steps_m = np.diff(np.column_stack([along, 0 * along, 0 * along]), axis=0)
    speeds = steps_m / np.diff(times_s)[:, None]
    speeds[5] = np.nan
    assert unexplained_step_m(steps_m, speeds, times_s, 5, np.array([0.3, 0.3])) == 0.0


@pytest.mark.parametrize("radius_m", [12.0, 50.0])
def test_a_bend_within_a_gap_is_no_jump(radius_m: float) -> None:
    speed = np.sqrt(4.0 * radius_m)
    angle = speed * TIMES_S / radius_m
    assert (
        unexplained_m(np.column_stack([radius_m * np.sin(angle), radius_m * np.cos(angle), 0.05 * speed * TIMES_S]))
        == 0.0
    )


@pytest.mark.parametrize(
    ("jump_m", "length_m"), [((0.0, 1.5, 0.0), 1.5), ((-3.0, 0.0, 0.0), 3.0), ((0.0, 0.0, 0.5), 0.5)]
)
def test_a_jump_across_a_gap_is_not_explained(jump_m: tuple[float, float, float], length_m: float) -> None:
    straight = np.outer(TIMES_S, [14.0, 0.0, 0.2])
    straight[GAP + 1 :] += jump_m
    assert unexplained_m(straight) == pytest.approx(length_m)


def test_one_neighbour_says_nothing() -> None:
    steps_m, speeds = np.full((9, 3), 100.0), np.full((9, 3), np.nan)
    speeds[3] = 1.0
    assert unexplained_step_m(steps_m, speeds, TIMES_S, GAP, ERRORS_M) == 0.0
    speeds[5] = 1.0
    assert unexplained_step_m(steps_m, speeds, TIMES_S, GAP, ERRORS_M) > 100.0
