"""`conetl map picture`: a plan of the map for a report."""

from __future__ import annotations

import math
from collections import Counter
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from pyproj import Transformer

from conetl.cli.console import JsonOption, MapOption, answer, counted, counted_by_class, parse_instant
from conetl.cli.database import open_map
from conetl.cli.map.compare import instants_of, state_of
from conetl.db.map.map_store import read_features_as_of
from conetl.mapping.map_diff import diff
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE, LANE_MARKING, noun_of
from conetl.reports.map_picture import SUFFIXES, Bbox, draw_map_picture, plan_extent, read_plan_content


def picture(
    output: Annotated[Path, typer.Argument(metavar="OUT", help=f"File to write: {', '.join(SUFFIXES)}.")],
    at: Annotated[
        str | None, typer.Option("--at", help="State of the road at this time, e.g. 2026-03-02; default: latest.")
    ] = None,
    known_at: Annotated[
        str | None, typer.Option("--known-at", help="Database state at this time; default: now.")
    ] = None,
    changes: Annotated[
        tuple[str, str] | None,
        typer.Option("--changes", metavar="A B", help="Show the changes between two changeset numbers or two times."),
    ] = None,
    bbox: Annotated[
        str | None,
        typer.Option("--bbox", help="west,south,east,north in the map's CRS or in degrees; default: the whole map."),
    ] = None,
    size: Annotated[str | None, typer.Option("--size", help="Width x height in millimetres, e.g. 240x160.")] = None,
    title: Annotated[str | None, typer.Option("--title", help="Title; default: the name of the map.")] = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Draw a plan of the map for a report: cones, lane markings, base layers, drive paths, scale bar, legend, CRS and date."""
    if output.suffix.lower() not in SUFFIXES:
        raise InputError(f"{output}: the file name must end in one of {', '.join(SUFFIXES)}")
    if changes is not None and (at is not None or known_at is not None):
        raise InputError("--changes names both states: leave --at and --known-at out")
    valid_at, known = parse_instant(at), parse_instant(known_at)
    size_mm = _size(size)
    with open_map(map_name) as (conn, info):
        name = info.map_name
        if changes is None:
            versions = read_features_as_of(conn, valid_at, known_at=known, map_name=name, lines=True)
            standing, differing = [version.feature for version in versions], None
        else:
            standing = state_of(conn, name, changes[1])
            valid_at, known = instants_of(conn, name, changes[1])
            differing = diff(state_of(conn, name, changes[0]), standing)
        extent = plan_extent(standing, differing) if bbox is None else _bbox(bbox, info.srid)
        content = read_plan_content(
            conn, name, info.srid, extent, standing, differing, valid_at=valid_at, known_at=known
        )
    classes = Counter(feature.category for feature in standing)
    painted = classes.pop(LANE_MARKING, 0)
    if title is None:
        drawn = [*standing, *(change.old for change in differing or () if change.old is not None)]
        title = f"Traffic cones, map {name}" if {one.category for one in drawn} <= {CONE} else f"Map {name}"
        title += f": changes from {changes[0]} to {changes[1]}" if changes else ""
    footer = _footer(valid_at, known, changes, info.last_committed_at)
    done = draw_map_picture(output, content, extent, size_mm=size_mm, title=title, footer=footer)
    lines, points = len(content.lines_m), len(content.points_m)
    facts: dict[str, object] = {
        "picture": str(done),
        "objects_by_class": Counter(feature.category for feature in standing),
    }
    facts |= {
        "changes": None if differing is None else len(differing),
        "lines": lines,
        "points": points,
        "bbox": extent,
    }
    shown = f"{counted_by_class(classes)}, " + (f"{counted(painted, noun_of(LANE_MARKING))}, " if painted else "")
    answer(as_json, facts, f"{shown}{lines} lane boundaries, {points} points -> {done}")


def _footer(
    valid_at: datetime | None, known: datetime | None, changes: tuple[str, str] | None, last: datetime | None
) -> str:
    """Which state of the map is drawn."""
    if changes:
        parts = [f"{changes[0]} compared with {changes[1]}"]
    else:
        parts = [f"on the road at {valid_at:%Y-%m-%d %H:%M} UTC" if valid_at else "latest state"]
    if known:
        parts.append(f"database state at {known:%Y-%m-%d %H:%M} UTC")
    elif last:
        parts.append(f"last change of the database {last:%Y-%m-%d %H:%M} UTC")
    return " · ".join([*parts, "grid north · conetl"])


def _size(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        width, height = (float(part) for part in text.lower().split("x"))
    except ValueError:
        width = height = math.nan
    if not (60 <= width <= 1200 and 60 <= height <= 1200):
        raise InputError(f"--size {text}: expected width x height in millimetres, 60 to 1200 each, like 240x160")
    return width, height


def _bbox(text: str, srid: int) -> Bbox:
    """In the map's CRS; numbers in the range of degrees are longitudes and latitudes. Raises InputError."""
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--bbox {text}: expected west,south,east,north") from None
    if not all(map(math.isfinite, (west, south, east, north))) or west >= east or south >= north:
        raise InputError(f"--bbox {text}: west must be less than east and south less than north")
    if abs(west) <= 180 and abs(east) <= 180 and abs(south) <= 90 and abs(north) <= 90:
        to_map = Transformer.from_crs(4326, srid, always_xy=True)
        west, south, east, north = to_map.transform_bounds(west, south, east, north)
        if not all(map(math.isfinite, (west, south, east, north))):
            raise InputError(f"--bbox {text}: this area does not exist in the map's CRS, EPSG:{srid}")
    if max(east - west, north - south) > 100_000:
        raise InputError(f"--bbox {text}: at most 100 km can be drawn")
    return west, south, east, north
