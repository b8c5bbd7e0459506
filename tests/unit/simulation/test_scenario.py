"""The sample scenario: what changes between its passes, and that every change can be seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conetl.model.errors import InputError
from conetl.simulation import trajectory
from conetl.simulation.rig import simulated_rig
from conetl.simulation.scenario import scenario_pass
from conetl.simulation.world import Cone


def test_first_pass_adds_all_cones_in_both_sizes() -> None:
    first = scenario_pass(1)
    assert set(first.changes.values()) == {"added"}
    assert {cone.height_m for cone in first.world.cones} == {0.5, 0.7}
    assert 8 <= len(first.world.cones) <= 10
    assert first.removed == ()


def test_one_moved_one_removed_two_added_overnight() -> None:
    before = {cone.cone_id: cone for cone in scenario_pass(1).world.cones}
    second = scenario_pass(2)
    after = {cone.cone_id: cone for cone in second.world.cones}
    moved = [k for k in before.keys() & after.keys() if before[k] != after[k]]
    assert len(moved) == 1
    a, b = before[moved[0]], after[moved[0]]
    assert math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) == pytest.approx(1.5)
    gone, new = before.keys() - after.keys(), after.keys() - before.keys()
    assert (len(gone), len(new)) == (1, 2)
    assert {cone.cone_id for cone in second.removed} == gone
    expected = dict.fromkeys(before.keys() & after.keys(), "confirmed")
    expected |= {moved[0]: "moved"} | dict.fromkeys(gone, "removed") | dict.fromkeys(new, "added")
    assert second.changes == expected


def test_third_pass_drives_the_other_way_past_the_same_cones() -> None:
    second, third = scenario_pass(2), scenario_pass(3)
    assert third.world.cones == second.world.cones
    assert set(third.changes.values()) == {"confirmed"}
    assert (third.end_x_m - third.start_x_m) * (second.end_x_m - second.start_x_m) < 0


def test_surroundings_stay_and_the_days_differ() -> None:
    passes = [scenario_pass(n) for n in (1, 2, 3)]
    assert len({p.world.objects for p in passes}) == 1
    assert len({(p.world.sun_elevation_deg, p.exposure) for p in passes}) == 3
    assert passes[0].start_utc.date() < passes[1].start_utc.date() < passes[2].start_utc.date()


def test_no_two_cones_are_near_enough_to_be_mistaken() -> None:
    for number in (1, 2, 3):
        cones = scenario_pass(number).world.cones
        gaps = [math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) for a in cones for b in cones if a is not b]
        assert min(gaps) > 1.2


def test_unknown_pass_is_refused() -> None:
    with pytest.raises(InputError, match="passes 1, 2 and 3, not 4"):
        scenario_pass(4)


@pytest.mark.parametrize("pass_number", [1, 2, 3])
def test_every_cone_and_every_left_spot_is_seen_by_both_cameras(pass_number: int) -> None:
    """At least 8 frames nearer than 20 m, foot and tip inside both images."""
    scenario, rig = scenario_pass(pass_number), simulated_rig()
    times = np.arange(scenario.frame_count) * trajectory.FRAME_PERIOD_S
    poses = trajectory.true_poses(scenario, times, float(rig.body_SE3_camera(2)[0, 3]), rig.imu_height_m)
    before = {cone.cone_id: cone for cone in scenario_pass(1).world.cones}
    old_places = [before[k] for k, change in scenario.changes.items() if change == "moved"]
    for cone in [*scenario.world.cones, *scenario.removed, *old_places]:
        seen = [pose for pose in poses if all(_in_image(cone, pose @ rig.body_SE3_camera(c)) for c in (2, 3))]
        assert len(seen) >= 8, cone.cone_id


def _in_image(cone: Cone, map_SE3_camera: np.ndarray) -> bool:
    rig = simulated_rig()
    points = np.array([[cone.x_m, cone.y_m, 0.0, 1.0], [cone.x_m, cone.y_m, cone.height_m, 1.0]]).T
    local = (np.linalg.inv(map_SE3_camera) @ trajectory.map_SE3_road() @ points)[:3]
    if not ((local[2] > 1.0) & (local[2] < 20.0)).all():
        return False
    u, v, _ = rig.k() @ local / local[2]
    size = rig.camera.width_px, rig.camera.height_px
    return bool(((u > 10) & (u < size[0] - 10) & (v > 5) & (v < size[1] - 5)).all())
