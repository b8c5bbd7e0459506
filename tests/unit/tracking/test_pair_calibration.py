"""What one pair shows of its calibration, and whether the assumed errors cover what it does not show."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry.calibration.covariance import calibration_cov
from conetl.geometry.calibration.self_calibration import equivalent_camera
from conetl.geometry.intersection import intersect
from conetl.geometry.rig import left_SE3_right, right_camera_turned
from conetl.model.errors import InputError
from conetl.model.params import PairParams, TrajectoryParams
from conetl.model.rig import Rig
from conetl.tracking.pair_calibration import calibrate_pair
from conetl.tracking.self_calibration import pixels_per_unit, with_assumed_errors
from tests.synthetic.world import FOCAL_PX, calibrated, make_rig

PARAMS, TRAJECTORY = PairParams(), TrajectoryParams()
RIG = make_rig()
STATED = calibrated(RIG, {f"relative.r{axis}_rad": 0.1 / FOCAL_PX for axis in "xyz"})


def off_by(*turn_and_bend_px: float, scale: float = 1.0) -> Rig:
    """The rig as it is, of which RIG is the calibration; see `pixels_per_unit`."""
    rotation, shift_px = equivalent_camera(np.array(turn_and_bend_px) / pixels_per_unit(RIG), FOCAL_PX)
    rig = right_camera_turned(RIG, rotation)
    right = rig.right.model_copy(update={"cx_px": RIG.right.cx_px + shift_px})
    pose = np.array(rig.body_SE3_right)
    left_m = np.array(RIG.body_SE3_left)[:3, 3]
    pose[:3, 3] = left_m + scale * (pose[:3, 3] - left_m)
    return rig.model_copy(update={"right": right, "body_SE3_right": se3.to_matrix4(pose)})


def seen(rig: Rig, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 4) px of points (N, 3) in the left camera's frame."""
    in_right = se3.apply(se3.invert(left_SE3_right(rig)), points_m)
    return np.column_stack([cam.project(rig.left, points_m), cam.project(rig.right, in_right)])


def street(rig: Rig, *, farthest_m: float, count: int = 400, seed: int = 3) -> NDArray[np.float64]:
    """(N, 4) px of points of a street, a tenth of them at its end, with noise and 1 % wrong matches."""
    rng = np.random.default_rng(seed)
    depth = 1 / rng.uniform(1 / farthest_m, 1 / 5.0, count)
    depth[-count // 10 :] = farthest_m
    points = np.column_stack([rng.uniform(-0.8, 0.8, count), rng.uniform(-0.2, 0.24, count), np.ones(count)])
    found = seen(rig, points * depth[:, None]) + rng.normal(0, 0.08, (count, 4))
    found[: count // 100, 2] += 60.0
    return found


def test_rows_are_corrected_whatever_the_distance() -> None:
    found = calibrate_pair(street(off_by(1.5, 0.0, -0.6, 0.0), farthest_m=60.0), RIG, PARAMS, TRAJECTORY)
    assert found.offsets is not None
    assert found.offsets.rows_px == pytest.approx([1.5, 0.6], abs=0.06)
    rows = np.diff(seen(found.rig, np.array([[0.0, 0.0, 9.0], [6.0, 0.0, 9.0]]))[:, [1, 3]])[:, 0]
    assert rows == pytest.approx([1.5, 1.5 + 0.6 * 6 / 9 * FOCAL_PX / (RIG.right.width_px / 2)], abs=0.1)
    assert "1.52 px too low" in found.detail and "corrected" in found.detail


@pytest.mark.parametrize("offset_px", [-1.0, 0.0, 1.0])
def test_points_at_finite_depth_show_no_offset_of_disparities(offset_px: float) -> None:
    """The camera stays as it is, and the sigma of positions contains the prior."""
    found = calibrate_pair(street(off_by(0.0, offset_px, 0.0, 0.0), farthest_m=60.0), RIG, PARAMS, TRAJECTORY)
    assert found.rig.right == RIG.right and found.rig.body_SE3_right == RIG.body_SE3_right
    assert "agree" in found.detail and "0.7 px is assumed" in found.detail
    assert not found.stated
    sigma_m = float(np.sqrt(calibration_cov([[0.0, 0.0, 20.0]], found.rig)[0, 2, 2]))
    per_px = 20.0**2 / (FOCAL_PX * RIG.baseline_m)
    prior_px, scale = TRAJECTORY.self_calibration_prior_px, TRAJECTORY.scale_sigma
    assert sigma_m == pytest.approx(np.hypot(prior_px * per_px, scale * 20.0), rel=0.02)


def test_points_beyond_infinity_are_corrected_as_far_as_they_show() -> None:
    found = calibrate_pair(street(off_by(0.0, -1.5, 0.0, 0.0), farthest_m=4000.0), RIG, PARAMS, TRAJECTORY)
    far = np.array([[0.0, 0.0, 1e7]])
    shift = float(np.diff(seen(found.rig, far)[0, [2, 0]])[0])
    assert shift == pytest.approx(-1.5, abs=0.35)
    assert "beyond infinity" in found.detail
    sigma_m = np.sqrt(calibration_cov([[0.0, 0.0, 20.0]], found.rig)[0, 2, 2])
    unseen_m = np.sqrt(calibration_cov([[0.0, 0.0, 20.0]], with_assumed_errors(RIG, TRAJECTORY))[0, 2, 2])
    assert sigma_m == pytest.approx(unseen_m, rel=0.1), "they may have been farther"


@pytest.mark.parametrize(
    ("turn", "said"),
    [((8.0, 0.0, 0.0, 0.0), r"8\.\d+ px too low"), ((0.0, -6.0, 0.0, 0.0), r"[6-9]\.\d px beyond infinity")],
)
def test_an_implausible_offset_is_refused_with_its_number(turn: tuple[float, ...], said: str) -> None:
    for rig in (RIG, STATED):
        with pytest.raises(InputError, match=said):
            calibrate_pair(street(off_by(*turn), farthest_m=4000.0), rig, PARAMS, TRAJECTORY)


def test_stated_errors_are_kept_unless_the_pair_refutes_them() -> None:
    agrees = calibrate_pair(street(RIG, farthest_m=60.0), STATED, PARAMS, TRAJECTORY)
    assert agrees.stated and agrees.rig == STATED
    refuted = calibrate_pair(street(off_by(2.0, 0.0, 0.0, 0.0), farthest_m=60.0), STATED, PARAMS, TRAJECTORY)
    assert not refuted.stated
    assert "against the errors that it states" in refuted.detail
    exact = calibrated(RIG, {"left.fx_px": 0.5})
    assert not calibrate_pair(street(off_by(2.0, 0.0, 0.0, 0.0), farthest_m=60.0), exact, PARAMS, TRAJECTORY).stated


def test_few_points_show_nothing() -> None:
    for points in (np.empty((0, 4)), street(RIG, farthest_m=60.0)[:49]):
        found = calibrate_pair(points, RIG, PARAMS, TRAJECTORY)
        assert found.offsets is None and "fewer than 50" in found.detail
        assert found.rig == with_assumed_errors(RIG, TRAJECTORY)


def test_assumed_errors_are_those_of_the_positions() -> None:
    """NEES of positions by calibrations that are off by the assumed errors, neither above nor below its band."""
    rng, count = np.random.default_rng(8), 300
    prior_px, scale = TRAJECTORY.self_calibration_prior_px, TRAJECTORY.scale_sigma
    values = []
    for seed in range(count):
        truth = off_by(*rng.normal(0, prior_px, 4), scale=1 + rng.normal(0, scale))
        rig = calibrate_pair(street(truth, farthest_m=80.0, seed=seed), RIG, PARAMS, TRAJECTORY).rig
        point = np.array([rng.uniform(-4, 4), 1.6, rng.uniform(8, 25)])
        relative = left_SE3_right(rig)
        located = intersect(
            seen(truth, point[None]).reshape(1, 2, 2), [cam.intrinsics(rig.left), cam.intrinsics(rig.right)],
            [np.eye(3), relative[:3, :3]], [np.zeros(3), relative[:3, 3]], 0.01,
        )  # fmt: skip
        off = located.xyz_m[0] - point
        cov = calibration_cov(located.xyz_m, rig)[0] + located.cov_m2[0]
        depth = located.xyz_m[0] / np.linalg.norm(located.xyz_m[0])
        values.append(float((off @ depth) ** 2 / (depth @ cov @ depth)))
    assert 0.84 < np.mean(values) < 1.17  # 95 % of chi-square with 300 degrees of freedom
