"""Lanelet2 maps (OSM XML): the ways that bound lanelets, and what else is painted or built along roads.

Format: Poggenhans et al., *Lanelet2*, ITSC 2018, and its documentation (LinestringTagging). Nodes are WGS 84.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from pyproj import CRS

from conetl.errors import InputError
from conetl.io.base_layers.lines import Line, LineFile, usable

#: Ways of these types are lane boundaries even where no lanelet uses them.
BOUNDARIES = frozenset(
    {"line_thin", "line_thick", "curbstone", "road_border", "guard_rail", "wall", "fence", "virtual", "bike_marking", "pedestrian_marking"}
)  # fmt: skip
_WGS84 = 4326


def read_lanelet2(path: Path) -> LineFile:
    """Boundaries of a Lanelet2 file. Raises InputError where it is no such file or holds none."""
    nodes: dict[str, tuple[float, float, float]] = {}
    ways: dict[str, tuple[list[str], dict[str, str]]] = {}
    used: set[str] = set()
    refused: list[str] = []
    local = 0
    try:
        for _, item in ElementTree.iterparse(path, events=("end",)):
            if item.tag == "node":
                tags = _tags(item)
                local += "local_x" in tags
                try:
                    height = float(tags["ele"]) if "ele" in tags else math.nan
                    place = (float(item.get("lon", "")), float(item.get("lat", "")), height)
                except ValueError:
                    refused.append(f"node {item.get('id')}: longitude, latitude or height is no number")
                else:
                    nodes[item.get("id", "")] = place
            elif item.tag == "way":
                ways[item.get("id", "")] = ([n.get("ref", "") for n in item.iter("nd")], _tags(item))
            elif item.tag == "relation" and _tags(item).get("type") == "lanelet":
                used.update(m.get("ref", "") for m in item.iter("member") if m.get("role") in ("left", "right"))
            else:
                continue
            item.clear()
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: is no OSM XML ({error}); expected a Lanelet2 map") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if local and all(lon == 0 and lat == 0 for lon, lat, _ in nodes.values()):
        raise InputError(
            f"{path}: its nodes have local_x and local_y and no longitude and latitude: export it with both"
        )
    lines = []
    for identity, (references, tags) in ways.items():
        if identity not in used and tags.get("type") not in BOUNDARIES:
            continue
        missing = [r for r in references if r not in nodes]
        if missing:
            refused.append(f"way {identity}: its node {missing[0]} is missing")
            continue
        attributes = {**tags, "way": identity, "bounds_a_lanelet": identity in used}
        line = Line(tags.get("type", "unknown"), np.array([nodes[r] for r in references]).reshape(-1, 3), attributes)
        problem = usable(line, f"way {identity}")
        if problem is None:
            lines.append(line)
        else:
            refused.append(problem)
    if not lines:
        raise InputError(
            f"{path}: no lane boundaries in it; expected ways that lanelets refer to, or of type {', '.join(sorted(BOUNDARIES))}"
        )
    return LineFile(lines, CRS.from_epsg(_WGS84), refused)


def _tags(item: ElementTree.Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in item.iter("tag")}
