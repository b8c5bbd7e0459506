"""Lines of a file, the result of every reader of lane boundaries, and the reader of Lanelet2 maps (OSM XML).

Lanelet2: the ways that bound lanelets, and other markings and barriers along roads (Poggenhans et al., *Lanelet2*, ITSC 2018,
and its documentation, LinestringTagging). Nodes are WGS 84.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely
from pyproj import CRS

from conetl.files.documents import shown
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.base_layers.osm_xml import NO_ID, read_osm

MAX_LINES = 500_000
#: Largest deviation of vertices that are left out from the line.
TOLERANCE_M = 0.01
MAX_COORDINATE_M = 1e9
#: Vertices that are simplified at once: the time for a curled line rises with the square of it; and those in memory at once.
_BLOCK, BATCH = 2_000, 50_000
#: Lanelet2 line strings that bound lanes or the road; others (stop lines, signs, walls) do not.
LANELET2_BOUNDARIES = frozenset({"line_thin", "line_thick", "curbstone", "road_border", "guard_rail", "virtual"})
#: Ways of these types are lane boundaries even without a lanelet.
BOUNDARIES = frozenset(
    {"line_thin", "line_thick", "curbstone", "road_border", "guard_rail", "wall", "fence", "virtual", "bike_marking",
     "pedestrian_marking"}
)  # fmt: skip


class Line(NamedTuple):
    """One boundary, marking, kerb or reference line."""

    kind: str
    """As in the file: line_thin, curbstone, road_border, solid, ..."""
    xyz: Floats
    """(N, 3) in the file's CRS and units, N >= 2; heights are NaN where the file has none."""
    attributes: Mapping[str, Any]


class LineFile(NamedTuple):
    """The lines of one file."""

    lines: list[Line]
    crs: CRS | None
    refused: list[str]
    """What could not be used, one message each."""
    why_no_crs: str = "the file has no CRS"


def add_lines(found: Sequence[tuple[str, Line | str]], lines: list[Line], refused: list[str]) -> None:
    """Append lines to `lines`, or to `refused` why they cannot be used: names of records with a line, or why they have none."""
    some = [line.xyz for _, line in found if isinstance(line, Line)]
    counts = np.array([len(xyz) for xyz in some], np.int64)
    xyz = np.concatenate([np.empty((0, 3)), *some])
    line_of = np.repeat(np.arange(len(counts)), counts)
    first = xyz[np.repeat(np.cumsum(counts) - counts, counts), :2]
    no_place, other, no_height = (
        np.bincount(line_of[vertices], minlength=len(counts)) > 0
        for vertices in (~np.isfinite(xyz[:, :2]).all(axis=1), (xyz[:, :2] != first).any(axis=1), np.isinf(xyz[:, 2]))
    )
    words = ["a coordinate is not a number", "fewer than two different points", "a height is not a number"]
    problems = iter(np.select([no_place, ~other, no_height], words, "").tolist())
    for what, line in found:
        if problem := line if isinstance(line, str) else next(problems):
            refused.append(f"{what}: {problem}")
        elif isinstance(line, Line):
            lines.append(line)


def bounds_lanes(kind: str, attributes: Mapping[str, Any]) -> bool:
    """Whether lanes are beside a line: in Lanelet2 by its type, in other files always."""
    return "bounds_a_lanelet" not in attributes or kind in LANELET2_BOUNDARIES


def full_kind(kind: str, attributes: Mapping[str, Any]) -> str:
    """`type/subtype` where a line has these attributes, for example `line_thin/dashed`."""
    return "/".join(str(attributes[name]) for name in ("type", "subtype") if attributes.get(name)) or kind


def simplified(lines: Iterable[Line]) -> Iterator[Line]:
    """The lines with the vertices required by plan or height within TOLERANCE_M, and every _BLOCK vertices one.

    Raises ValueError.
    """
    batch: list[Line] = []
    count = 0
    for line in lines:
        batch.append(line)
        count += len(line.xyz)
        if count > BATCH:
            yield from _simplified(batch)
            batch, count = [], 0
    if batch:
        yield from _simplified(batch)


def require_near(xyz: Floats) -> None:
    """Raise ValueError for coordinates that are no numbers, or so large that GEOS does not return from some of them."""
    if not (np.abs(xyz) < MAX_COORDINATE_M).all():
        raise ValueError(f"it has coordinates beyond {MAX_COORDINATE_M:g} m")


def _simplified(lines: list[Line]) -> list[Line]:
    """All at once, as blocks of vertices whose third coordinate is their number."""
    all_xyz = np.concatenate([line.xyz for line in lines])
    require_near(all_xyz)
    line_of = np.repeat(np.arange(len(lines)), [len(line.xyz) for line in lines])
    first = np.diff(line_of, prepend=-1) > 0
    # Equal vertices are where a geometry is too short.
    different = first | np.any(np.diff(all_xyz, axis=0, prepend=np.inf) != 0, axis=1)
    xyz, line_of, first = all_xyz[different], line_of[different], first[different]
    numbers = np.arange(len(xyz))
    starts = numbers[first]
    steps = np.linalg.norm(np.diff(xyz[:, :2], axis=0, prepend=xyz[:1, :2]), axis=1)
    along = np.cumsum(np.where(first, 0.0, steps))
    along -= along[starts][line_of]
    at = numbers - starts[line_of]
    begins = (at % _BLOCK == 0) & ~np.append(first[1:], True)  # a block of one vertex is the end of the one before
    # The vertex between two blocks is in both.
    twice = np.sort(np.concatenate([numbers, numbers[begins & (at > 0)]]))
    block_of = np.cumsum(begins)[twice] - 1
    shared = np.append(twice[1:] == twice[:-1], False)
    block_of[shared] -= 1
    keep = first | np.append(first[1:], True)
    enough = np.bincount(block_of)[block_of] > 1
    for flat in (xyz[:, :2], np.column_stack([along, xyz[:, 2]])):
        vertices = np.column_stack([flat, numbers])[twice][enough]
        blocks = shapely.linestrings(vertices, indices=block_of[enough])
        kept = shapely.get_coordinates(shapely.simplify(blocks, TOLERANCE_M, preserve_topology=False), include_z=True)
        keep[kept[:, 2].astype(np.int64)] = True
    parts = np.split(xyz[keep], np.flatnonzero(np.diff(line_of[keep])) + 1)
    return [line._replace(xyz=part) for line, part in zip(lines, parts, strict=True)]


def read_lanelet2(path: Path) -> LineFile:
    """Boundaries of a Lanelet2 file. Raises InputError where it is not one, has none, or has local coordinates only."""
    found = read_osm(path)
    if found.has_local and not found.lon_lat_ele[:, :2].any():
        raise InputError(
            f"{path}: its nodes have local_x and local_y and no longitude and latitude: export it with both"
        )
    used = {
        identity: way
        for identity, way in found.ways.items()
        if identity in found.lanelet_ways or way[1].get("type") in BOUNDARIES
    }
    made: list[tuple[str, Line | str]] = []
    nodes = np.concatenate([np.empty(0, np.int64), *(references for references, _ in used.values())])
    at = np.searchsorted(found.node_ids, nodes).clip(0, max(len(found.node_ids) - 1, 0))
    exists = found.node_ids[at] == nodes if len(found.node_ids) else np.zeros(len(nodes), bool)
    start = 0
    for identity, (references, tags) in used.items():
        own = slice(start, start + len(references))
        start = own.stop
        what = f"way '{identity}'"
        if missing := references[~exists[own]].tolist():
            first = "one whose id is not a number" if missing[0] == NO_ID else f"node {shown(str(missing[0]))}"
            made.append((what, f"{len(missing)} of its {len(references)} nodes are missing, {first} first"))
            continue
        attributes = {**tags, "way": str(identity), "bounds_a_lanelet": identity in found.lanelet_ways}
        made.append((what, Line(tags.get("type", "unknown"), found.lon_lat_ele[at[own]], attributes)))
    lines: list[Line] = []
    refused = found.refused
    add_lines(made, lines, refused)
    if not lines:
        reason = f"{refused[-1]}; " if refused else ""
        raise InputError(
            f"{path}: there are no whole lane boundaries; {reason}expected ways that lanelets refer to, or of type "
            f"{', '.join(sorted(BOUNDARIES))}"
        )
    return LineFile(lines, CRS.from_epsg(4326), refused)
