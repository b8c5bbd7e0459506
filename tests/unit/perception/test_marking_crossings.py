"""Points of lane markings in images of a made-up road: where they are, how wide, what colour, and how high."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.params import MarkingParams
from conetl.model.rig import Camera, Rig
from conetl.perception.markings.crossings import find_points
from conetl.perception.markings.points import PointColumns
from conetl.readers.rigs.common import rig_of

Floats = NDArray[np.float64]
CAMERA = Camera(width_px=640, height_px=240, fx_px=430.0, fy_px=430.0, cx_px=315.2, cy_px=84.6)
RIG = rig_of("test", CAMERA, CAMERA, se3.se3(np.eye(3), [0.54, 0.0, 0.0]))
HEIGHT_M = 1.6
#: Middles of paint, to the right of the camera; the yellow line leans by 0.02 to the right.
WHITE_M, YELLOW_M, LEAN, WIDTH_M = -1.4, 1.6, 0.02, 0.15
#: A bright kerb, 0.12 m high and 0.15 m wide, from here on.
KERB_M = (2.6, 2.75)
_FINE = 3


def _road(x_m: Floats, z_m: Floats, noise: Floats, shade_m: float) -> Floats:
    """(..., 3) colours of the road (blue, green, red), which lies in shadow to the right of shade_m, and in bright sun else."""
    cell = (x_m / 0.03).astype(int) * 73856093 ^ (z_m / 0.08).astype(int) * 19349663
    grey = 85 + 12 * noise[cell % len(noise)]
    colours = np.repeat(grey[..., None], 3, axis=-1)
    colours[np.abs(x_m - WHITE_M) < WIDTH_M / 2] = (205, 210, 208)
    colours[np.abs(x_m - YELLOW_M - LEAN * z_m) < WIDTH_M / 2] = (40, 170, 200)
    if np.isfinite(shade_m):
        colours *= np.where(x_m > shade_m, 0.4, 1.6)[..., None]
    return colours


def render(rig: Rig, side: int, *, shade_m: float = np.inf) -> NDArray[np.uint8]:
    """What one camera sees, several rays per pixel."""
    camera = rig.left if side == 0 else rig.right
    left_SE3_camera = np.eye(4) if side == 0 else rigs.left_SE3_right(rig)
    v, u = ((np.indices((camera.height_px * _FINE, camera.width_px * _FINE)) + 0.5) / _FINE) - 0.5
    ray = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones_like(u)], axis=-1)
    ray = ray @ left_SE3_camera[:3, :3].T
    noise = np.random.default_rng(5).normal(size=4096)
    image = np.full((*u.shape, 3), 150.0)
    for height, is_kerb in ((HEIGHT_M, False), (HEIGHT_M - 0.12, True)):
        below = ray[..., 1] > 0.02
        far = np.where(below, height / np.where(below, ray[..., 1], 1.0), 0.0)
        x, z = ray[..., 0] * far + left_SE3_camera[0, 3], ray[..., 2] * far
        if is_kerb:
            image[below & (x > KERB_M[0]) & (x < KERB_M[1])] = (190, 195, 200)
        else:
            image[below] = _road(x, z, noise, shade_m)[below]
    small = cv2.resize(image, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA)
    shaken = small + np.random.default_rng(side).normal(0, 1.5, small.shape)
    return np.clip(np.rint(shaken), 0, 255).astype(np.uint8)


@lru_cache(maxsize=2)
def _found(turned: bool) -> tuple[PointColumns, Floats]:
    """Points, and where they are in the left camera's frame."""
    # As after self-calibration: rows of the right image are half a pixel lower, and disparities differ.
    rig = rigs.right_camera_turned(RIG, np.array([0.0012, 0.0009, 0.0])) if turned else RIG
    columns = find_points(3, render(rig, 0), render(rig, 1), rig, MarkingParams()).columns()
    z = CAMERA.fx_px * RIG.baseline_m / columns.disparity_px
    return columns, np.stack(
        [(columns.u_px - CAMERA.cx_px) / CAMERA.fx_px * z, (columns.v_px - CAMERA.cy_px) / CAMERA.fy_px * z, z]
    )


@pytest.mark.parametrize("turned", [False, True])
def test_points_lie_on_the_middle_of_the_paint_and_on_the_road(turned: bool) -> None:
    columns, (x, y, z) = _found(turned)
    for middle in (np.full(len(z), WHITE_M), YELLOW_M + LEAN * z):
        own = np.abs(x - middle) < 0.12
        assert own.sum() > 20
        assert abs(np.median((x - middle)[own])) < 0.005
        assert np.percentile(np.abs(x - middle)[own], 80) < 0.03
        assert abs(np.median(y[own]) - HEIGHT_M) < 0.01
        assert abs(np.median(columns.width_m[own]) - WIDTH_M) < 0.015


def test_a_line_along_the_edge_of_a_shadow_is_found() -> None:
    """Road in the sun on its left, as bright as 0.6 of it, and road in shadow on its right."""
    images = [render(RIG, side, shade_m=WHITE_M + WIDTH_M / 2) for side in (0, 1)]
    columns = find_points(3, *images, RIG, MarkingParams()).columns()
    z = CAMERA.fx_px * RIG.baseline_m / columns.disparity_px
    apart = (columns.u_px - CAMERA.cx_px) / CAMERA.fx_px * z - WHITE_M
    own = np.abs(apart) < 0.12
    assert own.sum() > 20
    assert abs(np.median(apart[own])) < 0.02
    assert abs(np.median(columns.width_m[own]) - WIDTH_M) < 0.03


def test_colours_are_told_by_the_ratio_to_the_road() -> None:
    columns, (x, _, z) = _found(False)
    white, yellow = np.abs(x - WHITE_M) < 0.12, np.abs(x - YELLOW_M - LEAN * z) < 0.12
    assert np.abs(np.median(columns.blue[white])) < 0.1
    assert np.median(columns.blue[yellow]) < -0.8


def test_a_kerb_is_higher_than_the_road_beside_it_and_paint_is_not() -> None:
    columns, (x, _, z) = _found(False)
    above = np.fmax(columns.above_left_m, columns.above_right_m)
    kerb = (x > KERB_M[0] - 0.1) & (x < KERB_M[1] + 0.1) & (np.abs(x - YELLOW_M - LEAN * z) > 0.15)
    assert kerb.sum() > 5
    assert np.nanmedian(above[kerb]) > 0.07
    assert np.nanmedian(above[np.abs(x - WHITE_M) < 0.12]) < 0.03


@pytest.mark.parametrize("blur_px", [0.0, 1.5, 2.5])
def test_blur_is_measured_at_the_edges_of_the_paint(blur_px: float) -> None:
    images = [render(RIG, side) for side in (0, 1)]
    if blur_px:
        images = [np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px), np.uint8) for image in images]
    columns = find_points(3, *images, RIG, MarkingParams()).columns()
    measured_px = np.sqrt(max(np.median(columns.blur_px2), 0.0))
    # Pixels and interpolation blur by 0.5; of a strong blur the near end of the road, where it is smallest, weighs most.
    assert 0.7 * blur_px < measured_px < blur_px + 0.9


def test_images_without_a_road_have_neither_points_nor_searched_rows() -> None:
    blank = np.full((CAMERA.height_px, CAMERA.width_px, 3), 120, dtype=np.uint8)
    found = find_points(0, blank, blank, RIG, MarkingParams())
    assert not found.points
    assert not found.rows
