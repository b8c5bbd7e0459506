"""The two collections of each map, as tipg sees them: its features as of an instant, and its changes between two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any
from uuid import UUID

import asyncpg
from cql2 import Expr
from morecantile import Tile, TileMatrixSet
from tipg.collections import Column, ItemList, Parameter, PgCollection
from tipg.errors import NotFound
from tipg.model import Extent, Spatial, Temporal

from conetl.db.ogc_store import (
    ALL_ROWS,
    EVERYWHERE,
    Degrees,
    ServedMap,
    count_features,
    find_versions,
    part_of_map,
    read_page,
    rows_near,
    rows_of_versions,
    rows_within,
    warm_session,
)
from conetl.model.params import ReconcileParams
from conetl.web.ogc.pages import Page
from conetl.web.ogc.values import BadParameterError, check_value

SCHEMA = "conetl_ogc"
MAX_ZOOM = 24
#: PostgreSQL's timestamps count microseconds.
_TICK = timedelta(microseconds=1)
_EDGES = ("west", "south", "east", "north")
_NEAR = ("min_x_m", "min_y_m", "max_x_m", "max_y_m")
_INNER = ("inner_min_x_m", "inner_min_y_m", "inner_max_x_m", "inner_max_y_m")
_BOX = (*_EDGES, *_NEAR, *_INNER)
#: In place of a parameter of the function: the rows of the versions that are wanted of it.
_VERSIONS = "versions"
#: From about so many versions in a box on, a page and the number of all items come from one look at the table.
MANY_VERSIONS = 20_000
#: From this part of all versions of the database on, reading the whole table takes less than going by the index of places.
MOST_VERSIONS = 0.3


@dataclass(frozen=True)
class Instants:
    """Which state of the map is asked for; None: the latest of all (of `start`, `known_start`: before anything)."""

    at: datetime | None = None
    known_at: datetime | None = None
    start: datetime | None = None
    end: datetime | None = None
    known_start: datetime | None = None
    known_end: datetime | None = None


#: Columns of features that are looked up in the deltas, and what a page takes them from.
EVIDENCE_COLUMNS = {
    "existence_probability": "coalesce(e.existence_after, p.existence_probability)",
    "seen_count": "coalesce(n.seen_count, 0)",
    "missed_count": "coalesce(n.missed_count, 0)",
}
FEATURE_COLUMNS = {
    "feature_id": ("uuid", "The cone, the same in all its versions"),
    "version": ("integer", "Counts the states that it had on the road"),
    "category": ("text", "What stands there"),
    "existence_probability": ("float8", "After the last drive that looked for it, until the instant asked for"),
    "easting_m": ("float8", "In the map's CRS"),
    "northing_m": ("float8", "In the map's CRS"),
    "height_m": ("float8", "Above the WGS 84 ellipsoid"),
    "sigma_east_m": ("float8", "Standard deviation"),
    "sigma_north_m": ("float8", "Standard deviation"),
    "sigma_height_m": ("float8", "Standard deviation"),
    "cov_xy_m2": ("float8", "Covariance of easting and northing"),
    "cone_height_m": ("float8", "From the foot to the tip"),
    "cone_height_sigma_m": ("float8", "Standard deviation"),
    "observation_count": ("integer", "Frame pairs that it was seen in"),
    "seen_count": ("integer", "Drives that saw it, until the instant asked for"),
    "missed_count": ("integer", "Drives that looked for it in vain, until the instant asked for"),
    "first_seen_at": ("timestamptz", "First frame pair"),
    "last_seen_at": ("timestamptz", "Last frame pair of this version"),
    "valid_from": ("timestamptz", "It stood so from this instant on"),
    "valid_to": ("timestamptz", "until this one (null: it still does)"),
}
CHANGE_COLUMNS = {
    "feature_id": ("uuid", "The cone"),
    "kind": ("text", "added, removed, moved or confirmed (the same place with newer values)"),
    "changed_at": ("timestamptz", "From when on it is so on the road (confirmed: the newest confirmation)"),
    "shift_m": ("float8", "How far it moved on the ground"),
    "category": ("text", "What stands there"),
    "easting_m": ("float8", "After the change (removed: before), in the map's CRS"),
    "northing_m": ("float8", "After the change (removed: before), in the map's CRS"),
    "height_m": ("float8", "Above the WGS 84 ellipsoid"),
    "old_easting_m": ("float8", "Before the change"),
    "old_northing_m": ("float8", "Before the change"),
    "old_height_m": ("float8", "Before the change"),
    "existence_probability": ("float8", "Of the version"),
    "observation_count": ("integer", "Frame pairs that it was seen in"),
    "cone_height_m": ("float8", "From the foot to the tip"),
    "version": ("integer", "After the change (removed: before)"),
}
FEATURE_PARAMETERS = {"map_name": "text", "from_at": "timestamptz", "to_at": "timestamptz", "known_at": "timestamptz"}
CHANGE_PARAMETERS = {
    "map_name": "text", "from_at": "timestamptz", "known_from": "timestamptz", "to_at": "timestamptz", "known_to": "timestamptz",
    "moved_from_m": "float8",
}  # fmt: skip


class AsOfCollection(PgCollection):
    """One function of one map with its arguments; boxes and times of a request become arguments of the function."""

    served: ServedMap
    instants: Instants
    format: str = "geojson"

    @property
    def extent(self) -> Extent:
        """Around all that the map's drives looked at, from the first one on."""
        return Extent(
            spatial=Spatial(bbox=[list(self.served.extent)]),
            temporal=Temporal(interval=[[_rfc3339(self.served.since), None]]),
        )

    def cql_where(  # type: ignore[override]  # the same parameters, handed on
        self, ids: list[str] | None = None, **asked: Any
    ) -> Expr | None:
        """tipg's condition; its own one for several ids would compare uuid with text."""
        kinds = {column.name: column.type for column in self.properties}
        for name, text in asked.get("properties") or ():
            check_value(name, kinds[name], text)
        where = super().cql_where(**asked)
        if not ids:
            return where
        each = [{"op": "=", "args": [{"property": "feature_id"}, text]} for text in ids]
        wanted = Expr({"op": "or", "args": each} if len(each) > 1 else each[0])
        return wanted if where is None else where + wanted

    def _sort_expressions(self, sortby: str | None) -> list[tuple[str, str]]:
        """tipg's order, and by id what is equal in it: or pages could hold an item twice and another one never."""
        order: list[tuple[str, str]] = super()._sort_expressions(sortby)
        return order if any(name == "feature_id" for name, _ in order) else [*order, ("feature_id", "feature_id")]

    def columns(self, properties: list[str] | None = None) -> list[str]:
        """Names of the properties that are wanted. Raises BadParameterError for one that there is not."""
        there: list[str] = super().columns()
        unknown = set(properties or ()) - {*there, ""}
        if unknown:
            raise BadParameterError(f"There is no property {min(unknown)!r}; there are: {', '.join(there)}.")
        return there if properties is None else [name for name in there if name in properties]

    async def page(
        self, conn: asyncpg.Connection, *, ids: list[str] | None, box: Degrees | None,
        interval: tuple[datetime | None, datetime | None] | None, values: list[tuple[str, str]] | None,
        sortby: str | None, properties: list[str] | None, limit: int, offset: int, links: tuple[str, str],
    ) -> Page:  # fmt: skip
        """One page of items as GeoJSON, made by PostgreSQL; `links` stands around the id at the end of each item."""
        _check_ids(ids)
        where = self.cql_where(ids=ids, properties=values)
        order = self._sort_expressions(sortby)
        wanted = {name: f"p.{name}" for name in self.columns(properties)}
        text = {"where": self._where_clause(where), "order": ", ".join(sql for _, sql in order)}
        arguments = self._arguments(box, interval)
        looks_evidence_up = True
        if self.table == "features":
            looks_evidence_up = _needs_evidence(order, values)
            text["source"] = f"{SCHEMA}.{'features' if looks_evidence_up else 'standing'}"
            wanted = {name: EVIDENCE_COLUMNS.get(name, column) for name, column in wanted.items()}
        text["properties"] = ", ".join(f"{column} as {name}" for name, column in wanted.items())
        if not looks_evidence_up and (by_place := self._by_place_of_many(box)) is not None:
            text["by_place"] = by_place
            return await self._page_of_many(conn, text, arguments, limit, offset, links)
        text["box"] = _named(arguments, 5)
        items, returned = await read_page(conn, self.table, text, [limit, offset, *links, *arguments.values()])
        if returned < limit and (returned or not offset):  # the last page says how many there are
            return Page(items, returned, offset + returned)
        if self.table == "features":
            return Page(items, returned, await self._count(conn, text, arguments))
        matched = await self._features_count_query(conn, where=where, function_parameters=_texts(arguments))
        return Page(items, returned, matched)

    def _by_place_of_many(self, box: Degrees | None) -> str | None:
        """Where a box holds a large part of a large map: whether to go by the index of places, in SQL. None where it does not."""
        part = part_of_map(box, self.served)
        if part * self.served.version_count < MANY_VERSIONS:
            return None
        return "false" if part * self.served.share >= MOST_VERSIONS else "true"

    async def _page_of_many(
        self, conn: asyncpg.Connection, text: Mapping[str, str], arguments: Mapping[str, str | float],
        limit: int, offset: int, links: tuple[str, str],
    ) -> Page:  # fmt: skip
        """A page of features out of a large part of a large map: first which versions are on it, then their items."""
        found_text = {**text, "box": _named(arguments, 3)}
        versions, matched = await find_versions(conn, found_text, [limit, offset, *arguments.values()])
        if matched is None:
            return Page(b"", 0, await self._count(conn, text, arguments) if offset else 0)
        own = [value for name, value in arguments.items() if name not in _BOX]
        page_text = {**text, "box": "", "where": f"where version_row_id = any(${5 + len(own)}::bigint[])"}
        items, returned = await read_page(conn, self.table, page_text, [limit, 0, *links, *own, versions])
        return Page(items, returned, matched)

    async def _count(
        self, conn: asyncpg.Connection, text: Mapping[str, str], arguments: Mapping[str, str | float]
    ) -> int:
        return await count_features(conn, {**text, "box": _named(arguments, 1)}, [*arguments.values()])

    async def features(self, conn: asyncpg.Connection, **asked: Any) -> ItemList:
        """One page of items, for the other forms."""
        box = asked.pop("bbox_filter", None)
        arguments = self._arguments(box, asked.pop("datetime_filter", None))
        asked["function_parameters"] = _texts(arguments)
        ids = asked.get("ids_filter")
        _check_ids(ids)
        by_place = self._by_place_of_many(box) if self.table == "features" and not ids else None
        order, values = self._sort_expressions(asked.get("sortby")), asked.get("properties_filter")
        if by_place is None or _needs_evidence(order, values):
            found = await super().features(conn, **asked)
        else:
            found = await self._features_of_many(conn, by_place, arguments, asked)
        if not found["items"] and self.format == "csv":
            raise EmptyTableError(["collectionId", "itemId", *self.columns(asked.get("properties")), "geometry"])
        return found

    async def _features_of_many(
        self, conn: asyncpg.Connection, by_place: str, arguments: Mapping[str, str | float], asked: Mapping[str, Any]
    ) -> ItemList:
        """tipg's page out of a large part of a large map: it would look every feature up to count it, and keep all in order."""
        limit, offset = asked["limit"], asked.get("offset") or 0
        text = {
            "where": self._where_clause(self.cql_where(properties=asked.get("properties_filter"))), "by_place": by_place,
            "order": ", ".join(sql for _, sql in self._sort_expressions(asked.get("sortby"))), "box": _named(arguments, 3),
        }  # fmt: skip
        versions, matched = await find_versions(conn, text, [limit, offset, *arguments.values()])
        if matched is None:
            source = {**text, "source": f"{SCHEMA}.standing"}
            return ItemList(
                items=[], matched=await self._count(conn, source, arguments) if offset else 0, next=None,
                prev=max(offset - limit, 0) if offset else None,
            )  # fmt: skip
        of_query = ("sortby", "properties", "geom", "bbox_only", "simplify", "geom_as_wkt")
        wanted: dict[str, Any] = {name: asked[name] for name in of_query if name in asked}
        wanted |= {"limit": limit, "function_parameters": {**arguments, _VERSIONS: versions}}
        items = [item async for item in self._features_query(conn, **wanted)]
        following = offset + len(items)
        return ItemList(
            items=items,
            matched=matched,
            next=following if matched > following else None,
            prev=max(offset - limit, 0) if offset else None,
        )

    def _from(self, function_parameters: dict[str, Any] | None, params: list[Any]) -> str:
        """tipg's call of the function, or a query for the versions that were found already."""
        if function_parameters is None or _VERSIONS not in function_parameters:
            called: str = super()._from(function_parameters, params)
            return called
        params.extend(function_parameters[name] for name in (*FEATURE_PARAMETERS, _VERSIONS))
        return f"FROM ({rows_of_versions()}) page"

    async def get_tile(self, conn: asyncpg.Connection, *, tms: TileMatrixSet, tile: Tile, **asked: Any) -> bytes:
        """One vector tile."""
        if not 0 <= tile.z <= MAX_ZOOM or not (0 <= tile.x < 2**tile.z and 0 <= tile.y < 2**tile.z):
            raise NotFound(f"There is no tile {tile.z}/{tile.x}/{tile.y}: the zoom levels are 0 to {MAX_ZOOM}.")
        _check_ids(asked.get("ids_filter"))
        box = asked.pop("bbox_filter", None)
        edges = tms.bounds(tile)
        around = (edges.left, edges.bottom, edges.right, edges.top)
        arguments = self._arguments(box, asked.pop("datetime_filter", None))
        near = rows_near(around, self.served)
        if box is None and near != ALL_ROWS:
            arguments |= dict(zip((*_EDGES, *_NEAR), (*EVERYWHERE, *near), strict=True))
        asked["function_parameters"] = _texts(arguments)
        tile_bytes: bytes = await super().get_tile(conn, tms=tms, tile=tile, **asked)
        return tile_bytes

    def _arguments(
        self, box: Degrees | None, interval: tuple[datetime | None, datetime | None] | None
    ) -> dict[str, str | float]:
        """What the function is called with, in the order of its parameters: names and instants as text.

        Without a box where all of the map is asked for: that is a statement of its own, with a plan of its own.
        """
        near = ALL_ROWS if box is None else rows_near(box, self.served)
        asked = {"map_name": self.served.map_name} | self._times(interval)
        if box is None or near == ALL_ROWS:
            return asked
        edges = dict(zip((*_EDGES, *_NEAR), (*box, *near), strict=True))
        inner = dict(zip(_INNER, rows_within(box, self.served), strict=True)) if self.table == "features" else {}
        return asked | edges | inner

    def _times(self, interval: tuple[datetime | None, datetime | None] | None) -> dict[str, str | float]:
        asked = self.instants
        if self.table == "features":
            start, end = interval or (asked.at or "infinity", asked.at or "infinity")
            return {
                "from_at": "-infinity" if start is None else _text(start),
                "to_at": "infinity" if end is None else _text(end),
                "known_at": _text(asked.known_at or "infinity"),
            }
        if interval is not None:  # what changed at its edges lies within it
            asked = replace(asked, start=None if interval[0] is None else interval[0] - _TICK, end=interval[1])
        return {
            "from_at": _text(asked.start or "-infinity"),
            "known_from": _text(asked.known_start or asked.known_end or "infinity"),
            "to_at": _text(asked.end or "infinity"),
            "known_to": _text(asked.known_end or "infinity"),
            "moved_from_m": ReconcileParams().min_gate_m,
        }


class EmptyTableError(Exception):
    """A table in CSV without a row; carries the names of its columns. (tipg takes them from the first row.)"""

    def __init__(self, names: list[str]) -> None:
        super().__init__("no rows")
        self.names = names


def features_of(served: ServedMap, instants: Instants, output: str = "geojson") -> AsOfCollection:
    """The map as of an instant on the road, as the database knew it at another."""
    return _collection(
        "features", served, instants, output, FEATURE_COLUMNS, FEATURE_PARAMETERS,
        f"Cones of the map {served.map_name}",
        "Traffic cones as they stood at the instant `at` on the road, as the database knew it at `known_at`; "
        "without them, the latest.",
    )  # fmt: skip


def changes_of(served: ServedMap, instants: Instants, output: str = "geojson") -> AsOfCollection:
    """How the map differs between two instants."""
    return _collection(
        "changes", served, instants, output, CHANGE_COLUMNS, CHANGE_PARAMETERS,
        f"Changes of the map {served.map_name}",
        "Traffic cones that were added, moved, removed or confirmed between the instants `from` and `to` on the road; "
        "without `from`, "
        "all that stand are added.",
    )  # fmt: skip


def _collection(
    name: str, served: ServedMap, instants: Instants, output: str, columns: Mapping[str, tuple[str, str]],
    parameters: Mapping[str, str], title: str, description: str,
) -> AsOfCollection:  # fmt: skip
    place = Column(name="geom", type="geometry", geometry_type="Point", srid=4326, bounds=list(served.extent))
    listed = [Column(name=name, type=kind, description=text) for name, (kind, text) in columns.items()]
    types = dict(parameters) | dict.fromkeys(_BOX, "float8")  # tipg leaves out what a request does not name
    return AsOfCollection(
        type="Function", id=f"{served.map_name}.{name}", table=name, schema=SCHEMA, title=title, description=description,
        table_columns=[*listed, place], properties=[*listed, place], id_column=listed[0], geometry_column=place,
        parameters=[Parameter(name=key, type=kind, default="") for key, kind in types.items()],
        served=served, instants=instants, format=output,
    )  # fmt: skip


async def warm(conn: asyncpg.Connection) -> None:
    """Ask for a page of nothing, so that the first page of a session takes no longer than the next ones."""
    await warm_session(conn)
    nowhere = ServedMap(
        "", 0, 0, datetime.min.replace(tzinfo=UTC), (0.0, 0.0, 0.0, 0.0), datetime.min.replace(tzinfo=UTC)
    )
    elsewhere = (90.0, 45.0, 90.0, 45.0)
    await features_of(nowhere, Instants()).page(
        conn,
        ids=None,
        box=elsewhere,
        interval=None,
        values=None,
        sortby=None,
        properties=None,
        limit=1,
        offset=0,
        links=("", ""),
    )


def _needs_evidence(order: Sequence[tuple[str, str]], values: Sequence[tuple[str, str]] | None) -> bool:
    """Whether an order or a filter asks for what drives saw or looked for in vain."""
    return not ({name for name, _ in order} | {name for name, _ in values or ()}).isdisjoint(EVIDENCE_COLUMNS)


def _named(arguments: Mapping[str, Any], first: int) -> str:
    """The box of a call in SQL: its named arguments, each after a comma; `first` numbers the first of all arguments."""
    return "".join(f", {name} => ${k}" for k, name in enumerate(arguments, first) if name in _BOX)


def _check_ids(ids: list[str] | None) -> None:
    for text in ids or ():
        try:
            UUID(text)
        except ValueError as error:
            raise NotFound(f"There is no item {text!r}: ids of cones are UUIDs.") from error


def _text(time: datetime | str) -> str:
    return time if isinstance(time, str) else time.isoformat()


def _texts(values: Mapping[str, str | float]) -> dict[str, str]:
    return {name: value if isinstance(value, str) else repr(float(value)) for name, value in values.items()}


def _rfc3339(time: datetime) -> str:
    return time.astimezone(UTC).isoformat().replace("+00:00", "Z")
