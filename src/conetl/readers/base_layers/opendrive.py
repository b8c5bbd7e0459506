"""OpenDRIVE files (.xodr): reference lines and lane borders of every road (`roads.py`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from pyproj import CRS

from conetl.files.documents import MAX_SHOWN, XmlFile, input_errors, library_errors, require_few_refused, shown
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.base_layers.georeferencing import parse_crs
from conetl.readers.base_layers.lines import BATCH, Line, LineFile, add_lines, require_near, simplified
from conetl.readers.base_layers.roads import (
    STEP_M,
    Border,
    Cubics,
    Curve,
    Piece,
    RoadShape,
    RoadSpan,
    arc,
    lines_of,
    param_poly3,
    poly3,
    spiral,
)

Element = ElementTree.Element

_MAX_ROAD_M = 100_000.0
#: Points that are computed for all lines of a file, and how many of them a line costs at least.
MAX_POINTS = 50_000_000
_LINE_POINTS = 100
#: Elements and points of a road, which are in memory at once.
_MOST_ELEMENTS, _MOST_ROAD_POINTS = 500_000, 2_000_000

#: Attributes with the numbers of a geometry, by its kind.
_SHAPES: dict[str, tuple[Curve, tuple[str, ...]]] = {
    "line": (arc, ()), "arc": (arc, ("curvature",)), "spiral": (spiral, ("curvStart", "curvEnd")),
    "poly3": (poly3, tuple("abcd")), "paramPoly3": (param_poly3, tuple(f"{name}{axis}" for axis in "UV" for name in "abcd")),
}  # fmt: skip


def read_opendrive(path: Path) -> LineFile:
    """Lines of an OpenDRIVE file, in the CRS of its geoReference. Raises InputError without a usable road, or with too many."""
    lines: list[Line] = []
    refused: list[str] = []
    batch: list[tuple[str, RoadShape | str]] = []
    header = ElementTree.Element("header")
    left = batch_left = float(MAX_POINTS)

    def spend(points: float) -> None:
        nonlocal left
        left -= points
        if left < 0:
            raise InputError(
                f"{path}: {what}: up to here the lanes have more than {MAX_POINTS:,} points, one each {STEP_M:g} m; "
                "import the file in parts"
            )

    def add_batch() -> None:
        """The lines of many roads at once: arrays of one would be of a few numbers."""
        found: list[tuple[str, Line | str]] = []
        made = iter(lines_of([road for _, road in batch if isinstance(road, RoadShape)]))
        for name, road in batch:
            if isinstance(road, str):
                found.append((name, road))
                continue
            own = next(made)
            try:
                require_near(np.concatenate([line.xyz for line in own]))
                found += [(f"{name}, {line.attributes['border']}", line) for line in own]
            except ValueError as error:
                found.append((name, str(error)))
        some = simplified([line for _, line in found if isinstance(line, Line)])
        add_lines([(name, one if isinstance(one, str) else next(some)) for name, one in found], lines, refused)
        require_few_refused(path, refused)
        batch.clear()

    not_xml = library_errors(f"{path}: is not XML", ElementTree.ParseError, hint="; expected an OpenDRIVE file")
    with not_xml, input_errors(path), XmlFile(path) as file:
        for part in _parts(file, path):
            if part.tag == "header":
                header = part
            elif part.tag == "road":
                what = f"road {shown(part.get('id', ''))}"
                try:
                    batch.append((what, _road(part, spend)))
                except ValueError as error:
                    batch.append((what, str(error)))
                if batch_left - left > 4 * BATCH or len(batch) > BATCH:
                    add_batch()
                    batch_left = left
        add_batch()
        turn, shift = _offset_of(header)
    if not lines:
        raise InputError(f"{path}: none of its roads can be used{'; ' + refused[0] if refused else ''}")
    if header.find("offset") is not None:
        lines = [line._replace(xyz=line.xyz @ turn.T + shift) for line in lines]
    return LineFile(lines, *_crs(header, refused))


def _parts(file: XmlFile, path: Path) -> Iterator[Element]:
    """Header, roads and other elements below the root, each once and whole. Raises InputError, ParseError."""
    open_elements: list[Element] = []
    count = 0
    for event, item in ElementTree.iterparse(file, ("start", "end")):
        if event == "start":
            open_elements.append(item)
            count += 1
            if open_elements[0].tag != "OpenDRIVE":
                raise InputError(f"{path}: its root is <{item.tag[:MAX_SHOWN]}>, expected <OpenDRIVE>")
            if count > _MOST_ELEMENTS:
                part = open_elements[min(1, len(open_elements) - 1)]
                name = f"<{part.tag[:MAX_SHOWN]}> {shown(part.get('id', ''))}"
                raise InputError(f"{path}: {name} has more than {_MOST_ELEMENTS:,} elements: split it")
            continue
        open_elements.pop()
        if len(open_elements) == 1:
            yield item
            open_elements[0].clear()
            count = 0


def _crs(header: Element, refused: list[str]) -> tuple[CRS | None, list[str], str]:
    """The CRS of the coordinates, which are metres whatever it is; what was refused, and why there is none."""
    reference = (header.findtext("geoReference") or "").strip()
    why = "the file has no geoReference"
    if reference:
        try:
            crs = parse_crs(reference)
        except ValueError as error:
            why = f"geoReference: {error}"
        else:
            if not crs.is_geographic:
                return crs, refused, ""
            why = f"geoReference: {shown(reference)} is in degrees, but the lengths of OpenDRIVE are metres: 1 m would be 111 km"
        refused.append(why)
    return None, refused, why


def _road(road: Element, spend: Callable[[float], None]) -> RoadShape:
    """A road; `spend` is called with the number of its points. Raises ValueError."""
    length = _number(road, "length")
    if not 0 < length <= _MAX_ROAD_M:
        raise ValueError(f"its length is {length:g} m; expected more than 0 and at most {_MAX_ROAD_M:g}")
    pieces = sorted((_piece(g) for g in road.findall("planView/geometry")), key=lambda piece: piece.start_m)
    if not pieces:
        raise ValueError("it has no planView geometry")
    if not sum(p.length_m for p in pieces) <= _MAX_ROAD_M:
        raise ValueError(f"its geometries are longer than {_MAX_ROAD_M:g} m")
    elevation = _cubics(road.findall("elevationProfile/elevation"), "s")
    roll = _cubics(road.findall("lateralProfile/superelevation"), "s")
    offset = _cubics(road.findall("lanes/laneOffset"), "s")
    about = {"road": road.get("id"), "road_name": road.get("name") or None}
    sections = sorted(road.findall("lanes/laneSection"), key=lambda section: _number(section, "s"))
    starts = [_number(section, "s") for section in sections]
    if starts and not 0 <= starts[0] <= starts[-1] <= length:
        raise ValueError(f"its lane sections begin from {starts[0]:g} to {starts[-1]:g} m; expected 0 to {length:g} m")
    spans = [RoadSpan(0.0, length, [Border("reference_line", {**about, "border": "reference line"}, None)])]
    for section, start, end in zip(sections, starts, [*starts[1:], length], strict=False):
        if start < end:
            spans.append(RoadSpan(start, end, _borders(section, about)))
    points = sum(_points(pieces, span.start_m, span.end_m) * (len(span.borders) + 1) for span in spans)
    spend(points)
    if points > _MOST_ROAD_POINTS:
        raise ValueError(f"its lines have more than {_MOST_ROAD_POINTS:,} points, one each {STEP_M:g} m: split it")
    return RoadShape(pieces, elevation, roll, offset, spans)


def _borders(section: Element, about: dict[str, str | None]) -> list[Border]:
    lanes = {int(_number(lane, "id")): lane for lane in section.iter("lane")}
    borders: list[Border] = []
    for side in (0, 1, -1):
        ids = sorted((number for number in {*lanes, 0} if (number > 0) - (number < 0) == side), key=abs)
        for at, number in enumerate(ids, abs(side)):
            lane = lanes.get(number)
            mark = lane.find("roadMark") if lane is not None else None
            paint = mark.get("type", "none") if mark is not None else "none"
            kind = paint if paint != "none" else "lane_border" if number else None
            attributes = {**about, "border": f"lane {number}", "lane_type": None if lane is None else lane.get("type")}
            cubics = () if lane is None else (_cubics(lane.findall(name), "sOffset") for name in ("width", "border"))
            borders.append(Border(kind, attributes, at, side, 0 if at < 2 else len(borders) - 1, *cubics))
    return borders


def _points(pieces: Sequence[Piece], from_m: float, to_m: float) -> float:
    """Points that one line between these s costs, with those that its pieces (in order) are integrated over."""
    ends = [*(piece.start_m for piece in pieces[1:]), math.inf]
    integrated_m = sum(p.length_m for p, end in zip(pieces, ends, strict=True) if p.start_m <= to_m and end >= from_m)
    return _LINE_POINTS + len(pieces) + (to_m - from_m + integrated_m) / STEP_M


def _piece(geometry: Element) -> Piece:
    start, x, y, heading, length = (_number(geometry, name) for name in ("s", "x", "y", "hdg", "length"))
    if length < 0:
        raise ValueError(f"a geometry's length is {length:g} m")
    shape = next(iter(geometry), None)
    kind = shape.tag if shape is not None else "line"
    if kind not in _SHAPES:
        raise ValueError(
            f"its geometry <{kind[:MAX_SHOWN]}> is unknown; expected line, arc, spiral, poly3 or paramPoly3"
        )
    curve, names = _SHAPES[kind]
    numbers = [_number(shape, name) for name in names] if shape is not None else []
    if curve is param_poly3:
        normalised = shape is not None and shape.get("pRange", "normalized") != "arcLength" and length > 0
        numbers.insert(0, length if normalised else 1.0)
    return Piece(start, x, y, heading, length, curve, tuple(numbers) or (0.0,))


def _cubics(elements: list[Element], start: str) -> Cubics:
    return [[_number(element, name) for name in (start, *"abcd")] for element in elements]


def _number(element: Element, name: str) -> float:
    text = element.get(name)
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"<{element.tag}> has {name}={shown(text)}; expected a number")
    return value


def _offset_of(header: Element) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and translation (3,) of the header's offset, from the file's coordinates to those of its CRS."""
    offset = header.find("offset")
    stated = {} if offset is None else {k: _number(offset, k) for k in ("x", "y", "z", "hdg") if offset.get(k)}
    x, y, z, heading = (stated.get(name, 0.0) for name in ("x", "y", "z", "hdg"))
    cos, sin = math.cos(heading), math.sin(heading)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]), np.array([x, y, z])
