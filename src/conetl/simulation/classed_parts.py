"""Objects of the classes of `model/feature_classes.py` other than cones, as parts, and their truth.

Plates face -x of their own frame: a drive along +x sees the front of an object that is not turned.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from conetl.simulation import meshes, sign_faces, textures
from conetl.simulation.meshes import Mesh
from conetl.simulation.parts import Part, at_object
from conetl.simulation.scenario import ORANGE, RoadObject

_GREY = (0.50, 0.51, 0.52)
_RUBBER = (0.10, 0.10, 0.10)
_WHITE = (0.92, 0.92, 0.90)
#: Height of a plate as a share of its width, 1 unless given.
_BOARD_SHARE = {"arrow_board": 0.5, "rectangle": 1.25}
#: Classes of kinds that stand on the road, and of plates.
_STANDING = {
    "drum": "drum",
    "tubular_marker": "tubular_marker",
    "vertical_panel": "vertical_panel",
    "type_3": "barricade",
}
_PLATES = {
    "diamond": "work_zone_sign", "work_triangle": "work_zone_sign", "arrow_board": "arrow_board", "speed_disc": "traffic_sign",
    "mandatory_disc": "traffic_sign", "warning_triangle": "traffic_sign", "rectangle": "traffic_sign",
}  # fmt: skip
CLASSED_KINDS = frozenset({*_STANDING, *_PLATES})


class TrueShape(NamedTuple):
    """What truth.csv states of an object: its class, the lower end of what is located above the ground, and its height."""

    category: str
    foot_m: float
    height_m: float


def true_shape(item: RoadObject) -> TrueShape:
    """Of signs and boards the plate alone. Raises KeyError for kinds without a class."""
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
    return [Part(at_object(item, tube), textures.striped(bands, seed)), Part(at_object(item, base), _RUBBER)]


def _vertical_panel(item: RoadObject, seed: int) -> list[Part]:
    """A striped board on a rubber base."""
    board_m = 0.8 * item.height_m
    board = meshes.box([0.03, item.length_m, board_m], item.height_m - board_m)
    mast = meshes.box([0.04, 0.07, item.height_m - board_m], 0.05)
    face = sign_faces.stripes(seed, item.colour, item.length_m / board_m, bool(seed % 2))
    return [
        Part(at_object(item, board), face),
        Part(at_object(item, mast), _RUBBER),
        Part(at_object(item, meshes.box([0.45, 0.42, 0.08])), _RUBBER),
    ]


def _type_3_barricade(item: RoadObject, seed: int) -> list[Part]:
    """Three striped boards on two posts with feet (MUTCD 2023, chapter 6K: type 3)."""
    h, width = item.height_m, item.length_m
    face = sign_faces.stripes(seed, item.colour, width / 0.2, bool(seed % 2))
    parts = [Part(at_object(item, meshes.box([0.03, width, 0.2], h * z)), face) for z in (0.3, 0.57)]
    parts.append(Part(at_object(item, meshes.box([0.03, width, 0.2], h - 0.2)), face))
    for y in (-0.38 * width, 0.38 * width):
        parts.append(Part(at_object(item, meshes.box([0.05, 0.05, h - 0.02]), x=0.045, y=y), _WHITE))
        parts.append(Part(at_object(item, meshes.box([0.9, 0.06, 0.05]), y=y), _GREY))
    return parts


def _plate(item: RoadObject, seed: int) -> list[Part]:
    """A sign on one post, or a temporary one or an arrow board on its stand; grey from behind."""
    high = _plate_height_m(item)
    low = item.height_m - high
    outline, face = sign_faces.FACES[item.kind]
    corners = outline * [item.length_m, high] + [0.0, low]
    parts = [
        Part(_front(item, meshes.prism(corners, 0.012)), face(seed)[::-1]),  # the first row of a texture is the lowest
        Part(at_object(item, meshes.prism(corners, 0.012), x=0.02), _GREY),
    ]
    if item.kind == "arrow_board":
        parts += [
            Part(at_object(item, meshes.box([0.08, 0.08, low + 0.5 * high], 0.3), x=0.08, y=y), _GREY)
            for y in (-0.6, 0.6)
        ]
        parts.append(Part(at_object(item, meshes.box([1.6, 1.5, 0.35], 0.35), x=0.5), ORANGE))
        wheel = meshes.box([0.6, 0.18, 0.6])
        return parts + [Part(at_object(item, wheel, x=0.5, y=y), _RUBBER) for y in (-0.85, 0.85)]
    if true_shape(item).category == "work_zone_sign":
        parts += [Part(at_object(item, meshes.box([0.04, 0.9, 0.05], 0.02), x=x), _GREY) for x in (-0.25, 0.06, 0.35)]
        parts.append(Part(at_object(item, meshes.box([0.7, 0.05, 0.05], 0.02), x=0.05), _GREY))
    mast = meshes.lathe([0.03, 0.03, 0.0], [0.0, low + 0.8 * high, low + 0.8 * high], 16)
    return [*parts, Part(at_object(item, mast, x=0.06), _GREY, 0.3)]


def _front(item: RoadObject, mesh: Mesh) -> Mesh:
    """The mesh at the object, its front alone: triangles of the side towards -x."""
    count = len(mesh.triangles) // 2
    return at_object(item, mesh._replace(triangles=mesh.triangles[:count]))


def _plate_height_m(item: RoadObject) -> float:
    return float(np.round(item.length_m * _BOARD_SHARE.get(item.kind, 1.0), 3))


BUILDERS: dict[str, Callable[[RoadObject, int], list[Part]]] = {
    "tubular_marker": _tubular_marker, "vertical_panel": _vertical_panel, "type_3": _type_3_barricade,
    **dict.fromkeys(_PLATES, _plate),
}  # fmt: skip
