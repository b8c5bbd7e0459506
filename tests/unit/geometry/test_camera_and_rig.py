"""Projection, rays, horizon and the places of the cameras."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.drive import Pose
from conetl.model.rig import Camera, Lens, Rig
from conetl.readers.rigs.common import rig_of

CAMERA = Camera(width_px=1242, height_px=375, fx_px=721.5, fy_px=720.0, cx_px=609.6, cy_px=172.9)
#: A camera that looks along the body's x axis.
BODY_R_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def make_rig(pitch_down_rad: float = 0.0) -> Rig:
    tilt = se3.rotation_from_rpy(0, pitch_down_rad, 0) @ BODY_R_CAM
    beside = se3.se3(np.eye(3), [0.5, 0, 0])
    return rig_of("test", CAMERA, CAMERA, beside, body_SE3_left=se3.se3(tilt, [1.0, 0.25, 0.7]))


def make_pose(yaw_rad: float = 0.0) -> Pose:
    return Pose(
        map_R_body=se3.to_matrix3(se3.rotation_from_rpy(0, 0, yaw_rad)), map_t_body_m=(4.5e5, 5.4e6, 100.0),
        sigma_enu_m=(0.3, 0.3, 0.5), sigma_rpy_rad=(0.001, 0.001, 0.002),
    )  # fmt: skip


@given(st.floats(-0.7, 0.7), st.floats(-0.4, 0.4), st.floats(0.1, 100))
def test_the_ray_through_an_image_point_passes_through_its_point(x: float, y: float, z: float) -> None:
    plain = cam.rays(CAMERA, cam.project(CAMERA, np.array([x, y, 1.0]) * z))
    np.testing.assert_allclose(plain, [x, y, 1.0], atol=1e-9)
    barrel = Lens(model="brown", coefficients=(-0.35, 0.15, 1e-3, -8e-4, -0.03))
    camera = CAMERA.model_copy(update={"lens": barrel})
    uv = cam.project(camera, np.array([x, y, 1.0]) * z)
    np.testing.assert_allclose(cam.rays(camera, uv), [x, y, 1.0], atol=1e-9)
    if math.hypot(x, y) > 0.2:
        assert np.linalg.norm(uv - cam.project(CAMERA, np.array([x, y, 1.0]))) > 1.0, "a lens that does nothing"


def test_a_point_behind_the_camera_has_no_image() -> None:
    with pytest.raises(ValueError, match="in front"):
        cam.project(CAMERA, np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))


def test_far_points_at_camera_height_lie_on_the_horizon_row() -> None:
    rig = make_rig(pitch_down_rad=math.radians(3))
    map_SE3_left = rigs.map_SE3_left(make_pose(0.4), rig)
    forward = map_SE3_left[:3, 2] * [1, 1, 0]
    far = map_SE3_left[:3, 3] + 1e4 * forward / np.linalg.norm(forward)
    u, v = cam.project(CAMERA, se3.apply(se3.invert(map_SE3_left), far))
    assert abs(cam.horizon_row_px(CAMERA, map_SE3_left[:3, :3], float(u)) - v) < 1e-6
    assert v < CAMERA.cy_px - 30, "a camera that looks down sees the horizon above its principal point"


def test_camera_centres_follow_the_body() -> None:
    rig = make_rig()
    north = make_pose(math.pi / 2)
    left, right = (rigs.map_SE3_camera(north, rig, side)[:3, 3] for side in ("left", "right"))
    # Driving north: forward is +N, left is -E.
    np.testing.assert_allclose(left - np.array(north.map_t_body_m), [-0.25, 1.0, 0.7], atol=1e-9)
    np.testing.assert_allclose(right - left, [0.5, 0, 0], atol=1e-9)
    assert rig.baseline_m == pytest.approx(0.5)
    np.testing.assert_allclose(rigs.left_SE3_right(rig), se3.se3(np.eye(3), [0.5, 0, 0]), atol=1e-12)


@given(st.floats(-0.2, 0.2), st.floats(-0.05, 0.05), st.floats(2.0, 60.0), st.floats(-8.0, 8.0))
def test_no_cone_on_a_level_road_reaches_above_the_first_road_row(
    pitch: float, roll: float, ahead: float, aside: float
) -> None:
    """A camera 1.2 m above the road; the tip of a 1.15 m cone anywhere before it shows at or below that row."""
    rotation = se3.rotation_from_rpy(roll, pitch, 0) @ BODY_R_CAM
    row = cam.first_road_row(CAMERA, [rotation], 0.0)
    tip = rotation.T @ np.array([ahead, aside, 1.15 - 1.2])
    u, v = cam.project(CAMERA, tip)
    if tip[2] > 0.1 and 0 <= u <= CAMERA.width_px - 1:
        assert min(v, CAMERA.height_px - 1) >= row
    lower = cam.first_road_row(CAMERA, [rotation], 0.1)
    assert lower == 0 or row - lower == pytest.approx(CAMERA.fy_px * np.tan(0.1), abs=1.01)


def test_a_camera_that_looks_down_has_no_first_road_row() -> None:
    assert cam.first_road_row(CAMERA, [np.diag([1.0, -1.0, -1.0])], 0.1) == 0


@pytest.mark.parametrize("binning", [1, 2, 4])
def test_a_pixel_of_a_binned_part_is_the_middle_of_its_block(binning: int) -> None:
    whole = make_rig()
    part = rigs.cropped(whole, 10, -6, 800, 320, binning=binning)
    block = np.array([[0.0, 0.0], [3.0, 7.0]])
    middles = block * binning + (binning - 1) / 2 + [10, -6]  # of columns and rows 10 to 13, -6 to -3 ...
    for side in (whole.right, whole.left):
        rays = np.column_stack([(middles - [side.cx_px, side.cy_px]) / [side.fx_px, side.fy_px], [1.0, 1.0]])
        np.testing.assert_allclose(cam.project(part.left if side is whole.left else part.right, rays), block, atol=1e-9)
