"""Positions, course and their sigmas between sparse positions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry.motion.position_spline import PositionSpline, course_attitude, position_spline, states_at

Floats = NDArray[np.float64]


def spline(times_s: Floats, positions_m: Floats, sigma_m: float = 0.02) -> PositionSpline:
    sigma = np.full((len(times_s), 3), sigma_m)
    return position_spline(times_s, positions_m, sigma, white_share=0.1, correlation_s=20.0)


def bend(times_s: Floats, speed_m_s: float = 8.0, turn_rad_s: float = 0.4) -> tuple[Floats, Floats]:
    """Positions (N, 3) and yaw (N,) of a car that goes straight for 8 s and then round a bend of a quarter."""
    yaw = np.clip(times_s - 8.0, 0.0, np.pi / 2 / turn_rad_s) * turn_rad_s
    fine_s = np.arange(0.0, times_s[-1] + 0.01, 0.01)
    fine_yaw = np.clip(fine_s - 8.0, 0.0, np.pi / 2 / turn_rad_s) * turn_rad_s
    places = np.cumsum(np.stack([np.cos(fine_yaw), np.sin(fine_yaw), 0 * fine_s], axis=1) * speed_m_s * 0.01, axis=0)
    return np.stack([np.interp(times_s, fine_s, column) for column in places.T], axis=1), yaw


def yaw_of(rotations: Floats) -> Floats:
    return np.asarray(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))


def test_a_bend_at_1_hz_is_covered_by_the_sigmas() -> None:
    """A straight line between the records would cut the bend by 0.4 m."""
    times_s, between_s = np.arange(0.0, 21.0), np.arange(1.0, 19.0, 0.1)
    found = spline(times_s, bend(times_s)[0])
    truth, yaw = bend(between_s)
    moved = states_at(found, between_s)
    off = np.abs(moved.positions_m - truth)
    assert (off < 3 * moved.sigma_m).all()
    assert off.max() < 0.1
    rotations, sigma, short = course_attitude(found, between_s)
    turned = np.abs(np.angle(np.exp(1j * (yaw_of(rotations) - yaw))))
    assert (turned < 3 * sigma[:, 2]).all()
    assert (short <= sigma).all()


def test_the_sigma_grows_between_the_records_and_with_their_distance() -> None:
    middle = []
    for step_s in (0.5, 1.0, 2.0):
        times_s = np.arange(0.0, 20.1, step_s)
        found = spline(times_s, bend(times_s)[0])
        at_record, between = (states_at(found, [t]).sigma_m[0, 0] for t in (10.0, 10.0 + step_s / 2))
        assert between > 1.5 * at_record
        middle.append(between)
    assert middle[0] < middle[1] < middle[2]


def test_a_standing_vehicle_keeps_its_heading() -> None:
    times_s = np.arange(0.0, 60.0)
    driven_m = 8.0 * np.minimum(times_s, 20.0) + 8.0 * np.maximum(times_s - 40.0, 0.0)
    found = spline(times_s, np.stack([0.6 * driven_m, 0.8 * driven_m, 0 * driven_m], axis=1), 0.4)
    rotations, sigma, _ = course_attitude(found, np.arange(5.0, 55.0, 0.5))
    assert np.abs(yaw_of(rotations) - np.arctan2(0.8, 0.6)).max() < np.radians(3.0)
    assert sigma[50, 2] > sigma[10, 2]  # standing at 30 s, driving at 10 s


def test_a_heading_at_a_stop_is_covered_although_each_record_errs_by_itself() -> None:
    """Errors that were taken for slow ones turned the course of a standing vehicle by 130 degrees at 20 stated ones."""
    times_s, between_s = np.arange(0.0, 40.0), np.arange(2.0, 38.0, 0.5)
    left_s = np.clip(times_s - 24.0, 0.0, None)
    driven_m = np.interp(times_s, [0, 10, 16, 24], [0, 80, 104, 104]) + np.minimum(left_s, 6.0) ** 2 / 2
    driven_m += 6.0 * np.maximum(left_s - 6.0, 0.0)
    worst, squares = [], []
    for seed in range(40):
        off_m = np.random.default_rng(seed).normal(0, 0.3, (len(times_s), 3))
        found = spline(times_s, np.outer(driven_m, [0.6, 0.8, 0.0]) + off_m, 0.3)
        rotations, sigma, _ = course_attitude(found, between_s)
        off = np.angle(np.exp(1j * (yaw_of(rotations) - np.arctan2(0.8, 0.6)))) / sigma[:, 2]
        worst.append(np.abs(off).max())
        squares.append(np.mean(off**2))
    assert max(worst) < 4.0
    assert 0.05 < np.mean(squares) < 1.2


def test_pitch_is_the_grade() -> None:
    times_s = np.arange(0.0, 20.0)
    found = spline(times_s, np.stack([10 * times_s, 0 * times_s, -0.5 * times_s], axis=1))
    rotations, _, _ = course_attitude(found, [10.0])
    np.testing.assert_allclose(rotations[0], se3.rotation_from_rpy(0.0, np.arctan(0.05), 0.0), atol=1e-3)


@pytest.mark.parametrize(
    ("times_s", "positions_m"),
    [
        (np.arange(2.0), np.zeros((2, 3))),
        (np.zeros(0), np.zeros((0, 3))),
        (np.array([0.0, 0.05, 0.1]), np.zeros((3, 3))),
        (np.array([0.0, 1.0, 1.0, 2.0]), np.zeros((4, 3))),
        (np.arange(4.0), np.full((4, 3), np.nan)),
    ],
)
def test_positions_that_cannot_be_smoothed_are_refused(times_s: Floats, positions_m: Floats) -> None:
    with pytest.raises(ValueError, match="expected"):
        spline(times_s, positions_m)


def test_instants_beyond_the_records_are_refused() -> None:
    found = spline(np.arange(4.0), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="between the first and the last"):
        states_at(found, [3.5])


@settings(max_examples=20, deadline=None)
@given(
    steps=st.lists(st.floats(0.2, 3.0), min_size=4, max_size=12),
    seed=st.integers(0, 1000),
    turn_rad=st.sampled_from([np.pi / 2, np.pi, -np.pi / 2]),
    shift_m=st.floats(-1e6, 1e6),
)
def test_a_turned_and_shifted_path_turns_and_shifts_the_result(
    steps: list[float], seed: int, turn_rad: float, shift_m: float
) -> None:
    times_s = np.cumsum([0.0, *steps])
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal([8.0, 0.0, 0.0], 1.0, (len(times_s), 3)), axis=0)
    turn = se3.rotation_from_rpy(0.0, 0.0, turn_rad)
    between_s = np.linspace(times_s[0], times_s[-1], 20)
    one, other = spline(times_s, path), spline(times_s, path @ turn.T + shift_m)
    np.testing.assert_allclose(
        states_at(one, between_s).positions_m @ turn.T + shift_m, states_at(other, between_s).positions_m, atol=1e-6
    )
    np.testing.assert_allclose(
        turn @ course_attitude(one, between_s)[0], course_attitude(other, between_s)[0], atol=1e-6
    )
