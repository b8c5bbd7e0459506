"""Laws of rigid motions, and the sign conventions that KITTI's files rely on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3

Array = NDArray[np.float64]
angles = st.floats(-math.pi, math.pi)
metres = st.floats(-1e3, 1e3)


@st.composite
def poses(draw: st.DrawFn) -> Array:
    rotation = se3.rotation_from_rpy(draw(angles), draw(angles), draw(angles))
    return se3.se3(rotation, [draw(metres) for _ in range(3)])


@given(poses())
def test_a_pose_and_its_inverse_compose_to_the_identity(a: Array) -> None:
    np.testing.assert_allclose(se3.compose(a, se3.invert(a)), np.eye(4), atol=1e-9)
    np.testing.assert_allclose(se3.invert(se3.invert(a)), a, atol=1e-9)


@given(poses(), poses(), poses())
def test_composition_is_associative_and_means_one_after_the_other(a: Array, b: Array, c: Array) -> None:
    np.testing.assert_allclose(se3.compose(se3.compose(a, b), c), se3.compose(a, se3.compose(b, c)), atol=1e-8)
    point = np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(se3.apply(se3.compose(a, b), point), se3.apply(a, se3.apply(b, point)), atol=1e-8)
    np.testing.assert_allclose(se3.invert(se3.compose(a, b)), se3.compose(se3.invert(b), se3.invert(a)), atol=1e-8)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_roll_pitch_yaw_are_scipys(roll: float, pitch: float, yaw: float) -> None:
    rotation = se3.rotation_from_rpy(roll, pitch, yaw)
    assert se3.is_rotation(rotation, 1e-12)
    # scipy's intrinsic "ZYX" is the same convention, written by somebody else.
    np.testing.assert_allclose(rotation, Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), atol=1e-12)


def test_stacks_broadcast() -> None:
    rng = np.random.default_rng(1)
    stack = se3.se3(se3.rotation_from_rpy(*rng.uniform(-1, 1, (3, 5))), rng.normal(size=(5, 3)))
    points = rng.normal(size=(4, 5, 3))
    moved = se3.apply(stack, points)
    assert moved.shape == (4, 5, 3)
    for i in range(5):
        np.testing.assert_allclose(moved[:, i], points[:, i] @ stack[i, :3, :3].T + stack[i, :3, 3], atol=1e-12)
    np.testing.assert_allclose(se3.invert(stack) @ stack, np.tile(np.eye(4), (5, 1, 1)), atol=1e-12)


@given(poses(), poses(), st.floats(0, 1))
def test_interpolation_starts_at_a_ends_at_b_and_stays_rigid(a: Array, b: Array, weight: float) -> None:
    np.testing.assert_allclose(se3.interpolate(a, b, 0.0), a, atol=1e-9)
    np.testing.assert_allclose(se3.interpolate(a, b, 1.0), b, atol=1e-6)
    assert se3.is_rotation(se3.interpolate(a, b, weight)[:3, :3], 1e-9)


def test_interpolating_across_west_takes_the_short_way() -> None:
    a = se3.se3(se3.rotation_from_rpy(0, 0, math.radians(179)), np.zeros(3))
    b = se3.se3(se3.rotation_from_rpy(0, 0, math.radians(-179)), np.array([2.0, 0, 0]))
    middle = se3.interpolate(a, b, 0.5)
    np.testing.assert_allclose(middle[:2, 0], [-1, 0], atol=1e-9)
    np.testing.assert_allclose(middle[:3, 3], [1, 0, 0])


def test_a_matrix_that_is_no_rotation_is_refused() -> None:
    for matrix in (np.diag([1.0, 1.0, -1.0]), 1.01 * np.eye(3), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="not a rotation"):
            se3.nearest_rotation(matrix)
    rounded = np.round(se3.rotation_from_rpy(0.1, 0.2, 0.3), 5)
    assert se3.is_rotation(se3.nearest_rotation(rounded), 1e-14)
