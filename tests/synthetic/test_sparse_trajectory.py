"""1 Hz positions without attitude: refined poses are honest, and clocks that are seconds apart are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from conetl.checks.verdict import judge_all
from conetl.evaluation.drive_evaluation import evaluate_drive, nees_of
from conetl.evaluation.truth import read_truth_cones
from conetl.geometry import pose as se3
from conetl.geometry.motion.chain_solver import cross_covariance
from conetl.model.health import Verdict, hold_reason
from conetl.model.params import IngestParams
from conetl.pipeline.analysis import analyse
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.readers.drives.poses import Samples
from conetl.readers.drives.sparse_poses import pose_reader
from conetl.readers.drives.video_timing import refined_clock
from conetl.simulation.scenario import scenario_pass
from conetl.simulation.trajectory import true_poses
from conetl.tracking.checks.poses import check_trajectory
from conetl.tracking.clock_search import find_clock_offset, rates_of
from conetl.tracking.drive_refinement import refine_with_cones
from conetl.tracking.trajectory import RefinementOutcome, log_errors, refine_trajectory
from tests.cases import cases
from tests.integration.small_drives import SAMPLES
from tests.synthetic.good_drives import PARAMS, RIG
from tests.synthetic.odometry import motions_of, pose_errors
from tests.synthetic.sparse_drive import record


@pytest.mark.parametrize(("sigma_m", "most_m"), cases((0.4, 1.0), release=[(0.02, 0.1)]))
def test_refined_poses_of_1_hz_positions_are_honest(sigma_m: float, most_m: float) -> None:
    runs, positions, attitudes, rms_m = 4, [], [], []
    for seed in range(runs):
        drive = record(seed, sigma_m=sigma_m, seconds=20.0)
        result = refine_trajectory(drive.frame_pairs(0.0), RIG, drive.motions, PARAMS)
        assert result.outcome is RefinementOutcome.REFINED, result.detail
        assert result.covariance is not None
        error, cov = pose_errors(result.frame_pairs, drive.truth), result.covariance.of(100)
        positions.append(error[100, :3] @ np.linalg.solve(cov[:3, :3], error[100, :3]))
        attitudes.append(error[100, 3:] @ np.linalg.solve(cov[3:6, 3:6], error[100, 3:]))
        rms_m.append(np.sqrt(np.mean(error[:, :3] ** 2)))
    assert chi2.ppf(0.001, 3 * runs) < sum(positions) < chi2.ppf(0.999, 3 * runs)
    assert sum(attitudes) < chi2.ppf(0.999, 3 * runs)
    assert np.median(rms_m) < most_m


@pytest.mark.release
def test_the_heading_of_a_few_scattering_positions_is_honest() -> None:
    """Four seconds: an adjusted heading lies nearer to four records than the vehicle's does."""
    runs, squares = 60, 0.0
    for seed in range(runs):
        drive, error_m = record(seed, sigma_m=1e-6, seconds=4.0), np.random.default_rng(seed).normal(0, 0.3, (84, 3))
        true, sigma = drive.track.map_SE3_body.copy(), drive.track.sigma.copy()
        true[:, :3, 3] += error_m[: len(true)] * (1.0, 1.0, 1.5)
        sigma[:, :3] = 0.3, 0.3, 0.45
        drive = replace(drive, track=drive.track._replace(map_SE3_body=true, sigma=sigma))
        result = refine_trajectory(drive.frame_pairs(0.0), RIG, drive.motions, PARAMS)
        middle = result.frame_pairs[len(result.frame_pairs) // 2].pose
        squares += (
            pose_errors(result.frame_pairs, drive.truth)[len(result.frame_pairs) // 2, 5] / middle.sigma_rpy_rad[2]
        ) ** 2
    assert squares < chi2.ppf(0.9999, runs)  # five records hardly show their spectrum


@pytest.mark.parametrize("rad_per_m", [-5e-5, 5e-5])
def test_odometry_that_turns_alike_in_all_intervals_is_honest(rad_per_m: float) -> None:
    """Rendered and real images turn visual odometry about the optical axis by up to 0.006 degrees per metre."""
    drive = record(3, seconds=20.0)
    motions = []
    for motion in drive.motions:
        pose = np.array(motion.second_SE3_first)
        turn = rad_per_m * np.linalg.norm(pose[:3, 3]) * np.array([0.0, 0.0, 1.0])
        pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
        motions.append(motion.model_copy(update={"second_SE3_first": se3.to_matrix4(pose)}))
    result = refine_trajectory(drive.frame_pairs(0.0), RIG, motions, PARAMS)
    assert result.covariance is not None
    error = pose_errors(result.frame_pairs, drive.truth)
    first, last = 5, len(error) - 6
    between = cross_covariance(result.covariance, first, last)[3, 3]
    variance = result.covariance.variances[[first, last], 3].sum() - 2 * between
    assert (error[last, 3] - error[first, 3]) ** 2 < chi2.ppf(0.95, 1) * variance


@pytest.mark.parametrize(("number", "scatter_m"), cases((3, 0.3), release=[(1, 0.02)]))
def test_a_sample_drive_by_positions_alone_states_true_sigmas(
    sample_settings: Settings, number: int, scatter_m: float
) -> None:
    """One position a second, from before the images to after them. Where they scatter by 0.3 m, they hardly show the scale of
    visual odometry, which stretches all tracks."""
    drive, _ = read_drive(SAMPLES[number - 1])
    times_s = np.arange(-8.6, 12.0)
    true = true_poses(scenario_pass(number), times_s)
    true[:, :3, 3] += np.random.default_rng(number).normal(0, scatter_m, (len(true), 3))
    captured_ns = [pair.captured_at_ns for pair in drive.frame_pairs]
    stamps = (captured_ns[0] + np.round(times_s * 1e9)).astype(np.int64).tolist()
    sigma = np.tile(scatter_m * np.array([1.0, 1.0, 1.5, 0.0, 0.0, 0.0]), (len(times_s), 1))
    pose_at = pose_reader(Samples("gnss", stamps, true, sigma, {}), captured_ns, from_course=True)
    pairs = tuple(pair.model_copy(update={"pose": pose_at(pair.captured_at_ns)}) for pair in drive.frame_pairs)
    found = analyse(drive.model_copy(update={"frame_pairs": pairs}), settings=sample_settings)
    cones, _ = read_truth_cones(SAMPLES[number - 1] / "truth.csv")
    evaluation = evaluate_drive(cones, found, within_m=20.0)
    nees = nees_of([evaluation])["tracks"]
    assert nees is not None and nees.common.holds(0.99) and nees.relative.value < nees.relative.band()[1]


@pytest.mark.parametrize(("seed", "path_seed"), [(1, 2), (5, 6), (11, 12)])
def test_images_of_another_hour_of_the_log_are_not_laid_to_the_calibration(seed: int, path_seed: int) -> None:
    drive = record(seed, rate_hz=10.0, seconds=10.0, has_attitude=True, path_seed=path_seed)
    result = refine_with_cones(drive.frame_pairs(0.0), RIG, drive.motions, [], IngestParams())
    reason = hold_reason(judge_all(check_trajectory(result.logged, RIG, drive.motions, result, PARAMS)))
    assert reason is not None and "check first when they were taken (images.start" in reason, reason


def test_odometry_whose_scale_changes_is_no_offset_of_the_clocks_of_a_short_drive() -> None:
    """Five seconds of positions ten times a second: 0.3 % of the speed look like a clock that is 30 ms off."""
    squares = []
    for seed in range(6):
        drive, motions = record(seed, rate_hz=10.0, seconds=5.0), []
        for k, motion in enumerate(drive.motions):
            pose = np.array(motion.second_SE3_first)
            pose[:3, 3] *= 1 + 0.003 * np.cos(2 * np.pi * k / len(drive.motions) + seed)
            motions.append(motion.model_copy(update={"second_SE3_first": se3.to_matrix4(pose)}))
        clock = refine_with_cones(drive.frame_pairs(0.0), RIG, motions, [], IngestParams()).clock
        squares += [] if clock is None else [(clock.offset_s / clock.sigma_s) ** 2]
    assert len(squares) > 2 and sum(squares) < chi2.ppf(0.999, len(squares))


def test_an_antenna_behind_the_rear_axle_does_not_shift_the_clocks() -> None:
    """Its course turns after the vehicle does: 1.5 m at 9 m/s are 0.17 s."""
    drive, moved = record(1, rate_hz=10.0, seconds=20.0, has_attitude=True, offset_s=0.05), {}
    poses = drive.track.map_SE3_body.copy()
    poses[:, :3, 3] -= 1.5 * poses[:, :3, 0]
    drive = replace(drive, track=drive.track._replace(map_SE3_body=poses), has_attitude=False)
    for side in ("body_SE3_left", "body_SE3_right"):
        camera = np.array(getattr(RIG, side))
        camera[0, 3] += 1.5
        moved[side] = se3.to_matrix4(camera)
    rig = RIG.model_copy(update=moved)
    clock = refine_with_cones(drive.frame_pairs(0.0), rig, drive.motions, [], IngestParams()).clock
    assert clock is not None and clock.sigma_s < 0.006
    assert abs(clock.offset_s + 0.05) < 3 * clock.sigma_s


def test_frame_pairs_between_records_are_no_measurements_of_their_own() -> None:
    """Without visual odometry twice the images tell no more about where the vehicle was."""
    drive = record(1, sigma_m=0.4)
    some, all_of_them = (
        refine_trajectory(drive.frame_pairs(0.0, every), RIG, kept, PARAMS)
        for every, kept in ((5, []), (1, drive.motions[:1]))
    )
    assert some.outcome is RefinementOutcome.NO_MEASUREMENT
    sigma = np.array([pair.pose.sigma_enu_m for pair in drive.frame_pairs(0.0)])
    refined = np.array([pair.pose.sigma_enu_m for pair in all_of_them.frame_pairs])
    assert np.median(refined / sigma) > 0.8
    cov = log_errors(drive.frame_pairs(0.0, 5), PARAMS)
    assert np.linalg.eigvalsh(cov).min() > -1e-9
    np.testing.assert_allclose(np.sqrt(np.diag(cov))[:3], sigma[0], rtol=1e-6)


@pytest.mark.parametrize(("seed", "offset_s"), [(10, -20.0), (11, -3.2), (12, 0.0), (13, 20.0)])
def test_clocks_seconds_apart_are_found_from_positions_alone(seed: int, offset_s: float) -> None:
    found = record(seed, offset_s=offset_s, seconds=40.0).offset()
    assert found is not None
    assert abs(found.offset_s - offset_s) < min(0.01, 4 * found.sigma_s)


def test_the_offset_is_found_with_positions_of_0_4_m() -> None:
    """The median error is 12 ms, which no estimator can halve: it is 0.9 of the Cramer-Rao bound of its drive."""
    found = [record(1000 + seed, offset_s=5.0, sigma_m=0.4, seconds=40.0).offset() for seed in range(8)]
    assert np.median([abs(one.offset_s - 5.0) for one in found if one is not None]) < 0.016 and None not in found


@pytest.mark.release
def test_attitudes_show_the_offset_to_10_ms_before_the_analysis() -> None:
    """Positions of 0.4 m: heading and speed alone leave up to 17 ms in these drives."""
    errors_s, sigmas_s = [], []
    for seed, offset_s in enumerate(np.random.default_rng(3).uniform(-20.0, 20.0, 10)):
        drive = record(500 + seed, offset_s=offset_s, rate_hz=10.0, sigma_m=0.4, has_attitude=True, seconds=40.0)
        coarse = drive.offset()
        assert coarse is not None
        found = refined_clock(coarse, drive.motions, drive.track, drive.image_ns, RIG)
        errors_s.append(found.offset_s - offset_s)
        sigmas_s.append(found.sigma_s)
    assert np.abs(errors_s).max() < 0.01
    nees = float(((np.array(errors_s) / sigmas_s) ** 2).sum())
    assert chi2.ppf(0.001, 10) < nees < chi2.ppf(0.999, 10)


def test_what_is_left_of_the_offset_is_found_with_the_poses() -> None:
    """0.4 m and attitudes: turns and speeds find some 20 ms, the adjustment the rest; what remains is in the covariance."""
    errors_s, nees = [], []
    for seed in range(2):
        drive = record(20 + seed, offset_s=12.037, rate_hz=10.0, sigma_m=0.4, has_attitude=True, seconds=40.0)
        found = drive.offset()
        assert found is not None
        params = PARAMS.model_copy(update={"clock_sigma_s": found.sigma_s})
        refined = refine_with_cones(
            drive.frame_pairs(found.offset_s), RIG, drive.motions, [], IngestParams(trajectory=params)
        )
        assert refined.clock is not None
        assert refined.covariance is not None
        left_s = refined.clock.offset_s if refined.clock.is_applied(found.sigma_s) else 0.0
        errors_s.append(found.offset_s - left_s - 12.037)
        error = pose_errors(refined.frame_pairs, drive.truth)[200, :3]
        nees.append(error @ np.linalg.solve(refined.covariance.of(200)[:3, :3], error))
    assert np.abs(errors_s).max() < 0.01
    assert sum(nees) < chi2.ppf(0.999, 6)


@pytest.mark.parametrize("sigma_m", cases(0.02, release=[0.4]))
def test_a_vehicle_that_reverses_is_held(sigma_m: float) -> None:
    """Its course is opposite to its heading, which positions do not show."""
    drive = record(2, sigma_m=sigma_m)
    turned = drive.truth @ se3.se3(se3.rotation_from_rpy(0.0, 0.0, np.pi), np.zeros(3))
    backwards = motions_of(turned, RIG, np.random.default_rng(1), PARAMS)
    for motions, held in ((backwards, True), (drive.motions, False)):
        refined = refine_with_cones(drive.frame_pairs(0.0), RIG, motions, [], IngestParams())
        seen = [pair.model_copy(update={"detail": 10.0}) for pair in refined.logged]
        checks = judge_all(check_trajectory(seen, RIG, motions, refined, PARAMS))
        assert (hold_reason(checks) is not None) == held
        assert "driving direction" in {check.name for check in checks}
        [stated] = [check for check in checks if check.name == "stated sigmas of the poses"]
        assert held or stated.verdict is not Verdict.HOLD


def test_a_straight_drive_another_one_or_too_little_do_not_show_the_offset() -> None:
    assert record(1, straight=True).offset() is None
    assert [record(seed, path_seed=900 + seed, offset_s=4.0).offset() for seed in range(3)] == [None] * 3
    assert record(2, seconds=4.0).offset() is None
    drive = record(3, offset_s=200.0)
    assert drive.offset() is None
    rates, samples = rates_of([], dict(enumerate(drive.image_ns)), RIG), drive.track
    places = samples.map_SE3_body[:, :3, 3]
    assert find_clock_offset(rates, drive.image_ns[0], samples.times_ns, places, None, samples.sigma[:, :3]) is None
