"""Lines of a file, the result of every reader of lane boundaries, and the reader of Lanelet2 maps (OSM XML).

Lanelet2: the ways that bound lanelets, and other markings and barriers along roads (Poggenhans et al., *Lanelet2*, ITSC 2018,
and its documentation, LinestringTagging). Nodes are WGS 84.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from pyproj import CRS

from conetl.files.documents import MAX_VALUES, XmlFile, input_errors, library_errors, shown
from conetl.model.arrays import Floats
from conetl.model.errors import InputError

MAX_LINES = 500_000
#: Lanelet2 line strings that bound lanes or the road; others (stop lines, signs, walls) do not.
LANELET2_BOUNDARIES = frozenset({"line_thin", "line_thick", "curbstone", "road_border", "guard_rail", "virtual"})
#: Ways of these types are lane boundaries even without a lanelet.
BOUNDARIES = frozenset(
    {"line_thin", "line_thick", "curbstone", "road_border", "guard_rail", "wall", "fence", "virtual", "bike_marking",
     "pedestrian_marking"}
)  # fmt: skip


#: References and tags of a node or way.
_MOST_PARTS = 2000


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
    elif len(xy) < 2 or not np.ptp(xy, axis=0).any():
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
    """Boundaries of a Lanelet2 file. Raises InputError where it is not one or has none."""
    refused: list[str] = []
    not_xml = library_errors(f"{path}: is not OSM XML", ElementTree.ParseError, hint="; expected a Lanelet2 map")
    with not_xml, input_errors(path), XmlFile(path) as file:
        nodes, ways, bounding = _read(file, path, refused)
    lines: list[Line] = []
    for identity, (references, tags) in ways.items():
        if identity not in bounding and tags.get("type") not in BOUNDARIES:
            continue
        missing = [r for r in references if r not in nodes]
        if missing:
            count = f"{len(missing)} of its {len(references)} nodes are missing"
            refused.append(f"way {shown(identity)}: {count}, node {shown(missing[0])} first")
            continue
        attributes = {**tags, "way": identity, "bounds_a_lanelet": identity in bounding}
        xyz = np.array([nodes[r] for r in references], np.float64).reshape(-1, 3)
        add_line(Line(tags.get("type", "unknown"), xyz, attributes), f"way {shown(identity)}", lines, refused)
    if not lines:
        reason = f"{refused[-1]}; " if refused else ""
        raise InputError(
            f"{path}: there are no whole lane boundaries; {reason}expected ways that lanelets refer to, or of type "
            f"{', '.join(sorted(BOUNDARIES))}"
        )
    return LineFile(lines, CRS.from_epsg(4326), refused)


def _read(
    file: XmlFile, path: Path, refused: list[str]
) -> tuple[dict[str, tuple[float, float, float]], dict[str, tuple[list[str], dict[str, str]]], set[str]]:
    """Nodes (longitude, latitude, height, NaN without) and ways (node ids, tags) by their ids; the ways that bound a lanelet.

    Raises InputError where the nodes have local coordinates only.
    """
    nodes: dict[str, tuple[float, float, float]] = {}
    ways: dict[str, tuple[list[str], dict[str, str]]] = {}
    bounding: set[str] = set()
    is_local, others = False, 0
    for _, item in ElementTree.iterparse(file, events=("end",)):
        identity = item.get("id", "")
        if item.get("action") == "delete" or item.get("visible") == "false":
            item.clear()  # an object that an editor (JOSM) has deleted, but not uploaded yet
        elif item.tag == "node":
            tags = _tags(item)
            is_local |= "local_x" in tags
            try:
                height = float(tags["ele"]) if "ele" in tags else math.nan
                nodes[identity] = (float(item.get("lon", "")), float(item.get("lat", "")), height)
            except ValueError:
                refused.append(f"node {shown(identity)}: longitude, latitude or height is not a number")
        elif item.tag == "way":
            ways[identity] = ([n.get("ref", "") for n in item.iter("nd")], _tags(item))
        elif item.tag == "relation":
            if _tags(item).get("type") == "lanelet":
                bounding.update(m.get("ref", "") for m in item.iter("member") if m.get("role") in ("left", "right"))
        else:
            others += 1
            if others > MAX_VALUES + _MOST_PARTS * (len(nodes) + len(ways) + len(bounding)):
                raise InputError(
                    f"{path}: is not OSM XML: {others:,} elements are no nodes or ways; expected a Lanelet2 map"
                )
            continue  # a part of one of these, read with it
        item.clear()
    if is_local and all(lon == 0 and lat == 0 for lon, lat, _ in nodes.values()):
        raise InputError(
            f"{path}: its nodes have local_x and local_y and no longitude and latitude: export it with both"
        )
    return nodes, ways, bounding


def _tags(item: ElementTree.Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in item.iter("tag")}
