"""Refined trajectories against ground truth: honest covariance, no harm, and what wrong measurements may not do."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from conetl.geometry import pose as se3
from conetl.geometry.motion import chain_solver
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.model.drive import FramePair, Position
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.tracking.drive_refinement import refine_with_cones
from conetl.tracking.error_propagation import motion_error, relative_cov
from conetl.tracking.trajectory import RefinedTrajectory, RefinementOutcome, refine_trajectory
from tests import records
from tests.synthetic.noisy_drive import draw_positions
from tests.synthetic.odometry import log_of, motions_of, pose_errors, true_poses
from tests.synthetic.world import Cone, make_path, make_rig

RIG = make_rig()
PARAMS = TrajectoryParams()
FRAMES = 60


def drive(seed: int, sigma_m: float = 0.4) -> tuple[np.ndarray, list[FramePair], list[RelativeMotion]]:
    rng = np.random.default_rng(seed)
    truth = true_poses(FRAMES)
    return truth, log_of(truth, rng, sigma_m, 0.0009, PARAMS), motions_of(truth, RIG, rng, PARAMS)


@cache
def refined(seed: int, sigma_m: float = 0.4) -> RefinedTrajectory:
    _, log, motions = drive(seed, sigma_m)
    return refine_trajectory(log, RIG, motions, PARAMS)


def slide(error: np.ndarray) -> float:
    """How far the error of the place changes over a drive, m."""
    return float(np.linalg.norm(np.ptp(error[:, :3], axis=0)))


def shifted(motion: RelativeMotion, shift_m: float) -> RelativeMotion:
    """The measured motion, longer by so much along the road."""
    pose = np.array(motion.second_SE3_first)
    pose[2, 3] -= shift_m
    return motion.model_copy(update={"second_SE3_first": se3.to_matrix4(pose)})


def test_absolute_and_relative_covariance_are_honest() -> None:
    """NEES of poses and of motions over 30 frames: both sides of the band, so that doubled or halved sigmas fail."""
    runs, absolute, relative = 8, [], []
    for seed in range(runs):
        (truth, _, _), result = drive(seed), refined(seed)
        assert result.outcome is RefinementOutcome.REFINED, result.detail
        error = pose_errors(result.frame_pairs, truth)[30]
        assert result.covariance is not None
        absolute.append(error @ np.linalg.solve(result.covariance.of(30)[:6, :6], error))
        left = se3.compose(truth, np.array(RIG.body_SE3_left))
        true_motion = se3.compose(se3.invert(left[45]), left[15])
        found = se3.compose(se3.invert(result.map_SE3_left[45]), result.map_SE3_left[15])
        wrong = found[:3, :3] @ true_motion[:3, :3].T
        turn = np.array([wrong[2, 1] - wrong[1, 2], wrong[0, 2] - wrong[2, 0], wrong[1, 0] - wrong[0, 1]]) / 2
        off = np.concatenate([turn, found[:3, 3] - true_motion[:3, 3]])
        relative.append(off @ np.linalg.solve(relative_cov(result, 15, 45), off))
    low, high = chi2.ppf([0.005, 0.995], 6 * runs) / runs
    assert low < np.mean(absolute) < high
    assert low < np.mean(relative) < high
    assert high < 4 * low  # half or double sigmas (factor 4) cannot stay inside


def test_refinement_takes_the_slide_out() -> None:
    before, after = [], []
    for seed in range(8):
        truth, log, _ = drive(seed)
        before.append(slide(pose_errors(log, truth)))
        after.append(slide(pose_errors(refined(seed).frame_pairs, truth)))
    assert np.median(after) < 0.35 * np.median(before)


def test_rtk_grade_poses_are_not_harmed() -> None:
    before, after = [], []
    for seed in range(4):
        truth, log, _ = drive(seed, sigma_m=0.02)
        before.append(np.sqrt(np.mean(pose_errors(log, truth)[:, :3] ** 2)))
        result = refined(seed, 0.02)
        after.append(np.sqrt(np.mean(pose_errors(result.frame_pairs, truth)[:, :3] ** 2)))
        places = [np.array([pair.pose.map_t_body_m for pair in pairs]) for pairs in (result.frame_pairs, log)]
        assert np.linalg.norm(places[0] - places[1], axis=1).max() < 0.05
    assert np.mean(after) <= 1.02 * np.mean(before)


def test_without_measurements_the_poses_are_those_of_the_log() -> None:
    _, log, motions = drive(1)
    dark = [m.model_copy(update={"second_SE3_first": None, "cov": (), "reason": "image_blank"}) for m in motions]
    for nothing, params, outcome in (
        ([], PARAMS, RefinementOutcome.NO_MEASUREMENT),
        (dark, PARAMS, RefinementOutcome.NO_MEASUREMENT),
        (motions, TrajectoryParams(refine=False), RefinementOutcome.SWITCHED_OFF),
    ):
        result = refine_trajectory(log, RIG, nothing, params)
        assert result.outcome is outcome
        assert result.frame_pairs == tuple(log)
        assert motion_error(result) is None


def test_a_gap_in_the_measurements_is_bridged() -> None:
    _, log, motions = drive(2)
    result = refine_trajectory(log, RIG, motions[:20] + motions[30:], PARAMS)
    whole = refined(2)
    assert result.outcome is RefinementOutcome.REFINED
    error, whole_error = motion_error(result), motion_error(whole)
    assert error is not None and whole_error is not None
    point = np.array([0.0, 1.0, 10.0])
    assert np.trace(error.cov_m2(18, 32, point)) > 2 * np.trace(whole_error.cov_m2(18, 32, point))
    assert np.trace(error.cov_m2(2, 16, point)) < 1.5 * np.trace(whole_error.cov_m2(2, 16, point))


def test_no_motion_errs_more_than_it_is_said_to_at_most() -> None:
    _, log, motions = drive(2)
    result = refine_trajectory(log, RIG, motions[:20] + motions[30:], PARAMS)
    error = motion_error(result)
    assert error is not None
    left, most = result.map_SE3_left, []
    for start in range(0, len(log), 3):
        for end in range(0, len(log), 3):
            point = np.array([2.0, 1.0, 15.0])
            at_end = np.linalg.inv(left[end]) @ left[start] @ np.append(point, 1.0)
            seen_m = max(np.linalg.norm(point), np.linalg.norm(at_end[:3]))
            most.append(
                np.trace(error.cov_m2(log[start].frame_index, log[end].frame_index, point))
                / error.most_m2(float(seen_m))
            )
    assert max(most) <= 1


@pytest.mark.parametrize("wild_m", [0.5, 1.0, 5.0])
def test_one_wild_motion_is_refused(wild_m: float) -> None:
    truth, log, motions = drive(3)
    wild = [*motions[:25], shifted(motions[25], wild_m), *motions[26:]]
    result = refine_trajectory(log, RIG, wild, PARAMS)
    assert "1 rejected" in result.detail
    assert slide(pose_errors(result.frame_pairs, truth)) < slide(pose_errors(refined(3).frame_pairs, truth)) + 0.15


def test_a_jump_of_the_log_is_not_blamed_on_the_images() -> None:
    _, log, motions = drive(4)
    jumped = [
        pair
        if pair.frame_index < 30
        else pair.model_copy(
            update={
                "pose": pair.pose.model_copy(
                    update={"map_t_body_m": (pair.pose.map_t_body_m[0] + 0.25, *pair.pose.map_t_body_m[1:])}
                )
            }
        )
        for pair in log
    ]
    result = refine_trajectory(jumped, RIG, motions, PARAMS)
    assert "0 rejected" in result.detail


def test_a_lorry_that_fills_the_images_is_not_followed() -> None:
    """For 20 frames all that is seen drives along at 6 m/s beside us: the motion measured is that against the lorry."""
    truth, log, motions = drive(5)
    beside = [shifted(m, -0.6) if 20 <= k < 40 else m for k, m in enumerate(motions)]
    result = refine_trajectory(log, RIG, beside, PARAMS)
    assert "20 rejected" in result.detail
    assert np.abs(pose_errors(result.frame_pairs, truth)[:, :3]).max() < 3 * 0.4 * 1.5


def test_measurements_beyond_the_stated_sigmas_leave_the_log_alone() -> None:
    """A log that claims centimetres and slides by metres: keep it and say so."""
    _, log, motions = drive(6, sigma_m=0.02)
    long = [shifted(m, 0.01) for m in motions]
    result = refine_trajectory(log, RIG, long, PARAMS.model_copy(update={"max_shift_chi2": 0.01}))
    assert result.outcome is RefinementOutcome.AGAINST_STATED_SIGMAS
    assert result.frame_pairs == tuple(log)
    assert "stated" in result.detail


def test_a_standing_car_stays_where_it_is() -> None:
    rng = np.random.default_rng(7)
    truth = np.broadcast_to(true_poses(1), (FRAMES, 4, 4)).copy()
    result = refine_trajectory(
        log_of(truth, rng, 0.4, 0.0009, PARAMS), RIG, motions_of(truth, RIG, rng, PARAMS), PARAMS
    )
    assert result.outcome is RefinementOutcome.REFINED
    assert slide(pose_errors(result.frame_pairs, truth)) < 0.25


def test_cones_as_landmarks_bridge_what_images_do_not_tell() -> None:
    """Twelve frames without visual odometry, but three cones in view: they hold the trajectory together."""
    before, after = [], []
    for seed in range(3):
        truth, log, motions = drive(seed)
        kept = motions[:24] + motions[36:]
        rng = np.random.default_rng(100 + seed)
        left = se3.compose(truth, np.array(RIG.body_SE3_left))
        feet = se3.apply(left[40], np.array([[-3.0, 1.6, 8.0], [3.0, 1.6, 12.0], [0.5, 1.6, 16.0]]))
        cones = [
            [seen(k, c, se3.apply(se3.invert(left[k]), foot) + rng.normal(0, 0.03, 3)) for k in range(20, 41)]
            for c, foot in enumerate(feet)
        ]
        for groups, errors in (((), before), (cones, after)):
            result = refine_trajectory(log, RIG, kept, PARAMS, groups)
            assert result.outcome is RefinementOutcome.REFINED
            errors.append(slide(pose_errors(result.frame_pairs, truth)[20:41]))
    assert np.mean(after) < 0.5 * np.mean(before)


def test_cones_as_landmarks_correct_the_length_of_the_way() -> None:
    """Visual odometry that makes all ways 1.5 % too long: cones, located by stereo, say so; they do not count twice."""
    pairs = make_path(32)
    truth = np.stack([se3.map_SE3_body(pair.pose) for pair in pairs])
    before, after = [], []
    for seed in range(2):
        cones = [Cone((12.0 + 4.0 * k, 3.2 - 6.0 * (k % 2), 0.0)) for k in range(5)]
        matches = draw_positions(np.random.default_rng(seed), RIG, cones).matches
        log = log_of(truth, np.random.default_rng(50 + seed), 0.4, 0.0009, PARAMS)
        motions = [longer(m, 1.015) for m in motions_of(truth, RIG, np.random.default_rng(9 + seed), PARAMS)]
        alone = refine_with_cones(log, RIG, motions, [], IngestParams())
        together = refine_with_cones(log, RIG, motions, matches, IngestParams())
        for result, errors in ((alone, before), (together, after)):
            assert result.outcome is RefinementOutcome.REFINED
            errors.append(slide(pose_errors(result.frame_pairs, truth)))
        assert together.detail.endswith(f"point objects used as landmarks: {len(cones)}")
        for one, other in zip(alone.frame_pairs, together.frame_pairs, strict=True):
            assert one.pose.sigma_enu_m == pytest.approx(other.pose.sigma_enu_m, rel=1e-4)
            assert one.pose.map_t_body_m != other.pose.map_t_body_m
    assert np.mean(after) < 0.6 * np.mean(before)


def test_cones_do_not_bend_what_rtk_says() -> None:
    """Whatever the cones say: the log is better than they are."""
    cones = [Cone((12.0 + 4.0 * k, 3.2 - 6.0 * (k % 2), 0.0)) for k in range(3)]
    matches = draw_positions(np.random.default_rng(1), RIG, cones).matches
    truth = np.stack([se3.map_SE3_body(pair.pose) for pair in make_path(32)])
    rng = np.random.default_rng(2)
    log, motions = log_of(truth, rng, 0.02, 0.0009, PARAMS), motions_of(truth, RIG, rng, PARAMS)
    result = refine_with_cones(log, RIG, motions, matches, IngestParams())
    assert result.outcome is RefinementOutcome.REFINED
    assert result.frame_pairs == refine_with_cones(log, RIG, motions, [], IngestParams()).frame_pairs


def longer(motion: RelativeMotion, factor: float) -> RelativeMotion:
    pose = np.array(motion.second_SE3_first)
    pose[:3, 3] *= factor
    return motion.model_copy(update={"second_SE3_first": se3.to_matrix4(pose)})


def test_without_cones_the_trajectory_is_that_of_visual_odometry() -> None:
    _, log, motions = drive(3)
    alone, result = (
        refined(3),
        refine_with_cones(log, RIG, motions, [], IngestParams()),
    )
    assert np.array_equal(alone.map_SE3_left, result.map_SE3_left)


def test_common_errors_are_not_averaged_out() -> None:
    """Clock, lever arm and a constant offset of GNSS/INS move all poses together, however many records there are."""
    _, log, motions = drive(3)
    result = refine_with_cones(log, RIG, motions, [], IngestParams())
    assert result.covariance is not None
    stated = np.min([pair.pose.sigma_enu_m for pair in log], axis=0)
    assert (np.array([pair.pose.sigma_enu_m for pair in result.frame_pairs]) > 0.8 * stated).all()
    first, last = (result.covariance.of(k)[:3, :3] for k in (0, -1))
    common = chain_solver.cross_covariance(result.covariance, 0, len(log) - 1)[:3, :3]
    difference = first + last - common - common.T
    assert np.diag(difference).max() < 0.5 * np.diag(first).min()  # what is common does not move one against the other


def seen(frame: int, cone: int, xyz: np.ndarray) -> Position:
    place, cov_m2 = tuple(xyz.tolist()), records.cov_of(0.03)
    return records.position(
        frame, cone, xyz_m=place, cov_m2=cov_m2, centre_xyz_m=place, camera_xyz_m=place, camera_cov_m2=cov_m2
    )
