"""OpenDRIVE files (.xodr): reference lines and lane borders of every road."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely
from pyproj import CRS

from conetl.model.errors import InputError
from conetl.readers.base_layers import opendrive_geometry as od
from conetl.readers.base_layers.georeferencing import parse_crs
from conetl.readers.base_layers.lines import Line, LineFile, usable

Element = ElementTree.Element
#: Largest deviation of omitted vertices from the line.
TOLERANCE_M = 0.01
_MAX_ROAD_M = 1_000_000.0


def read_opendrive(path: Path) -> LineFile:
    """Lines of an OpenDRIVE file, in the CRS of its geoReference. Raises InputError without a usable road."""
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: is not XML ({error}); expected an OpenDRIVE file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if root.tag != "OpenDRIVE":
        raise InputError(f"{path}: its root is <{root.tag}>, expected <OpenDRIVE>")
    lines: list[Line] = []
    refused: list[str] = []
    move = _header_offset(root)
    for road in root.iter("road"):
        what = f"road {road.get('id')}"
        try:
            for line in _road_lines(road):
                moved = line._replace(xyz=_simplified(line.xyz) @ move[0].T + move[1])
                problem = usable(moved, f"{what}, {line.attributes.get('border')}")
                if problem is None:
                    lines.append(moved)
                else:
                    refused.append(problem)
        except (ValueError, KeyError) as error:
            refused.append(f"{what}: {error}")
    if not lines:
        raise InputError(f"{path}: none of its roads can be used{'; ' + refused[0] if refused else ''}")
    reference = (root.findtext("header/geoReference") or "").strip()
    crs: CRS | None = None
    if reference:
        try:
            crs = parse_crs(reference)
        except ValueError as error:
            refused.append(f"geoReference: {error}")
    return LineFile(lines, crs, refused)


def _road_lines(road: Element) -> Iterator[Line]:
    length = _number(road, "length")
    if not 0 < length <= _MAX_ROAD_M:
        raise ValueError(f"its length is {length:g} m; expected more than 0 and at most {_MAX_ROAD_M:g}")
    pieces = [_piece(g) for g in road.findall("planView/geometry")]
    if not pieces:
        raise ValueError("it has no planView geometry")
    if not sum(p.length_m for p in pieces) <= _MAX_ROAD_M:
        raise ValueError(f"its geometries are longer than {_MAX_ROAD_M:g} m")
    elevation = _cubics(road.findall("elevationProfile/elevation"), "s")
    roll = _cubics(road.findall("lateralProfile/superelevation"), "s")
    offset = _cubics(road.findall("lanes/laneOffset"), "s")
    about = {"road": road.get("id"), "road_name": road.get("name") or None}
    s = od.samples_m(pieces, 0.0, length)
    yield Line(
        "reference_line",
        od.offset_line(pieces, elevation, [], s, np.zeros(len(s))),
        {**about, "border": "reference line"},
    )
    sections = sorted(road.findall("lanes/laneSection"), key=lambda section: _number(section, "s"))
    starts = [_number(section, "s") for section in sections]
    for section, start, end in zip(sections, starts, [*starts[1:], length], strict=True):
        if end <= start:
            continue
        s = od.samples_m(pieces, start, end)
        elements = {int(_number(lane, "id")): lane for lane in section.iter("lane")}
        lanes = [
            od.Lane(number, _cubics(lane.findall("width"), "sOffset"), _cubics(lane.findall("border"), "sOffset"))
            for number, lane in elements.items()
        ]
        for number, t in od.lane_borders(lanes, offset, start, s).items():
            lane = elements.get(number)
            mark = lane.find("roadMark") if lane is not None else None
            paint = mark.get("type", "none") if mark is not None else "none"
            if number == 0 and paint == "none":
                continue
            attributes = {
                **about,
                "border": f"lane {number}",
                "lane_type": lane.get("type") if lane is not None else None,
            }
            yield Line(
                "lane_border" if paint == "none" else paint, od.offset_line(pieces, elevation, roll, s, t), attributes
            )


def _piece(geometry: Element) -> od.Piece:
    start, x, y, heading, length = (_number(geometry, name) for name in ("s", "x", "y", "hdg", "length"))
    if length < 0:
        raise ValueError(f"a geometry's length is {length:g} m")
    shape = next(iter(geometry), None)
    kind = shape.tag if shape is not None else "nothing"
    if shape is None or kind == "line":
        return od.Piece("curvature", start, x, y, heading, length)
    if kind == "arc":
        k = _number(shape, "curvature")
        return od.Piece("curvature", start, x, y, heading, length, k0=k, k1=k)
    if kind == "spiral":
        return od.Piece(
            "curvature", start, x, y, heading, length, k0=_number(shape, "curvStart"), k1=_number(shape, "curvEnd")
        )
    if kind == "poly3":
        a, b, c, d = (_number(shape, name) for name in "abcd")
        return od.Piece("poly3", start, x, y, heading, length, v=(a, b, c, d))
    if kind == "paramPoly3":
        u0, u1, u2, u3 = (_number(shape, f"{name}U") for name in "abcd")
        v0, v1, v2, v3 = (_number(shape, f"{name}V") for name in "abcd")
        normalised = shape.get("pRange", "normalized") != "arcLength"
        return od.Piece(
            "paramPoly3", start, x, y, heading, length, u=(u0, u1, u2, u3), v=(v0, v1, v2, v3), normalised=normalised
        )
    raise ValueError(f"its geometry <{kind}> is unknown; expected line, arc, spiral, poly3 or paramPoly3")


def _cubics(elements: list[Element], start: str) -> tuple[od.Cubic, ...]:
    return tuple(od.Cubic(_number(e, start), *(_number(e, name) for name in "abcd")) for e in elements)


def _number(element: Element, name: str) -> float:
    text = element.get(name)
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"<{element.tag}> has {name}={text!r}; expected a number")
    return value


def _header_offset(root: Element) -> tuple[od.Array, od.Array]:
    """Rotation (3, 3) and translation (3,) of header/offset, from the file's coordinates to those of its CRS."""
    offset = root.find("header/offset")
    values = {
        name: _number(offset, name) if offset is not None and offset.get(name) else 0.0
        for name in ("x", "y", "z", "hdg")
    }
    cos, sin = math.cos(values["hdg"]), math.sin(values["hdg"])
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.array(
        [values["x"], values["y"], values["z"]]
    )


def _simplified(xyz: od.Array) -> od.Array:
    """The vertices required by plan or height within TOLERANCE_M."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz[:, :2], axis=0), axis=1))])
    keep = np.zeros(len(xyz), bool)
    keep[[0, -1]] = True
    for flat in (xyz[:, :2], np.column_stack([along, xyz[:, 2]])):
        kept = {
            tuple(p) for p in shapely.get_coordinates(shapely.simplify(shapely.LineString(flat), TOLERANCE_M)).tolist()
        }
        keep |= np.array([tuple(p) in kept for p in flat.tolist()])
    return np.asarray(xyz[keep])
