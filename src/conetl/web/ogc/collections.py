"""The collections of each map as tipg collections: points and lane markings as of an instant, changes of points between two,
differences from plans."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any
from uuid import UUID

import asyncpg
import orjson
from cql2 import Expr
from fastapi.concurrency import run_in_threadpool
from morecantile import Tile, TileMatrixSet
from tipg.collections import Column, PgCollection
from tipg.errors import NotFound
from tipg.model import Extent, Spatial, Temporal

from conetl.db import ogc_store as store
from conetl.db.ogc_store import Degrees, GivenRows, ItemRows, ServedMap
from conetl.model.base import TICK
from conetl.model.columns import BY_NAME, Face, names
from conetl.model.planned_zones import DIFFERENCE_COLUMNS
from conetl.pipeline.maps.planned_zones import PlanComparison
from conetl.web.parameters import BadParameterError, Interval, check_value
from conetl.web.tiles import STORED_ZOOMS

MAX_ZOOM = 24
#: Vector tiles with more items have clusters instead; tipg would leave out the others without a word.
MAX_IN_TILE = 10_000
#: From about this number of versions in a box, one scan of the table finds both a page and the number of all items.
MANY_VERSIONS = 20_000
#: From this share of all versions of the database, a scan of the whole table is faster than the spatial index.
MOST_VERSIONS = 0.3


@dataclass(frozen=True)
class Instants:
    """The requested state of the map; None: the latest (of `start`, `known_start`: before anything)."""

    at: datetime | None = None
    known_at: datetime | None = None
    start: datetime | None = None
    end: datetime | None = None
    known_start: datetime | None = None
    known_end: datetime | None = None


@dataclass(frozen=True)
class Page:
    """Items as comma-separated JSON, their number, and the number of items on all pages."""

    items: bytes
    returned: int
    matched: int

    def parsed(self) -> list[dict[str, Any]]:
        """The items as GeoJSON objects."""
        items: list[dict[str, Any]] = orjson.loads(b"[%b]" % self.items)
        return items


_SCHEMAS: dict[str, dict[str, Any]] = {
    "text": {"type": "string"}, "integer": {"type": "integer"}, "float8": {"type": "number"},
    "boolean": {"type": "boolean"}, "uuid": {"type": "string", "format": "uuid"},
    "timestamptz": {"type": "string", "format": "date-time"},
}  # fmt: skip
_OF_DIFFERENCES = {column.name: column for column in DIFFERENCE_COLUMNS}
#: All properties by name.
_COLUMNS = _OF_DIFFERENCES | BY_NAME
_FEATURES, _LINES, _CHANGED = (
    names(Face.OGC, "points"),
    names(Face.OGC, "lines"),
    names(Face.OGC | Face.CHANGE, "points"),
)


#: Name of a collection of each map -> title, description, properties, type of geometry.
COLLECTIONS = {
    "features": (
        "Cones",
        "Traffic cones at the instant `at` on the road, as known at `known_at`; by default the latest.",
        _FEATURES, "Point",
    ),
    "lane_markings": (
        "Lane markings",
        "Stretches of lane markings at the instant `at` on the road, as known at `known_at`; by default the latest.",
        _LINES, "LineString",
    ),
    "changes": (
        "Changes",
        "Traffic cones that were added, moved, removed, confirmed or not observed between the instants `from` and `to` on the "
        "road; "
        "without `from`, all cones that exist at `to` count as added. Positions and versions are those after the change; "
        "those of removed cones are from before it.",
        _CHANGED, "Point",
    ),
    "differences": (
        "Differences from plans",
        "Planned work zones against those that were found until the instant `at`, as known at `known_at`; `rank` 1 is the worst.",
        tuple(column.name for column in DIFFERENCE_COLUMNS if column.name != "images"), "Point",
    ),
}  # fmt: skip


#: Compares the plans of a map, as of an instant and as known at another one; a plain function, for a thread.
Compare = Callable[[str, datetime | None, datetime | None], PlanComparison]
Rows = ItemRows | GivenRows


class AsOfCollection(PgCollection):
    """States or changes of one map; boxes and times of a request become conditions of the rows."""

    served: ServedMap
    instants: Instants
    compare: Compare

    @property
    def extent(self) -> Extent:
        """The area that the map's drives covered, and the time from the first drive on."""
        since = self.served.since.astimezone(UTC).isoformat().replace("+00:00", "Z")
        return Extent(spatial=Spatial(bbox=[list(self.served.bbox)]), temporal=Temporal(interval=[[since, None]]))

    def cql_where(  # type: ignore[override]  # tipg's other parameters are passed on
        self, ids: list[str] | None = None, **others: Any
    ) -> Expr | None:
        """tipg's condition; for several ids tipg itself would compare uuid with text. Raises NotFound, BadParameterError."""
        kinds = {column.name: column.type for column in self.properties}
        for name, text in others.get("properties") or ():
            check_value(name, kinds[name], text)
            if text not in (words := _COLUMNS[name].words or (text,)):
                raise BadParameterError(f"{name}={text!r} should be one of {', '.join(words)}.")
        where = super().cql_where(**others)
        if not ids:
            return where
        each = [{"op": "=", "args": [{"property": "feature_id"}, _checked_id(text)]} for text in ids]
        wanted = Expr({"op": "or", "args": each} if len(each) > 1 else each[0])
        return wanted if where is None else where + wanted

    def _sort_expressions(self, sortby: str | None) -> list[tuple[str, str]]:
        """tipg's order, and last the id: without it, items that compare equal could appear on two pages or on none."""
        order: list[tuple[str, str]] = super()._sort_expressions(sortby)
        return order if any(name == "feature_id" for name, _ in order) else [*order, ("feature_id", "feature_id")]

    def columns(self, properties: list[str] | None = None) -> list[str]:
        """Names of the requested properties. Raises BadParameterError for an unknown one."""
        known: list[str] = super().columns()
        unknown = set(properties or ()) - {*known, ""}
        if unknown:
            raise BadParameterError(f"There is no property {min(unknown)!r}; there are: {', '.join(known)}.")
        return known if properties is None else [name for name in known if name in properties]

    async def page(
        self, conn: asyncpg.Connection, *, limit: int, offset: int = 0, ids: list[str] | None = None, box: Degrees | None = None,
        interval: Interval | None = None, values: list[tuple[str, str]] | None = None, sortby: str | None = None,
        properties: list[str] | None = None, links: tuple[str, str] = ('"', '"'),
    ) -> Page:  # fmt: skip
        """One page of items as GeoJSON made by PostgreSQL; `links` is the JSON around the id in the links of each item."""
        where = self.cql_where(ids=ids, properties=values)
        order = self._sort_expressions(sortby)
        columns = self.columns(properties)
        needed = {*columns, "feature_id", "geom", *(name for name, _ in [*order, *(values or ())])}
        text = {
            "where": self._where_clause(where), "order": ", ".join(sql for _, sql in order), "columns": ", ".join(sorted(needed)),
            "properties": ", ".join(f"p.{name}" for name in columns),
        }  # fmt: skip
        rows = await self._rows(box, interval)
        if not ids and isinstance(rows, ItemRows) and self.table != "changes" and self._is_large(box):
            return await self._page_of_many(conn, text, rows, limit, offset, links)
        items, returned = await _items(conn, text, rows, limit, offset, links)
        if returned < limit and (returned or not offset):  # the last page gives the number of all
            return Page(items, returned, offset + returned)
        return Page(items, returned, await _count(conn, text, rows))

    def _is_large(self, box: Degrees | None) -> bool:
        return store.part_of_map(box, self.served) * self.served.version_count >= MANY_VERSIONS

    async def _page_of_many(
        self, conn: asyncpg.Connection, text: Mapping[str, str], rows: ItemRows, limit: int, offset: int, links: tuple[str, str]
    ) -> Page:  # fmt: skip
        """A page of a large part of a large map: first the rows that are on it, with their number, then their items."""
        by_index = store.part_of_map(rows.box, self.served) * self.served.share < MOST_VERSIONS
        sql, arguments = replace(rows, by_index=by_index).source(3)
        found = await store.fetch(conn, "items_found", {**text, "source": sql}, limit, offset, *arguments)
        if not found:
            return Page(b"", 0, await _count(conn, text, rows) if offset else 0)
        chosen = replace(rows, box=None, row_ids=[row["version_row_id"] for row in found])
        items, returned = await _items(conn, {**text, "where": "where true"}, chosen, limit, 0, links)
        return Page(items, returned, found[0]["matched"])

    async def get_tile(self, conn: asyncpg.Connection, *, tms: TileMatrixSet, tile: Tile, **asked: Any) -> bytes:
        """One vector tile."""
        if not 0 <= tile.z <= MAX_ZOOM or not (0 <= tile.x < 2**tile.z and 0 <= tile.y < 2**tile.z):
            raise NotFound(f"There is no tile {tile.z}/{tile.x}/{tile.y}: the zoom levels are 0 to {MAX_ZOOM}.")
        box = asked.pop("bbox_filter", None)
        edges = tms.bounds(tile)
        rows = await self._rows(box, asked.pop("datetime_filter", None))
        if isinstance(rows, GivenRows):
            asked["function_parameters"] = rows
            whole: bytes = await super().get_tile(conn, tms=tms, tile=tile, **asked)
            return whole
        if box is None:  # tipg itself tests the edges of the tile
            near = store.rows_near((edges.left, edges.bottom, edges.right, edges.top), self.served)
            rows = replace(rows, near=None if near == store.ALL_ROWS else near)
        if asked.get("limit") is None and (clusters := await self._clusters(conn, rows, tms, tile, asked)) is not None:
            return clusters
        asked["function_parameters"] = rows
        tile_bytes: bytes = await super().get_tile(conn, tms=tms, tile=tile, **asked)
        return tile_bytes

    async def _clusters(
        self, conn: asyncpg.Connection, rows: ItemRows, tms: TileMatrixSet, tile: Tile, asked: Mapping[str, Any]
    ) -> bytes | None:
        """A tile with the numbers of its items, if it has more than `MAX_IN_TILE`: by class, and of changes by kind."""
        edges = tuple(tms.xy_bounds(tile))
        ids, values = asked.get("ids_filter"), asked.get("properties_filter")
        if self.table == "features" and not (ids or values or rows.box or "since" in rows.instants):
            near = rows.near or store.ALL_ROWS
            latitude = (tms.bounds(tile).top + tms.bounds(tile).bottom) / 2
            side_m = (edges[2] - edges[0]) * math.cos(math.radians(latitude))
            zoom = next((z for z in STORED_ZOOMS if 2.0 ** (20 - z) <= side_m / 32), STORED_ZOOMS[-1])
            times = [rows.instants[name] for name in ("valid_at", "known_at")]
            [found] = await store.fetch(conn, "stored_clusters", {}, rows.map_name, *times, zoom, *near, *edges)
            if found["is_now"]:
                return bytes(found["tile"]) if found["feature_count"] > MAX_IN_TILE else None
        where = self._where_clause(self.cql_where(ids=ids, properties=values, tms=tms, tile=tile))
        text = {"where": where, "columns": "category, change" if self.table == "changes" else "category"}
        sql, arguments = rows.source(5)
        [found] = await store.fetch(conn, "counted_clusters", {**text, "source": sql}, *edges, *arguments)
        return bytes(found["tile"]) if found["feature_count"] > MAX_IN_TILE else None

    def _from(self, function_parameters: Any, params: list[Any]) -> str:
        """The rows of a tile, in place of tipg's table."""
        sql, arguments = function_parameters.source(len(params) + 1)
        params += arguments
        return f"FROM {sql}"

    async def _rows(self, box: Degrees | None, interval: Interval | None) -> Rows:
        """Which rows a request means. Without a box if the whole map is requested: that is a separate statement with its plan."""
        if self.table == "differences":
            return await self._differences(box, interval)
        near = store.ALL_ROWS if box is None else store.rows_near(box, self.served)
        rows = ItemRows(self.table, self.served.map_name, self._times(interval))
        if box is None or near == store.ALL_ROWS:
            return rows
        return replace(rows, box=box, near=near, inner=store.rows_within(box, self.served))

    async def _differences(self, box: Degrees | None, interval: Interval | None) -> GivenRows:
        """As of an instant, or the end of an interval: those that last until its begin."""
        begin, at = interval or (None, self.instants.at)
        found = await run_in_threadpool(self.compare, self.served.map_name, at, self.instants.known_at)
        ends = ((row, row.difference.span[1]) for row in found.rows)
        rows = [row.flat() for row, end in ends if begin is None or begin == at or end is None or end >= begin]
        return GivenRows("differences", orjson.dumps(rows).decode(), DIFFERENCE_COLUMNS, box)

    def _times(self, interval: Interval | None) -> dict[str, datetime | None]:
        """Instants by the parameter of the SQL function; None: the latest, or of a beginning the earliest."""
        asked = self.instants
        if self.table != "changes":
            start, end = interval or (None, asked.at)
            since = {} if interval is None or (start == end and start) else {"since": start}
            return {"valid_at": end, "known_at": asked.known_at, **since}
        if interval is not None:  # changes at its two ends are within it
            asked = replace(asked, start=None if interval[0] is None else interval[0] - TICK, end=interval[1])
        return {
            "from_at": asked.start, "to_at": asked.end, "known_at": asked.known_end,
            "known_from": asked.known_start or asked.known_end,
        }  # fmt: skip


def collection_of(name: str, served: ServedMap, instants: Instants, compare: Compare) -> AsOfCollection:
    """A collection of a map; name: of `COLLECTIONS`."""
    title, description, columns, geometry = COLLECTIONS[name]
    place = Column(name="geom", type="geometry", geometry_type=geometry, srid=4326, bounds=list(served.extent))
    listed = [_column(column, name) for column in columns]
    return AsOfCollection(
        type="Table", id=f"{served.map_name}.{name}", table=name, schema="conetl", title=f"{title} of the map {served.map_name}",
        description=description, table_columns=[*listed, place], properties=[*listed, place], id_column=listed[0],
        geometry_column=place, parameters=[], served=served, instants=instants, compare=compare,
    )  # fmt: skip


def _column(name: str, collection: str) -> Column:
    column = (_OF_DIFFERENCES if collection == "differences" else BY_NAME)[name]
    return Column(name=name, type=column.kind, description=column.meaning)


#: By property, by which items are filtered: JSON Schema of its values, and what it means.
FILTERS = {
    name: (_SCHEMAS[column.kind] | ({"enum": list(column.words)} if column.words else {}), column.meaning)
    for name in dict.fromkeys(name for _, _, names_, _ in COLLECTIONS.values() for name in names_)
    if (column := _COLUMNS[name])
}


def as_ewkt(geometry: dict[str, Any]) -> str:
    """A GeoJSON point or line as PostGIS' extended well-known text."""
    kind, places = geometry["type"].upper(), geometry["coordinates"]
    vertices = ",".join(" ".join(map(repr, place)) for place in ([places] if kind == "POINT" else places))
    return f"SRID=4326;{kind}({vertices})"


async def _items(
    conn: asyncpg.Connection, text: Mapping[str, str], rows: Rows, limit: int, offset: int, links: tuple[str, str]
) -> tuple[bytes, int]:
    """Items of one page as comma-separated JSON, and their number."""
    sql, arguments = rows.source(5)
    [row] = await store.fetch(conn, "page", {**text, "source": sql}, limit, offset, *links, *arguments)
    return (row["items"] or "").encode(), row["returned"]


async def _count(conn: asyncpg.Connection, text: Mapping[str, str], rows: Rows) -> int:
    sql, arguments = rows.source(1)
    [row] = await store.fetch(conn, "count", {**text, "source": sql}, *arguments)
    return int(row[0])


def _checked_id(text: str) -> str:
    try:
        UUID(text)
    except ValueError as error:
        raise NotFound(f"There is no item {text!r}: ids of cones are UUIDs.") from error
    return text
