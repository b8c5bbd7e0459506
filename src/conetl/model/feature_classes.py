"""Classes of road objects: what matching, positions, the map and work zones need to know about them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from conetl.model.errors import InputError

CONE = "traffic_cone"
LANE_MARKING = "lane_marking"

# Heights that are built; `FeatureClass.heights_m` contains all. MUTCD: 2023, chapter 6K, mostly least heights, with lamps of
# about 0.35 m; TL: the terms of delivery for devices of the German StVO.
#   cones            0.30 to 1.00 m (TL-Leitkegel, EN 13422); 0.45 m and more (MUTCD), up to 1.07 m (42 inches)
#   tubular markers  0.45 m and more (MUTCD), up to 1.22 m (48 inches)
#   drums            0.91 m and more (MUTCD), up to 1.07 m and a lamp
#   vertical panels  0.61 m and more (MUTCD); beacons of 1.00 m (TL-Leitbaken) on a base, with a lamp up to 1.75 m
#   barricades       0.91 m, type 3 1.52 m and more (MUTCD), and a lamp
#   signs            plates of 0.30 to 1.72 m (48 inches on a corner), with a supplementary one below them
#   arrow boards     0.61 to 1.22 m (MUTCD, types A to C), 3.60 m (sign 616-30, TL-Absperrtafeln)


@dataclass(frozen=True)
class FeatureClass:
    """One class. Heights are those of the box: of the whole object, of signs and boards that of the plate alone."""

    heights_m: tuple[float, float]
    """From the lowest to the highest that is built, with lamps, and at least 5 cm for the measurement; sources are above."""
    match_heights_m: tuple[float, float]
    """Bounds of the height from two loose boxes: they keep an object from being matched with its neighbour."""
    width_over_height: float
    """Of the box, seen from the front; common road cones have 0.5 to 0.6."""
    round_body: bool
    """Matched as a body of revolution; False: as a plane."""
    on_road: bool
    """Whether the box ends at the road. Boxes of signs and boards end above it, so another object may stand below."""
    in_rows: bool
    """Whether rows of it close a lane, as channelizing devices do (MUTCD 2023, chapter 6K)."""
    letter: str
    """Printed beside the symbol on plans. Cones, the most common class, have none; lines are drawn as lines."""
    rim_in_box: bool = False
    """Whether the box ends at the near rim of a round or square base, by half of its width before the middle of the foot; False
    where it ends at the object itself."""
    network_share: float = 0.5
    """Weight of the network's foot against that of the box; their errors have opposite signs on rendered cones. 0 where it takes
    the near rim of a wide base for the foot."""
    body: tuple[float, float] = (0.10, 0.31)
    """Of round objects: half width of the body at its upper and lower end, as shares of the width of the box, which holds the
    base too."""
    board: float = 0.42
    """Of flat objects on the road: half width of what is matched, as a share of the width of the box, which may hold a base."""
    face_m: float = 0.0
    """Of flat objects: from the face that is matched to the axis, half the thickness of the board."""
    end: Literal["box", "edges"] = "box"
    """What shows where it ends: the box, or the edges of a rectangular board."""
    axis_from_outline: bool = False
    """Whether the edges of the body in the image, instead of the box, give the axis: those of wide, straight bodies do."""
    outline_share: float | None = 0.02
    """Sigma across the rows, as a share of the height of the box, of what all boxes of one object have in common: which part of
    it they take for its foot. Measured on rendered objects; None of cones, whose feet networks give."""
    outline_aside: float = 1.0
    """That along the rows, of its axis, as a share of it: two sides of the box show the axis, the lower one alone the foot."""
    outline_common: float = 0.5
    """Share of the variance of these errors, and of that of the shape in matching, that objects of the class have in common.
    Measured on rendered objects; cones of the sample drives show none."""
    height_common: float = 0.012
    """Sigma, as a share of the height, of what measured heights of the class have in common: which part of an object the network
    takes for its tip, such as the far rim of a drum. Neither images nor drives average it out. Measured on rendered objects."""
    geometry: Literal["point", "line"] = "point"
    """Point objects are found by the detector, lines by `perception/markings/`, which needs no network."""


FEATURE_CLASSES = {
    CONE: FeatureClass(
        (0.25, 1.15), (0.15, 1.8), 0.55, round_body=True, on_road=True, in_rows=True, letter="", rim_in_box=True,
        outline_share=None, outline_common=0.0,
    ),
    "tubular_marker": FeatureClass(
        (0.4, 1.4), (0.25, 2.0), 0.3, round_body=True, on_road=True, in_rows=True, letter="T", rim_in_box=True,
        body=(0.20, 0.22), outline_share=0.003, outline_common=0.25, height_common=0.02,
    ),
    "drum": FeatureClass(
        (0.7, 1.5), (0.45, 2.0), 0.65, round_body=True, on_road=True, in_rows=True, letter="D", rim_in_box=True,
        network_share=0.0, body=(0.33, 0.39), axis_from_outline=True, outline_share=0.005, outline_common=0.75,
        height_common=0.025,
    ),
    "vertical_panel": FeatureClass(
        (0.6, 1.8), (0.4, 2.2), 0.4, round_body=False, on_road=True, in_rows=True, letter="V", rim_in_box=True,
        network_share=0.0, board=0.26, face_m=0.015, outline_share=0.01, outline_aside=0.7, outline_common=0.75,
        height_common=0.015,
    ),
    "barricade": FeatureClass(
        (0.5, 2.0), (0.35, 2.6), 1.2, round_body=False, on_road=True, in_rows=True, letter="B",
        outline_share=0.03, outline_aside=0.8,
    ),
    "work_zone_sign": FeatureClass(
        (0.25, 2.2), (0.15, 3.0), 1.0, round_body=False, on_road=False, in_rows=False, letter="W", outline_share=0.025,
        outline_aside=0.3,
    ),
    "arrow_board": FeatureClass(
        (0.5, 3.65), (0.3, 4.2), 1.5, round_body=False, on_road=False, in_rows=False, letter="A", end="edges",
        outline_share=0.004, outline_aside=2.0,
    ),
    "traffic_sign": FeatureClass(
        (0.15, 2.5), (0.1, 3.5), 0.9, round_body=False, on_road=False, in_rows=False, letter="S", outline_share=0.025,
        outline_aside=0.3,
    ),
    LANE_MARKING: FeatureClass(
        (0.0005, 0.006), (0.0, 0.02), 30.0, round_body=False, on_road=True, in_rows=False, letter="", geometry="line"
    ),
}  # fmt: skip
"""By category; objects of other categories are not located. The height of a marking is the thickness of its paint."""
LINE_CLASSES = tuple(name for name, one in FEATURE_CLASSES.items() if one.geometry == "line")


def known_classes(categories: Iterable[str]) -> tuple[str, ...]:
    """The categories that conetl knows, without duplicates, in the order of `FEATURE_CLASSES`."""
    given = set(categories)
    return tuple(name for name in FEATURE_CLASSES if name in given)


def width_over_height(category: str) -> float:
    """See `FeatureClass`; objects of unknown classes are drawn like cones."""
    return FEATURE_CLASSES.get(category, FEATURE_CLASSES[CONE]).width_over_height


def letter_of(category: str) -> str:
    """See `FeatureClass`; `?` for unknown classes."""
    return FEATURE_CLASSES[category].letter if category in FEATURE_CLASSES else "?"


def require_classes(names: Iterable[str], besides: Iterable[str]) -> None:
    """Raise InputError for classes that neither conetl nor `besides` knows: imported maps may hold any."""
    if unknown := set(names) - {*FEATURE_CLASSES, *besides}:
        known = ", ".join(FEATURE_CLASSES)
        raise InputError(f"--category: there is no class {', '.join(sorted(unknown))}; give {known} or all")


def noun_of(category: str) -> str:
    """The class in messages: `cone`, `work zone sign`."""
    return "cone" if category == CONE else category.replace("_", " ")


def mutually_exclusive(a: str, b: str) -> bool:
    """Whether two categories cannot be at one position: detectors confuse classes, but a plate may hang above an object."""
    return FEATURE_CLASSES[a].on_road == FEATURE_CLASSES[b].on_road
