"""Boxes of the labelled training renders: tight, occlusion-aware, none for what cannot be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conetl.model.rig import Camera
from conetl.simulation.scenario import Cone, RoadObject, World
from conetl.simulation.scene import build_scene, render
from training.render_scenes import object_boxes, random_world

pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'conetl[simulate]'")

CAMERA = Camera(width_px=160, height_px=96, fx_px=200.0, fy_px=200.0, cx_px=79.5, cy_px=40.0)
CONE = Cone("R1", 7.0, 0.0, 0.7, dirt=0.0)
WORLD = World(cones=(CONE,), objects=(), sun_elevation_deg=50.0, sun_azimuth_deg=100.0, sun_scale=0.0)


def _pose() -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    pose[:3, 3] = (0.0, 0.0, 1.4)
    return pose


def _boxes(world: World, category: int = 0) -> list[tuple[float, ...]]:
    """x0, y0, x1, y1 and the ends of the boxes, all of this class."""
    boxes = object_boxes(build_scene(world), world, CAMERA, _pose())
    assert all(box[0] == category for box in boxes)
    return [box[1:] for box in boxes]


def test_box_holds_exactly_the_pixels_that_the_cone_changes() -> None:
    (box,) = _boxes(WORLD)
    images = [
        render(build_scene(w), CAMERA, _pose(), samples_per_pixel=32, seed=2) for w in (WORLD, replace(WORLD, cones=()))
    ]
    change = np.abs(images[0] - images[1]).sum(axis=-1) / images[1].sum(axis=-1)
    rows, columns = np.nonzero(change > 0.55)  # the cone itself, not its faint shadow under an overcast sky
    assert box[0] == pytest.approx(columns.min(), abs=1.5)
    assert box[1] == pytest.approx(rows.min(), abs=1.5)
    assert box[2] == pytest.approx(columns.max() + 1, abs=1.5)
    assert box[3] == pytest.approx(rows.max() + 1, abs=1.5)


@pytest.mark.release
def test_cone_behind_a_bin_has_no_box_and_one_half_hidden_a_smaller_one() -> None:
    (whole,) = _boxes(WORLD)
    hidden = replace(WORLD, objects=(RoadObject("bin", 5.0, 0.0, height_m=1.2),))
    assert _boxes(hidden) == []
    half = replace(WORLD, objects=(RoadObject("bin", 5.0, 0.31, height_m=1.2),))  # covers the left side
    (part,) = _boxes(half)
    assert part[0] > whole[0] + 2.0
    assert part[2] == pytest.approx(whole[2], abs=0.5)


def test_cones_behind_the_camera_or_too_small_have_no_box() -> None:
    far = replace(WORLD, cones=(replace(CONE, x_m=-5.0), replace(CONE, x_m=60.0), replace(CONE, y_m=30.0)))
    assert _boxes(far) == []


def test_a_marker_is_labelled_whole_and_a_sign_from_its_front_alone() -> None:
    marker = replace(WORLD, cones=(), objects=(RoadObject("tubular_marker", 7.0, 0.0, height_m=0.9),))
    (box,) = _boxes(marker, 1)
    assert box[3] - box[1] == pytest.approx(0.9 / 7.0 * 200.0, rel=0.08)
    sign = RoadObject("speed_disc", 9.0, 0.0, height_m=1.6, length_m=0.6)
    (plate,) = _boxes(replace(WORLD, cones=(), objects=(sign,)), 7)
    assert plate[3] - plate[1] == pytest.approx(0.6 / 9.0 * 200.0, rel=0.08)
    assert np.isnan(plate[4:]).all()
    assert _boxes(replace(WORLD, cones=(), objects=(replace(sign, yaw_rad=np.pi),))) == []


@pytest.mark.release
def test_equal_seeds_give_equal_worlds_and_other_seeds_others() -> None:
    a, b, c = (random_world(np.random.default_rng([1, n])) for n in (5, 5, 6))
    assert a == b
    assert a != c
