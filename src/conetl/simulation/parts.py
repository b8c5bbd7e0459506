"""Cones and road objects as coloured meshes in the road frame, and the truth of those that have a class of
`model/feature_classes.py`. Sizes follow the usual articles of German road works.

Plates face -x of their own frame: a drive along +x sees the front of an object that is not turned.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from conetl.geometry.pose import se3
from conetl.model.arrays import Floats, Image
from conetl.simulation import meshes, textures
from conetl.simulation.meshes import Mesh
from conetl.simulation.scenario import ORANGE, Colour, Cone, RoadObject

_GREY = (0.50, 0.51, 0.52)
_RUBBER = (0.10, 0.10, 0.10)
_WHITE = (0.92, 0.92, 0.90)
#: Height of a plate as a share of its width; default: 1.
_BOARD_SHARE = {"arrow_board": 0.5, "rectangle": 1.25}
#: Classes of kinds that stand on the road, and of plates.
_STANDING = {"type_3": "barricade"} | {kind: kind for kind in ("drum", "tubular_marker", "vertical_panel")}
_PLATES = {
    "diamond": "work_zone_sign", "work_triangle": "work_zone_sign", "arrow_board": "arrow_board", "speed_disc": "traffic_sign",
    "mandatory_disc": "traffic_sign", "warning_triangle": "traffic_sign", "rectangle": "traffic_sign",
}  # fmt: skip
CLASSED_KINDS = frozenset({*_STANDING, *_PLATES})


class Part(NamedTuple):
    """One mesh in the road frame with its surface."""

    mesh: Mesh
    surface: Colour | Image
    roughness: float | None = None
    """None for a matt surface, else that of a plastic coat."""


def motion(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> Floats:
    """(4, 4) turn about the vertical, then shift."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s, 0.0, x_m], [s, c, 0.0, y_m], [0.0, 0.0, 1.0, z_m], [0.0, 0.0, 0.0, 1.0]])


def _lean(angle_rad: float, azimuth_rad: float, height_m: float = 0.0) -> Floats:
    """(4, 4) lean towards an azimuth, about a horizontal axis at a height."""
    axis = np.array([-math.sin(azimuth_rad), math.cos(azimuth_rad), 0.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + (math.sin(angle_rad) * cross + (1.0 - math.cos(angle_rad)) * cross @ cross)
    pivot = np.array([0.0, 0.0, height_m])
    return se3(turn, pivot - turn @ pivot)


def cone_parts(cone: Cone, seed: int) -> list[Part]:
    """Base plate and body, together `height_m` high."""
    h = cone.height_m
    side = 0.03 + 0.5 * h  # base plate: 38 cm under a 70 cm cone, 28 cm under a 50 cm one
    thick = 0.04 * math.sqrt(h / 0.7)
    bottom, top = 0.37 * side * cone.slimness, 0.035 * math.sqrt(h / 0.7)
    plate = meshes.box([side, side, thick])
    heights = [thick, thick + 0.02 * h, thick + 0.05 * h, *np.linspace(thick + 0.1 * h, 0.985 * h, 6), h, h]
    reach = (np.array(heights) - thick) / (h - thick)
    radii = bottom + (top - bottom) * reach
    radii[0] *= 1.16
    radii[-1] = 0.0
    body = meshes.lathe(radii, heights)
    body = meshes.transformed(body, _lean(cone.tilt_rad, cone.tilt_azimuth_rad, thick))
    stand = motion(cone.x_m, cone.y_m, 0.0, cone.yaw_rad)
    if cone.fallen:  # lies on the plate's edge and the tip
        lie = math.pi / 2 - math.asin((side / 2 - top) / (h - thick))
        lean = _lean(math.pi - (math.pi / 2 - lie) - math.pi / 2, 0.0)
        stand = stand @ motion(-h / 2, 0.0) @ lean
        low = min((stand @ np.vstack([m.vertices.T, np.ones(len(m.vertices))]))[2].min() for m in (plate, body))
        stand = motion(0.0, 0.0, -low) @ stand
    plate_skin = textures.mottled(seed + 11, cone.plate_colour, 0.18, size=64)
    return [
        Part(meshes.transformed(plate, stand), plate_skin),
        Part(meshes.transformed(body, stand), textures.cone_skin(cone, seed)),
    ]


def _part(
    item: RoadObject, mesh: Mesh, surface: Colour | Image, roughness: float | None = None,
    x: float = 0.0, y: float = 0.0, z: float = 0.0,
) -> Part:  # fmt: skip
    """A mesh at (x, y, z) of the object's frame as a part in the road frame."""
    stand = motion(item.x_m, item.y_m, item.ground_m, item.yaw_rad) @ motion(x, y, z)
    return Part(meshes.transformed(mesh, stand), surface, roughness)


def _bollard(item: RoadObject, seed: int) -> list[Part]:
    red, white = (0.78, 0.08, 0.07), (0.9, 0.9, 0.88)
    h = item.height_m
    body = meshes.lathe([0.055, 0.055, 0.0], [0.0, h, h + 0.01], 24)
    foot = meshes.lathe([0.17, 0.14, 0.0], [0.0, 0.05, 0.06], 24)
    return [_part(item, body, textures.striped((red, white, red, white, red), seed)), _part(item, foot, _RUBBER)]


def _barrier_post(item: RoadObject, seed: int) -> list[Part]:
    """A red-and-white guide board on a rubber foot, as beside German road works."""
    red, white = (0.8, 0.08, 0.07), (0.92, 0.92, 0.9)
    board = meshes.box([0.03, 0.25, item.height_m - 0.15], 0.15)
    foot = meshes.box([0.8, 0.4, 0.12])
    return [
        _part(item, board, textures.striped((red, white) * 3, seed)),
        _part(item, foot, textures.mottled(seed, (0.16, 0.16, 0.16), 0.2, size=64)),
    ]


def _drum(item: RoadObject, seed: int) -> list[Part]:
    """A plastic channelising drum with reflective bands on a rubber ring, as beside American road works."""
    h = item.height_m
    body = meshes.lathe([0.29 * h, 0.24 * h, 0.22 * h, 0.08 * h, 0.0], [0.04, 0.85 * h, 0.97 * h, h, h], 28)
    ring = meshes.lathe([0.38 * h, 0.36 * h, 0.0], [0.0, 0.06, 0.07], 24)
    bands = (item.colour, _WHITE, item.colour, _WHITE, item.colour)
    return [_part(item, body, textures.striped(bands, seed)), _part(item, ring, _RUBBER)]


def _post(item: RoadObject, seed: int) -> list[Part]:
    return [_part(item, meshes.lathe([0.038, 0.038, 0.0], [0.0, item.height_m, item.height_m], 20), item.colour, 0.3)]


def _round_sign(item: RoadObject, seed: int) -> list[Part]:
    turn = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    disc = meshes.prism(np.column_stack([0.3 * np.cos(turn), item.height_m - 0.3 + 0.3 * np.sin(turn)]), 0.02)
    return [*_post(item, seed), _part(item, disc, textures.round_sign(seed), x=-0.05)]


def _triangle_sign(item: RoadObject, seed: int) -> list[Part]:
    parts = _post(item, seed)
    for scale, colour, x in ((1.0, (0.8, 0.07, 0.08), -0.05), (0.66, (0.93, 0.93, 0.9), -0.065)):
        outline = np.array([[0.45, -0.26], [0.0, 0.52], [-0.45, -0.26]]) * scale
        parts.append(_part(item, meshes.prism(outline + np.array([0.0, item.height_m - 0.5]), 0.015), colour, x=x))
    bar = meshes.box([0.012, 0.06, 0.26], item.height_m - 0.62)
    return [*parts, _part(item, bar, (0.05, 0.05, 0.05), x=-0.08)]


def _bin(item: RoadObject, seed: int) -> list[Part]:
    body = meshes.box([0.5, 0.52, item.height_m - 0.12], 0.06)
    lid = meshes.box([0.56, 0.58, 0.07], item.height_m - 0.07)
    r, g, b = (0.7 * c for c in item.colour)
    return [_part(item, body, textures.mottled(seed, item.colour, 0.1, size=128)), _part(item, lid, (r, g, b))]


def _hydrant(item: RoadObject, seed: int) -> list[Part]:
    h = item.height_m
    body = meshes.lathe(
        [0.13, 0.13, 0.09, 0.09, 0.13, 0.12, 0.05, 0.0], np.array([0, 0.06, 0.1, 0.7, 0.72, 0.84, 0.98, 1]) * h
    )
    arm = meshes.transformed(meshes.box([0.09, 0.34, 0.09]), motion(0.0, 0.0, 0.55 * h))
    return [_part(item, body, item.colour, 0.3), _part(item, arm, item.colour, 0.3)]


def _van(item: RoadObject, seed: int) -> list[Part]:
    """A panel van, front towards +x of its own frame."""
    length, width, h = item.length_m, 1.95, item.height_m
    glass, black = (0.07, 0.09, 0.11), (0.04, 0.04, 0.04)
    nose = length / 2
    outline = np.array([[-nose, 0.35], [nose, 0.35], [nose, 1.05], [nose - 0.55, 1.2], [nose - 1.35, h], [-nose, h]])
    turn = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    side = meshes.transformed(meshes.prism(outline @ np.array([[-1.0, 0.0], [0.0, 1.0]]), width), turn)
    skin = textures.mottled(seed, item.colour, 0.03, size=256)
    # The hull between the two sides: one thin box per edge of the outline.
    parts = [_part(item, meshes.transformed(side, motion(0, 0, 0, math.pi)), skin, 0.15)]
    for (x0, z0), (x1, z1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        run = math.hypot(x1 - x0, z1 - z0)
        lean = math.atan2(z1 - z0, x1 - x0)
        c, s = math.cos(lean), math.sin(lean)
        place = np.array([[c, 0, -s, (x0 + x1) / 2], [0, 1, 0, 0], [s, 0, c, (z0 + z1) / 2], [0, 0, 0, 1.0]])
        surface, roughness = (glass, 0.1) if x0 == nose - 0.55 else (skin, 0.15)
        panel = meshes.box([run, width + 0.004, 0.03], -0.015)
        parts.append(_part(item, meshes.transformed(panel, place), surface, roughness))
    for y in (-width / 2 - 0.012, width / 2 + 0.012):
        parts.append(_part(item, meshes.box([0.8, 0.02, 0.5], 1.2), glass, 0.1, x=nose - 1.55, y=y))
        parts.append(_part(item, meshes.box([length - 0.2, 0.015, 0.12], 0.75), (0.85, 0.85, 0.85), y=y))
        wheel = meshes.lathe([0.0, 0.2, 0.33, 0.33, 0.2, 0.0], [0.0, 0.0, 0.02, 0.2, 0.22, 0.22], 28)
        lying = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0.33], [0, 0, 0, 1.0]])
        for x in (-0.31 * length, 0.31 * length):
            parts.append(_part(item, meshes.transformed(wheel, lying), black, x=x, y=y - 0.11 - math.copysign(0.06, y)))
    for y in (-0.48, 0.48):
        parts.append(_part(item, meshes.box([0.02, 0.7, 0.55], 1.25), glass, 0.1, x=-nose - 0.03, y=y))
        parts.append(_part(item, meshes.box([0.03, 0.14, 0.35], 0.75), (0.6, 0.04, 0.03), x=-nose - 0.03, y=1.8 * y))
        parts.append(_part(item, meshes.box([0.03, 0.3, 0.18], 0.75), (0.9, 0.9, 0.85), x=nose + 0.02, y=1.4 * y))
    parts.append(_part(item, meshes.box([0.02, 0.52, 0.11], 0.55), (0.9, 0.9, 0.88), x=-nose - 0.03))
    return parts


def _worker(item: RoadObject, seed: int) -> list[Part]:
    """A standing figure in hi-vis clothes, made of boxes."""
    k = item.height_m / 1.8
    legs = (0.12, 0.14, 0.25) if seed % 2 else item.colour
    silver = (0.82, 0.82, 0.82)
    pieces: list[tuple[list[float], float, float, Colour]] = [
        ([0.2, 0.17, 0.85], 0.0, -0.11, legs), ([0.2, 0.17, 0.85], 0.0, 0.11, legs),
        ([0.26, 0.46, 0.62], 0.83, 0.0, item.colour), ([0.27, 0.47, 0.06], 1.0, 0.0, silver),
        ([0.27, 0.47, 0.06], 1.2, 0.0, silver), ([0.13, 0.12, 0.6], 0.82, -0.3, item.colour),
        ([0.13, 0.12, 0.6], 0.82, 0.3, item.colour), ([0.2, 0.17, 0.24], 1.47, 0.0, (0.75, 0.55, 0.45)),
    ]  # fmt: skip
    parts = [_part(item, meshes.box(np.array(size) * k, base * k), colour, y=y * k) for size, base, y, colour in pieces]
    helmet = meshes.lathe(np.array([0.14, 0.14, 0.1, 0.0]) * k, np.array([1.66, 1.7, 1.78, 1.81]) * k, 20)
    return [*parts, _part(item, helmet, (0.9, 0.75, 0.1) if seed % 3 else (0.92, 0.92, 0.9), 0.2)]


def _house(item: RoadObject, seed: int) -> list[Part]:
    wall = textures.facade(seed, item.colour, columns=max(2, round(item.length_m / 2.6)))
    front = meshes.box([item.length_m, 6.0, item.height_m])
    roof = meshes.box([item.length_m + 0.6, 6.8, 0.35], item.height_m)
    return [_part(item, front, wall), _part(item, roof, textures.mottled(seed, (0.45, 0.25, 0.2), 0.15, size=256))]


def _hedge(item: RoadObject, seed: int) -> list[Part]:
    """Overlapping textured boxes, so that the outline is uneven."""
    rng = np.random.default_rng([seed, 8])
    skin = textures.mottled(seed, item.colour, 0.45, size=512, grain_px=2.0)
    count = max(2, round(item.length_m / 2.0))
    parts = []
    for x in np.linspace(-item.length_m / 2, item.length_m / 2, count):
        size = [2.6, rng.uniform(0.8, 1.1), item.height_m * rng.uniform(0.88, 1.08)]
        parts.append(
            _part(item, meshes.transformed(meshes.box(size), motion(0, 0, 0, rng.uniform(-0.12, 0.12))), skin, x=x)
        )
    return parts


def _tree(item: RoadObject, seed: int) -> list[Part]:
    rng = np.random.default_rng([seed, 9])
    h = item.height_m
    trunk = meshes.lathe([0.22, 0.14, 0.1], [0.0, 0.5 * h, 0.7 * h], 16)
    leaves = textures.mottled(seed, item.colour, 0.45, size=256, grain_px=2.0)
    parts = [_part(item, trunk, textures.mottled(seed, (0.32, 0.25, 0.18), 0.3, size=128))]
    angle = np.linspace(0.0, np.pi, 9)
    for _ in range(7):
        r = 0.2 * h * rng.uniform(0.7, 1.1)
        ball = meshes.lathe(r * np.sin(angle), -r * np.cos(angle), 14)
        x, y = rng.normal(0.0, 0.13 * h, 2)
        parts.append(_part(item, ball, leaves, x=x, y=y, z=h * rng.uniform(0.58, 0.88)))
    return parts


class TrueShape(NamedTuple):
    """The values of an object in truth.csv: its class, its lower end above the ground, and its height."""

    category: str
    foot_m: float
    height_m: float


def true_shape(item: RoadObject) -> TrueShape:
    """Class and size of an object; for signs and boards of the plate alone. Raises KeyError for kinds without a class."""
    if item.kind in _STANDING:
        return TrueShape(_STANDING[item.kind], 0.0, item.height_m)
    plate = _plate_height_m(item)
    return TrueShape(_PLATES[item.kind], item.height_m - plate, plate)


def _tubular_marker(item: RoadObject, seed: int) -> list[Part]:
    h, colour = item.height_m, item.colour
    radius = 0.045 + 0.01 * (seed % 3)
    tube = meshes.lathe([radius, radius, 0.9 * radius, 0.0], [0.03, 0.8 * h, h, h], 24)
    base = meshes.lathe([0.19, 0.16, 0.0], [0.0, 0.05, 0.06], 24)
    bands = (colour, colour, colour, colour, _WHITE, colour, _WHITE, colour)  # from the foot up
    return [_part(item, tube, textures.striped(bands, seed)), _part(item, base, _RUBBER)]


def _vertical_panel(item: RoadObject, seed: int) -> list[Part]:
    """A striped board on a rubber base."""
    board_m = 0.8 * item.height_m
    board = meshes.box([0.03, item.length_m, board_m], item.height_m - board_m)
    mast = meshes.box([0.04, 0.07, item.height_m - board_m], 0.05)
    face = textures.stripes(seed, item.colour, item.length_m / board_m, bool(seed % 2))
    return [_part(item, board, face), _part(item, mast, _RUBBER), _part(item, meshes.box([0.45, 0.42, 0.08]), _RUBBER)]


def _type_3_barricade(item: RoadObject, seed: int) -> list[Part]:
    """Three striped boards on two posts with feet (MUTCD 2023, chapter 6K: type 3)."""
    h, width = item.height_m, item.length_m
    face = textures.stripes(seed, item.colour, width / 0.2, bool(seed % 2))
    parts = [_part(item, meshes.box([0.03, width, 0.2], h * z), face) for z in (0.3, 0.57)]
    parts.append(_part(item, meshes.box([0.03, width, 0.2], h - 0.2), face))
    for y in (-0.38 * width, 0.38 * width):
        parts.append(_part(item, meshes.box([0.05, 0.05, h - 0.02]), _WHITE, x=0.045, y=y))
        parts.append(_part(item, meshes.box([0.9, 0.06, 0.05]), _GREY, y=y))
    return parts


def _plate(item: RoadObject, seed: int) -> list[Part]:
    """A sign on one post, or a temporary one or an arrow board on its stand; grey from behind."""
    high = _plate_height_m(item)
    low = item.height_m - high
    outline, face = textures.FACES[item.kind]
    plate = meshes.prism(outline * [item.length_m, high] + [0.0, low], 0.012)
    parts = [
        # The front alone: triangles of the side towards -x. The first row of a texture is the lowest.
        _part(item, plate._replace(triangles=plate.triangles[: len(plate.triangles) // 2]), face(seed)[::-1]),
        _part(item, plate, _GREY, x=0.02),
    ]
    if item.kind == "arrow_board":
        parts += [_part(item, meshes.box([0.08, 0.08, low + 0.5 * high], 0.3), _GREY, x=0.08, y=y) for y in (-0.6, 0.6)]
        parts.append(_part(item, meshes.box([1.6, 1.5, 0.35], 0.35), ORANGE, x=0.5))
        wheel = meshes.box([0.6, 0.18, 0.6])
        return parts + [_part(item, wheel, _RUBBER, x=0.5, y=y) for y in (-0.85, 0.85)]
    if true_shape(item).category == "work_zone_sign":
        parts += [_part(item, meshes.box([0.04, 0.9, 0.05], 0.02), _GREY, x=x) for x in (-0.25, 0.06, 0.35)]
        parts.append(_part(item, meshes.box([0.7, 0.05, 0.05], 0.02), _GREY, x=0.05))
    mast = meshes.lathe([0.03, 0.03, 0.0], [0.0, low + 0.8 * high, low + 0.8 * high], 16)
    return [*parts, _part(item, mast, _GREY, 0.3, x=0.06)]


def _plate_height_m(item: RoadObject) -> float:
    return float(np.round(item.length_m * _BOARD_SHARE.get(item.kind, 1.0), 3))


BUILDERS: dict[str, Callable[[RoadObject, int], list[Part]]] = {
    "tubular_marker": _tubular_marker, "vertical_panel": _vertical_panel, "type_3": _type_3_barricade,
    **dict.fromkeys(_PLATES, _plate), "bollard": _bollard, "barrier_post": _barrier_post, "post": _post,
    "round_sign": _round_sign, "triangle_sign": _triangle_sign, "bin": _bin, "hydrant": _hydrant, "van": _van,
    "worker": _worker, "drum": _drum, "house": _house, "hedge": _hedge, "tree": _tree,
}  # fmt: skip
