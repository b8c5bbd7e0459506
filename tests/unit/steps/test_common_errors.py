"""What all sightings of a cone share stays in its covariance, however many they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.consistency import Nees
from conetl.geometry.joint_fit import fit_point, pair_jacobian
from conetl.geometry.packing import cov_matrix
from conetl.records import CalibrationCovariance, FramePair, Position, Rig
from conetl.steps.common_errors import common_cov
from tests.synthetic.noisy_drive import PoseErrors, draw_positions
from tests.synthetic.world import ORIGIN_M, Cone, camera_poses, make_path, make_rig

Array = NDArray[np.float64]
NAMES = ("left.fx_px", "right.cx_px", "relative.ry_rad", "relative.tx_m")
SIGMAS = np.array([1.5, 0.8, 8e-4, 2e-3])
COVARIANCE = CalibrationCovariance(names=NAMES, matrix=tuple(tuple(row) for row in np.diag(SIGMAS**2).tolist()))
RIG = make_rig().model_copy(update={"calibration_covariance": COVARIANCE})
CONE = Cone((22.0, 3.0, 0.0))


def true_rig(step: Array) -> Rig:
    fx, cx, ry, tx = step.tolist()
    relative = rigs.left_SE3_right(RIG)
    relative[:3, :3] = relative[:3, :3] @ Rotation.from_rotvec([0.0, ry, 0.0]).as_matrix()
    relative[0, 3] += tx
    return RIG.model_copy(
        update={
            "left": RIG.left.model_copy(update={"fx_px": RIG.left.fx_px + fx}),
            "right": RIG.right.model_copy(update={"cx_px": RIG.right.cx_px + cx}),
            "body_SE3_right": se3.to_matrix4(se3.compose(rigs.body_SE3_camera(RIG, "left"), relative)),
        }
    )


def test_one_sighting_carries_what_its_position_carries() -> None:
    drawn = draw_positions(np.random.default_rng(2), RIG, [CONE], PoseErrors(), frames=6)
    pairs = {pair.frame_index: pair for pair in drawn.drive.frame_pairs}
    poses = camera_poses(list(drawn.drive.frame_pairs), RIG, "left")
    assert drawn.positions
    for position in drawn.positions:
        added = common_cov([position], np.eye(3)[None], pairs, RIG, poses)
        turn = poses[position.frame_index][:3, :3]
        image = turn @ cov_matrix(position.camera_cov_m2) @ turn.T
        np.testing.assert_allclose(added + image, cov_matrix(position.cov_m2), rtol=1e-6, atol=1e-12)


def test_many_sightings_with_a_wrong_calibration_stay_inside_what_they_state() -> None:
    """NEES of joint fits over 12 frames, the calibration drawn once a drive: honest with the common part, far off without."""
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
    honest, proud = Nees(0.0, 0), Nees(0.0, 0)
    for _ in range(200):
        actual = true_rig(rng.normal(0, SIGMAS))
        right = np.stack(list(camera_poses(pairs, actual, "right").values()))
        exact, _ = pair_jacobian(truth, nominal[0], right, *constants(actual))
        observed = exact + rng.normal(0, 0.4, exact.shape)
        fit = fit_point(observed, truth, *nominal, *constants(RIG), **stated)
        assert fit is not None
        group = [position_at(pair, left[pair.frame_index], fit.xyz_m) for pair in pairs]
        common = common_cov(group, fit.shares, by_index, RIG, left)
        off = fit.xyz_m - truth
        honest += Nees(float(off @ np.linalg.solve(fit.cov_m2 + common, off)), 3)
        proud += Nees(float(off @ np.linalg.solve(fit.cov_m2, off)), 3)
    assert honest.holds(0.99)
    assert proud.per_dof > 2


def position_at(pair: FramePair, map_SE3_left: Array, xyz_m: Array) -> Position:
    """What a frame pair says of a point; of no account here are all fields but its place."""
    in_camera = se3.apply(se3.invert(map_SE3_left), xyz_m).tolist()
    return Position(
        frame_index=pair.frame_index, match_index=0, xyz_m=tuple(xyz_m.tolist()), cov_m2=(1, 0, 0, 1, 0, 1),
        centre_xyz_m=tuple(xyz_m.tolist()), cone_height_m=0.7, camera_xyz_m=tuple(in_camera), camera_cov_m2=(1, 0, 0, 1, 0, 1),
        range_m=in_camera[2], ray_angle_rad=0.03, residual_rms_px=0.1, iterations=3, score=0.9,
    )  # fmt: skip


def constants(rig: Rig) -> tuple[Array, Array]:
    focal = np.array([rig.left.fx_px, rig.left.fy_px, rig.right.fx_px, rig.right.fy_px])
    return focal, np.array([rig.left.cx_px, rig.left.cy_px, rig.right.cx_px, rig.right.cy_px])
