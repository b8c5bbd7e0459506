"""Following points through pictures of a textured wall and floor whose geometry is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry.rig import left_SE3_right, map_SE3_left
from conetl.io.drive_folder import read_drive
from conetl.io.pictures.images import ImageFileError, read_image
from conetl.io.visual_odometry import measure_motions
from conetl.params import TrajectoryParams
from conetl.records import FramePair, Lens, Side
from conetl.rejections import RejectionReason
from tests.synthetic.world import make_path, make_rig

Picture = NDArray[np.uint8]
SAMPLE = Path(__file__).resolve().parents[3] / "data" / "drives" / "2026-03-02_taper_pass1"
PARAMS = TrajectoryParams()
RIG = make_rig()
PAIRS = make_path(3, step_m=0.4)
WALL_M = 14.0


def wall_picture(pair: FramePair, side: Side) -> Picture:
    """A wall across the road, WALL_M ahead of the first pair, painted with blobs."""
    rng = np.random.default_rng(11)
    texture = cv2.GaussianBlur(rng.integers(0, 255, (700, 2200)).astype(np.uint8), (0, 0), 2.0)
    texture = cv2.normalize(texture, None, 10, 245, cv2.NORM_MINMAX)
    first, now = (map_SE3_left(p.pose, RIG) for p in (PAIRS[0], pair))
    pose = now if side == "left" else se3.compose(now, left_SE3_right(RIG))
    camera_SE3_first = se3.compose(se3.invert(pose), first)
    camera = RIG.left
    scale = 0.012  # metres a texel, in the plane z = WALL_M of the first left camera
    plane = np.array([[scale, 0, -1100 * scale], [0, scale, -350 * scale], [0, 0, WALL_M]])
    k = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    homography = k @ (camera_SE3_first[:3, :3] @ plane + np.outer(camera_SE3_first[:3, 3], [0, 0, 1]))
    size = (camera.width_px, camera.height_px)
    noise = np.random.default_rng([pair.frame_index, side == "left"]).normal(0, 2.0, size[::-1])
    warped = cv2.warpPerspective(texture, homography, size, flags=cv2.INTER_LINEAR)
    return np.clip(warped + noise, 0, 255).astype(np.uint8)


def reasons(read: Callable[[FramePair, Side], Picture], pairs: list[FramePair] = PAIRS) -> list[str]:
    return [motion.reason for motion in measure_motions(pairs, RIG, read, PARAMS)]


def test_the_motion_before_a_wall_comes_out() -> None:
    motions = list(measure_motions(PAIRS, RIG, wall_picture, PARAMS))
    assert [m.reason for m in motions] == ["ok", "ok"]
    for motion in motions:
        found = np.array(motion.second_SE3_first)
        assert found[:3, 3] == pytest.approx([0.0, 0.0, -0.4], abs=0.02)
        sigma = np.sqrt(np.diag(motion.cov_matrix()))
        assert (sigma > 0).all() and sigma[3:].max() < 0.02


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (9, 70), (64, 64)])
def test_tiny_pictures_give_no_measurement(shape: tuple[int, int]) -> None:
    """Half and a quarter of their size hold no window, and below one pixel there is no picture."""
    noise = np.random.default_rng(0).integers(0, 255, (len(PAIRS), 2, *shape)).astype(np.uint8)
    pictures = {
        (p.frame_index, side): noise[i, j] for i, p in enumerate(PAIRS) for j, side in enumerate(("left", "right"))
    }
    found = reasons(lambda pair, side: pictures[pair.frame_index, side])
    assert set(found) <= {"too_few_points", "picture_blank"}


def test_equal_input_gives_equal_output() -> None:
    assert list(measure_motions(PAIRS, RIG, wall_picture, PARAMS)) == list(
        measure_motions(PAIRS, RIG, wall_picture, PARAMS)
    )


def test_dark_blank_and_frozen_pictures_say_so() -> None:
    size = (RIG.left.height_px, RIG.left.width_px)
    assert reasons(lambda pair, side: np.zeros(size, np.uint8)) == ["picture_blank"] * 2
    assert reasons(lambda pair, side: np.full((*size, 3), 200, np.uint8)) == ["picture_blank"] * 2
    assert reasons(lambda pair, side: wall_picture(PAIRS[0], side)) == ["picture_frozen"] * 2


def test_noise_alone_gives_no_measurement() -> None:
    def noise(pair: FramePair, side: Side) -> Picture:
        rng = np.random.default_rng([pair.frame_index, side == "left"])
        return rng.integers(0, 255, (RIG.left.height_px, RIG.left.width_px)).astype(np.uint8)

    assert set(reasons(noise)) <= {"too_few_points", "no_consensus", "degenerate"}


def test_a_missing_picture_costs_its_two_intervals_only() -> None:
    pairs = make_path(5, step_m=0.4)

    def read(pair: FramePair, side: Side) -> Picture:
        if pair.frame_index == 2 and side == "right":
            raise ImageFileError(RejectionReason.IMAGE_MISSING, "2.jpg: there is no such file")
        return wall_picture(pair, side)

    assert reasons(read, pairs) == ["ok", "picture_unreadable", "picture_unreadable", "ok"]


def test_a_standing_car_measures_that_it_stands() -> None:
    def read(pair: FramePair, side: Side) -> Picture:
        still = wall_picture(PAIRS[0], side).astype(np.float64)
        noise = np.random.default_rng([7, pair.frame_index, side == "left"]).normal(0, 2.0, still.shape)
        return np.clip(still + noise, 0, 255).astype(np.uint8)

    standing = [pair.model_copy(update={"pose": PAIRS[0].pose}) for pair in PAIRS]
    for motion in measure_motions(standing, RIG, read, PARAMS):
        assert motion.reason == "ok"
        assert np.abs(np.array(motion.second_SE3_first) - np.eye(4)).max() < 0.01


def test_the_sample_drive_moves_as_its_log_says() -> None:
    """Rendered pictures, poses of RTK grade: 1.4 m a frame, agreed within 2 cm."""
    found, _ = read_drive(SAMPLE)
    pairs = found.frame_pairs[10:14]

    def read(pair: FramePair, side: Side) -> Picture:
        return read_image(Path(pair.left_path if side == "left" else pair.right_path))

    for motion, first, second in zip(measure_motions(pairs, found.rig, read, PARAMS), pairs, pairs[1:], strict=False):
        logged = se3.compose(se3.invert(map_SE3_left(second.pose, found.rig)), map_SE3_left(first.pose, found.rig))
        assert motion.reason == "ok"
        assert np.linalg.norm(np.array(motion.second_SE3_first)[:3, 3] - logged[:3, 3]) < 0.03


def test_a_rig_with_a_lens_is_refused() -> None:
    lens = Lens(model="radial", coefficients=(0.1, 0.0))
    raw = RIG.model_copy(update={"left": RIG.left.model_copy(update={"lens": lens})})
    with pytest.raises(ValueError, match="rectified"):
        list(measure_motions(PAIRS, raw, wall_picture, PARAMS))
