"""OpenDRIVE files (.xodr): reference lines and lane borders of every road.

ASAM OpenDRIVE 1.8, on geometries of the reference line, elevation, superelevation, lane offset, lane sections, lane width
and border. s runs along the reference line in plan, t to its left. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from pyproj import CRS

from conetl.files.documents import XmlFile, input_errors, library_errors, require_few_refused, shown
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.base_layers.georeferencing import parse_crs
from conetl.readers.base_layers.lines import BATCH, Line, LineFile, add_lines, require_near, simplified

Element = ElementTree.Element

#: Between samples of a curve; headings are integrated over steps of this length at most.
STEP_M = 1.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)
_ARC_LENGTH_SAMPLES = 512
_MAX_ROAD_M = 100_000.0
#: Points that are computed for all lines of a file, and how many of them a line costs at least.
MAX_POINTS = 50_000_000
_LINE_POINTS = 100
#: Elements of a road, which are in memory at once.
_MOST_ELEMENTS = 500_000


#: Positions (N, 2) and turns (N,) at distances (N,) from the beginning of a geometry, whose heading there is 0.
Curve = Callable[[Floats], tuple[Floats, Floats]]
#: Attributes with the curvature at the beginning and at the end, by geometry.
_CURVATURES = {"arc": ("curvature", "curvature"), "spiral": ("curvStart", "curvEnd")}


class Piece(NamedTuple):
    """One geometry of the reference line from `start_m` on."""

    start_m: float
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    curve: Curve


def cubic_at(pieces: Floats, s_m: Floats) -> Floats:
    """Value (N,) at s of piecewise cubics (M, 5): a + b ds + c ds^2 + d ds^3 from a start on, given start, a, b, c, d.

    0 where there are none or before the first.
    """
    s = np.asarray(s_m, np.float64)
    if not len(pieces):
        return np.zeros(len(s))
    if len(pieces) > 1:
        pieces = pieces[np.argsort(pieces[:, 0], kind="stable")]
        owner = np.searchsorted(pieces[:, 0], s, side="right") - 1
        start, a, b, c, d = pieces[np.maximum(owner, 0)].T
    else:
        start, a, b, c, d = pieces.T
    ds = s - start
    return np.where(s >= pieces[0, 0], a + ds * (b + ds * (c + ds * d)), 0.0)


def samples_m(pieces: Sequence[Piece], from_m: float, to_m: float) -> Floats:
    """Sorted s from from_m to to_m: the ends, where a geometry begins, and every STEP_M between."""
    count = max(int(np.ceil((to_m - from_m) / STEP_M)), 1)
    joints = [p.start_m for p in pieces if from_m < p.start_m < to_m]
    s = np.sort(np.concatenate([np.linspace(from_m, to_m, count + 1), joints]))
    return np.asarray(s[np.concatenate([[True], np.diff(s) > 1e-6])])


def reference_line(pieces: Sequence[Piece], s_m: Floats) -> tuple[Floats, Floats]:
    """Positions (N, 2) and headings (N,) of the reference line at s; of its nearest end outside of the pieces."""
    ordered = sorted(pieces, key=lambda p: p.start_m)
    starts = np.array([p.start_m for p in ordered])
    s = np.asarray(s_m, np.float64)
    owner = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(ordered) - 1)
    xy, heading = np.empty((len(s), 2)), np.empty(len(s))
    for index in np.unique(owner):
        piece, here = ordered[index], owner == index
        ds = np.clip(s[here] - piece.start_m, 0.0, piece.length_m)
        local, turn = piece.curve(ds)
        cos, sin = np.cos(piece.heading_rad), np.sin(piece.heading_rad)
        xy[here] = local @ np.array([[cos, sin], [-sin, cos]]) + [piece.x_m, piece.y_m]
        heading[here] = piece.heading_rad + turn
    return xy, heading


def lane_borders(
    lanes: Mapping[int, tuple[Floats, Floats]], offset: Floats, section_start_m: float, s_m: Floats
) -> dict[int, Floats]:
    """Lane id -> t (N,) of its outer border at s; id 0 is the centre line. Left lanes have positive ids.

    lanes: cubics of the widths and of the borders (t of the outer edge) of each, one of them without any.
    """
    centre = cubic_at(offset, s_m)
    ds = np.asarray(s_m, np.float64) - section_start_m
    found = {0: centre}
    for side in (1, -1):
        t = centre
        for number in sorted((number for number in lanes if number * side > 0), key=abs):
            widths, borders = lanes[number]
            wide = len(widths) or not len(borders)  # borders are signed distances from the reference line
            t = t + side * np.maximum(cubic_at(widths, ds), 0.0) if wide else cubic_at(borders, ds)
            found[number] = t
    return found


class RoadFrame(NamedTuple):
    """Where a point at (s, t) is: base_m + t * left."""

    base_m: Floats
    """(N, 3) on the reference line, with the elevation."""
    left: Floats
    """(N, 3) unit vectors across it, tilted by the superelevation (counter-clockwise seen along s)."""

    def at(self, t_m: Floats) -> Floats:
        """(N, 3) points at t (N,)."""
        return self.base_m + t_m[:, None] * self.left


def frame_of(pieces: Sequence[Piece], elevation: Floats, superelevation: Floats, s_m: Floats) -> RoadFrame:
    """At s (N,) of a road."""
    xy, heading = reference_line(pieces, s_m)
    roll = cubic_at(superelevation, s_m)
    left = np.column_stack([-np.sin(heading) * np.cos(roll), np.cos(heading) * np.cos(roll), np.sin(roll)])
    return RoadFrame(np.column_stack([xy, cubic_at(elevation, s_m)]), left)


def straight(ds: Floats) -> tuple[Floats, Floats]:
    """A line."""
    return np.column_stack([ds, np.zeros(len(ds))]), np.zeros(len(ds))


def clothoid(length_m: float, k0: float, k1: float, ds: Floats) -> tuple[Floats, Floats]:
    """Arc, spiral, whose curvature changes linearly from k0 to k1 (1/m): the heading is a quadratic of s; its unit vector
    is integrated by Gauss-Legendre over short steps.

    (Fresnel integrals are the closed form, but lose all digits where the curvature hardly changes.)
    """
    if k0 == k1:  # an arc: its chord, in the direction of its middle
        turn = k0 * ds
        chord = ds * np.sinc(turn / (2 * np.pi))
        return np.column_stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2)]), turn
    grid = np.unique(np.concatenate([np.linspace(0.0, length_m, int(length_m / STEP_M) + 2), ds]))
    rate = (k1 - k0) / length_m if length_m > 0 else 0.0
    half = np.diff(grid) / 2
    at = grid[:-1, None] + half[:, None] * (1 + _NODES)
    turn = k0 * at + rate * at**2 / 2
    steps = half[:, None] * np.column_stack([np.cos(turn) @ _WEIGHTS, np.sin(turn) @ _WEIGHTS])
    track = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return track[np.searchsorted(grid, ds)], k0 * ds + rate * ds**2 / 2


def poly3(length_m: float, v: Sequence[float], ds: Floats) -> tuple[Floats, Floats]:
    """v is a polynomial of u, and s the length of the curve: find u(s)."""
    u = np.linspace(0.0, length_m, _ARC_LENGTH_SAMPLES)
    slope = np.abs(np.hypot(1.0, polyval(u, polyder(v))))
    length = np.concatenate([[0.0], np.cumsum(np.diff(u) * (slope[1:] + slope[:-1]) / 2)])
    p = np.interp(ds, length, u)
    return np.column_stack([p, polyval(p, v)]), np.arctan(polyval(p, polyder(v)))


def param_poly3(unit_m: float, u: Sequence[float], v: Sequence[float], ds: Floats) -> tuple[Floats, Floats]:
    """u and v are polynomials of the distance in this unit."""
    p = ds / unit_m
    return np.column_stack([polyval(p, u), polyval(p, v)]), np.arctan2(polyval(p, polyder(v)), polyval(p, polyder(u)))


def read_opendrive(path: Path) -> LineFile:
    """Lines of an OpenDRIVE file, in the CRS of its geoReference. Raises InputError without a usable road, or with too many."""
    lines: list[Line] = []
    refused: list[str] = []
    batch: list[tuple[str, Line]] = []
    count = 0
    header = ElementTree.Element("header")
    left = float(MAX_POINTS)

    def spend(points: float) -> None:
        nonlocal left
        left -= points
        if left < 0:
            raise InputError(
                f"{path}: {what}: up to here the lanes have more than {MAX_POINTS:,} points, one each {STEP_M:g} m; "
                "import the file in parts"
            )

    def add_batch() -> None:
        """The lines of several roads at once: for each road, arrays would be of a few vertices."""
        nonlocal count
        some = simplified([line for _, line in batch])
        add_lines([(name, line) for (name, _), line in zip(batch, some, strict=True)], lines, refused)
        batch.clear()
        count = 0

    not_xml = library_errors(f"{path}: is not XML", ElementTree.ParseError, hint="; expected an OpenDRIVE file")
    with not_xml, input_errors(path), XmlFile(path) as file:
        for part in _parts(file, path):
            if part.tag == "header":
                header = part
            elif part.tag == "road":
                what = f"road {shown(part.get('id', ''))}"
                try:
                    own = [*_road_lines(part, spend)]
                    for line in own:
                        require_near(line.xyz)
                except (ValueError, KeyError) as error:
                    refused.append(f"{what}: {error}")
                    require_few_refused(path, refused)
                    continue
                batch += [(f"{what}, {line.attributes.get('border')}", line) for line in own]
                count += sum(len(line.xyz) for line in own)
                if count > BATCH:
                    add_batch()
        add_batch()
        turn, shift = _offset_of(header)
    if not lines:
        raise InputError(f"{path}: none of its roads can be used{'; ' + refused[0] if refused else ''}")
    return LineFile([line._replace(xyz=line.xyz @ turn.T + shift) for line in lines], *_crs(header, refused))


def _parts(file: XmlFile, path: Path) -> Iterator[Element]:
    """Header, roads and other elements below the root, each once and whole. Raises InputError, ParseError."""
    open_elements: list[Element] = []
    count = 0
    for event, item in ElementTree.iterparse(file, ("start", "end")):
        if event == "start":
            open_elements.append(item)
            count += 1
            if open_elements[0].tag != "OpenDRIVE":
                raise InputError(f"{path}: its root is <{item.tag}>, expected <OpenDRIVE>")
            if count > _MOST_ELEMENTS:
                part = open_elements[min(1, len(open_elements) - 1)]
                raise InputError(
                    f"{path}: <{part.tag}> {shown(part.get('id', ''))} has more than {_MOST_ELEMENTS:,} elements: split it"
                )
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


def _road_lines(road: Element, spend: Callable[[float], None]) -> Iterator[Line]:
    """Lines of a road; `spend` is called with the number of points before they are computed."""
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
    ends = [*starts[1:], length][: len(starts)]
    spans = [(None, 0.0, length), *zip(sections, starts, ends, strict=True)]
    spans = [span for span in spans if span[1] < span[2]]
    lanes_of = [
        {} if one is None else {int(_number(lane, "id")): lane for lane in one.iter("lane")} for one, _, _ in spans
    ]
    for elements, (_, start, end) in zip(lanes_of, spans, strict=True):
        spend(_points(pieces, start, end) * (len(elements) + 1))
    samples = [samples_m(pieces, start, end) for _, start, end in spans]
    whole = frame_of(pieces, elevation, roll, np.concatenate(samples))
    stops = np.cumsum([len(s) for s in samples]).tolist()
    for elements, (section, start, _), s, stop in zip(lanes_of, spans, samples, stops, strict=True):
        frame = RoadFrame(whole.base_m[stop - len(s) : stop], whole.left[stop - len(s) : stop])
        if section is None:
            yield Line("reference_line", frame.base_m, {**about, "border": "reference line"})
            continue
        lanes = {
            number: (_cubics(lane.findall("width"), "sOffset"), _cubics(lane.findall("border"), "sOffset"))
            for number, lane in elements.items()
        }
        for number, t in lane_borders(lanes, offset, start, s).items():
            lane = elements.get(number)
            mark = lane.find("roadMark") if lane is not None else None
            paint = mark.get("type", "none") if mark is not None else "none"
            if number == 0 and paint == "none":
                continue
            kind = "lane_border" if paint == "none" else paint
            attributes = {**about, "border": f"lane {number}", "lane_type": None if lane is None else lane.get("type")}
            yield Line(kind, frame.at(t), attributes)


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
    curve: Curve
    if shape is None or kind == "line":
        curve = straight
    elif kind in _CURVATURES:
        k0, k1 = (_number(shape, name) for name in _CURVATURES[kind])
        curve = partial(clothoid, length, k0, k1)
    elif kind == "poly3":
        curve = partial(poly3, length, [_number(shape, name) for name in "abcd"])
    elif kind == "paramPoly3":
        u, v = ([_number(shape, f"{name}{axis}") for name in "abcd"] for axis in "UV")
        normalised = shape.get("pRange", "normalized") != "arcLength" and length > 0
        curve = partial(param_poly3, length if normalised else 1.0, u, v)
    else:
        raise ValueError(f"its geometry <{kind}> is unknown; expected line, arc, spiral, poly3 or paramPoly3")
    return Piece(start, x, y, heading, length, curve)


def _cubics(elements: list[Element], start: str) -> Floats:
    """(N, 5) as of `cubic_at`."""
    return np.array([[_number(e, name) for name in (start, *"abcd")] for e in elements]).reshape(-1, 5)


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
