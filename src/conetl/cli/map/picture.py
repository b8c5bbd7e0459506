"""`conetl map picture`: the map in plan, to be pasted into a report."""

from __future__ import annotations

import math
from contextlib import closing
from datetime import datetime
from pathlib import Path
from typing import Annotated

import numpy as np
import shapely
import typer
from pyproj import Transformer

from conetl.cli.console import JsonOption, out, parse_time, print_json
from conetl.cli.database import open_map
from conetl.cli.map.decisions import instants_of, state_of
from conetl.db.connection import Connection
from conetl.db.map.map_store import find_map, list_changesets, read_features_as_of
from conetl.db.serve_store import read_base_lines, read_base_tile, read_base_tiles
from conetl.db.zone_store import read_paths
from conetl.mapping.map_diff import diff as diff_of
from conetl.model.errors import InputError
from conetl.pipeline.settings import read_settings
from conetl.readers.base_layers.point_tiles import decode_points, tile_side_m
from conetl.reports.map_picture import SUFFIXES, Array, Bbox, PlanContent, draw_map_picture, plan_extent

_MAX_POINTS = 400_000
_MAX_TILES = 100_000
_MAX_LINES = 200_000


def picture(
    output: Annotated[Path, typer.Argument(metavar="OUT", help=f"File to write: {', '.join(SUFFIXES)}.")],
    at: Annotated[
        str | None, typer.Option("--at", help="The road at this time, e.g. 2026-03-02; default the latest.")
    ] = None,
    known_at: Annotated[
        str | None, typer.Option("--known-at", help="As the database knew it then; default what it knows now.")
    ] = None,
    changes: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--changes", metavar="A B", help="What differs between two changesets' numbers or two times on the road."
        ),
    ] = None,
    bbox: Annotated[
        str | None,
        typer.Option("--bbox", help="west,south,east,north in the map's CRS, or in degrees; default around all cones."),
    ] = None,
    size: Annotated[str | None, typer.Option("--size", help="Width x height in millimetres, e.g. 240x160.")] = None,
    title: Annotated[str | None, typer.Option("--title", help="Heading; default the map's name.")] = None,
    as_json: JsonOption = False,
) -> None:
    """A plan picture for a report: cones, base layers, paths, scale bar, north arrow, legend, CRS and date."""
    if output.suffix.lower() not in SUFFIXES:
        raise InputError(f"{output}: a picture is one of {', '.join(SUFFIXES)}")
    if changes is not None and (at is not None or known_at is not None):
        raise InputError("--changes names two states by itself: leave --at and --known-at out")
    valid_at, known = parse_time(at), parse_time(known_at)
    size_mm = _size(size)
    settings = read_settings()
    name = settings.map_name
    with closing(open_map(settings)) as conn:
        info = find_map(conn, name)
        if info is None:
            raise InputError(f"there is no map named {name} in this database: ingest a drive first.")
        if changes is None:
            versions = read_features_as_of(conn, valid_at, known_at=known, map_name=name)
            standing, differing = [version.feature for version in versions], None
        else:
            standing = state_of(conn, settings, changes[1])
            valid_at, known = instants_of(conn, settings, changes[1])
            differing = diff_of(state_of(conn, settings, changes[0]), standing)
        extent = plan_extent(standing, differing) if bbox is None else _bbox(bbox, info.srid)
        around = _around(extent)
        points, shades = _points(conn, name, around)
        content = PlanContent(
            srid=info.srid, standing=standing, changes=differing,
            ways_m=_ways(conn, name, valid_at, known),
            lines_m=_lines(conn, name, around), points_m=points, shades=shades,
        )  # fmt: skip
        last = info.last_committed_at
    done = draw_map_picture(
        output,
        content,
        extent,
        size_mm=size_mm,
        title=title or _title(name, changes),
        footer=_footer(valid_at, known, changes, last),
    )
    about = {"picture": str(done), "cones": len(standing), "changes": None if differing is None else len(differing)}
    about |= {"lines": len(content.lines_m), "points": len(points), "bbox": extent}
    if as_json:
        print_json(about)
    else:
        out.print(
            f"{len(standing)} cones, {len(content.lines_m)} lane boundaries, {len(points)} points -> {done}",
            markup=False,
        )


def _title(name: str, changes: tuple[str, str] | None) -> str:
    return f"Traffic cones, map {name}" + (f": changes from {changes[0]} to {changes[1]}" if changes else "")


def _footer(
    valid_at: datetime | None, known: datetime | None, changes: tuple[str, str] | None, last: datetime | None
) -> str:
    """What the picture shows, in words that can be checked."""
    if changes:
        parts = [f"{changes[0]} compared with {changes[1]}"]
    else:
        parts = [f"on the road at {valid_at:%Y-%m-%d %H:%M} UTC" if valid_at else "latest state"]
    if known:
        parts.append(f"as known at {known:%Y-%m-%d %H:%M} UTC")
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
        raise InputError(f"--size {text}: write width x height in millimetres, 60 to 1200 each, like 240x160")
    return width, height


def _bbox(text: str, srid: int) -> Bbox:
    """In the map's CRS; numbers that can be degrees are longitudes and latitudes. Raises InputError."""
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--bbox {text}: write west,south,east,north") from None
    if not all(map(math.isfinite, (west, south, east, north))) or west >= east or south >= north:
        raise InputError(f"--bbox {text}: west must be less than east and south less than north")
    if abs(west) <= 180 and abs(east) <= 180 and abs(south) <= 90 and abs(north) <= 90:
        to_map = Transformer.from_crs(4326, srid, always_xy=True)
        west, south, east, north = to_map.transform_bounds(west, south, east, north)
        if not all(map(math.isfinite, (west, south, east, north))):
            raise InputError(f"--bbox {text}: this place does not exist in the map's CRS, EPSG:{srid}")
    if max(east - west, north - south) > 100_000:
        raise InputError(f"--bbox {text}: a picture shows at most 100 km")
    return west, south, east, north


def _around(extent: Bbox) -> Bbox:
    """More than the picture: its paper has another shape than the place."""
    west, south, east, north = extent
    more = max(east - west, north - south)
    return west - more, south - more, east + more, north + more


def _ways(conn: Connection, name: str, valid_at: datetime | None, known: datetime | None) -> list[Array]:
    """Paths of the drives that the state can know of."""
    paths = read_paths(conn, map_name=name, until=valid_at)
    if known is None:
        return [path.xy_m for path in paths]
    by_then = {c.drive_id for c in list_changesets(conn, map_name=name) if c.committed_at <= known}
    return [path.xy_m for path in paths if path.drive_id in by_then]


def _lines(conn: Connection, name: str, around: Bbox) -> list[Array]:
    rows = read_base_lines(conn, name, _MAX_LINES)
    shapes = shapely.from_wkb([bytes(row["geom"]) for row in rows])
    return [shapely.get_coordinates(shape) for shape in shapes if shapely.intersects(shape, shapely.box(*around))]


def _points(conn: Connection, name: str, around: Bbox) -> tuple[Array, np.ndarray]:
    """Points of the tiles around, coarse ones first, as many as a picture can show."""
    west, south, east, north = around
    found, shades, count = [np.empty((0, 2))], [np.empty(0, np.uint8)], 0
    for row in read_base_tiles(conn, name, _MAX_TILES):
        x, y = row["origin_m"][:2]
        side = tile_side_m(row["level"])
        if x > east or y > north or x + side < west or y + side < south:
            continue
        count += row["points"]
        payload = read_base_tile(conn, name, row["sha256"]) if count <= _MAX_POINTS else None
        if payload is None:
            break
        steps, shade = decode_points(payload)
        found.append(steps[:, :2] * np.array(row["scale_m"][:2]) + (x, y))
        shades.append(shade)
    return np.concatenate(found), np.concatenate(shades)
