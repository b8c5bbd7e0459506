"""The sample scenario: the changes between its passes, and that they are visible."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conetl.geometry.camera import project
from conetl.model.errors import InputError
from conetl.simulation import trajectory
from conetl.simulation.scenario import Cone, scenario_pass
from conetl.simulation.simulate import simulated_camera


def test_all_cones_are_added_then_one_moved_one_removed_two_added_then_all_confirmed() -> None:
    first, second, third = (scenario_pass(number) for number in (1, 2, 3))
    assert (set(first.changes.values()), first.removed) == ({"added"}, ())
    assert {cone.height_m for cone in first.world.cones} == {0.5, 0.7}
    before, after = ({cone.cone_id: cone for cone in one.world.cones} for one in (first, second))
    (moved,) = [k for k in before.keys() & after.keys() if before[k] != after[k]]
    a, b = before[moved], after[moved]
    assert math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) == pytest.approx(1.5)
    gone, new = before.keys() - after.keys(), after.keys() - before.keys()
    assert (len(gone), len(new)) == (1, 2)
    assert {cone.cone_id for cone in second.removed} == gone
    expected = dict.fromkeys(before.keys() & after.keys(), "confirmed")
    expected |= {moved: "moved"} | dict.fromkeys(gone, "removed") | dict.fromkeys(new, "added")
    assert second.changes == expected
    assert (third.world.cones, set(third.changes.values())) == (second.world.cones, {"confirmed"})
    assert (third.end_x_m - third.start_x_m) * (second.end_x_m - second.start_x_m) < 0, "in the opposite direction"


def test_surroundings_are_constant_the_light_varies_and_cones_stand_apart() -> None:
    passes = [scenario_pass(n) for n in (1, 2, 3)]
    assert len({p.world.objects for p in passes}) == 1
    assert len({(p.world.sun_elevation_deg, p.exposure) for p in passes}) == 3
    assert passes[0].start_utc.date() < passes[1].start_utc.date() < passes[2].start_utc.date()
    for one in passes:
        xy_m = np.array([(cone.x_m, cone.y_m) for cone in one.world.cones])
        gaps = np.hypot(*np.moveaxis(xy_m[:, None] - xy_m, 2, 0))
        assert gaps[gaps > 0].min() > 1.2


def test_unknown_pass_is_refused() -> None:
    with pytest.raises(InputError, match="passes 1, 2 and 3, not 4"):
        scenario_pass(4)


@pytest.mark.parametrize("pass_number", [1, 2, 3])
def test_every_present_and_former_cone_is_visible_to_both_cameras(pass_number: int) -> None:
    """At least 8 frames nearer than 20 m, foot and tip inside both images."""
    scenario = scenario_pass(pass_number)
    times = np.arange(scenario.frame_count) * trajectory.FRAME_PERIOD_S
    poses = trajectory.true_poses(scenario, times)
    before = {cone.cone_id: cone for cone in scenario_pass(1).world.cones}
    former = [before[k] for k, change in scenario.changes.items() if change == "moved"]
    for cone in [*scenario.world.cones, *scenario.removed, *former]:
        visible = [pose for pose in poses if all(_in_image(cone, pose @ trajectory.body_SE3_camera(c)) for c in (2, 3))]
        assert len(visible) >= 8, cone.cone_id


def _in_image(cone: Cone, map_SE3_camera: np.ndarray) -> bool:
    camera = simulated_camera()
    points = np.array([[cone.x_m, cone.y_m, 0.0, 1.0], [cone.x_m, cone.y_m, cone.height_m, 1.0]]).T
    local = (np.linalg.inv(map_SE3_camera) @ trajectory.map_SE3_road() @ points)[:3]
    if not ((local[2] > 1.0) & (local[2] < 20.0)).all():
        return False
    u, v = project(camera, local.T).T
    size = camera.width_px, camera.height_px
    return bool(((u > 10) & (u < size[0] - 10) & (v > 5) & (v < size[1] - 5)).all())
