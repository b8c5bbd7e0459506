"""Positions of known cones from their stereo matches; covariance by Monte Carlo; all rejections."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.packing import cov_matrix
from conetl.geometry.rectification import rectify
from conetl.model.drive import FramePair, Pose, StereoMatch
from conetl.model.params import PositionParams
from conetl.model.rejections import RejectionReason
from conetl.model.rig import Camera, Rig
from conetl.tracking.positions import locate_in_camera, locate_positions
from tests import records
from tests.synthetic.world import calibrated

Array = NDArray[np.float64]
CAMERA = Camera(width_px=1242, height_px=375, fx_px=721.5, fy_px=721.5, cx_px=609.6, cy_px=172.9)
PARAMS = PositionParams()
BODY_R_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def make_rig(*, body: bool = True) -> Rig:
    left = se3.se3(BODY_R_CAM, [1.08, 0.25, 0.73]) if body else np.eye(4)
    return Rig(
        rig_id="test", left=CAMERA, right=CAMERA, body_SE3_left=se3.to_matrix4(left),
        body_SE3_right=se3.to_matrix4(se3.compose(left, se3.se3(np.eye(3), [0.53, 0, 0]))),
    )  # fmt: skip


RIG = make_rig()
MAP_R_BODY = se3.rotation_from_rpy(0.01, -0.02, 2.0)
PAIR = FramePair(
    frame_index=7, left_path="left.png", right_path="right.png", captured_at_ns=1,
    pose=Pose(
        map_R_body=se3.to_matrix3(MAP_R_BODY), map_t_body_m=(457_808.3, 5_428_849.1, 113.0),
        sigma_enu_m=(0.3, 0.2, 0.5), sigma_rpy_rad=(0.001, 0.001, 0.003),
    ),
)  # fmt: skip


LEFT, RIGHT = (
    records.box(1, 1, 9, 20, frame=7, side=side, score=score) for side, score in (("left", 0.9), ("right", 0.6))
)


def match_of(
    points: dict[str, tuple[Array, Array]], index: int = 0, frame_index: int = 7, **sigmas: float
) -> StereoMatch:
    """A match from the image points (left, right) of foot, centre and tip."""
    uv = {
        f"{name}_{side}_uv_px": (float(p[0]), float(p[1]))
        for name, pair in points.items()
        for side, p in zip(("left", "right"), pair, strict=True)
    }
    values = {"sigma_u_px": 0.2, "sigma_v_px": 0.5, "sigma_pointing_px": 0.0} | sigmas
    return StereoMatch(
        frame_index=frame_index, match_index=index, left=LEFT, right=RIGHT, refined=True, cost=0.1,
        **uv, **values,
    )  # fmt: skip


def up(height_m: float) -> Array:
    return np.array([0.0, 0.0, height_m])


def project_cone(rig: Rig, foot: Array, upwards: Array) -> dict[str, tuple[Array, Array]]:
    """Image points of a cone of 0.7 m with its foot (3,) in the body frame, upwards a unit vector."""
    return {
        name: tuple(  # type: ignore[misc]
            cam.project(rigs.camera_of(rig, side), se3.apply(se3.invert(rigs.body_SE3_camera(rig, side)), point))
            for side in ("left", "right")
        )
        for name, point in (("foot", foot), ("centre", foot + 0.35 * upwards), ("tip", foot + 0.7 * upwards))
    }


def see(foot_map: Array) -> dict[str, tuple[Array, Array]]:
    """Image points of a cone that stands upright in the map."""
    body_SE3_map = se3.invert(se3.map_SE3_body(PAIR.pose))
    return project_cone(RIG, se3.apply(body_SE3_map, foot_map), body_SE3_map[:3, 2])


def ahead(forward_m: float, left_m: float = 0.0, up_m: float = -0.9) -> Array:
    """Map point before the vehicle."""
    return se3.apply(se3.map_SE3_body(PAIR.pose), np.array([forward_m, left_m, up_m]))


def test_a_cone_is_located_at_its_position() -> None:
    foot = ahead(12.0, 2.0)
    positions, rejections = locate_positions([match_of(see(foot))], [PAIR], RIG, PARAMS)
    assert not rejections
    (position,) = positions
    np.testing.assert_allclose(position.xyz_m, foot, atol=1e-6)
    np.testing.assert_allclose(position.centre_xyz_m, foot + up(0.35), atol=1e-6)
    assert position.object_height_m == pytest.approx(0.7, abs=1e-6)
    left = rigs.map_SE3_left(PAIR.pose, RIG)
    np.testing.assert_allclose(se3.apply(left, np.array(position.camera_xyz_m)), foot, atol=1e-6)
    assert position.range_m == pytest.approx(math.hypot(*(foot - left[:3, 3])[:2]), abs=1e-6)
    assert position.camera_xyz_m[2] > 10 and position.camera_xyz_m[1] > 1, "z forward, y down"
    assert position.score == 0.6, "that of the weaker box"
    assert (position.frame_index, position.match_index) == (7, 0)


def test_both_covariances_agree_with_monte_carlo() -> None:
    rng = np.random.default_rng(1)
    foot, draws = ahead(10.0, -1.0), 4000
    exact = see(foot)
    matches = []
    for i in range(draws):
        pointing = np.array([0.4 * rng.normal(), 0.0])
        noisy = {
            name: tuple(p + pointing + [0.2, 0.5] * rng.normal(size=2) for p in pair) for name, pair in exact.items()
        }
        matches.append(match_of(noisy, i, sigma_pointing_px=0.4))  # type: ignore[arg-type]
    positions, rejections = locate_positions(matches, [PAIR], RIG, PARAMS)
    assert not rejections
    (predicted,), _ = locate_positions([match_of(exact, sigma_pointing_px=0.4)], [PAIR], RIG, PARAMS)
    errors = np.array([p.camera_xyz_m for p in positions]) - predicted.camera_xyz_m
    whitened = np.linalg.solve(np.linalg.cholesky(cov_matrix(predicted.camera_cov_m2)), errors.T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.12)  # sigmas doubled: 0.25; halved: 4

    # The map covariance is that of the image turned into the map, plus position and attitude drawn from their sigmas.
    shift = np.array(PAIR.pose.sigma_enu_m) * rng.normal(size=(draws, 3))
    turned = se3.rotation_from_rpy(
        *(np.array([0.01, -0.02, 2.0]) + np.array(PAIR.pose.sigma_rpy_rad) * rng.normal(size=(draws, 3))).T
    )
    bodies = se3.se3(turned, np.array(PAIR.pose.map_t_body_m) + shift)
    in_body = se3.apply(rigs.body_SE3_camera(RIG, "left"), np.array([p.camera_xyz_m for p in positions]))
    errors = se3.apply(bodies, in_body) - foot
    whitened = np.linalg.solve(np.linalg.cholesky(cov_matrix(predicted.cov_m2)), errors.T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.12)


def test_without_a_trajectory_ground_distance_and_height_are_given() -> None:
    rig = make_rig(body=False)
    foot = np.array([1.0, 1.6, 8.0])
    points = project_cone(rig, foot, np.array([0.0, -1.0, 0.0]))
    (position,), rejections = locate_in_camera([match_of(points)], rig, PARAMS)
    assert not rejections
    np.testing.assert_allclose(position.xyz_m, foot, atol=1e-9)
    assert position.ground_distance_m == pytest.approx(math.hypot(1.0, 8.0))
    assert position.object_height_m == pytest.approx(0.7)
    assert position.foot_height_m == pytest.approx(-1.6)
    assert position.centre_height_m == pytest.approx(-1.25)
    # Z^2 sigma_disparity / (f B), nearly along the viewing direction.
    expected = 8.0**2 * 0.2 * math.sqrt(2) / (721.5 * 0.53)
    assert position.ground_distance_sigma_m == pytest.approx(expected, rel=0.03)


SIGMA_PHI = math.radians(0.02)
PHI = {"relative.ry_rad": SIGMA_PHI}


def test_the_error_of_the_calibration_is_in_the_map_covariance_only() -> None:
    rig = calibrated(RIG, PHI)
    matches = [match_of(see(ahead(10.0))), *BAD.values()]
    exact, refused = locate_positions(matches, [PAIR], RIG, PARAMS)
    positions, still_refused = locate_positions(matches, [PAIR], rig, PARAMS)
    assert [r.reason for r in still_refused] == [r.reason for r in refused]
    assert positions[0].xyz_m == exact[0].xyz_m
    assert positions[0].camera_cov_m2 == exact[0].camera_cov_m2, "images of one rig share the error"
    added = cov_matrix(positions[0].cov_m2) - cov_matrix(exact[0].cov_m2)
    values, vectors = np.linalg.eigh(added)
    depth = positions[0].camera_xyz_m[2]
    assert math.sqrt(values[2]) == pytest.approx(depth**2 / 0.53 * SIGMA_PHI, rel=0.03)
    sight = np.subtract(positions[0].xyz_m, rigs.map_SE3_left(PAIR.pose, RIG)[:3, 3])
    assert abs(vectors[:, 2] @ sight) / np.linalg.norm(sight) > 0.999, "it moves the cone along the line of sight"


def test_the_distance_from_one_pair_includes_the_error_of_the_calibration() -> None:
    exact = locate_in_camera([match_of(see(ahead(10.0)))], RIG, PARAMS)[0][0]
    rig = calibrated(RIG, PHI)
    (position,), _ = locate_in_camera([match_of(see(ahead(10.0)))], rig, PARAMS)
    added = math.sqrt(position.ground_distance_sigma_m**2 - exact.ground_distance_sigma_m**2)
    assert added == pytest.approx(exact.xyz_m[2] ** 2 / 0.53 * SIGMA_PHI, rel=0.05)
    assert position.cov_m2[5] > exact.cov_m2[5]


@pytest.mark.parametrize("rows_px", [0.1, 4.0])
def test_the_sigma_of_one_pair_contains_its_own_residual(rows_px: float) -> None:
    """Rows of foot and tip of both images differ by more than their sigmas predict: so may the columns."""
    points = see(ahead(10.0))
    lower = {name: (left, right + np.array([0.0, rows_px])) for name, (left, right) in points.items()}
    (fits,), _ = locate_in_camera([match_of(points)], RIG, PARAMS)
    (position,), _ = locate_in_camera([match_of(lower)], RIG, PARAMS)
    # The difference of two rows with sigmas of 0.5 px, of foot and tip alike.
    ratio = position.ground_distance_sigma_m / fits.ground_distance_sigma_m
    assert ratio == pytest.approx(max(1.0, rows_px / (0.5 * math.sqrt(2))), rel=0.02)


def test_heights_of_a_tilted_rig_are_along_the_body_axis() -> None:
    tilt = se3.rotation_from_rpy(0, math.radians(8), 0) @ BODY_R_CAM
    left = se3.se3(tilt, [1.0, 0.2, 0.7])
    rig = RIG.model_copy(
        update={
            "body_SE3_left": se3.to_matrix4(left),
            "body_SE3_right": se3.to_matrix4(se3.compose(left, se3.se3(np.eye(3), [0.53, 0, 0]))),
        }
    )
    points = project_cone(rig, np.array([9.0, 1.0, -0.9]), up(1.0))
    (position,), _ = locate_in_camera([match_of(points)], rig, PARAMS)
    assert position.object_height_m == pytest.approx(0.7)
    assert position.foot_height_m == pytest.approx(-1.6)
    assert position.ground_distance_m == pytest.approx(math.hypot(8.0, 0.8))


def test_a_raw_rig_without_a_body_measures_in_the_frame_of_its_own_left_camera() -> None:
    """Rectification rotates the image, not the camera: the axes are those of the camera that took it."""
    turned = Rotation.from_euler("xyz", [0.4, -1.5, 0.8], degrees=True).as_matrix()
    raw = RIG.model_copy(
        update={
            "body_SE3_left": se3.to_matrix4(np.eye(4)),
            "body_SE3_right": se3.to_matrix4(se3.se3(turned, [0.53, 0.004, 0.01])),
        }
    )
    flat = rectify(raw)
    assert not rigs.body_is_left_camera(flat)
    foot = np.array([1.0, 1.6, 8.0])
    points = project_cone(flat, foot, np.array([0.0, -1.0, 0.0]))
    (position,), rejections = locate_in_camera([match_of(points)], flat, PARAMS)
    assert not rejections
    np.testing.assert_allclose(position.xyz_m, foot, atol=1e-6)
    np.testing.assert_allclose(position.centre_xyz_m, foot - np.array([0, 0.35, 0]), atol=1e-6)
    assert position.ground_distance_m == pytest.approx(math.hypot(1.0, 8.0))
    assert position.object_height_m == pytest.approx(0.7)
    assert position.foot_height_m == pytest.approx(-1.6)
    along = np.array([1.0, 0.0, 8.0]) / math.hypot(1.0, 8.0)
    sigma = math.sqrt(along @ cov_matrix(position.cov_m2) @ along)
    assert sigma == pytest.approx(position.ground_distance_sigma_m, rel=1e-6)


def shifted(
    points: dict[str, tuple[Array, Array]], u_px: float = 0.0, v_px: float = 0.0
) -> dict[str, tuple[Array, Array]]:
    return {name: (left, right + np.array([u_px, v_px])) for name, (left, right) in points.items()}


BAD = {
    RejectionReason.RAY_ANGLE_TOO_SMALL: match_of(see(ahead(80.0)), 1),
    RejectionReason.RANGE_OUT_OF_BOUNDS: match_of(see(ahead(45.0)), 2),
    RejectionReason.BEHIND_CAMERA: match_of(shifted(see(ahead(10.0)), u_px=80.0), 3),
    RejectionReason.RESIDUAL_TOO_LARGE: match_of(shifted(see(ahead(10.0)), v_px=40.0), 4),
    RejectionReason.POSITION_INVALID: match_of(see(ahead(10.0)), 5, frame_index=8),
}


@pytest.mark.parametrize("locate", ["map", "camera"])
def test_every_bad_match_is_rejected_with_its_reason_and_the_good_ones_stay(locate: str) -> None:
    matches = [match_of(see(ahead(10.0))), *BAD.values(), match_of(see(ahead(20.0)), 6)]
    if locate == "map":
        positions, rejections = locate_positions(matches, [PAIR], RIG, PARAMS)
        expected = list(BAD)
    else:  # without need of a pose
        positions, rejections = locate_in_camera(matches, RIG, PARAMS)  # type: ignore[assignment]
        expected = [reason for reason in BAD if reason is not RejectionReason.POSITION_INVALID]
    assert [r.reason for r in rejections] == expected
    assert len(positions) + len(rejections) == len(matches)
    assert {p.match_index for p in positions} >= {0, 6}
    for rejection in rejections:
        assert rejection.step == "positions"
        assert StereoMatch.model_validate(rejection.payload) in matches, "the payload is the whole record"
        assert len(rejection.detail) > 20


def test_too_few_iterations_and_missing_poses_are_rejections() -> None:
    points = shifted(see(ahead(6.0, 2.0)), v_px=15.0)
    params = PARAMS.model_copy(update={"max_iterations": 1, "max_residual_px": 50.0})
    _, (rejection,) = locate_positions([match_of(points)], [PAIR], RIG, params)
    assert rejection.reason is RejectionReason.NOT_CONVERGED
    assert locate_positions([], [PAIR], RIG, PARAMS) == locate_in_camera([], RIG, PARAMS) == ([], [])
    _, rejections = locate_positions([match_of(see(ahead(10.0)))], [], RIG, PARAMS)
    assert [r.reason for r in rejections] == [RejectionReason.POSITION_INVALID]


def test_an_invalid_position_is_a_rejection_and_no_exception() -> None:
    # A cone straight under the camera: its ground distance of 0 is invalid.
    looking_down = se3.se3(np.diag([1.0, -1.0, -1.0]), [0, 0, 5.0])
    rig = RIG.model_copy(
        update={
            "body_SE3_left": se3.to_matrix4(looking_down),
            "body_SE3_right": se3.to_matrix4(se3.compose(looking_down, se3.se3(np.eye(3), [0.53, 0, 0]))),
        }
    )
    level = Pose(
        map_R_body=se3.to_matrix3(np.eye(3)), map_t_body_m=(0.0, 0.0, 0.0), sigma_enu_m=(0.1, 0.1, 0.1),
        sigma_rpy_rad=(0.0, 0.0, 0.0),
    )  # fmt: skip
    disparity = 721.5 * 0.53 / 5.0
    left, right = np.array([609.6, 172.9]), np.array([609.6 - disparity, 172.9])
    points = dict.fromkeys(("foot", "centre", "tip"), (left, right))
    pair = PAIR.model_copy(update={"pose": level})
    positions, (rejection,) = locate_positions([match_of(points)], [pair], rig, PARAMS)
    assert not positions
    assert rejection.reason is RejectionReason.POSITION_INVALID
    assert "range_m" in rejection.detail
