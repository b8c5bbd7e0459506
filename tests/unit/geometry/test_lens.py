"""Lens models against OpenCV, their inverse and their derivatives."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.geometry.lens import distort, distort_jacobian, field_radius, undistort
from conetl.model.rig import Lens

LENSES = (
    Lens(),
    Lens(model="radial", coefficients=(-0.28, 0.07)),
    Lens(model="radial", coefficients=(0.2, 0.05)),
    Lens(model="brown", coefficients=(-0.35, 0.15, 1.2e-3, -0.8e-3, -0.03)),
    Lens(model="brown", coefficients=(-0.3728, 0.2037, 0.002219, 0.001383, -0.07233)),
    Lens(model="rational", coefficients=(1.5, 0.4, 4e-4, -3e-4, 0.02, 1.9, 0.8, 0.1)),
    Lens(model="fisheye", coefficients=(0.02, -0.01, 0.004, -0.0008)),
    Lens(model="fisheye", coefficients=(-0.05, 0.01, 0.0, 0.0)),
)
WITH_LENS = LENSES[1:]


def grid(radius: float, count: int = 15) -> np.ndarray:
    axis = np.linspace(-radius, radius, count)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return points[np.hypot(points[:, 0], points[:, 1]) <= radius]


def name(lens: Lens) -> str:
    return lens.model


@pytest.mark.parametrize("lens", LENSES, ids=name)
def test_distortion_is_that_of_opencv(lens: Lens) -> None:
    xy = grid(0.8)
    points = np.column_stack([xy, np.ones(len(xy))])[:, None, :]
    zero, k = np.zeros(3), np.array(lens.coefficients, dtype=float)
    if lens.model == "fisheye":
        theirs, _ = cv2.fisheye.projectPoints(points, zero, zero, np.eye(3), k)
    else:
        d = None if lens.model == "none" else np.concatenate([k, np.zeros(max(0, 4 - len(k)))])
        theirs, _ = cv2.projectPoints(points, zero, zero, np.eye(3), d)
    np.testing.assert_allclose(distort(lens, xy), theirs.reshape(-1, 2), atol=1e-14)


@pytest.mark.parametrize("lens", LENSES, ids=name)
def test_jacobians_are_the_differences(lens: Lens) -> None:
    xy = grid(0.8)
    by_xy, by_k = distort_jacobian(lens, xy)
    assert by_xy.shape == (len(xy), 2, 2) and by_k.shape == (len(xy), 2, len(lens.coefficients))
    h = 1e-6
    for i in range(2):
        step = h * np.eye(2)[i]
        difference = (distort(lens, xy + step) - distort(lens, xy - step)) / (2 * h)
        np.testing.assert_allclose(by_xy[:, :, i], difference, atol=2e-9)
    for i in range(len(lens.coefficients)):
        step = h * np.eye(len(lens.coefficients))[i]
        more, less = (Lens(model=lens.model, coefficients=tuple(lens.coefficients + s * step)) for s in (1, -1))
        np.testing.assert_allclose(by_k[:, :, i], (distort(more, xy) - distort(less, xy)) / (2 * h), atol=2e-9)


coordinate = st.floats(-1.0, 1.0)


@settings(max_examples=200, deadline=None)
@given(
    k=st.tuples(
        st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-0.005, 0.005), st.floats(-0.005, 0.005),
        st.floats(-0.1, 0.1), st.floats(-0.2, 0.6), st.floats(-0.1, 0.3), st.floats(-0.05, 0.05),
    ),
    model=st.sampled_from(["radial", "brown", "rational"]),
    xy=st.tuples(coordinate, coordinate),
)  # fmt: skip
def test_undistort_is_the_inverse_inside_the_field(k: tuple[float, ...], model: str, xy: tuple[float, float]) -> None:
    lens = Lens(model=model, coefficients=k[: {"radial": 2, "brown": 5, "rational": 8}[model]])
    point = np.array(xy)
    limit = 0.9 * field_radius(lens)
    if np.isfinite(limit):
        point = point * min(1.0, limit / max(float(np.hypot(*point)), 1e-9))
    by_xy, _ = distort_jacobian(lens, point)
    if np.linalg.det(by_xy) < 0.05:  # next to a fold, which decentring moves
        return
    back = undistort(lens, distort(lens, point))
    np.testing.assert_allclose(back, point, atol=1e-10)


@settings(max_examples=100, deadline=None)
@given(
    k=st.tuples(*[st.floats(-0.02, 0.02)] * 4),
    theta=st.floats(0.0, 1.5),
    azimuth=st.floats(0.0, 6.28),
)
def test_fisheye_round_trip_up_to_86_degrees(k: tuple[float, ...], theta: float, azimuth: float) -> None:
    lens = Lens(model="fisheye", coefficients=k)
    limit = np.arctan(field_radius(lens))
    theta = min(theta, 0.95 * limit)
    point = np.tan(theta) * np.array([np.cos(azimuth), np.sin(azimuth)])
    back = undistort(lens, distort(lens, point))
    np.testing.assert_allclose(back, point, rtol=1e-9, atol=1e-14)


def test_field_ends_where_the_barrel_turns_back() -> None:
    lens = Lens(model="radial", coefficients=(-0.3, 0.0))
    edge = np.sqrt(1 / 0.9)  # 1 - 0.9 r^2 = 0
    assert field_radius(lens) == pytest.approx(edge)
    widest = edge * (1 - 0.3 * edge**2)
    inside, outside = undistort(lens, [[0.999 * widest, 0.0], [1.001 * widest, 0.0]])
    assert inside[0] < edge and distort(lens, inside)[0] == pytest.approx(0.999 * widest, abs=1e-12)
    assert np.isnan(outside).all()
    assert field_radius(Lens(model="radial", coefficients=(0.2, 0.05))) == float("inf")
    assert field_radius(Lens(model="rational", coefficients=(0, 0, 0, 0, 0, -1.0, 0, 0))) == pytest.approx(1.0)


def test_fisheye_beyond_90_degrees_and_bad_numbers_have_no_answer() -> None:
    lens = Lens(model="fisheye", coefficients=(0.0, 0.0, 0.0, 0.0))
    assert np.isnan(undistort(lens, [1.6, 0.0])).all()
    for any_lens in WITH_LENS:
        assert np.isnan(undistort(any_lens, [np.nan, 0.0])).all()
