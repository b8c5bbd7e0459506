"""Queries of the OGC API that tipg does not provide: maps and their extents, boxes, pages."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import asyncpg
import numpy as np

from conetl.db.connection import load_sql
from conetl.geometry.geodesy import to_geodetic, to_map
from conetl.model.arrays import Floats
from conetl.model.columns import FeatureColumn

#: West, south, east, north in degrees.
Degrees = tuple[float, float, float, float]
#: Smallest and largest easting and northing: min x, min y, max x, max y.
Metres = tuple[float, float, float, float]
EVERYWHERE: Degrees = (-180.0, -90.0, 180.0, 90.0)
#: A box around all coordinates of any CRS, and one around nothing.
ALL_ROWS: Metres = (-1e30, -1e30, 1e30, 1e30)
NO_ROWS: Metres = (1e30, 1e30, 1e30, 1e30)
#: An inner box that contains nothing: every row is tested in degrees.
NOTHING_INSIDE: Metres = (1e30, 1e30, -1e30, -1e30)
_NEAR = ("min_x_m", "min_y_m", "max_x_m", "max_y_m")
_INNER = ("inner_min_x_m", "inner_min_y_m", "inner_max_x_m", "inner_max_y_m")
#: Margin around the areas of a map's drives that contains all its features (about 2 km; rounding of PROJ).
_SPARE_DEG = 0.02
#: Distance of an inner box from the box in degrees, beside the bulge of its edges: versions of PROJ may differ by metres.
_INNER_SPARE_M = 100.0
#: In larger parts a projection may fold the earth, not only bend edges.
_LARGEST_INNER_DEG = 20.0


@dataclass(frozen=True)
class ServedMap:
    """One map in its current state."""

    map_name: str
    srid: int
    changeset_no: int
    last_written_at: datetime
    """See `conetl.newest_write`."""
    extent: Degrees
    since: datetime
    """Beginning of the first drive."""
    bbox: Degrees = EVERYWHERE
    """The extent as standards state it: west > east across 180 degrees, where `extent` goes around the earth."""
    share: float = 0.0
    """Estimated share of this map in all versions of features of the database; 0 without an estimate."""
    version_count: float = 0.0
    """Estimated number of versions of its features; 0 without an estimate."""


@dataclass(frozen=True)
class ItemRows:
    """Rows of the read model as items: with the geometry in degrees, and a box exact to the rounding of an answer."""

    kind: str
    """features, lane_markings or changes."""
    map_name: str
    instants: Mapping[str, datetime | None]
    """By parameter of the SQL function. None: `-infinity` for from_at and since, else infinity."""
    box: Degrees | None = None
    """West, south, east, north; edges included; west > east crosses 180 degrees."""
    near: Metres | None = None
    """Contains all rows in the box, for the index."""
    inner: Metres = NOTHING_INSIDE
    """Certainly inside the box: rows in it need no test in degrees."""
    by_index: bool = True
    """False: read the whole table, which takes less time for most of it."""
    row_ids: Sequence[int] | None = None
    """Only these states."""

    def source(self, first: int) -> tuple[str, list[object]]:
        """SQL for a FROM clause, and the values of its parameters, the first of which is numbered `first`."""
        values: list[object] = []

        def number(value: object, kind: str) -> str:
            values.append(value)
            return f"${first + len(values) - 1}::{kind}"

        given = [f"map_name => {number(self.map_name, 'text')}"]
        for name, instant in self.instants.items():
            begins = "'-infinity'" if name in ("from_at", "since") else "'infinity'"
            given.append(f"{name} => {begins if instant is None else number(instant, 'timestamptz')}")
        where = ["true"]
        if self.near is not None and self.by_index:
            where.append(f"s.{'line' if self.kind == 'lane_markings' else 'geom'} && {_envelope(self.near, number)}")
            if (
                self.kind == "changes"
            ):  # numbers in the text: the plan of a statement with parameters is the same for any box
                given.append(f"box => {_envelope(self.near, lambda side, _: f'{side:.3f}')}")
        if self.box is not None:
            test = load_sql(f"ogc.{'line' if self.kind == 'lane_markings' else 'point'}_in_box")
            sides = dict(zip(("west", "south", "east", "north"), self.box, strict=True))
            if self.kind != "lane_markings":
                sides |= dict(zip(_NEAR, self.near or ALL_ROWS, strict=True)) | dict(
                    zip(_INNER, self.inner, strict=True)
                )
            where.append(f"({_filled(test, {name: number(value, 'float8') for name, value in sides.items()})})")
        if self.row_ids is not None:
            where.append(f"s.version_row_id = any({number(self.row_ids, 'bigint[]')})")
        text = {"arguments": ", ".join(given), "where": " and ".join(where)}
        return f"({_filled(load_sql(f'ogc.{self.kind}'), text)}) items", values


@dataclass(frozen=True)
class GivenRows:
    """Rows that were computed, as items."""

    kind: str
    """Name of the statement in sql/ogc.sql that reads them."""
    rows: str
    """JSON."""
    columns: Sequence[FeatureColumn]
    box: Degrees | None = None

    def source(self, first: int) -> tuple[str, list[object]]:
        """As of `ItemRows`."""
        west, south, east, north = self.box or EVERYWHERE
        names = ("rows", "west", "south", "east", "north")
        text = {name: f"${first + k}::{'float8' if k else 'text::jsonb'}" for k, name in enumerate(names)}
        text["columns"] = ", ".join(f"{column.name} {column.kind}" for column in self.columns)
        return f"({_filled(load_sql(f'ogc.{self.kind}'), text)}) items", [self.rows, west, south, east, north]


def _envelope(box: Metres, number: Callable[[object, str], str]) -> str:
    return f"ST_MakeEnvelope({', '.join(number(side, 'float8') for side in box)})"


class MapDirectory:
    """The maps of a database, read for every request; extents are computed once per changeset."""

    def __init__(self) -> None:
        self._known: dict[str, ServedMap] = {}

    async def maps(self, conn: asyncpg.Connection, map_name: str | None = None) -> list[ServedMap]:
        """All maps by name, or the named one; [] if it does not exist."""
        rows = await conn.fetch(load_sql("ogc.maps"), map_name)
        return [await self._described(conn, row) for row in rows]

    async def _described(self, conn: asyncpg.Connection, row: asyncpg.Record) -> ServedMap:
        known = self._known.get(row["map_name"])
        if known is None or known.srid != row["srid"] or known.changeset_no != row["changeset_no"]:
            found = await conn.fetchrow(load_sql("ogc.extent"), row["map_name"])
            extent = (found["west"], found["south"], found["east"], found["north"])
            extent = EVERYWHERE if None in extent else extent
            west, south, east, north = bbox = extent
            west_360, east_360 = found["west_360"] or 0.0, found["east_360"] or 360.0
            if west_360 < 180.0 < east_360 and east_360 - west_360 < east - west:
                bbox = (west_360, south, east_360 - 360.0, north)
            sizes = {"share": found["share"], "version_count": found["version_count"]}
            known = ServedMap(**row, extent=extent, bbox=bbox, since=found["since"], **sizes)
            self._known[row["map_name"]] = known
        return replace(known, last_written_at=row["last_written_at"])


async def fetch(
    conn: asyncpg.Connection, name: str, text: Mapping[str, str], *arguments: object
) -> list[asyncpg.Record]:
    """ItemRows of a statement of sql/ogc.sql; text: its placeholders."""
    rows: list[asyncpg.Record] = await conn.fetch(_filled(load_sql(f"ogc.{name}"), text), *arguments)
    return rows


def _filled(sql: str, text: Mapping[str, str]) -> str:
    """In one pass: a condition may contain the text of a client, in which nothing is replaced."""
    without_comments = re.sub(r"^--.*\n", "", sql, flags=re.MULTILINE)  # which name the placeholders
    return re.sub(r"\{\{(\w+)\}\}", lambda found: text[found[1]], without_comments).rstrip("; \n")


def rows_near(box: Degrees, served: ServedMap) -> Metres:
    """A box in the map's CRS that contains all features of the map in `box` (west > east: across 180 degrees), for the index.

    Only its intersection with the map's extent is used: far from its zone a projection is meaningless.
    """
    reach = _grown(served.extent)
    parts = parts_of_box(box, reach)
    if reach in parts:
        return ALL_ROWS
    if not parts:
        return NO_ROWS
    sides = list(zip(*(_around(part, served.srid) for part in parts), strict=True))
    return min(sides[0]), min(sides[1]), max(sides[2]), max(sides[3])


def rows_within(box: Degrees, served: ServedMap) -> Metres:
    """The largest box in the map's CRS that is certainly inside `box`: its features need no test in degrees."""
    inner = [_inside(part, served.srid) for part in parts_of_box(box, _grown(served.extent))]
    return max(inner, key=_area, default=NOTHING_INSIDE)


def part_of_map(box: Degrees | None, served: ServedMap) -> float:
    """Share of the map's extent inside `box`, 0 to 1 by area in degrees."""
    reach = _grown(served.extent)
    return 1.0 if box is None else sum(_area(part) for part in parts_of_box(box, reach)) / _area(reach)


def parts_of_box(box: Degrees, reach: Degrees) -> list[Degrees]:
    """The parts of a box (two if it crosses 180 degrees) inside another one."""
    west, south, east, north = box
    low_x, low_y, high_x, high_y = reach
    pieces = [(west, east)] if west <= east else [(west, 180.0), (-180.0, east)]
    cut = [(max(left, low_x), max(south, low_y), min(right, high_x), min(north, high_y)) for left, right in pieces]
    return [part for part in cut if part[0] <= part[2] and part[1] <= part[3]]


def _area(box: Degrees | Metres) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])


def _around(box: Degrees, srid: int) -> Metres:
    """A box in a CRS that certainly contains a box in degrees.

    Its edges are bent there, so they are sampled in 16 pieces each; their bulge in between is far below the hundredth (and the
    metre) that is added.
    """
    places = _edges(box, srid).reshape(-1, 2)
    (low_x, low_y), (high_x, high_y) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    spare_m = 1 + 0.01 * max(high_x - low_x, high_y - low_y)
    return low_x - spare_m, low_y - spare_m, high_x + spare_m, high_y + spare_m


def _inside(box: Degrees, srid: int) -> Metres:
    """A box in a CRS that is certainly inside a box in degrees; NOTHING_INSIDE if none is found.

    No edge of the box in degrees, bent in the CRS, reaches into it, and its centre is inside: so all of it is.
    """
    west, south, east, north = box
    if max(east - west, north - south) > _LARGEST_INNER_DEG:
        return NOTHING_INSIDE
    edges = _edges(box, srid)
    (_, low_y), (low_x, _) = edges[0].max(axis=0).tolist(), edges[2].max(axis=0).tolist()
    (_, high_y), (high_x, _) = edges[1].min(axis=0).tolist(), edges[3].min(axis=0).tolist()
    # An edge bulges between three neighbours by an eighth of their second difference.
    spare_m = _INNER_SPARE_M + 2 * float(np.abs(np.diff(edges, n=2, axis=1)).max())
    inner = (low_x + spare_m, low_y + spare_m, high_x - spare_m, high_y - spare_m)
    if inner[0] >= inner[2] or inner[1] >= inner[3]:
        return NOTHING_INSIDE
    lat, lon, _ = to_geodetic(srid, ((inner[0] + inner[2]) / 2, (inner[1] + inner[3]) / 2, 0.0)).tolist()
    return inner if west <= lon <= east and south <= lat <= north else NOTHING_INSIDE


def _edges(box: Degrees, srid: int) -> Floats:
    """Easting and northing along the southern, northern, western and eastern edge of a box in degrees (4, 17, 2)."""
    west, south, east, north = box
    steps = np.linspace(0.0, 1.0, 17)
    lon, lat = west + (east - west) * steps, south + (north - south) * steps
    lons = np.stack([lon, lon, np.full(17, west), np.full(17, east)])
    lats = np.stack([np.full(17, south), np.full(17, north), lat, lat])
    return to_map(srid, lats, lons, 0.0)[..., :2]


def _grown(extent: Degrees) -> Degrees:
    west, south, east, north = extent
    if east - west > 180:  # a map across 180 degrees: its corners are on both sides, at unknown distance
        west, east = -180.0, 180.0
    return west - _SPARE_DEG, south - _SPARE_DEG, east + _SPARE_DEG, north + _SPARE_DEG
