"""Which calibration a rig has, and what its errors do, the same way in every drive."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.calibration.covariance import (
    calibration_id,
    calibration_jacobian,
    jacobian_of,
    shared_cov,
    shared_errors,
    square_root,
    unpack_jacobians,
    with_covariance,
)
from conetl.geometry.packing import as_rows
from conetl.model.rig import CalibrationCovariance, Rig
from tests.synthetic.world import make_rig

NAMES = ("left.fx_px", "left.cx_px", "right.cx_px", "relative.ry_rad", "relative.tx_m")
SIGMAS = np.array([1.5, 0.0, 0.8, 8e-4, 2e-3])


def covariance(correlation: float = 0.6) -> CalibrationCovariance:
    correlations = np.full((5, 5), correlation) + (1 - correlation) * np.eye(5)
    return CalibrationCovariance(names=NAMES, matrix=as_rows(correlations * np.outer(SIGMAS, SIGMAS)))


RIG = with_covariance(make_rig(), covariance())


def turned(rig: Rig) -> Rig:
    """The same pair of cameras, bolted to the car another way."""
    mount = se3.se3(Rotation.from_rotvec([0.01, -0.3, 0.2]).as_matrix(), [1.0, 0.2, -0.4])
    left, right = (se3.to_matrix4(se3.compose(mount, pose)) for pose in (rig.body_SE3_left, rig.body_SE3_right))
    return rig.model_copy(update={"body_SE3_left": left, "body_SE3_right": right})


def test_a_calibration_is_the_same_whatever_the_rig_is_called_and_wherever_it_is_mounted() -> None:
    assert calibration_id(RIG.model_copy(update={"rig_id": "another", "sigma_px": 0.7})) == calibration_id(RIG)
    assert calibration_id(turned(RIG)) == calibration_id(RIG)
    assert calibration_id(Rig.model_validate_json(RIG.model_dump_json())) == calibration_id(RIG)


def test_another_calibration_is_another_one() -> None:
    camera = RIG.left.model_copy(update={"fx_px": RIG.left.fx_px + 1e-6})
    pose = np.array(RIG.body_SE3_right)
    pose[1, 3] += 1e-6
    others = [
        RIG.model_copy(update={"left": camera}),
        RIG.model_copy(update={"body_SE3_right": se3.to_matrix4(pose)}),
        with_covariance(RIG, covariance(0.5)),
        make_rig(),
    ]
    assert len({calibration_id(rig) for rig in [RIG, *others]}) == 5


def test_the_calibration_of_a_rectified_rig_is_that_of_the_one_that_took_the_images() -> None:
    wider = make_rig().model_copy(update={"left": RIG.left.model_copy(update={"width_px": 2000})})
    rectified = wider.model_copy(update={"rectified_from": RIG})
    assert calibration_id(rectified) == calibration_id(RIG)
    assert shared_errors(rectified) == shared_errors(RIG)


def test_levers_are_the_square_root_of_the_calibrations_part() -> None:
    jacobian = calibration_jacobian(np.array([[2.0, 1.0, 9.0]]), RIG)[0]
    shared_jacobian = jacobian_of(jacobian, RIG)
    assert shared_jacobian is not None and shared_jacobian.calibrations == (calibration_id(RIG),)
    moved = unpack_jacobians(shared_jacobian.calibrations, [shared_jacobian])[0, 0]
    assert moved.shape == (3, 4)  # one of the five parameters is exact
    np.testing.assert_allclose(moved @ moved.T, shared_cov(jacobian, RIG), rtol=1e-5, atol=1e-9)


def test_the_square_root_does_not_depend_on_the_order_of_the_parameters() -> None:
    """So that the same error has the same sign and size wherever it is worked out."""
    matrix = np.array(covariance().matrix)
    root = square_root(matrix)
    np.testing.assert_allclose(root @ root.T, matrix, atol=1e-12)
    order = [4, 2, 0, 1, 3]
    other = square_root(matrix[np.ix_(order, order)])
    uncertain = [k for k in order if SIGMAS[k] > 0]
    np.testing.assert_allclose(other, root[order][:, [[0, 2, 3, 4].index(k) for k in uncertain]], atol=1e-12)


def test_a_rig_of_unknown_accuracy_has_no_levers() -> None:
    rig = make_rig()
    assert shared_errors(rig) is None
    assert jacobian_of(np.zeros((3, 0)), rig) is None


def test_a_calibration_that_is_stated_to_be_exact_has_none_either() -> None:
    exact = CalibrationCovariance(names=("left.fx_px",), matrix=((0.0,),))
    assert jacobian_of(np.ones((3, 1)), with_covariance(make_rig(), exact)) is None
