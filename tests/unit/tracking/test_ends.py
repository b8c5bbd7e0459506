from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry.pose import to_matrix4
from conetl.model.drive import Detection
from conetl.model.params import MatchParams
from conetl.model.rig import Camera
from conetl.tracking.matching.ends import board_edges, ground_row
from conetl.tracking.matching.matches import match_pair
from tests.synthetic.world import make_rig

F_PX, BASE_M, CAMERA_HEIGHT_M, FOOT_ROW = 640.0, 0.54, 1.4, 150.0
CAMERA = Camera(width_px=400, height_px=220, fx_px=F_PX, fy_px=F_PX, cx_px=200.0, cy_px=50.0)


def up_of(pitch_rad: float) -> NDArray[np.float64]:
    """In a camera that looks down by an angle."""
    return np.array([0.0, -np.cos(pitch_rad), -np.sin(pitch_rad)])


def ground_disparity(row: NDArray[np.float64], pitch_rad: float) -> NDArray[np.float64]:
    """Of level ground below the camera, in rows of the left image (px)."""
    downwards = np.cos(pitch_rad) * (row - CAMERA.cy_px) / F_PX + np.sin(pitch_rad)
    return np.asarray(F_PX * BASE_M / CAMERA_HEIGHT_M * downwards)


def street(
    pitch_rad: float = 0.0, *, seed: int = 1, contrast: float = 1.0
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Both images of level ground; before it three boards, whose foot would be in `FOOT_ROW`."""
    rng = np.random.default_rng(seed)
    texture, face = (cv2.GaussianBlur(rng.uniform(0, 255, (220, 400, 3)), (0, 0), 1.2) for _ in range(2))
    texture = 128 + contrast * (texture - 128)
    v, u = np.mgrid[0:220, 0:400].astype(np.float32)
    shift = np.maximum(ground_disparity(v, pitch_rad), 0.0).astype(np.float32)
    foot = np.float32(ground_disparity(np.array(FOOT_ROW), pitch_rad))
    boards = (np.abs(v - 80) < 9) | (np.abs(v - 100) < 9) | (np.abs(v - 120) < 9)
    boards = np.where(boards & (np.abs(u - 210) < 38), 1.0, 0.0).astype(np.float32)[..., None]
    left = boards * face + (1 - boards) * texture
    seen = cv2.remap(boards, u + foot, v, cv2.INTER_LINEAR)[..., None]
    right = seen * cv2.remap(face, u + foot, v, cv2.INTER_CUBIC) + (1 - seen) * cv2.remap(
        texture, u + shift, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )
    noisy = [np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8) for image in (left, right)]
    return noisy[0], noisy[1]


def box_of(category: str, end_row: float, off_px: float = 0.0) -> Detection:
    """Of the boards of `street`, ending in a row of the left image."""
    return Detection(
        frame_index=0, side="right" if off_px else "left", detection_index=0, category=category, score=0.9,
        x_px=172.5 - off_px, y_px=71.0, w_px=76.0, h_px=end_row + 0.5 - 71.0,
    )  # fmt: skip


@pytest.mark.parametrize("pitch_rad", [0.0, 0.03])
@pytest.mark.parametrize("end_row", [FOOT_ROW - 5, FOOT_ROW + 7])
def test_an_object_stands_where_the_ground_has_its_disparity(pitch_rad: float, end_row: float) -> None:
    """Whether the box ends at the posts, or at the feet and their shadow."""
    disparity = float(ground_disparity(np.array(FOOT_ROW), pitch_rad))
    row = ground_row(street(pitch_rad), box_of("barricade", end_row), [], disparity, camera=CAMERA, up=up_of(pitch_rad))
    assert row == pytest.approx(FOOT_ROW, abs=0.4)


def test_ground_without_texture_or_above_the_horizon_shows_no_foot() -> None:
    disparity = float(ground_disparity(np.array(FOOT_ROW), 0.0))
    bare = street(contrast=0.0)
    assert ground_row(bare, box_of("barricade", FOOT_ROW), [], disparity, camera=CAMERA, up=up_of(0.0)) is None
    upwards = up_of(-0.2)
    assert ground_row(street(), box_of("barricade", FOOT_ROW), [], disparity, camera=CAMERA, up=upwards) is None


def test_barricades_stand_on_the_ground_and_boxes_alone_count_less() -> None:
    right_pose = [[1.0, 0.0, 0.0, BASE_M], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    rig = make_rig().model_copy(
        update={
            "left": CAMERA, "right": CAMERA,
            "body_SE3_left": to_matrix4(np.eye(4)), "body_SE3_right": to_matrix4(np.array(right_pose)),
        }
    )  # fmt: skip
    off_px = float(ground_disparity(np.array(FOOT_ROW), 0.0))
    left, right = box_of("barricade", FOOT_ROW + 6), box_of("barricade", FOOT_ROW + 8, off_px)
    (seen,), _ = match_pair([left], [right], rig, MatchParams(), up_left=up_of(0.0), images=street())
    (bare,), _ = match_pair([left], [right], rig, MatchParams(), up_left=up_of(0.0), images=street(contrast=0.0))
    rows = np.array([[m.foot_left_uv_px[1], m.foot_right_uv_px[1]] for m in (seen, bare)])
    assert rows.mean(axis=1) == pytest.approx([FOOT_ROW, FOOT_ROW + 7], abs=0.6)
    assert np.diff(rows) == pytest.approx(2.0), "the scatter of the boxes remains"
    assert bare.refined and bare.sigma_v_px > 2 * seen.sigma_v_px


def test_a_board_ends_at_its_edges_not_at_those_of_its_box() -> None:
    rng = np.random.default_rng(2)
    image = cv2.GaussianBlur(rng.uniform(90, 220, (220, 400, 3)), (0, 0), 2.0)
    image[60:110, 150:240] = rng.normal(20, 3, (50, 90, 3))
    image = cv2.GaussianBlur(image, (0, 0), 0.7).clip(0, 255).astype(np.uint8)
    box = Detection(
        frame_index=0, side="left", detection_index=0, category="arrow_board", score=0.9, x_px=153, y_px=58, w_px=90, h_px=55
    )  # fmt: skip
    found = board_edges(image, box)
    ends = (found.x_px, found.x_px + found.w_px, found.y_px, found.y_px + found.h_px)
    assert ends == pytest.approx((150, 240, 60, 110), abs=0.3)
    even = np.full_like(image, 90)
    assert board_edges(even, box) == box, "without any change of colour the box remains"
