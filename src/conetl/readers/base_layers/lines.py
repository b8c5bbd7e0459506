"""Lines of a file, the result of every reader of lane boundaries, and the reader of Lanelet2 maps (OSM XML).

Lanelet2: the ways that bound lanelets, and other markings and barriers along roads (Poggenhans et al., *Lanelet2*, ITSC 2018,
and its documentation, LinestringTagging). Nodes are WGS 84.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pyproj import CRS

from conetl.files.documents import shown
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.base_layers.osm_xml import NO_ID, read_osm

MAX_LINES = 500_000
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


def add_line(line: Line, what: str, lines: list[Line], refused: list[str]) -> None:
    """Append a line to `lines`, or to `refused` why it cannot be used."""
    xy = line.xyz[:, :2]
    if not np.isfinite(xy).all():
        refused.append(f"{what}: a coordinate is not a number")
    elif not (xy != xy[:1]).any():
        refused.append(f"{what}: fewer than two different points")
    elif np.isinf(line.xyz[:, 2]).any():
        refused.append(f"{what}: a height is not a number")
    else:
        lines.append(line)


def bounds_lanes(kind: str, attributes: Mapping[str, Any]) -> bool:
    """Whether lanes are beside a line: in Lanelet2 by its type, in other files always."""
    return "bounds_a_lanelet" not in attributes or kind in LANELET2_BOUNDARIES


def full_kind(kind: str, attributes: Mapping[str, Any]) -> str:
    """`type/subtype` where a line has these attributes, for example `line_thin/dashed`."""
    return "/".join(str(attributes[name]) for name in ("type", "subtype") if attributes.get(name)) or kind


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
    lines: list[Line] = []
    refused = found.refused
    nodes = np.concatenate([np.empty(0, np.int64), *(references for references, _ in used.values())])
    at = np.searchsorted(found.node_ids, nodes).clip(0, max(len(found.node_ids) - 1, 0))
    exists = found.node_ids[at] == nodes if len(found.node_ids) else np.zeros(len(nodes), bool)
    start = 0
    for identity, (references, tags) in used.items():
        own = slice(start, start + len(references))
        start = own.stop
        what = f"way {shown(str(identity))}"
        if missing := references[~exists[own]].tolist():
            first = "one whose id is not a number" if missing[0] == NO_ID else f"node {shown(str(missing[0]))}"
            refused.append(f"{what}: {len(missing)} of its {len(references)} nodes are missing, {first} first")
            continue
        attributes = {**tags, "way": str(identity), "bounds_a_lanelet": identity in found.lanelet_ways}
        add_line(Line(tags.get("type", "unknown"), found.lon_lat_ele[at[own]], attributes), what, lines, refused)
    if not lines:
        reason = f"{refused[-1]}; " if refused else ""
        raise InputError(
            f"{path}: there are no whole lane boundaries; {reason}expected ways that lanelets refer to, or of type "
            f"{', '.join(sorted(BOUNDARIES))}"
        )
    return LineFile(lines, CRS.from_epsg(4326), refused)
