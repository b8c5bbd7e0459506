"""What the OGC API asks of the database beside tipg's own queries: which maps there are, where they lie, boxes, pages."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import asyncpg
import numpy as np

from conetl.geometry.geodesy import to_map
from conetl.io.db import load_sql

#: West, south, east, north in degrees.
Degrees = tuple[float, float, float, float]
#: Smallest and largest easting and northing: min x, min y, max x, max y.
Metres = tuple[float, float, float, float]
EVERYWHERE: Degrees = (-180.0, -90.0, 180.0, 90.0)
#: A box around all that any CRS can say, and one around nothing.
ALL_ROWS: Metres = (-1e30, -1e30, 1e30, 1e30)
NO_ROWS: Metres = (1e30, 1e30, 1e30, 1e30)
#: Features of a map lie this near to what its drives looked at (about 2 km; they lie inside, but for the rounding of PROJ).
_SPARE_DEG = 0.02


@dataclass(frozen=True)
class ServedMap:
    """One map as it stands."""

    map_name: str
    srid: int
    changeset_no: int
    last_committed_at: datetime
    """Of changesets and decisions."""
    extent: Degrees
    since: datetime
    """Beginning of the first drive."""


class MapDirectory:
    """The maps of a database that hold something, asked anew for every request; extents are computed once a changeset."""

    def __init__(self) -> None:
        self._known: dict[str, ServedMap] = {}

    async def maps(self, conn: asyncpg.Connection, map_name: str | None = None) -> list[ServedMap]:
        """All maps by name, or the one that is named; [] where there is no such map or it is empty."""
        rows = await conn.fetch(load_sql("serve/ogc_maps"), map_name)
        return [await self._described(conn, row) for row in rows]

    async def _described(self, conn: asyncpg.Connection, row: asyncpg.Record) -> ServedMap:
        known = self._known.get(row["map_name"])
        if known is None or known.srid != row["srid"] or known.changeset_no != row["changeset_no"]:
            found = await conn.fetchrow(load_sql("serve/ogc_extent"), row["map_name"])
            extent = (found["west"], found["south"], found["east"], found["north"])
            known = ServedMap(**row, extent=extent, since=found["since"])
            self._known[row["map_name"]] = known
        return replace(known, last_committed_at=row["last_committed_at"])


async def read_page(
    conn: asyncpg.Connection, kind: str, text: Mapping[str, str], arguments: Sequence[str | float]
) -> tuple[bytes, int]:
    """Items of one page as JSON with commas between them, and how many; `kind` is features or changes, `text` what the statement
    wants put in."""
    # In one go: a condition may hold the text of a client, in which nothing is put in.
    statement = re.sub(r"\{\{(\w+)\}\}", lambda found: text[found[1]], load_sql(f"serve/ogc_{kind}_page"))
    row = await conn.fetchrow(statement, *arguments)
    return (row["items"] or "").encode(), row["returned"]


async def warm_session(conn: asyncpg.Connection) -> None:
    """Read what the first question of a session would read: what maps there are, and their coordinate reference systems."""
    await conn.fetch(load_sql("serve/ogc_warm"))
    await conn.fetch(load_sql("serve/ogc_maps"), "")


def rows_near(box: Degrees, served: ServedMap) -> Metres:
    """A box in the map's CRS that holds all features of the map in `box` (west > east: across 180 degrees), for the index.

    Only the part of it that the map reaches is looked at: far from its zone a projection says nothing.
    """
    west, south, east, north = box
    low_x, low_y, high_x, high_y = _grown(served.extent)
    pieces = [(west, east)] if west <= east else [(west, 180.0), (-180.0, east)]
    found = []
    for left, right in pieces:
        part = (max(left, low_x), max(south, low_y), min(right, high_x), min(north, high_y))
        if part == (low_x, low_y, high_x, high_y):
            return ALL_ROWS
        if part[0] <= part[2] and part[1] <= part[3]:
            found.append(_around(part, served.srid))
    if not found:
        return NO_ROWS
    sides = list(zip(*found, strict=True))
    return min(sides[0]), min(sides[1]), max(sides[2]), max(sides[3])


def _around(box: Degrees, srid: int) -> Metres:
    """A box in a CRS that surely holds a box in degrees.

    Its edges are bent there, so they are looked at in 16 pieces each; what they bulge between is far below the hundredth (and the
    metre) that is added.
    """
    west, south, east, north = box
    steps = np.linspace(0.0, 1.0, 17)
    lon, lat = west + (east - west) * steps, south + (north - south) * steps
    lons = np.concatenate([lon, lon, np.full(17, west), np.full(17, east)])
    lats = np.concatenate([np.full(17, south), np.full(17, north), lat, lat])
    places = to_map(srid, lats, lons, 0.0)[:, :2]
    (low_x, low_y), (high_x, high_y) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    spare_m = 1 + 0.01 * max(high_x - low_x, high_y - low_y)
    return low_x - spare_m, low_y - spare_m, high_x + spare_m, high_y + spare_m


def _grown(extent: Degrees) -> Degrees:
    west, south, east, north = extent
    return west - _SPARE_DEG, south - _SPARE_DEG, east + _SPARE_DEG, north + _SPARE_DEG
