"""When a drive's self-calibration is applied, and the rig after it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.calibration.covariance import calibration_cov, calibration_id, shared_errors
from conetl.geometry.camera import project
from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.rectification import raw_from_rectified
from conetl.geometry.rig import infinity_shift_px, left_SE3_right
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Lens, Rig
from conetl.tracking.self_calibration import (
    SWITCHED_OFF,
    SelfCalibration,
    SelfCalibrationOutcome,
    Span,
    choose_spans,
    self_calibrate,
    self_calibrated_rig,
    with_assumed_errors,
    with_measured_scale,
)
from tests.synthetic.spans import CX_PX, FOCAL_PX, followed, make_span, motion
from tests.synthetic.world import calibrated, make_rig

PARAMS = TrajectoryParams()
RIG = make_rig()
TURN = np.array([0.2, -0.6, 0.2]) / FOCAL_PX


def found_by(
    rig: Rig = RIG,
    turn: np.ndarray = TURN,
    seed: int = 1,
    spans: int = 14,
    params: TrajectoryParams = PARAMS,
    bend_px: float = 0.0,
) -> SelfCalibration:
    rng = np.random.default_rng(seed)
    chosen, tracks = [], []
    for k in range(spans):
        made = make_span(rng, turn, points=80)
        for seen in (made.first_px, made.last_px):
            seen[:, 2] += bend_px * ((seen[:, 2] - CX_PX) / FOCAL_PX) ** 2
        chosen.append(Span(k, k + 1, made.last_SE3_first))
        tracks.append(followed(made, k))
    return self_calibrate(rig, chosen, tracks, params)


def turns(sigma_px: float) -> dict[str, float]:
    return {f"relative.r{axis}_rad": sigma_px / FOCAL_PX for axis in "xyz"}


#: With principal point and focal length.
FULL = {
    "left.fx_px": 2.0, "right.cx_px": 0.7, "relative.ry_rad": 0.7 / FOCAL_PX, "relative.rx_rad": 0.5 / FOCAL_PX,
    "relative.rz_rad": 0.5 / FOCAL_PX,
}  # fmt: skip


def disparity_sigma_px(rig: Rig) -> float:
    """Of the middle of the image, by the calibration."""
    depth_sigma_m = float(np.sqrt(calibration_cov(np.array([[0.0, 0.0, 10.0]]), rig)[0, 2, 2]))
    return depth_sigma_m * FOCAL_PX * RIG.baseline_m / 100


def moves(*ways_m: float, turn_rad: float = 0.0) -> list[np.ndarray]:
    return [motion(way, turn_rad) for way in ways_m]


def test_a_turned_camera_is_found_and_applied() -> None:
    found = found_by()
    assert found.outcome is SelfCalibrationOutcome.APPLIED
    assert np.array(found.rotation_rad) * FOCAL_PX == pytest.approx(TURN * FOCAL_PX, abs=0.12)
    rig = self_calibrated_rig(RIG, found, PARAMS)
    turned = left_SE3_right(RIG)[:3, :3].T @ left_SE3_right(rig)[:3, :3]
    assert found.rotation_rad is not None
    rx, ry, rz = found.rotation_rad
    assert Rotation.from_matrix(turned).as_rotvec() == pytest.approx([rx, ry - found.bend, rz], abs=1e-9)
    assert rig.right.cx_px - RIG.right.cx_px == pytest.approx(-found.bend * RIG.right.fx_px)
    assert left_SE3_right(rig)[:3, 3] == pytest.approx(left_SE3_right(RIG)[:3, 3])
    assert "mrad" in found.detail and "px" in found.detail


def test_a_bend_is_found_and_applied() -> None:
    """The sides of a bent image are corrected, too, and their remaining uncertainty is stated."""
    found = found_by(bend_px=1.6)
    assert found.outcome is SelfCalibrationOutcome.APPLIED
    assert found.bend * FOCAL_PX == pytest.approx(1.6, abs=0.5)
    assert np.array(found.rotation_rad) * FOCAL_PX == pytest.approx(TURN * FOCAL_PX, abs=0.15)
    after = self_calibrated_rig(RIG, found, PARAMS)
    side = np.array([[8.0, 0.0, 10.0]])
    sigma_px = FOCAL_PX * RIG.baseline_m / 100 * float(np.sqrt(calibration_cov(side, after)[0, 2, 2]))
    assert 0.05 < sigma_px < 0.35
    assert "bent" in found.detail


def test_a_calibration_with_exact_principal_points_is_not_bent() -> None:
    """If only the orientation is uncertain, only the turn is corrected."""
    rig = calibrated(RIG, turns(0.7))
    found = found_by(rig)
    assert found.outcome is SelfCalibrationOutcome.APPLIED
    assert found.bend == 0.0
    assert self_calibrated_rig(rig, found, PARAMS).right == RIG.right


def test_the_remaining_uncertainty_is_an_error_of_the_calibration() -> None:
    rig = self_calibrated_rig(RIG, found_by(), PARAMS)
    assert rig.calibration_covariance is not None
    assert rig.calibration_covariance.names == (
        "relative.rx_rad", "relative.ry_rad", "relative.rz_rad", "right.cx_px",
        "relative.tx_m", "relative.ty_m", "relative.tz_m",
    )  # fmt: skip
    matrix = np.array(rig.calibration_covariance.matrix)[:4, :4]
    middle = np.array([0, FOCAL_PX, 0, -1])  # turn and principal point: only their sum moves the middle of the image
    sigma_px = np.sqrt(middle @ matrix @ middle)
    assert 0.05 <= sigma_px < 0.2
    assert 0.05 <= np.sqrt(matrix[3, 3]) < 0.3  # and the bend determines the principal point
    depth_sigma_m = float(np.sqrt(calibration_cov(np.array([[0.0, 0.0, 10.0]]), rig)[0, 2, 2]))
    by_turn_m, by_scale_m = 100 * sigma_px / (FOCAL_PX * RIG.baseline_m), 10 * PARAMS.scale_sigma
    assert depth_sigma_m == pytest.approx(np.hypot(by_turn_m, by_scale_m), rel=0.05)


def test_insignificant_and_small_corrections_are_not_applied() -> None:
    found = found_by(turn=np.zeros(3))
    assert found.outcome is SelfCalibrationOutcome.INSIGNIFICANT
    stated = calibrated(RIG, FULL)
    assert self_calibrated_rig(stated, found, PARAMS) is stated
    rig = self_calibrated_rig(RIG, found, PARAMS)
    assert rig.body_SE3_right == RIG.body_SE3_right and rig.right == RIG.right
    assert disparity_sigma_px(rig) < 0.2 < PARAMS.self_calibration_prior_px, "it was measured"
    coarse = PARAMS.model_copy(update={"self_calibration_least_px": 1.0})
    assert found_by(params=coarse).outcome is SelfCalibrationOutcome.INSIGNIFICANT


def test_an_implausible_correction_of_a_good_calibration_is_not_applied() -> None:
    rig = calibrated(RIG, turns(0.03))
    found = found_by(rig)
    assert found.outcome is SelfCalibrationOutcome.IMPLAUSIBLE
    assert self_calibrated_rig(rig, found, PARAMS) is rig


def test_a_known_covariance_is_reduced_and_not_replaced() -> None:
    """Principal point and turn are correlated: the estimate of their sum corrects both."""
    rig, sigma = calibrated(RIG, FULL), np.array(list(FULL.values()))
    found = found_by(rig)
    assert found.outcome is SelfCalibrationOutcome.APPLIED
    after = self_calibrated_rig(rig, found, PARAMS).calibration_covariance
    assert after is not None and after.names == tuple(FULL)
    matrix = np.array(after.matrix)
    assert np.linalg.eigvalsh(matrix / np.outer(sigma, sigma)).min() > -1e-9
    assert matrix[0, 0] == pytest.approx(4.0)
    both = np.array([0, -1 / FOCAL_PX, 1, 0, 0])
    assert np.sqrt(both @ matrix @ both) * FOCAL_PX < 0.2
    assert np.sqrt(matrix[2, 2]) * FOCAL_PX < 0.3  # separated from the principal point by the bend


def test_of_unknown_accuracy_a_calibration_has_one_id_in_all_drives() -> None:
    rigs = [self_calibrated_rig(RIG, found_by(bend_px=bend_px), PARAMS) for bend_px in (0.0, 1.6)]
    one, other = (shared_errors(rig) for rig in rigs)
    assert one is not None and other is not None and one.calibration == other.calibration


def test_shared_errors_are_part_of_the_remaining_covariance() -> None:
    """Two drives correct the same calibration: undetermined errors stay common, the scatter of spans is of one drive."""
    given, sigma = calibrated(RIG, FULL), np.array(list(FULL.values()))
    after = [self_calibrated_rig(given, found_by(given, bend_px=bend_px), PARAMS) for bend_px in (0.0, 1.6)]
    both = [shared_errors(rig) for rig in after]
    assert both[0] is not None and both[1] is not None
    assert both[0].calibration == both[1].calibration == calibration_id(given)
    for rig, shared in zip(after, both, strict=True):
        assert rig.calibration_covariance is not None and shared is not None
        part, whole = np.array(shared.matrix), np.array(rig.calibration_covariance.matrix)
        own = (whole - part @ part.T) / np.outer(sigma, sigma)
        assert np.linalg.eigvalsh(own).min() > -1e-9
        assert own[2, 2] > 1e-5
        # The left camera's focal length is undetermined: its error is unchanged and common.
        assert part[0] == pytest.approx([2.0, *[0.0] * (part.shape[1] - 1)], abs=1e-9)
    one, other = (np.array(shared.matrix) for shared in both if shared is not None)
    common = one @ other.T
    # Only the bend separates turn and principal point of the right camera: much of their error remains, in both drives alike.
    correlation = common[1, 1] / np.sqrt((one @ one.T)[1, 1] * (other @ other.T)[1, 1])
    assert correlation > 0.8


def test_the_camera_of_raw_images_is_turned_likewise_and_images_stay() -> None:
    lens = Lens(model="radial", coefficients=(-0.1, 0.01))
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 0.005]).as_matrix()
    raw = RIG.model_copy(
        update={
            "right": RIG.right.model_copy(update={"lens": lens}),
            "body_SE3_right": se3.to_matrix4(np.array(RIG.body_SE3_right) @ tilt),
        }
    )
    rig = RIG.model_copy(update={"rectified_from": raw})
    found = found_by(rig)
    after = self_calibrated_rig(rig, found, PARAMS)
    points = np.array([[100.0, 50.0], [600.0, 180.0], [1200.0, 360.0]])
    assert raw_from_rectified(after, "right", points) == pytest.approx(
        raw_from_rectified(rig, "right", points), abs=1e-6
    )
    assert after.rectified_from is not None and after.rectified_from.calibration_covariance is not None
    assert after.calibration_covariance is None
    turned = left_SE3_right(RIG)[:3, :3].T @ left_SE3_right(after)[:3, :3]
    assert Rotation.from_matrix(turned).as_rotvec() == pytest.approx(np.array(found.rotation_rad), abs=1e-9)


def test_infinity_is_where_a_turned_camera_projects_it() -> None:
    assert infinity_shift_px(RIG, np.array([300.0, 200.0])) == pytest.approx([0.0, 0.0], abs=1e-9)
    rig = self_calibrated_rig(RIG, found_by(), PARAMS)
    far_left = np.array([-4e5, 1e5, 1e6])
    far_right = se3.apply(se3.invert(left_SE3_right(rig)), far_left)
    shift = project(rig.left, far_left) - project(rig.right, far_right)
    assert infinity_shift_px(rig, project(rig.left, far_left)) == pytest.approx(shift, abs=1e-3)


def test_a_long_drive_is_represented_by_spans_from_all_of_it() -> None:
    spans = list(choose_spans(moves(*[2.0] * 1000), 2.0))
    assert len(spans) == 1000
    chosen = evenly_spaced(spans, 120)
    assert (len(chosen), chosen[0], chosen[-1]) == (120, spans[0], spans[-1])
    steps = np.diff([span.first for span in chosen])
    assert set(steps) == {8, 9}
    assert evenly_spaced(spans[:120], 120) == spans[:120]


def test_spans_are_consecutive() -> None:
    spans = list(choose_spans(moves(0.8, 0.8, 0.8, 0.8, 1.5, 1.5), 2.0))
    assert [(s.first, s.last) for s in spans] == [(0, 3), (3, 5)]
    assert np.linalg.norm(spans[0].last_SE3_first[:3, 3]) == pytest.approx(2.4, abs=0.05)


def test_a_standing_or_turning_car_gives_no_estimate() -> None:
    for turn in (0.0, 0.1):
        spans = list(choose_spans(moves(*[0.0] * 40, turn_rad=turn), 2.0))
        assert spans == []
    found = self_calibrate(RIG, [], [], PARAMS)
    assert found.outcome is SelfCalibrationOutcome.NO_ESTIMATE
    for unmeasured in (found, SWITCHED_OFF):
        rig = self_calibrated_rig(RIG, unmeasured, PARAMS)
        assert rig == with_assumed_errors(RIG, PARAMS)
        assert disparity_sigma_px(rig) == pytest.approx(PARAMS.self_calibration_prior_px, rel=0.1)
    stated = calibrated(RIG, FULL)
    assert self_calibrated_rig(stated, SWITCHED_OFF, PARAMS) is stated


def test_distances_of_the_log_show_the_scale_of_a_calibration_that_states_no_errors() -> None:
    assumed = with_assumed_errors(RIG, PARAMS)
    sigmas = [
        rig.calibration_covariance.sigmas["relative.tx_m"] / RIG.baseline_m
        for rig in (
            with_measured_scale(assumed, RIG, scale, PARAMS) for scale in (None, (0.0003, 0.0004), (0.01, 0.001))
        )
        if rig.calibration_covariance is not None
    ]
    assert sigmas == pytest.approx([PARAMS.scale_sigma, 0.0005, PARAMS.scale_sigma])
    measured = with_measured_scale(assumed, RIG, (0.0003, 0.0004), PARAMS)
    one, other = shared_errors(assumed), shared_errors(measured)
    assert one is not None and other is not None and one.calibration == other.calibration
    assert disparity_sigma_px(measured) == pytest.approx(disparity_sigma_px(assumed), rel=0.03)
    stated = calibrated(RIG, FULL)
    assert with_measured_scale(stated, stated, (0.0003, 0.0004), PARAMS) is stated


def test_drives_of_an_unstated_calibration_share_its_errors_measured_or_not() -> None:
    """An error of the calibration moves what both drives see alike: the measured part is smaller, and correlated."""
    found = [found_by(), found_by(turn=np.zeros(3)), SWITCHED_OFF]
    shared = [shared_errors(self_calibrated_rig(RIG, one, PARAMS)) for one in found]
    assert len({one.calibration for one in shared if one is not None}) == 1
    for one, calibration in zip(shared, found, strict=True):
        covariance = self_calibrated_rig(RIG, calibration, PARAMS).calibration_covariance
        assert one is not None and covariance is not None
        part, whole = np.array(one.matrix), np.array(covariance.matrix)
        kept = np.diag(whole) > 0
        scale = np.sqrt(np.diag(whole)[kept])
        own = (whole - part @ part.T)[np.ix_(kept, kept)] / np.outer(scale, scale)
        assert np.linalg.eigvalsh(own).min() > -1e-9
