"""Sigmas of covariances."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from conetl.geometry.packing import cov3, horizontal_sigma_m


@given(st.floats(0.001, 5.0), st.floats(0.0, 1.0), st.floats(0.0, np.pi))
def test_the_horizontal_sigma_is_that_of_the_worst_direction(worst_m: float, share: float, angle_rad: float) -> None:
    turn = np.array([[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]])
    cov = np.diag([0.0, 0.0, 9.0])
    cov[:2, :2] = turn @ np.diag([worst_m**2, (share * worst_m) ** 2]) @ turn.T
    assert np.isclose(horizontal_sigma_m(cov3(cov)), worst_m)
