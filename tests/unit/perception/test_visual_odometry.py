"""Following points through images of a textured wall and floor whose geometry is known."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import motions_of
from conetl.geometry.rig import camera_of, left_SE3_right, map_SE3_left
from conetl.model.drive import FramePair
from conetl.model.params import TrajectoryParams
from conetl.model.rejections import RejectionReason
from conetl.model.rig import Camera, Lens, Rig, Side
from conetl.perception.images import ImageFileError
from conetl.perception.visual_odometry import follow_drive
from tests.synthetic.world import make_path, make_rig

Image = NDArray[np.uint8]
PARAMS = TrajectoryParams()
RIG = make_rig()
PAIRS = make_path(3, step_m=0.4)
WALL_M = 14.0


def wall_image(pair: FramePair, side: Side, rig: Rig = RIG) -> Image:
    """A wall across the road, WALL_M ahead of the first pair, painted with blobs."""
    rng = np.random.default_rng(11)
    texture = cv2.GaussianBlur(rng.integers(0, 255, (700, 2200)).astype(np.uint8), (0, 0), 2.0)
    texture = cv2.normalize(texture, None, 10, 245, cv2.NORM_MINMAX)
    first, now = (map_SE3_left(p.pose, rig) for p in (PAIRS[0], pair))
    pose = now if side == "left" else se3.compose(now, left_SE3_right(rig))
    camera_SE3_first = se3.compose(se3.invert(pose), first)
    camera = camera_of(rig, side)
    scale = 0.012  # metres a texel, in the plane z = WALL_M of the first left camera
    plane = np.array([[scale, 0, -1100 * scale], [0, scale, -350 * scale], [0, 0, WALL_M]])
    k = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    homography = k @ (camera_SE3_first[:3, :3] @ plane + np.outer(camera_SE3_first[:3, 3], [0, 0, 1]))
    size = (camera.width_px, camera.height_px)
    noise = np.random.default_rng([pair.frame_index, side == "left"]).normal(0, 2.0, size[::-1])
    warped = cv2.warpPerspective(texture, homography, size, flags=cv2.INTER_LINEAR)
    return np.clip(warped + noise, 0, 255).astype(np.uint8)


def measure_motions(
    pairs: list[FramePair], rig: Rig, read: Callable[[FramePair, Side], Image], params: TrajectoryParams
) -> list[RelativeMotion]:
    return list(motions_of(follow_drive(pairs, rig, read, params), pairs, rig, params))


def reasons(read: Callable[[FramePair, Side], Image], pairs: list[FramePair] = PAIRS, rig: Rig = RIG) -> list[str]:
    return [motion.reason for motion in measure_motions(pairs, rig, read, PARAMS)]


def rig_with(*, left: dict[str, float] | None = None, right: dict[str, float] | None = None) -> Rig:
    """RIG with other numbers of its cameras; its principal points may be moved by `dcx`, `dcy`."""
    cameras = {}
    for side, changes in (("left", left or {}), ("right", right or {})):
        camera = camera_of(RIG, side)  # type: ignore[arg-type]
        moved = {
            f"c{axis}_px": getattr(camera, f"c{axis}_px") + changes[f"dc{axis}"]
            for axis in "xy"
            if f"dc{axis}" in changes
        }
        sizes = {key: value for key, value in changes.items() if key.endswith("_px")}
        cameras[side] = camera.model_copy(update={**sizes, **moved})
    return RIG.model_copy(update=cameras)


def assert_moved_before_the_wall(rig: Rig, params: TrajectoryParams = PARAMS) -> list[RelativeMotion]:
    motions = measure_motions(PAIRS, rig, lambda pair, side: wall_image(pair, side, rig), params)
    assert [m.reason for m in motions] == ["ok", "ok"]
    for motion in motions:
        found = np.array(motion.second_SE3_first)
        assert found[:3, 3] == pytest.approx([0.0, 0.0, -0.4], abs=0.02)
        sigma = np.sqrt(np.diag(motion.cov_matrix()))
        assert (sigma > 0).all() and sigma[3:].max() < 0.02
    return motions


@pytest.mark.parametrize(
    "rig",
    [
        rig_with(right={"dcx": -60.0, "dcy": -4.0}),
        rig_with(right={"dcx": 52.5, "dcy": 15.0}),
        rig_with(right={"width_px": 1100, "height_px": 370}),
        rig_with(left={"width_px": 1101, "dcx": -40.0, "dcy": 6.0}),
    ],
    ids=lambda rig: (
        f"{rig.left.width_px}+{rig.right.width_px}, {rig.right.cx_px - rig.left.cx_px:g}, {rig.right.cy_px - rig.left.cy_px:g}"
    ),
)
@pytest.mark.parametrize("max_width_px", [1280, 900])
def test_sides_may_differ_in_size_and_principal_point(rig: Rig, max_width_px: int) -> None:
    """As rectification leaves them. Nearly as many points as between equal sides take part."""
    params = PARAMS.model_copy(update={"max_width_px": max_width_px})
    equal = assert_moved_before_the_wall(RIG, params)
    for motion, other in zip(assert_moved_before_the_wall(rig, params), equal, strict=True):
        assert motion.inlier_count > 0.8 * other.inlier_count


def test_no_point_lies_in_the_padding() -> None:
    """The narrower image ends in the middle of the wall: what lies beyond is seen by the other side only."""
    for narrow in ("left", "right"):
        rig = rig_with(**{narrow: {"width_px": 700}})  # type: ignore[arg-type]
        tracks = follow_drive(PAIRS, rig, lambda pair, side, rig=rig: wall_image(pair, side, rig), PARAMS)
        for points in tracks:
            assert points.missing is None
            column = 0 if narrow == "left" else 2
            for px in points.points()[:2]:
                assert 600 < px[:, column].max() < 700 - 5.5


def test_points_of_a_reduced_image_come_back_to_the_stored_ones() -> None:
    """Every pixel four by four times, reduced to a quarter, is the image itself: points must agree but for the size."""
    params = PARAMS.model_copy(update={"max_width_px": RIG.left.width_px})
    large = RIG.model_copy(update={"left": enlarged(RIG.left), "right": enlarged(RIG.right)})
    wide = params.model_copy(update={"min_disparity_px": 4 * PARAMS.min_disparity_px})
    for found, own in zip(
        follow_drive(PAIRS, large, lambda *which: wall_image(*which).repeat(4, axis=0).repeat(4, axis=1), wide),
        follow_drive(PAIRS, RIG, wall_image, params),
        strict=True,
    ):
        for ours, theirs in zip(found.points()[:2], own.points()[:2], strict=True):
            assert ours == pytest.approx((theirs + 0.5) * 4 - 0.5, abs=0.02)


def enlarged(camera: Camera) -> Camera:
    return Camera(
        width_px=4 * camera.width_px, height_px=4 * camera.height_px, fx_px=4 * camera.fx_px, fy_px=4 * camera.fy_px,
        cx_px=4 * (camera.cx_px + 0.5) - 0.5, cy_px=4 * (camera.cy_px + 0.5) - 0.5,
    )  # fmt: skip


def test_points_stay_where_they_are_on_a_wall_that_comes_nearer() -> None:
    """It grows by a sixth: a window whose texture lies to one side of its centre moves with the texture, not with the centre."""
    pairs = make_path(2, step_m=2.0)
    (points,) = follow_drive(pairs, RIG, wall_image, PARAMS)
    before, after, _ = points.points()
    camera, first, second = RIG.left, *(map_SE3_left(pair.pose, RIG) for pair in pairs)
    rays = (before[:, :2] - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)
    on_wall = np.column_stack([WALL_M * rays, np.full(len(rays), WALL_M), np.ones(len(rays))])
    seen = on_wall @ se3.compose(se3.invert(second), first).T
    expected = seen[:, :2] / seen[:, 2:3] * (camera.fx_px, camera.fy_px) + (camera.cx_px, camera.cy_px)
    assert len(rays) > 200
    off = np.sort(np.abs(after[:, :2] - expected), axis=0)[: int(0.98 * len(rays))]  # motions leave slipped points out
    assert np.sqrt((off**2).mean(axis=0)).max() < 0.06


def test_what_opencv_refuses_costs_its_interval_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Never the drive: an error of the library in the first interval leaves the second."""
    whole, asked = cv2.StereoBM.create, []

    def broken_once(**settings: int) -> cv2.StereoBM:
        asked.append(settings)
        return whole(**settings) if len(asked) > 1 else whole(numDisparities=16, blockSize=4)  # even: an error

    monkeypatch.setattr(cv2, "StereoBM", SimpleNamespace(create=broken_once))
    assert reasons(wall_image) == ["image_unfit", "ok"]


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (9, 70), (64, 64)])
def test_tiny_images_give_no_measurement(shape: tuple[int, int]) -> None:
    """Half and a quarter of their size hold no window, and below one pixel there is no image."""
    noise = np.random.default_rng(0).integers(0, 255, (len(PAIRS), 2, *shape)).astype(np.uint8)
    images = {
        (p.frame_index, side): noise[i, j] for i, p in enumerate(PAIRS) for j, side in enumerate(("left", "right"))
    }
    size = {"width_px": shape[1], "height_px": shape[0]}
    rig = rig_with(left=size, right=size)
    found = reasons(lambda pair, side: images[pair.frame_index, side], rig=rig)
    assert set(found) <= {"too_few_points", "image_blank"}


def test_equal_input_gives_equal_output() -> None:
    assert measure_motions(PAIRS, RIG, wall_image, PARAMS) == measure_motions(PAIRS, RIG, wall_image, PARAMS)


def test_dark_blank_and_frozen_images_say_so() -> None:
    size = (RIG.left.height_px, RIG.left.width_px)
    assert reasons(lambda pair, side: np.zeros(size, np.uint8)) == ["image_blank"] * 2
    assert reasons(lambda pair, side: np.full((*size, 3), 200, np.uint8)) == ["image_blank"] * 2
    assert reasons(lambda pair, side: wall_image(PAIRS[0], side)) == ["image_frozen"] * 2


def test_noise_alone_gives_no_measurement() -> None:
    def noise(pair: FramePair, side: Side) -> Image:
        rng = np.random.default_rng([pair.frame_index, side == "left"])
        return rng.integers(0, 255, (RIG.left.height_px, RIG.left.width_px)).astype(np.uint8)

    assert set(reasons(noise)) <= {"too_few_points", "no_consensus", "degenerate"}


def test_a_missing_image_costs_its_two_intervals_only() -> None:
    pairs = make_path(5, step_m=0.4)

    def read(pair: FramePair, side: Side) -> Image:
        if pair.frame_index == 2 and side == "right":
            raise ImageFileError(RejectionReason.IMAGE_MISSING, "2.jpg: there is no such file")
        return wall_image(pair, side)

    assert reasons(read, pairs) == ["ok", "image_unreadable", "image_unreadable", "ok"]


def test_a_standing_car_measures_that_it_stands() -> None:
    def read(pair: FramePair, side: Side) -> Image:
        still = wall_image(PAIRS[0], side).astype(np.float64)
        noise = np.random.default_rng([7, pair.frame_index, side == "left"]).normal(0, 2.0, still.shape)
        return np.clip(still + noise, 0, 255).astype(np.uint8)

    standing = [pair.model_copy(update={"pose": PAIRS[0].pose}) for pair in PAIRS]
    for motion in measure_motions(standing, RIG, read, PARAMS):
        assert motion.reason == "ok"
        assert np.abs(np.array(motion.second_SE3_first) - np.eye(4)).max() < 0.01


def test_a_rig_with_a_lens_is_refused() -> None:
    lens = Lens(model="radial", coefficients=(0.1, 0.0))
    raw = RIG.model_copy(update={"left": RIG.left.model_copy(update={"lens": lens})})
    with pytest.raises(ValueError, match="rectified"):
        measure_motions(PAIRS, raw, wall_image, PARAMS)
