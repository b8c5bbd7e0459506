from __future__ import annotations

from uuid import UUID

import numpy as np

from conetl.params import ReconcileParams
from conetl.records import Detection, MapFeature, Position, Side
from conetl.steps.visibility import View, frames_in_plain_view, look_at_spot, view_of_drive
from tests.synthetic.world import ORIGIN_M, Cone, camera_poses, detect, make_path, make_rig, observe

RIG = make_rig()
PAIRS = make_path(30)
LEFT, RIGHT = camera_poses(PAIRS, RIG, "left"), camera_poses(PAIRS, RIG, "right")
TIMES = {pair.frame_index: pair.captured_at_ns for pair in PAIRS}
PARAMS = ReconcileParams()
SPOT = Cone((25.0, 2.0, 0.0))


def boxes(cones: list[Cone]) -> dict[int, list[Detection]]:
    found: dict[int, list[Detection]] = {}
    sides: tuple[Side, Side] = ("left", "right")
    by_side = detect(cones, PAIRS, RIG)
    for pair in PAIRS:
        found[pair.frame_index] = [d for side in sides for d in by_side[pair.frame_index, side]]
    return found


def in_view(cone: Cone, others: list[Cone] | None = None) -> list[int]:
    foot = ORIGIN_M + np.array(cone.foot_m)
    return frames_in_plain_view(foot, cone.height_m, RIG, LEFT, RIGHT, boxes(others or []), PARAMS)


def feature(cone: Cone) -> MapFeature:
    x, y, z = (ORIGIN_M + np.array(cone.foot_m)).tolist()
    return MapFeature(
        feature_id=UUID(int=1),
        version=1,
        category="traffic_cone",
        xyz_m=(x, y, z),
        cov_m2=(1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3),
        centre_xyz_m=(x, y, z + 0.3),
        cone_height_m=cone.height_m,
        cone_height_sigma_m=0.02,
        existence_probability=0.9,
        observation_count=5,
        first_seen_ns=1,
        last_seen_ns=2,
    )


def test_a_cone_ahead_is_in_view_until_it_leaves_the_picture() -> None:
    frames = in_view(SPOT)
    assert len(frames) > 8
    assert frames == list(range(frames[0], frames[-1] + 1))
    assert frames[-1] < 22, "abeam and behind it is out of view"


def test_small_far_and_sideways_spots_are_not_in_view() -> None:
    assert in_view(Cone((80.0, 0.0, 0.0))) == [f for f in in_view(Cone((80.0, 0.0, 0.0))) if f > 20]
    assert in_view(Cone((10.0, 30.0, 0.0))) == []
    assert in_view(Cone((-10.0, 0.0, 0.0))) == []


def test_a_nearer_cone_hides_a_spot_and_a_farther_one_does_not() -> None:
    hidden = in_view(SPOT, [Cone((23.5, 1.95, 0.0), height_m=0.9, base_m=0.6)])
    assert len(hidden) < len(in_view(SPOT)) - 3
    assert in_view(SPOT, [Cone((30.0, 2.1, 0.0))]) == in_view(SPOT)


def view(positions: list[Position]) -> View:
    return view_of_drive(RIG, PAIRS, [], [(p.frame_index, p.xyz_m) for p in positions])


def look(positions: list[Position], offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> int:
    found = look_at_spot(feature(SPOT), np.array(offset_m), view(positions), PARAMS)
    return 0 if found is None else found.frames


def test_an_empty_spot_was_looked_at_and_an_occupied_one_not() -> None:
    assert look([]) == len(in_view(SPOT))
    _, _, positions = observe([SPOT], PAIRS, RIG)
    assert look(positions) == 0


def test_the_offset_of_the_drive_moves_the_spot() -> None:
    _, _, positions = observe([SPOT], PAIRS, RIG)
    elsewhere = [p.model_copy(update={"xyz_m": (p.xyz_m[0] + 1.2, p.xyz_m[1], p.xyz_m[2])}) for p in positions]
    assert look(elsewhere) > 5
    assert look(elsewhere, (1.2, 0.0, 0.0)) == 0


def test_the_time_of_the_look_is_that_of_the_first_empty_frame() -> None:
    found = look_at_spot(feature(SPOT), np.zeros(3), view([]), PARAMS)
    assert found is not None
    assert found.first_ns == TIMES[in_view(SPOT)[0]]


def test_frames_from_before_the_cone_was_last_seen_say_nothing() -> None:
    """Another drive, which began earlier and overlaps this one, saw the cone in the midst of it."""
    frames = in_view(SPOT)
    seen = feature(SPOT).model_copy(update={"last_seen_ns": TIMES[frames[3]]})
    found = look_at_spot(seen, np.zeros(3), view([]), PARAMS)
    assert found is not None
    assert (found.frames, found.first_ns) == (len(frames) - 4, TIMES[frames[4]])
