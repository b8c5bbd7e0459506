"""Image points of a rolling shutter and of a global one: exact for constant rates, the identity without a readout."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from conetl.geometry import pose as se3
from conetl.geometry.calibration.covariance import calibration_id
from conetl.geometry.motion.rolling_shutter import (
    as_exposed,
    camera_rates,
    carried,
    middle_row_s,
    points_at_stamp,
    rate_of,
    right_rates,
    row_shares,
    stamp_sigma_s,
    with_shutters,
)
from conetl.geometry.motion.stereo_tracks import cameras_of
from conetl.geometry.rectification import raw_from_rectified, rectify
from conetl.geometry.rig import left_SE3_right
from conetl.geometry.small_arrays import cross_matrix
from conetl.model.rig import Camera, Lens, Rig, Shutter
from tests.synthetic.world import calibrated, make_path, make_rig

Floats = NDArray[np.float64]
RIG = make_rig()
RATE = np.array([0.02, -0.3, 0.05, 1.0, -0.4, -15.0])


def motion_in(rate: Floats, time_s: float) -> Floats:
    """(4, 4) by the matrix exponential, independent of the code under test."""
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = cross_matrix(rate[:3]), rate[3:]
    return np.asarray(expm(time_s * twist))


def exposed_by(camera: Camera, own: Floats, point_m: Floats, rate: Floats) -> Floats:
    """(2,) image point by the pose of its own row, which is found by bisection. own: (4, 4) from the left camera's frame."""
    shutter = camera.shutter or Shutter(readout_ms=0.0)
    share = {"first": 0.0, "middle": 0.5, "last": 1.0, None: 0.5}[shutter.stamp_row]

    def at(row: float) -> Floats:
        time_s = shutter.readout_ms * 1e-3 * (row / (camera.height_px - 1) - share)
        x, y, z = (own @ motion_in(rate, time_s) @ np.append(point_m, 1.0))[:3]
        return np.array([camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px])

    low, high = -2000.0, 3000.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if at(middle)[1] > middle else (low, middle)
    return at((low + high) / 2)


def exposed(rig: Rig, points_m: Floats, rate: Floats) -> Floats:
    """(N, 4) image points."""
    both = ((rig.left, np.eye(4)), (rig.right, se3.invert(left_SE3_right(rig))))
    return np.array([np.concatenate([exposed_by(*one, point, rate) for one in both]) for point in points_m])


POINTS_M = np.array([[-3.0, 1.6, 5.0], [2.0, 1.5, 9.0], [0.5, -3.0, 20.0], [8.0, 0.3, 40.0]])
STILL_PX = exposed(RIG, POINTS_M, np.zeros(6))


@pytest.mark.parametrize(
    ("left_ms", "right_ms"), [(10.0, 10.0), (20.0, 20.0), (10.0, 12.0), (-15.0, -15.0), (0.0, 5.0)]
)
@pytest.mark.parametrize("row", ["first", "middle", "last"])
def test_constant_rates_are_exact(left_ms: float, right_ms: float, row: str) -> None:
    left, right = (Shutter(readout_ms=ms, stamp_row=row) for ms in (left_ms, right_ms))
    rig = with_shutters(RIG, left, right)
    seen = exposed(rig, POINTS_M, RATE)
    assert np.abs(seen - STILL_PX).max() > 0.5
    assert points_at_stamp(rig, cameras_of(rig), seen, RATE) == pytest.approx(STILL_PX, abs=1e-4)


@given(
    st.floats(-30, 30), st.lists(st.floats(-0.6, 0.6), min_size=3, max_size=3),
    st.lists(st.floats(-25, 25), min_size=3, max_size=3),
)  # fmt: skip
def test_as_exposed_is_the_inverse(readout_ms: float, turn: list[float], shift: list[float]) -> None:
    rate = np.array([*turn, *shift]) * [1, 1, 1, 0.1, 0.1, 1]
    shutter = Shutter(readout_ms=readout_ms, stamp_row="first")
    rig, seen = with_shutters(RIG, shutter, shutter), []
    right = se3.invert(left_SE3_right(rig))
    for side, camera, points in (
        ("left", rig.left, POINTS_M), ("right", rig.right, se3.apply(right, POINTS_M))
    ):  # fmt: skip
        own = np.tile(rate, (len(points), 1)) if side == "left" else right_rates(rig, np.tile(rate, (len(points), 1)))
        moved = as_exposed(points, camera, rig, side, own)
        seen.append(moved[:, :2] / moved[:, 2:] * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px])
    assert points_at_stamp(rig, cameras_of(rig), np.hstack(seen), rate) == pytest.approx(STILL_PX, abs=0.01)


def test_without_a_readout_nothing_changes() -> None:
    for shutter in (None, Shutter(readout_ms=0.0), Shutter(readout_ms=0.0, readout_sigma_ms=10.0)):
        rig = with_shutters(RIG, shutter, shutter)
        assert points_at_stamp(rig, cameras_of(rig), STILL_PX, RATE) is STILL_PX
        assert as_exposed(POINTS_M, rig.left, rig, "left", RATE) is POINTS_M


def test_a_point_without_depth_stays() -> None:
    shutter = Shutter(readout_ms=10.0, stamp_row="first")
    rig = with_shutters(RIG, shutter, shutter)
    seen = np.array([[600.0, 100.0, 600.0, 100.0], [600.0, 100.0, 700.0, 100.0]])
    assert np.array_equal(points_at_stamp(rig, cameras_of(rig), seen, RATE), seen)


@pytest.mark.parametrize("lasts_s", [0.03, 0.1, 1.0])
def test_rate_and_motion_agree(lasts_s: float) -> None:
    motion = motion_in(RATE, lasts_s)
    assert rate_of(motion, lasts_s) == pytest.approx(RATE, rel=1e-3)
    moved = carried(POINTS_M, RATE, np.full(len(POINTS_M), 0.02))
    assert moved == pytest.approx(se3.apply(motion_in(RATE, 0.02), POINTS_M), abs=1e-8)
    assert not rate_of(motion, 0.0).any()


def test_rates_from_the_poses_of_a_drive() -> None:
    pairs = make_path(8, step_m=1.5)
    assert camera_rates(pairs, RIG)[:, 3:] == pytest.approx(np.tile([0.0, 0.0, -15.0], (8, 1)), abs=1e-6)
    assert not camera_rates(pairs[:1], RIG).any()
    apart = [
        *pairs[:4],
        *(pair.model_copy(update={"captured_at_ns": pair.captured_at_ns + 10**10}) for pair in pairs[5:]),
    ]
    assert camera_rates(apart, RIG)[:, 5] == pytest.approx(-15.0)  # the poses beyond a pause do not count


def test_rows_are_those_of_the_stored_image() -> None:
    """A lens bends the rows of the sensor in the rectified image."""
    lens = Lens(model="radial", coefficients=(-0.28, 0.07))
    raw = RIG.model_copy(update={"left": RIG.left.model_copy(update={"lens": lens})})
    shutter = Shutter(readout_ms=10.0, stamp_row="first")
    rig = with_shutters(rectify(raw), shutter, shutter)
    uv = np.array([[20.0, 40.0], [rig.left.width_px / 2, 40.0]])
    expected = raw_from_rectified(rig, "left", uv)[:, 1] / (raw.left.height_px - 1)
    assert row_shares(rig, "left", uv) == pytest.approx(expected)
    assert abs(np.diff(expected)[0]) > 1e-3


def test_what_is_not_known_of_the_stamp() -> None:
    def sigma_s(**values: object) -> float:
        shutter = Shutter.model_validate(values)
        return stamp_sigma_s(with_shutters(RIG, shutter, shutter))

    assert sigma_s(readout_ms=10.0) == pytest.approx(0.005)
    assert sigma_s(readout_ms=0.0, readout_sigma_ms=10.0) == pytest.approx(0.005)
    assert sigma_s(readout_ms=10.0, stamp_row="last") == 0.0
    assert stamp_sigma_s(RIG) == 0.0


@pytest.mark.parametrize(("row", "middle_s"), [("first", 0.005), ("middle", 0.0), (None, 0.0), ("last", -0.005)])
def test_the_middle_row(row: str | None, middle_s: float) -> None:
    shutter = Shutter(readout_ms=10.0, stamp_row=row)
    assert middle_row_s(with_shutters(RIG, shutter, shutter)) == pytest.approx(middle_s)
    assert middle_row_s(RIG) == 0.0


def test_a_shutter_that_is_not_stated_leaves_no_trace() -> None:
    """Keys and ids of rigs are hashes of their text; one calibration has one id, whatever readout a drive shows."""
    rig = calibrated(RIG, {"relative.ry_rad": 1e-3})
    shutter = Shutter(readout_ms=10.0)
    assert "shutter" not in rig.model_dump_json()
    assert "shutter" not in repr(with_shutters(rig, shutter, shutter).left)
    assert calibration_id(with_shutters(rig, shutter, shutter)) == calibration_id(rig)
