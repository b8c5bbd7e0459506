"""Rectified rigs: equal rows, the raw images' own directions, no pixel without a source."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rectification
from conetl.geometry import rig as rigs
from conetl.model.rig import Camera, Lens, Rig
from conetl.readers.rigs.common import rig_of

BARREL = Lens(model="brown", coefficients=(-0.3691481, 0.1968681, 1.353473e-3, 5.677587e-4, -0.0677))
FISHEYE = Lens(model="fisheye", coefficients=(0.02, -0.01, 0.004, -0.0008))
BODY_SE3_LEFT = se3.se3([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [1.0, 0.25, 0.7])


def camera(lens: Lens = BARREL, f: float = 960.0, **changes: float) -> Camera:
    values = {"width_px": 1392, "height_px": 512, "fx_px": f, "fy_px": f - 3, "cx_px": 696.0, "cy_px": 224.2} | changes
    return Camera(**values, lens=lens)  # type: ignore[arg-type]


def rig(turn: tuple[float, ...] = (0.01, -0.03, 0.008), t: tuple[float, ...] = (0.5, 0.01, -0.02), **kw: Camera) -> Rig:
    left, right = kw.get("left", camera()), kw.get("right", camera(f=905.0, cx_px=700.0))
    relative = se3.se3(Rotation.from_rotvec(turn).as_matrix(), t)
    return rig_of("raw", left, right, relative, sigma_px=0.3, body_SE3_left=BODY_SE3_LEFT)


def body_points(count: int = 60) -> np.ndarray:
    """Points 3 to 30 m ahead, in the body's frame."""
    rng = np.random.default_rng(5)
    ahead = rng.uniform(3, 30, count)
    return np.column_stack([ahead, rng.uniform(-0.5, 0.5, count) * ahead, rng.uniform(-0.15, 0.15, count) * ahead])


def in_camera(points_body: np.ndarray, r: Rig, side: str) -> np.ndarray:
    return se3.apply(se3.invert(rigs.body_SE3_camera(r, side)), points_body)  # type: ignore[arg-type]


angle = st.floats(-0.08, 0.08)


@settings(max_examples=15, deadline=None)
@given(turn=st.tuples(angle, angle, st.floats(-0.03, 0.03)), ty=st.floats(-0.05, 0.05), tz=st.floats(-0.05, 0.05))
def test_every_rig_ends_with_equal_rows_and_the_same_points(turn: tuple[float, ...], ty: float, tz: float) -> None:
    raw = rig(turn, (0.5, ty, tz))
    assume(not rectification.is_rectified(raw))
    flat = rectification.rectify(raw)
    assert flat.rectified_from == raw and rectification.is_rectified(flat)
    assert flat.baseline_m == pytest.approx(raw.baseline_m)
    np.testing.assert_allclose(rigs.left_SE3_right(flat)[1:3, 3], 0, atol=1e-12)
    points = body_points()
    uv = {side: cam.project(rigs.camera_of(flat, side), in_camera(points, flat, side)) for side in ("left", "right")}
    np.testing.assert_allclose(uv["left"][:, 1], uv["right"][:, 1], atol=1e-8)
    assert (uv["left"][:, 0] - uv["right"][:, 0] > flat.left.cx_px - flat.right.cx_px).all()
    for side in ("left", "right"):
        size = np.array([rigs.camera_of(flat, side).width_px, rigs.camera_of(flat, side).height_px])
        shown = ((uv[side] >= 0) & (uv[side] <= size - 1)).all(axis=1)
        assert shown.sum() > 15
        # The same object point in the raw image, by the raw camera alone.
        direct = cam.project(rectification.stored_camera(flat, side), in_camera(points[shown], raw, side))
        np.testing.assert_allclose(rectification.raw_from_rectified(flat, side, uv[side][shown]), direct, atol=1e-6)
        np.testing.assert_allclose(rectification.rectified_from_raw(flat, side, direct), uv[side][shown], atol=1e-6)


@pytest.mark.parametrize("lens", [Lens(), BARREL, Lens(model="radial", coefficients=(0.1, 0.02)), FISHEYE])
def test_every_rectified_pixel_was_seen_and_no_detail_is_lost(lens: Lens) -> None:
    raw = rig(left=camera(lens), right=camera(lens, f=930.0))
    flat = rectification.rectify(raw)
    for side in ("left", "right"):
        own = rigs.camera_of(flat, side)
        assert own.fx_px == own.fy_px == 960.0
        grid = np.stack(np.meshgrid(np.arange(own.width_px), np.arange(own.height_px)), -1)
        assert np.isfinite(rectification.raw_from_rectified(flat, side, grid)).all()
        outside = rectification.raw_from_rectified(flat, side, [[-3 * own.width_px, 10.0], [4 * own.width_px, 10.0]])
        assert np.isnan(outside).all()
    assert flat.left.height_px == flat.right.height_px and flat.left.cy_px == flat.right.cy_px
    # A barrel's borders move outwards when it is straightened: the image must not shrink much by the rotations.
    assert flat.left.width_px > 1250 and flat.left.height_px > 400


def test_a_half_sphere_lens_ends_at_60_degrees() -> None:
    wide = camera(FISHEYE, f=420.0, height_px=1392, cy_px=696.0)
    flat = rectification.rectify(rig(left=wide, right=wide))
    half = np.arctan(flat.left.cx_px / flat.left.fx_px)
    assert np.radians(50) < half <= np.radians(60) + 1e-9


def test_the_rotation_is_that_of_opencv() -> None:
    raw = rig((0.01, -0.03, 0.008), (0.5, 0.01, -0.02))
    left_SE3_right = rigs.left_SE3_right(raw)
    right_SE3_left = se3.invert(left_SE3_right)
    ours = rectification.common_rotation(left_SE3_right)
    theirs = cv2.stereoRectify(
        cam.matrix_k(raw.left), None, cam.matrix_k(raw.right), None, (1392, 512),
        right_SE3_left[:3, :3].copy(), right_SE3_left[:3, 3:].copy(),
    )[:2]  # fmt: skip
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(own.T, other, atol=1e-3)  # both halve the turn, to first order alike


def test_what_is_rectified_stays_as_it_is() -> None:
    plain = camera(Lens())
    parallel = rig((0, 0, 0), (0.5, 0.002, 0.001), left=plain, right=plain)
    assert rectification.rectify(parallel) is parallel
    # Rows may begin elsewhere in the right image: the matcher knows the offset of the principal points.
    assert rectification.is_rectified(rig((0, 0, 0), (0.5, 0, 0), left=plain, right=camera(Lens(), cy_px=220.0)))
    assert rectification.stored_camera(parallel, "left") is parallel.left
    np.testing.assert_array_equal(rectification.raw_from_rectified(parallel, "left", [1.0, 2.0]), [1.0, 2.0])
    for changed in (
        rig((0, 0.001, 0), (0.5, 0, 0), left=plain, right=plain),
        rig((0, 0, 0), (0.5, 0.02, 0), left=plain, right=plain),
        rig((0, 0, 0), (0.5, 0, 0), left=plain, right=camera(Lens(), fx_px=962.0)),
        rig((0, 0, 0), (0.5, 0, 0), left=plain, right=camera(Lens(), fy_px=958.0)),
        rig((0, 0, 0), (0.5, 0, 0), left=plain, right=camera()),
    ):
        assert not rectification.is_rectified(changed)
        assert rectification.is_rectified(rectification.rectify(changed))


@pytest.mark.parametrize(
    ("turn", "t", "message"),
    [
        ((0, 0, 0), (0.01, 0, 0.5), "along their baseline"),
        ((0, 2.6, 0), (0.5, 0, 0), "different directions|rectification"),
    ],
)
def test_cameras_without_a_common_image_are_refused(
    turn: tuple[float, ...], t: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        rectification.rectify(rig(turn, t))
