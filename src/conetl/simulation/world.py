"""Objects of a simulated scene as plain records, without rendering.

Road frame: x along the road, y to its left, z up, the origin on the road's centre line at ground height. Lengths in metres.
"""

from __future__ import annotations

from dataclasses import dataclass

Colour = tuple[float, float, float]
"""sRGB, 0..1."""

ORANGE: Colour = (0.95, 0.36, 0.08)


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


@dataclass(frozen=True)
class Road:
    """Cross-section of the road, from right (negative y) to left, and its markings."""

    right_m: float = -5.4
    left_m: float = 3.4
    start_m: float = -70.0
    end_m: float = 130.0
    centre_line: bool = True
    edge_lines: tuple[float, ...] = (-3.3, 3.1)
    """y of the continuous lines."""
    pavement_width_m: float = 2.2
    verge: Colour = (0.30, 0.37, 0.16)
    asphalt: float = 0.42
    """Mean sRGB grey."""


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
