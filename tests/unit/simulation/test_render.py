"""The renderer: projection of its images, and whole tiny drives. Requires the extra `conetl[simulate]`."""

from __future__ import annotations

import hashlib
import math
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from conetl.evaluation.truth import read_truth
from conetl.geometry.camera import project
from conetl.geometry.rig import body_SE3_camera, map_SE3_camera
from conetl.model.errors import InputError
from conetl.model.rig import Camera
from conetl.readers.drives import read_drive
from conetl.simulation import trajectory
from conetl.simulation.parts import true_shape
from conetl.simulation.scenario import Cone, Road, RoadObject, World, scenario_pass
from conetl.simulation.scene import build_scene, develop, exposure_gain, render
from conetl.simulation.simulate import simulate_drive, simulated_camera

pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'conetl[simulate]'")

RIG = Camera(width_px=96, height_px=64, fx_px=150.3, fy_px=150.3, cx_px=44.7, cy_px=29.4)
"""With an eccentric principal point, to test its sign."""


def _looking_along_x(height_m: float, pitch_rad: float) -> np.ndarray:
    pose = np.eye(4)
    forward = np.array([np.cos(pitch_rad), 0.0, -np.sin(pitch_rad)])
    right = np.array([0.0, -1.0, 0.0])
    pose[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = (0.0, 0.0, height_m)
    return pose


def test_cone_is_rendered_where_its_position_projects() -> None:
    """The centroid of its orange pixels is at the projection of the upright solid of revolution, to 0.3 px across."""
    x_m, y_m = 7.0, -0.9
    cone = Cone("C01", x_m, y_m, 0.7, band_count=0, dirt=0.0)
    images = [
        render(
            build_scene(World(cones=cones, objects=(), sun_elevation_deg=60.0, sun_azimuth_deg=180.0, sun_scale=0.0)),
            RIG, _looking_along_x(1.5, 0.1), samples_per_pixel=64, seed=4,
        )
        for cones in ((cone,), ())
    ]  # fmt: skip
    orange = [p[..., 0] / p.sum(axis=-1) for p in images]
    inside = (orange[0] - orange[1]) > 0.15
    assert inside.sum() > 30
    rows, columns = np.nonzero(inside)
    view = np.linalg.inv(_looking_along_x(1.5, 0.1))
    ends = [view @ [x_m, y_m, z, 1.0] for z in (0.04, 0.7)]
    (u0, v0), (u1, v1) = [(RIG.fx_px * p[0] / p[2] + RIG.cx_px, RIG.fx_px * p[1] / p[2] + RIG.cy_px) for p in ends]
    assert columns.mean() == pytest.approx((u0 + u1) / 2, abs=0.3)
    assert rows.min() - 0.5 == pytest.approx(v1, abs=1.0)
    assert rows.max() + 0.5 == pytest.approx(v0, abs=2.5)  # the near side of the ring is below its centre


@pytest.fixture(scope="module")
def tiny_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pass 2 in 48 x 16 pixels."""
    folder = tmp_path_factory.mktemp("simulated") / "drive"
    return simulate_drive(folder, pass_number=2, seed=11, width_px=48, height_px=16, samples_per_pixel=1)


def test_the_written_files_project_truth_to_its_rendered_position(tiny_drive: Path) -> None:
    drive, rejections = read_drive(tiny_drive)
    assert rejections == []
    assert drive.map_srid == trajectory.MAP_SRID
    simulated, scenario = simulated_camera(48, 16), scenario_pass(2)
    assert len(drive.frame_pairs) == scenario.frame_count
    times = np.arange(scenario.frame_count) * trajectory.FRAME_PERIOD_S
    poses = trajectory.true_poses(scenario, times)
    by_id = {cone.cone_id: cone for cone in (*scenario.world.cones, *scenario.removed)}
    poses_m = np.array([pair.pose.sigma_enu_m for pair in drive.frame_pairs])
    noise = (trajectory.HORIZONTAL_M, trajectory.HORIZONTAL_M, trajectory.VERTICAL_M)
    np.testing.assert_allclose(poses_m, [[math.hypot(one.drift, one.white) for one in noise]] * len(poses_m), rtol=1e-3)
    turned = [np.degrees(pair.pose.sigma_rpy_rad) for pair in drive.frame_pairs]
    np.testing.assert_allclose(turned, np.full((len(turned), 3), math.hypot(0.02, 0.002)), rtol=1e-3)
    checked = 0
    for row in read_truth(tiny_drive / "truth.csv"):
        cone, truth = by_id[row.cone_id], (row.easting_m, row.northing_m, row.height_ellipsoidal_m)
        in_road = np.array([cone.x_m, cone.y_m, 0.0, 1.0])
        for pair, true_pose in zip(drive.frame_pairs, poses, strict=True):
            for side, number, camera in (("left", 2, drive.rig.left), ("right", 3, drive.rig.right)):
                road_SE3_camera = (
                    np.linalg.inv(trajectory.map_SE3_road()) @ true_pose @ trajectory.body_SE3_camera(number)
                )
                x, y, z = (np.linalg.inv(road_SE3_camera) @ in_road)[:3]
                if z < 4.0:
                    continue
                rendered = simulated.fx_px * np.array([x, y]) / z + [simulated.cx_px, simulated.cy_px]
                true_camera = true_pose @ body_SE3_camera(drive.rig, side)
                by_truth = project(camera, (np.linalg.inv(true_camera) @ [*truth, 1.0])[:3])
                assert np.abs(by_truth - rendered).max() < 2e-3
                # The trajectory of the files differs by its noise only: 5 sigma of position and attitude.
                by_files = project(
                    camera, (np.linalg.inv(map_SE3_camera(pair.pose, drive.rig, side)) @ [*truth, 1.0])[:3]
                )
                assert np.abs(by_files - rendered).max() < simulated.fx_px * (0.12 / z + 0.003)
                checked += 1
    assert checked > 200


@pytest.mark.release
def test_tiny_drive_is_whole_and_equal_seeds_give_equal_files(tiny_drive: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    again = simulate_drive(
        tmp_path / "again", pass_number=2, seed=11, width_px=48, height_px=16, samples_per_pixel=1,
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    digests = [
        {p.relative_to(f).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in f.rglob("*") if p.is_file()}
        for f in (tiny_drive, again)
    ]
    assert digests[0] == digests[1]
    frames = scenario_pass(2).frame_count
    assert seen == [(n, 2 * frames) for n in range(1, 2 * frames + 1)]
    assert (
        len(digests[0]) == 2 * frames + frames + 3 + 3 + 3
    )  # images, poses, time stamps, calibration, truth and drive.yaml
    rows = read_truth(again / "truth.csv")
    assert [row.change for row in rows].count("removed") == 1
    assert all(row.present != (row.change == "removed") for row in rows)


@pytest.mark.release
def test_road_image_is_well_exposed_and_has_an_orange_cone() -> None:
    scenario, camera = scenario_pass(1), simulated_camera(96, 64)
    poses = trajectory.true_poses(scenario, np.array([1.2]))
    view = np.linalg.inv(trajectory.map_SE3_road()) @ poses[0] @ trajectory.body_SE3_camera(2)
    radiance = render(build_scene(scenario.world), camera, view, samples_per_pixel=4, seed=1)
    assert radiance.shape == (64, 96, 3)
    image = develop(radiance, exposure_gain(radiance), np.random.default_rng(0))
    assert 60 < np.median(image) < 200
    assert (image == 255).mean() < 0.05
    hue, saturation, value = cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2HSV))
    assert ((hue > 4) & (hue < 16) & (saturation > 170) & (value > 110)).sum() >= 3


def test_a_folder_with_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="not empty"):
        simulate_drive(tmp_path, pass_number=1, seed=1)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_without_mitsuba_the_extra_is_named(tmp_path: Path) -> None:
    """In a fresh interpreter in which Mitsuba cannot be imported."""
    code = (
        "import sys; sys.modules['mitsuba'] = None\n"
        "from pathlib import Path\n"
        "from conetl.model.errors import InputError\n"
        "from conetl.simulation.simulate import simulate_drive\n"
        "try:\n    simulate_drive(Path(sys.argv[1]), pass_number=1, seed=1)\n"
        "except InputError as error:\n    print(error)\n"
    )
    target = tmp_path / "drive"
    done = subprocess.run([sys.executable, "-c", code, str(target)], capture_output=True, text=True, check=True)
    assert "pip install 'conetl[simulate]'" in done.stdout
    assert not target.exists()


@pytest.mark.release
def test_a_barricade_on_the_verge_is_seen_down_to_its_true_foot() -> None:
    """Behind a kerb the ground is 8 cm higher than the road."""
    camera = Camera(width_px=240, height_px=160, fx_px=900.0, fy_px=900.0, cx_px=119.5, cy_px=-30.0)
    road = Road(markings=())
    item = RoadObject("type_3", 9.0, 4.6, height_m=1.2, length_m=1.4, ground_m=road.ground_m(4.6))
    view = _looking_along_x(1.5, 0.0)
    view[1, 3] = 4.6
    images = [
        render(
            build_scene(World((), objects, sun_elevation_deg=60.0, sun_azimuth_deg=180.0, sun_scale=0.0, road=road)),
            camera, view, samples_per_pixel=16, seed=4,
        ).mean(axis=-1)
        for objects in ((item,), ())
    ]  # fmt: skip
    changed = np.abs(images[0] - images[1]) > 0.3 * images[1]  # more than noise, less than grey feet on grass
    near_end_m = item.x_m - 0.45  # of the feet of a barricade
    row = camera.cy_px + camera.fx_px * (1.5 - 0.08) / near_end_m
    assert np.flatnonzero(changed.sum(axis=1) >= 3).max() == pytest.approx(row, abs=2.0)


def test_objects_of_all_classes_are_rendered_where_their_truth_says() -> None:
    """Side by side 14 m ahead: what they change in the image spans their height, of plates with the post below it."""
    kinds = {
        "drum": (1.0, 1.0), "tubular_marker": (1.0, 0.1), "vertical_panel": (1.1, 0.3), "type_3": (1.4, 1.4),
        "diamond": (1.7, 1.0), "work_triangle": (1.5, 0.9), "arrow_board": (2.6, 1.8), "speed_disc": (2.0, 0.6),
        "mandatory_disc": (2.0, 0.6),
        "warning_triangle": (2.0, 0.8), "rectangle": (2.2, 0.6),
    }  # fmt: skip
    camera = Camera(width_px=480, height_px=80, fx_px=200.0, fy_px=200.0, cx_px=239.5, cy_px=35.0)
    items = [
        RoadObject(kind, 14.0, 13.0 - 2.6 * n, height_m=height, length_m=width, colour=(0.95, 0.4, 0.1))
        for n, (kind, (height, width)) in enumerate(kinds.items())
    ]
    road = Road(right_m=-16.0, left_m=16.0, pavement_width_m=0.0, markings=())
    images = [
        render(
            build_scene(World((), objects, sun_elevation_deg=60.0, sun_azimuth_deg=180.0, sun_scale=0.0, road=road)),
            camera, _looking_along_x(1.5, 0.0), samples_per_pixel=16, seed=4,
        ).mean(axis=-1)
        for objects in (tuple(items), ())
    ]  # fmt: skip
    changed = np.abs(images[0] - images[1]) > 0.1 * images[1]
    for item in items:
        shape = true_shape(item)
        middle = camera.cx_px - camera.fx_px * item.y_m / item.x_m
        columns = slice(round(middle) - 1, round(middle) + 2)
        rows = np.flatnonzero(changed[:, columns].any(axis=1))
        top, low = (
            camera.cy_px + camera.fx_px * (1.5 - z) / item.x_m for z in (shape.foot_m + shape.height_m, shape.foot_m)
        )
        assert shape.foot_m + shape.height_m == pytest.approx(item.height_m)
        assert rows.min() == pytest.approx(top, abs=2.0), item.kind
        assert rows.max() > low - 2.0, item.kind
