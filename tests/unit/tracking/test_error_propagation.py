"""Errors common to many observations: of poses over time, of the calibration and of a cone's outline."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry.consistency import Nees
from conetl.geometry.intersection import fit_point, pair_jacobian
from conetl.geometry.motion.chain_solver import cross_covariance
from conetl.geometry.packing import cov_matrix
from conetl.model.drive import CommonError, FramePair, Position
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.params import TrajectoryParams
from conetl.tracking.error_propagation import (
    common_cov,
    common_error_id,
    constant_and_change,
    moved_cov,
    outline_jacobian,
    pose_cov,
    shared_by_drives,
)
from conetl.tracking.matching.covariance import shared_disparity_px
from conetl.tracking.trajectory import log_errors, refine_trajectory
from tests import records
from tests.synthetic.noisy_drive import draw_positions
from tests.synthetic.odometry import log_of, motions_of, true_poses
from tests.synthetic.world import ORIGIN_M, Cone, calibrated, camera_poses, make_path, make_rig
from tests.synthetic.wrong_rigs import wrong_rig

Array = NDArray[np.float64]
SIGMAS = {"left.fx_px": 1.5, "right.cx_px": 0.8, "relative.ry_rad": 8e-4, "relative.tx_m": 2e-3}
RIG = calibrated(make_rig(), SIGMAS)
CONE = Cone((22.0, 3.0, 0.0))


def test_one_observation_has_the_errors_of_its_position() -> None:
    drawn = draw_positions(np.random.default_rng(2), RIG, [CONE], frames=6)
    pairs = {pair.frame_index: pair for pair in drawn.drive.frame_pairs}
    poses = camera_poses(list(drawn.drive.frame_pairs), RIG, "left")
    assert drawn.positions
    for position in drawn.positions:
        added = common_cov([position], np.eye(3)[None], pairs, RIG, poses)
        turn = poses[position.frame_index][:3, :3]
        image = turn @ cov_matrix(position.camera_cov_m2) @ turn.T
        np.testing.assert_allclose(added + image, cov_matrix(position.cov_m2), rtol=1e-6, atol=1e-12)


def test_many_observations_with_a_wrong_calibration_are_within_their_covariance() -> None:
    """NEES of joint fits over 12 frames, the calibration drawn once a drive: consistent with the common part, not without."""
    rng = np.random.default_rng(8)
    pairs = make_path(12, step_m=1.2)
    exact_pose = {"sigma_enu_m": (0.0, 0.0, 0.0), "sigma_rpy_rad": (0.0, 0.0, 0.0)}
    by_index = {
        pair.frame_index: pair.model_copy(update={"pose": pair.pose.model_copy(update=exact_pose)}) for pair in pairs
    }
    left = camera_poses(pairs, RIG, "left")
    nominal = [np.stack(list(camera_poses(pairs, RIG, side).values())) for side in ("left", "right")]
    truth = np.add(ORIGIN_M, CONE.foot_m)
    stated = {
        "sigma_u_px": np.full(12, 0.4), "sigma_v_px": np.full(12, 0.4), "sigma_pointing_px": np.full(12, 0.0),
        "sigma_motion_m": np.zeros(12),
    }  # fmt: skip
    whole, own_only = Nees(0.0, 0), Nees(0.0, 0)
    for _ in range(200):
        actual = wrong_rig(RIG, rng.normal(0, list(SIGMAS.values())))
        right = np.stack(list(camera_poses(pairs, actual, "right").values()))
        exact, _ = pair_jacobian(truth, nominal[0], right, actual)
        observed = exact + rng.normal(0, 0.4, exact.shape)
        fit = fit_point(observed, truth, *nominal, RIG, **stated)
        assert fit is not None
        group = [position_at(pair, left[pair.frame_index], fit.xyz_m) for pair in pairs]
        common = common_cov(group, fit.shares, by_index, RIG, left)
        off = fit.xyz_m - truth
        whole += Nees(float(off @ np.linalg.solve(fit.cov_m2 + common, off)), 3)
        own_only += Nees(float(off @ np.linalg.solve(fit.cov_m2, off)), 3)
    assert whole.holds(0.99)
    assert own_only.per_dof > 2


def poses_with(sigma_m: float, sigma_rad: float) -> list[FramePair]:
    """Three seconds towards the cone at 10 Hz and 5 m/s."""
    sigmas = {"sigma_enu_m": (sigma_m,) * 3, "sigma_rpy_rad": (sigma_rad,) * 3}
    pairs = make_path(30, step_m=0.5)
    return [pair.model_copy(update={"pose": pair.pose.model_copy(update=sigmas)}) for pair in pairs]


def model(correlation_s: float) -> TrajectoryParams:
    times = {"gnss_correlation_s": correlation_s, "attitude_correlation_s": correlation_s}
    return TrajectoryParams(**times, gnss_white_share=0.0, attitude_white_share=0.0)


def test_correlation_of_one_is_one_error_and_none_is_an_average() -> None:
    pairs = poses_with(0.1, 0.0)
    by_index, left = {pair.frame_index: pair for pair in pairs}, camera_poses(pairs, make_rig(), "left")
    group = [position_at(pair, left[pair.frame_index], np.add(ORIGIN_M, CONE.foot_m)) for pair in pairs]
    equal = np.tile(np.eye(3) / 30, (30, 1, 1))

    def cov(correlation_s: float) -> Array:
        return common_cov(group, equal, by_index, make_rig(), left, model(correlation_s))

    np.testing.assert_allclose(common_cov(group, equal, by_index, make_rig(), left), 0.01 * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(cov(1e9), 0.01 * np.eye(3), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(cov(1e-4), 0.01 / 30 * np.eye(3), rtol=1e-6, atol=1e-12)
    apart_s = 0.1 * np.abs(np.subtract.outer(np.arange(30), np.arange(30)))
    for correlation_s in (1.0, 10.0, 100.0):
        expected = 0.01 * np.exp(-apart_s / correlation_s).mean()
        np.testing.assert_allclose(cov(correlation_s), expected * np.eye(3), rtol=1e-6, atol=1e-12)


def position_at(pair: FramePair, map_SE3_left: Array, xyz_m: Array) -> Position:
    """The position from a frame pair; only its coordinates matter here."""
    in_camera = se3.apply(se3.invert(map_SE3_left), xyz_m).tolist()
    place = tuple(xyz_m.tolist())
    return records.position(
        pair.frame_index, xyz_m=place, centre_xyz_m=place, camera_xyz_m=tuple(in_camera), range_m=in_camera[2]
    )


def test_outline_errors_remain_from_one_side_and_cancel_from_opposite_ones() -> None:
    drawn = draw_positions(np.random.default_rng(4), RIG, [CONE], frames=2)
    pairs = list(drawn.drive.frame_pairs)
    left = camera_poses(pairs, RIG, "left")
    position = drawn.positions[0].model_copy(update={"sigma_outline_m": 0.02})
    shares = np.stack([0.5 * np.eye(3)] * 2)
    one_side = outline_jacobian([position, position], shares, left, RIG)
    xyz_m = np.array(position.camera_xyz_m)
    per_px = xyz_m[2] ** 2 / (RIG.left.fx_px * RIG.baseline_m)
    sigma_px = cov_matrix(position.camera_cov_m2)[2, 2] ** 0.5 / per_px
    away = xyz_m / xyz_m[2] * shared_disparity_px(sigma_px) * per_px
    np.testing.assert_allclose(np.square(one_side).sum(), 2 * 0.02**2 + away @ away)
    aside = FEATURE_CLASSES["traffic_sign"].outline_aside
    sign = position.model_copy(update={"category": "traffic_sign"})
    of_sign = outline_jacobian([sign, sign], shares, left, RIG)
    np.testing.assert_allclose(np.square(of_sign).sum(), (1 + aside**2) * 0.02**2 + away @ away)
    turned = left[position.frame_index].copy()
    turned[:3, [0, 2]] *= -1  # from the other side: right and left, far and near are exchanged
    other = position.model_copy(update={"frame_index": 99})
    both_sides = outline_jacobian([position, other], shares, {**left, 99: turned}, RIG)
    np.testing.assert_allclose(np.square(both_sides).sum(), 0.02**2 + away[1] ** 2)


PARAMS = TrajectoryParams()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 8))
def test_constant_and_changing_parts_add_up_and_are_independent(seed: int, count: int) -> None:
    root = np.random.default_rng(seed).normal(size=(6 * count, 6 * count + 4))
    cov = root @ root.T
    constant, change = constant_and_change(cov)
    alike = np.tile(np.eye(6), (count, 1))
    assert np.allclose(alike @ constant @ alike.T + change, cov)
    assert np.linalg.eigvalsh(change).min() > -1e-6 * np.trace(cov)
    assert np.linalg.eigvalsh(constant).min() > 0
    # Residuals are uncorrelated with the best estimate of a constant.
    assert np.allclose(np.linalg.solve(cov, alike).T @ change, 0, atol=1e-6)


@pytest.mark.parametrize("variances", [[4.0, 4.0, 9.0, 0.1, 0.1, 0.2], [4e-4, 4e-4, 9e-4, 0.0, 0.0, 0.0]])
def test_constant_and_changing_errors_are_separated(variances: list[float]) -> None:
    """All poses with the same error but for a thousandth; with and without errors of attitude."""
    white = 1e-6 * np.array(variances)
    cov = np.tile(np.diag(variances), (7, 7)) + np.kron(np.eye(7), np.diag(white))
    constant, change = constant_and_change(cov)
    assert np.diag(constant) == pytest.approx(variances, rel=1e-4, abs=1e-15)
    assert np.diag(change) == pytest.approx(np.tile(white, 7), rel=0.2, abs=1e-15)


def test_pose_covariance_of_a_refined_drive_is_that_of_the_adjustment() -> None:
    """Frame indices in, joint covariance out; its diagonal is what the poses state."""
    rng, rig = np.random.default_rng(3), make_rig()
    truth = true_poses(30)
    result = refine_trajectory(log_of(truth, rng, 0.4, 9e-4, PARAMS), rig, motions_of(truth, rig, rng, PARAMS), PARAMS)
    assert result.covariance is not None
    frames = [pair.frame_index for pair in result.frame_pairs]
    cov = pose_cov(result, PARAMS)([frames[2], frames[9], frames[20]])
    for at, k in enumerate((2, 9, 20)):
        pose = result.frame_pairs[k].pose
        stated = np.square([*pose.sigma_enu_m, *pose.sigma_rpy_rad])
        assert np.diag(cov)[6 * at : 6 * at + 6] == pytest.approx(stated, rel=1e-6)
    assert np.allclose(cov[:6, 12:], cross_covariance(result.covariance, 2, 20)[:6, :6])


def test_pose_covariance_of_a_log_is_that_of_gauss_markov_processes() -> None:
    pairs = make_path(12, sigma_m=0.02)
    logged = refine_trajectory(pairs, make_rig(), [], PARAMS)
    frames = [pair.frame_index for pair in pairs]
    cov = pose_cov(logged, PARAMS)(frames)
    assert np.array_equal(cov, log_errors(pairs, PARAMS))
    blocks = cov.reshape(12, 6, 12, 6)
    apart_s = (pairs[11].captured_at_ns - pairs[0].captured_at_ns) * 1e-9
    sigma_rad = pairs[0].pose.sigma_rpy_rad[2]
    for column, variance, white_share, correlation_s in (
        (0, 0.02**2, PARAMS.gnss_white_share, PARAMS.gnss_correlation_s),
        (5, sigma_rad**2, PARAMS.attitude_white_share, PARAMS.attitude_correlation_s),
    ):
        kept = (1 - white_share**2) * np.exp(-apart_s / correlation_s)
        assert blocks[0, column, 11, column] == pytest.approx(kept * variance)
    assert blocks[4, 0, 4, 0] == pytest.approx(0.02**2)
    assert blocks[4, 5, 4, 5] == pytest.approx(pairs[4].pose.sigma_rpy_rad[2] ** 2)
    assert np.count_nonzero(blocks[0, 0, 11]) == 1


def test_points_of_one_frame_move_together() -> None:
    """By the covariance of their poses, for points of any frame."""
    rng = np.random.default_rng(8)
    jacobian, rank = rng.normal(size=(5, 3, 6)), np.array([1, 0, 2, 1, 1])
    root = rng.normal(size=(18, 18))
    cov = root @ root.T
    moved = moved_cov(jacobian, rank, cov).reshape(5, 3, 5, 3)
    for a in range(5):
        for b in range(5):
            block = cov[6 * rank[a] : 6 * rank[a] + 6, 6 * rank[b] : 6 * rank[b] + 6]
            assert np.allclose(moved[a, :, b], jacobian[a] @ block @ jacobian[b].T)


BASE = CommonError(id="base", sigma_m=(0.02, 0.02, 0.04))
ANTENNA = CommonError(id="antenna", sigma_m=(0.05, 0.01, 0.0), axes="vehicle")


def test_common_errors_are_a_part_of_the_poses_errors_which_are_never_smaller() -> None:
    poses, shares = [pair.pose for pair in make_path(4)], np.tile(np.eye(3) / 4, (4, 1, 1))
    shared, lacking = shared_by_drives([BASE], shares, poses, 0.1**2 * np.eye(3), corrected=False)
    [(key, moved)] = shared
    assert key == common_error_id(BASE)
    np.testing.assert_allclose(moved, np.diag(BASE.sigma_m), atol=1e-15)
    np.testing.assert_allclose(lacking, 0.0, atol=1e-15)
    # The adjustment averaged down what does not change within the drive, in height.
    of_poses = np.diag([0.1, 0.1, 0.01]) ** 2
    _, lacking = shared_by_drives([BASE], shares, poses, of_poses, corrected=False)
    np.testing.assert_allclose(of_poses + lacking, np.diag([0.1, 0.1, 0.04]) ** 2, atol=1e-12)
    assert shared_by_drives([], shares, poses, of_poses, corrected=False)[0] == []


def test_control_points_leave_at_most_what_the_adjustment_states_of_a_common_error() -> None:
    poses, shares = [pair.pose for pair in make_path(1)], np.eye(3)[None]
    of_poses = 0.01**2 * np.eye(3)
    [(_, moved)], lacking = shared_by_drives([BASE], shares, poses, of_poses, corrected=True)
    assert not lacking.any()
    np.testing.assert_allclose(moved, np.diag(BASE.sigma_m) / 4, rtol=1e-9, atol=1e-15)


def test_the_error_of_a_lever_arm_turns_with_the_vehicle() -> None:
    there, back = (make_path(1, east=east)[0].pose for east in (True, False))
    of_poses, shares = 0.1**2 * np.eye(3), np.eye(3)[None]
    moved = [shared_by_drives([ANTENNA], shares, [pose], of_poses, corrected=False)[0][0][1] for pose in (there, back)]
    np.testing.assert_allclose(moved[0], -moved[1], atol=1e-12)
    np.testing.assert_allclose(moved[0][:2, 0], 0.05 * np.array(there.map_R_body)[:2, 0], atol=1e-12)


def test_another_sigma_or_other_axes_are_another_error() -> None:
    same = CommonError.model_validate({"id": "base", "sigma_m": [0.02, 0.02, 0.04]})
    others = [BASE.model_copy(update=update) for update in ({"sigma_m": (0.03,) * 3}, {"axes": "vehicle"}, {"id": "b"})]
    assert common_error_id(same) == common_error_id(BASE)
    assert len({common_error_id(one) for one in (BASE, *others)}) == 4
