"""Worlds with objects of all classes and several kinds of lane markings, drawn from a seed, on three days.

From day to day light, exposure and path change. On the second day the left edge line is painted 0.5 m farther in and a traffic
sign is set up; on the third day the marking T1 is gone.
"""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np

from conetl.model.errors import InputError
from conetl.model.markings import MarkingColour
from conetl.simulation.scenario import (
    ORANGE,
    PASS_NUMBERS,
    Colour,
    Cone,
    Road,
    RoadMarking,
    RoadObject,
    ScenarioPass,
    World,
    scenario_pass,
)

_START_M, _END_M = -70.0, 130.0
_FRAME_COUNT = 34
_SPACING_M = 1.35
_MOVED_M = 0.5
#: Dash and gap in use: Germany in towns, Germany on motorways, the US.
_PATTERNS_M = ((3.0, 3.0), (6.0, 12.0), (3.0, 9.0))


def mixed_pass(seed: int, pass_number: int) -> ScenarioPass:
    """Day 1, 2 or 3 of the world of a seed. Raises InputError for another day."""
    if pass_number not in PASS_NUMBERS:
        raise InputError(f"the world has passes 1, 2 and 3, not {pass_number}")
    cones, objects, added = _objects(np.random.default_rng([seed, 1]))
    markings = _markings(np.random.default_rng([seed, 2]), seed)
    changes = {one.cone_id: "confirmed" for one in cones} | {one.object_id: "confirmed" for one in objects}
    if pass_number == 1:
        changes = dict.fromkeys(changes, "added")
    else:
        changes |= {added.object_id: "added" if pass_number == 2 else "confirmed"}
        objects = (*objects, added)
        markings = tuple(
            replace(one, points_m=tuple((x, y - _MOVED_M) for x, y in one.points_m)) if one.marking_id == "E2" else one
            for one in markings
        )
    if pass_number == 3:
        markings = tuple(one for one in markings if one.marking_id != "T1")
    rng = np.random.default_rng([seed, 3, pass_number])
    road = np.random.default_rng([seed, 4])
    background = (one for one in scenario_pass(1).world.objects if one.kind in _BACKGROUND)
    world = World(
        cones=cones, objects=(*objects, *background), sun_elevation_deg=float(rng.uniform(25.0, 60.0)),
        sun_azimuth_deg=float(rng.uniform(-180.0, 180.0)), turbidity=float(rng.uniform(2.5, 5.0)),
        road=Road(markings=markings, asphalt=float(road.uniform(0.34, 0.46))), texture_seed=100 + seed,
    )  # fmt: skip
    start_x_m = -17.0 + float(rng.uniform(-0.5, 0.5))
    path_y_m = float(rng.uniform(-1.2, -0.8)), float(rng.uniform(-0.3, 0.2))
    day = datetime(2026, 5, 4, 9, 30, tzinfo=UTC) + timedelta(days=pass_number - 1, minutes=int(rng.integers(300)))
    return ScenarioPass(
        drive_id=f"{day:%Y-%m-%d}_mixed{seed}_pass{pass_number}", start_utc=day, world=world, changes=changes, removed=(),
        exposure=float(rng.uniform(0.8, 1.1)), start_x_m=start_x_m, end_x_m=start_x_m + _SPACING_M * (_FRAME_COUNT - 1),
        path_y_m=path_y_m, frame_count=_FRAME_COUNT,
    )  # fmt: skip


def _markings(rng: np.random.Generator, seed: int) -> tuple[RoadMarking, ...]:
    """Edge lines, and between the lanes a double line, temporary yellow beside old white, or worn dashes and a yellow curve."""
    width = float(rng.choice([0.10, 0.12, 0.15]))
    dash_m, gap_m = _PATTERNS_M[int(rng.integers(3))]

    def along(
        name: str, y_m: float, *, dashed: bool = False, colour: MarkingColour = "white", worn: float = 0.0
    ) -> RoadMarking:
        # The pattern begins anywhere.
        start = _START_M - (float(rng.uniform(0.0, dash_m + gap_m)) if dashed else 0.0)
        return RoadMarking(
            name, ((start, y_m), (_END_M, y_m)), dash_m if dashed else None, gap_m if dashed else None, width, colour, worn
        )  # fmt: skip

    edges = (
        along("E1", -3.3 + float(rng.uniform(-0.1, 0.1)), worn=0.25 if seed % 3 == 2 else 0.0),
        along("E2", 3.1, worn=0.15 if seed % 2 else 0.0),
    )
    if seed % 3 == 0:
        gap = width + 0.15
        return (*edges, along("C1", 0.9, colour="yellow"), along("T1", 0.9 + gap, dashed=True, colour="yellow"))
    if seed % 3 == 1:
        old = along("C1", 0.6, dashed=True, worn=0.3)
        return (*edges, old, along("T1", 0.6 + float(rng.uniform(0.35, 0.6)), colour="yellow"))
    x = np.linspace(-12.0, 42.0, 55)
    share = (x - x[0]) / (x[-1] - x[0])
    y = -2.7 + 4.2 * share * share * (3.0 - 2.0 * share)  # across the vehicle's path
    curve = tuple(zip(x.tolist(), y.tolist(), strict=True))
    dashes = along("C1", 1.9, dashed=True, worn=0.35)
    return (*edges, dashes, RoadMarking("T1", curve, width_m=width, colour="yellow"))


def _objects(rng: np.random.Generator) -> tuple[tuple[Cone, ...], tuple[RoadObject, ...], RoadObject]:
    """Devices along the right of the lane in blocks of one class, markers on the left, signs on both sides; the sign of day 2."""
    blocks = [str(name) for name in rng.permutation(["cone", "drum", "vertical_panel", "tubular_marker"])]
    cones: list[Cone] = []
    objects: list[RoadObject] = []

    def add(kind: str, x: float, y: float, height: float, width: float = 1.0, colour: Colour = ORANGE) -> None:
        name = f"O{len(objects) + 1:02d}"
        turn = float(rng.normal(0.0, 0.08))
        ground_m = Road().ground_m(y)
        objects.append(RoadObject(kind, x, y, turn, round(height, 3), colour, round(width, 3), name, ground_m))

    x = -4.0
    for kind in blocks:
        height = {
            "cone": float(rng.choice([0.5, 0.7, 0.9])), "drum": rng.uniform(0.9, 1.05), "vertical_panel": rng.uniform(0.9, 1.2),
            "tubular_marker": rng.uniform(0.75, 1.1),
        }[kind]  # fmt: skip
        for _ in range(3):
            y = -4.0 + 0.25 * math.sin(0.2 * x) + float(rng.uniform(-0.1, 0.1))
            if kind == "cone":
                tilt, yaw = abs(float(rng.normal(0.0, 0.012))), float(rng.uniform(-0.5, 0.5))
                cones.append(
                    Cone(f"C{len(cones) + 1:02d}", x, y, height, yaw, tilt, dirt=float(rng.uniform(0.05, 0.35)))
                )
            else:
                add(kind, x, y, height, 0.3, _orange(rng))
            x += 2.6 + float(rng.uniform(-0.2, 0.2))
        x += 0.8
    add("type_3", x + 0.5, -4.3, rng.uniform(1.2, 1.5), rng.uniform(1.2, 1.8), _orange(rng))
    add("type_3", 14.0 + float(rng.uniform(-2, 2)), 4.6, rng.uniform(1.0, 1.5), rng.uniform(1.2, 1.6), _orange(rng))
    for k in range(2):
        add("tubular_marker", 2.0 + 7.0 * k + float(rng.uniform(-1, 1)), 2.3, rng.uniform(0.75, 1.1), 0.1, _orange(rng))
    add("arrow_board", 35.5 + float(rng.uniform(-1, 1)), -6.9, rng.uniform(2.9, 3.3), rng.uniform(2.0, 2.4))
    add("diamond", -2.0 + float(rng.uniform(-1, 1)), -6.4, rng.uniform(1.5, 1.8), rng.uniform(0.9, 1.2))
    add("diamond", 21.0 + float(rng.uniform(-1, 1)), 5.4, rng.uniform(1.5, 2.4), rng.uniform(0.9, 1.2))
    add("work_triangle", 10.0 + float(rng.uniform(-1, 1)), -6.3, rng.uniform(1.3, 1.7), rng.uniform(0.8, 1.0))
    add("speed_disc", 4.0 + float(rng.uniform(-1, 1)), -6.6, rng.uniform(2.2, 2.7), rng.uniform(0.55, 0.7))
    add("warning_triangle", 27.0 + float(rng.uniform(-1, 1)), -6.5, rng.uniform(2.2, 2.7), rng.uniform(0.8, 1.0))
    add("rectangle", 16.5 + float(rng.uniform(-1, 1)), -6.6, rng.uniform(2.2, 2.7), rng.uniform(0.6, 0.75))
    add("mandatory_disc", 7.0 + float(rng.uniform(-1, 1)), 5.2, rng.uniform(1.9, 2.4), rng.uniform(0.55, 0.7))
    add("speed_disc", 30.0 + float(rng.uniform(-1, 1)), 5.3, rng.uniform(2.1, 2.5), rng.uniform(0.55, 0.7))
    return tuple(cones), tuple(objects[:-1]), objects[-1]


def _orange(rng: np.random.Generator) -> Colour:
    r, g, b = np.clip(np.array(ORANGE) + rng.normal(0.0, (0.02, 0.04, 0.02)), 0.01, 0.99)
    return float(r), float(g), float(b)


#: Kinds of the sample scenario that have no class, and stand where no device does.
_BACKGROUND = ("house", "hedge", "tree", "bin", "hydrant")
