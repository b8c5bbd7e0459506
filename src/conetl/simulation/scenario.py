"""Objects of a simulated scene as plain records, and the sample scenario: three passes of one lane-closure taper on three days.

Road frame: x along the road, y to its left, z up, the origin on the road's centre line at ground height. Lengths in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from conetl.geometry import linear_reference
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.markings import MarkingColour

Colour = tuple[float, float, float]
"""sRGB, 0..1."""

ORANGE: Colour = (0.95, 0.36, 0.08)
PAINT_HEIGHT_M = 0.003
KERB_WIDTH_M, KERB_HEIGHT_M = 0.14, 0.12
PAVEMENT_HEIGHT_M, VERGE_HEIGHT_M = 0.10, 0.08
PASS_NUMBERS = (1, 2, 3)
_SCENE_SEED = 20260302
"""Seed of the cones' appearance (dirt, lean, shade), not of the noise of cameras and GNSS."""


@dataclass(frozen=True)
class Cone:
    """One traffic cone; x_m, y_m is the centre of the base plate's underside on the ground."""

    cone_id: str
    x_m: float
    y_m: float
    height_m: float
    yaw_rad: float = 0.0
    tilt_rad: float = 0.0
    """Lean of the body on its plate; the plate stays on the ground."""
    tilt_azimuth_rad: float = 0.0
    colour: Colour = ORANGE
    band_count: int = 2
    dirt: float = 0.2
    fallen: bool = False
    plate_colour: Colour = (0.13, 0.13, 0.13)
    slimness: float = 1.0
    """Width of the body's foot as a share of the usual one of this height."""


@dataclass(frozen=True)
class RoadObject:
    """Any other object on or beside the road; `kind` is a key of `parts.BUILDERS`."""

    kind: str
    x_m: float
    y_m: float
    yaw_rad: float = 0.0
    height_m: float = 1.0
    colour: Colour = (0.5, 0.5, 0.5)
    length_m: float = 1.0
    """Width of plates and boards."""
    object_id: str = ""
    """In truth.csv, of kinds that have a class; empty: not surveyed."""
    ground_m: float = 0.0
    """Height of the ground on which it stands, above the road."""


@dataclass(frozen=True)
class RoadMarking:
    """One painted line of the road."""

    marking_id: str
    points_m: tuple[tuple[float, float], ...]
    """(x, y) along its centre line; dashes count from the first."""
    dash_m: float | None = None
    """None of a continuous line. A dash that begins on the line is painted whole, beyond its end too."""
    gap_m: float | None = None
    width_m: float = 0.12
    colour: MarkingColour = "white"
    worn: float = 0.0
    """Share of the paint that is gone, in holes."""


def street_markings(
    start_m: float, end_m: float, edges_m: tuple[float, ...], *, centre_line: bool = True
) -> tuple[RoadMarking, ...]:
    """Continuous lines at y of edges_m, and a dashed line between the lanes (3 m of paint, 3 m of gap)."""
    lines = [RoadMarking(f"E{n}", ((start_m, y), (end_m, y))) for n, y in enumerate(edges_m, 1)]
    if centre_line:
        lines.append(RoadMarking("C1", ((start_m, 0.0), (end_m, 0.0)), dash_m=3.0, gap_m=3.0))
    return tuple(lines)


def painted_lines(marking: RoadMarking) -> list[Floats]:
    """Centre lines (K, 2) of the paint: the whole line, or one per dash."""
    line = np.array(marking.points_m)
    if marking.dash_m is None or marking.gap_m is None:
        return [line]
    station = linear_reference.stations(line)
    dashes = []
    for start in np.arange(0.0, station[-1], marking.dash_m + marking.gap_m):
        end = start + marking.dash_m
        at = np.array([start, *station[(station > start) & (station < end)], end])
        dashes.append(linear_reference.locate(line, at, np.zeros(len(at))))
    return dashes


@dataclass(frozen=True)
class Road:
    """Cross-section of the road, from right (negative y) to left, and its markings."""

    right_m: float = -5.4
    left_m: float = 3.4
    start_m: float = -70.0
    end_m: float = 130.0
    markings: tuple[RoadMarking, ...] = street_markings(-70.0, 130.0, (-3.3, 3.1))
    pavement_width_m: float = 2.2
    verge: Colour = (0.30, 0.37, 0.16)
    asphalt: float = 0.42
    """Mean sRGB grey."""

    @property
    def pavement_edge_m(self) -> float:
        """y of the pavement's far edge, behind the kerb on the right."""
        return self.right_m - KERB_WIDTH_M - self.pavement_width_m

    def ground_m(self, y_m: float) -> float:
        """Height of the ground above the asphalt: of pavement, verge and kerbs."""
        if self.right_m <= y_m <= self.left_m:
            return 0.0
        if self.right_m - KERB_WIDTH_M <= y_m <= self.left_m + KERB_WIDTH_M:
            return KERB_HEIGHT_M
        return PAVEMENT_HEIGHT_M if self.pavement_edge_m <= y_m < self.right_m else VERGE_HEIGHT_M


@dataclass(frozen=True)
class World:
    """A whole scene without cameras."""

    cones: tuple[Cone, ...]
    objects: tuple[RoadObject, ...]
    sun_elevation_deg: float
    sun_azimuth_deg: float
    """In the road frame, counter-clockwise from x."""
    turbidity: float = 3.0
    sun_scale: float = 1.0
    """0 for an overcast sky."""
    road: Road = Road()
    texture_seed: int = 0


@dataclass(frozen=True)
class ScenarioPass:
    """One drive past the taper."""

    drive_id: str
    start_utc: datetime
    world: World
    changes: dict[str, str]
    """cone_id or object_id -> added, confirmed, moved or removed, relative to the previous pass."""
    removed: tuple[Cone, ...]
    """Cones of the previous pass that were removed."""
    exposure: float
    """Brightness relative to a plain exposure."""
    start_x_m: float
    end_x_m: float
    """x of the left camera in the first and last frame."""
    path_y_m: tuple[float, float]
    """y of the vehicle at the smaller and the larger x of the taper."""
    frame_count: int


#: For each pass: drive, start, elevation and azimuth of the sun, turbidity, exposure, x at the first and at the last frame, path.
_PASSES = (
    ("2026-03-02_taper_pass1", datetime(2026, 3, 2, 9, 41, 7, 250_000, UTC), 34.0, 118.0, 2.6, 1.0, (-17.0, 33.7), (-1.3, 0.0)),
    ("2026-03-03_taper_pass2", datetime(2026, 3, 3, 13, 5, 44, 610_000, UTC), 47.0, -35.0, 4.5, 0.85, (-17.4, 33.3), (-1.1, 0.1)),
    ("2026-03-04_taper_pass3", datetime(2026, 3, 4, 15, 22, 31, 80_000, UTC), 27.0, -72.0, 3.2, 0.72, (60.6, 9.9), (0.5, 1.1)),
)  # fmt: skip


def scenario_pass(pass_number: int) -> ScenarioPass:
    """Pass 1, 2 or 3. Raises InputError for another number."""
    if pass_number not in PASS_NUMBERS:
        raise InputError(f"the scenario has passes 1, 2 and 3, not {pass_number}")
    drive_id, start_utc, elevation, azimuth, turbidity, exposure, x_m, path_y_m = _PASSES[pass_number - 1]
    first = _first_cones()
    second, changes = _changed(first)
    cones = first if pass_number == 1 else second
    if pass_number != 2:
        changes = {cone.cone_id: "added" if pass_number == 1 else "confirmed" for cone in cones}
    world = World(
        cones=cones, objects=_surroundings(), sun_elevation_deg=elevation, sun_azimuth_deg=azimuth, turbidity=turbidity,
        texture_seed=17,
    )  # fmt: skip
    return ScenarioPass(
        drive_id=drive_id, start_utc=start_utc, world=world, changes=changes,
        removed=tuple(cone for cone in first if changes.get(cone.cone_id) == "removed"), exposure=exposure,
        start_x_m=x_m[0], end_x_m=x_m[1], path_y_m=path_y_m, frame_count=39,
    )  # fmt: skip


def _first_cones() -> tuple[Cone, ...]:
    """Nine cones from the kerb into the lane, 70 cm and 50 cm high."""
    rng = np.random.default_rng(_SCENE_SEED)
    heights = (0.70, 0.70, 0.50, 0.70, 0.50, 0.70, 0.70, 0.50, 0.70)
    return tuple(
        _appearance(
            Cone(f"C{n:02d}", 4.6 * n + rng.uniform(-0.3, 0.3), -4.7 + 0.27 * n + rng.uniform(-0.08, 0.08), height), rng
        )
        for n, height in enumerate(heights, 1)
    )


def _appearance(cone: Cone, rng: np.random.Generator) -> Cone:
    r, g, b = np.array(cone.colour) + rng.normal(0.0, (0.02, 0.03, 0.015))
    return replace(
        cone,
        yaw_rad=rng.uniform(-0.5, 0.5), tilt_rad=abs(rng.normal(0.0, math.radians(0.8))),
        tilt_azimuth_rad=rng.uniform(-math.pi, math.pi), colour=(min(float(r), 1.0), float(g), max(float(b), 0.0)),
        band_count=2 if cone.height_m > 0.6 else 1, dirt=rng.uniform(0.05, 0.35),
    )  # fmt: skip


def _changed(first: tuple[Cone, ...]) -> tuple[tuple[Cone, ...], dict[str, str]]:
    """Overnight: C04 moved by 1.5 m, C07 removed, C10 and C11 added."""
    rng = np.random.default_rng(_SCENE_SEED + 1)
    changes = {cone.cone_id: "confirmed" for cone in first} | {"C04": "moved", "C07": "removed"}
    turn = math.radians(38.0)
    kept = [
        replace(c, x_m=c.x_m + 1.5 * math.cos(turn), y_m=c.y_m + 1.5 * math.sin(turn)) if c.cone_id == "C04" else c
        for c in first
        if c.cone_id != "C07"
    ]
    added = [_appearance(Cone("C10", 11.3, -3.1, 0.50), rng), _appearance(Cone("C11", 38.6, -4.3, 0.70), rng)]
    changes |= {cone.cone_id: "added" for cone in added}
    return (*kept, *added), changes


def _surroundings() -> tuple[RoadObject, ...]:
    """Objects on all three days, red-and-white and orange ones that are not cones among them."""
    grey, green, plaster = (0.55, 0.56, 0.57), (0.17, 0.27, 0.12), (0.78, 0.72, 0.60)
    behind = math.pi
    return (
        *(RoadObject("bollard", x, -6.1, height_m=0.95) for x in (6.0, 12.5, 19.0, 25.5)),
        *(RoadObject("bollard", x, 4.1, height_m=0.95) for x in (-2.0, 10.0, 22.0)),
        RoadObject("van", 50.5, -4.35, yaw_rad=0.03, height_m=2.25, length_m=5.1, colour=(0.93, 0.42, 0.08)),
        RoadObject("round_sign", 2.5, -6.4, height_m=2.6, colour=grey),
        RoadObject("triangle_sign", -4.5, -6.2, height_m=2.5, colour=grey),
        RoadObject("round_sign", 31.0, 4.5, yaw_rad=behind, height_m=2.6, colour=grey),
        RoadObject("triangle_sign", 40.5, 4.4, yaw_rad=behind, height_m=2.5, colour=grey),
        RoadObject("barrier_post", 45.6, -3.2, height_m=1.1),
        RoadObject("barrier_post", 45.9, -4.6, height_m=1.1),
        RoadObject("bin", 15.5, -7.3, yaw_rad=0.2, height_m=1.05, colour=(0.20, 0.24, 0.26)),
        RoadObject("bin", 16.2, -7.35, yaw_rad=-0.1, height_m=1.05, colour=(0.65, 0.30, 0.10)),
        RoadObject("hydrant", 28.5, -6.5, height_m=0.75, colour=(0.70, 0.10, 0.08)),
        RoadObject("worker", 47.2, -6.6, yaw_rad=0.8, height_m=1.8, colour=(0.95, 0.40, 0.06)),
        RoadObject("house", 8.0, -14.5, height_m=6.2, length_m=22.0, colour=plaster),
        RoadObject("house", 40.0, -15.5, height_m=5.6, length_m=18.0, colour=(0.62, 0.45, 0.38)),
        RoadObject("house", -22.0, -15.0, height_m=6.4, length_m=20.0, colour=(0.72, 0.73, 0.72)),
        RoadObject("house", 76.0, -14.0, height_m=6.0, length_m=26.0, colour=(0.80, 0.77, 0.70)),
        RoadObject("hedge", 14.0, 7.0, height_m=1.9, length_m=46.0, colour=green),
        RoadObject("hedge", 66.0, 7.6, height_m=2.4, length_m=50.0, colour=(0.20, 0.28, 0.11)),
        RoadObject("hedge", -34.0, 7.2, height_m=2.1, length_m=40.0, colour=(0.15, 0.24, 0.10)),
        RoadObject("house", 24.0, 19.0, yaw_rad=behind, height_m=7.0, length_m=28.0, colour=(0.70, 0.62, 0.52)),
        *(RoadObject("tree", x, 10.5, height_m=h, colour=green) for x, h in ((-12.0, 7.0), (1.0, 8.0), (47.0, 7.5), (74.0, 9.0))),
        *(RoadObject("tree", x, -9.8, height_m=h, colour=(0.24, 0.32, 0.12)) for x, h in ((24.0, 6.5), (58.0, 7.5), (-9.0, 6.0))),
        RoadObject("hedge", 118.0, 0.0, yaw_rad=math.pi / 2, height_m=7.0, length_m=60.0, colour=(0.16, 0.23, 0.12)),
        RoadObject("hedge", -62.0, 0.0, yaw_rad=math.pi / 2, height_m=7.0, length_m=60.0, colour=(0.16, 0.23, 0.12)),
    )  # fmt: skip
