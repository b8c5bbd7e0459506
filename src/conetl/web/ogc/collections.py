"""The collections of each map as tipg collections: points and lane markings as of an instant, changes of points between two."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any, get_args
from uuid import UUID

import asyncpg
import orjson
from cql2 import Expr
from morecantile import Tile, TileMatrixSet
from tipg.collections import Column, Parameter, PgCollection
from tipg.errors import NotFound
from tipg.model import Extent, Spatial, Temporal

from conetl.db import ogc_store as store
from conetl.db.connection import load_sql
from conetl.db.ogc_store import Degrees, ServedMap
from conetl.exports.fields import FIELDS
from conetl.model.markings import MarkingColour, MarkingPattern
from conetl.model.params import ReconcileParams
from conetl.web.parameters import BadParameterError, Interval, check_value

SCHEMA = "conetl_ogc"
MAX_ZOOM = 24
#: PostgreSQL's timestamps count microseconds.
_TICK = timedelta(microseconds=1)
_EDGES = ("west", "south", "east", "north")
_NEAR = ("min_x_m", "min_y_m", "max_x_m", "max_y_m")
_INNER = ("inner_min_x_m", "inner_min_y_m", "inner_max_x_m", "inner_max_y_m")
_BOX = (*_EDGES, *_NEAR, *_INNER)
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


#: Columns of features that are computed from the deltas, with their SQL.
EVIDENCE_COLUMNS = {
    "existence_probability": "coalesce(e.existence_after, p.existence_probability)",
    "seen_count": "coalesce(n.seen_count, 0)",
    "missed_count": "coalesce(n.missed_count, 0)",
}
#: Properties of the collections; `exports/fields.py` has their meanings and units.
FEATURE_COLUMNS = (
    "feature_id", "version", "category", "existence_probability", "easting_m", "northing_m", "ellipsoidal_height_m", "sigma_e_m",
    "sigma_n_m", "sigma_u_m", "cov_en_m2", "object_height_m", "height_sigma_m", "observation_count", "seen_count", "missed_count",
    "first_seen_at", "last_seen_at", "valid_from", "valid_to",
)  # fmt: skip
CHANGE_COLUMNS = (
    "feature_id", "change", "changed_at", "shift_m", "category", "easting_m", "northing_m", "ellipsoidal_height_m",
    "old_easting_m", "old_northing_m", "old_ellipsoidal_height_m", "existence_probability", "observation_count",
    "object_height_m", "version",
)  # fmt: skip
MARKING_COLUMNS = (
    "feature_id", "version", "category", "existence_probability", "width_m", "width_sigma_m", "colour", "pattern", "dash_m",
    "gap_m", "length_m", "sigma_lateral_m", "observation_count", "seen_count", "missed_count", "first_seen_at", "last_seen_at",
    "valid_from", "valid_to",
)  # fmt: skip
#: Types of PostgreSQL, of ids and counts by name, of words and times by unit; all others are numbers.
_TYPES = {"feature_id": "uuid", "version": "integer"} | dict.fromkeys(
    ("observation_count", "seen_count", "missed_count"), "integer"
)
_TYPES_BY_UNIT = {"": "text", "UTC": "timestamptz"}
_SCHEMAS: dict[str, dict[str, Any]] = {
    "text": {"type": "string"}, "integer": {"type": "integer"}, "float8": {"type": "number"},
    "uuid": {"type": "string", "format": "uuid"}, "timestamptz": {"type": "string", "format": "date-time"},
}  # fmt: skip
#: Properties with few values. Classes of objects are not among them: imported maps have classes of their own.
_WORDS = {
    "change": ("added", "moved", "removed", "confirmed"),
    "colour": get_args(MarkingColour),
    "pattern": get_args(MarkingPattern),
}
_FEATURE_PARAMETERS = {"map_name": "text", "from_at": "timestamptz", "to_at": "timestamptz", "known_at": "timestamptz"}
_CHANGE_PARAMETERS = {
    "map_name": "text", "from_at": "timestamptz", "known_from": "timestamptz", "to_at": "timestamptz", "known_to": "timestamptz",
    "moved_from_m": "float8",
}  # fmt: skip


#: Name of a collection of each map -> title, description, properties, parameters of its SQL function, type of geometry.
COLLECTIONS = {
    "features": (
        "Cones",
        "Traffic cones at the instant `at` on the road, in the state of the database at `known_at`; by default the latest.",
        FEATURE_COLUMNS, _FEATURE_PARAMETERS, "Point",
    ),
    "lane_markings": (
        "Lane markings",
        "Stretches of lane markings at the instant `at` on the road, in the state of the database at `known_at`; by default the "
        "latest.",
        MARKING_COLUMNS, _FEATURE_PARAMETERS, "LineString",
    ),
    "changes": (
        "Changes",
        "Traffic cones that were added, moved, removed or confirmed between the instants `from` and `to` on the road; "
        "without `from`, all cones that exist at `to` count as added. Positions and versions are those after the change; "
        "those of removed cones are from before it.",
        CHANGE_COLUMNS, _CHANGE_PARAMETERS, "Point",
    ),
}  # fmt: skip


class AsOfCollection(PgCollection):
    """One SQL function with its arguments for one map; boxes and times of a request become arguments of the function."""

    served: ServedMap
    instants: Instants

    @property
    def extent(self) -> Extent:
        """The area that the map's drives covered, and the time from the first drive on."""
        since = self.served.since.astimezone(UTC).isoformat().replace("+00:00", "Z")
        return Extent(spatial=Spatial(bbox=[list(self.served.extent)]), temporal=Temporal(interval=[[since, None]]))

    def cql_where(  # type: ignore[override]  # tipg's other parameters are passed on
        self, ids: list[str] | None = None, **others: Any
    ) -> Expr | None:
        """tipg's condition; for several ids tipg itself would compare uuid with text. Raises NotFound, BadParameterError."""
        kinds = {column.name: column.type for column in self.properties}
        for name, text in others.get("properties") or ():
            check_value(name, kinds[name], text)
            if text not in (words := _WORDS.get(name, (text,))):
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
        columns = {name: f"p.{name}" for name in self.columns(properties)}
        arguments = self._arguments(box, interval)
        source, evidence, by_place = self.table, "", None
        if self.table != "changes":
            columns = {name: EVIDENCE_COLUMNS.get(name, column) for name, column in columns.items()}
            evidence = load_sql("columns.evidence")
        used = {name for name, _ in [*order, *(values or ())]}
        if self.table == "features" and used.isdisjoint(EVIDENCE_COLUMNS):
            source = "standing"  # evidence is read after the limit
            by_place = None if ids else self._by_place_of_many(box)
        text = {
            "where": self._where_clause(where), "order": ", ".join(sql for _, sql in order), "evidence": evidence,
            "properties": ", ".join(f"{column} as {name}" for name, column in columns.items()),
        }  # fmt: skip
        if by_place is not None:
            return await self._page_of_many(conn, text, by_place, arguments, limit, offset, links)
        page_text = {**text, "call": _call(source, arguments, 5)}
        items, returned = await _items(conn, page_text, limit, offset, *links, *arguments.values())
        if returned < limit and (returned or not offset):  # the last page gives the number of all
            return Page(items, returned, offset + returned)
        return Page(items, returned, await _count(conn, text, source, arguments))

    def _by_place_of_many(self, box: Degrees | None) -> str | None:
        """For a large part of a large map: whether to use the spatial index, in SQL. None for smaller parts."""
        part = store.part_of_map(box, self.served)
        if part * self.served.version_count < MANY_VERSIONS:
            return None
        return "false" if part * self.served.share >= MOST_VERSIONS else "true"

    async def _page_of_many(
        self, conn: asyncpg.Connection, text: Mapping[str, str], by_place: str, arguments: Mapping[str, str | float],
        limit: int, offset: int, links: tuple[str, str],
    ) -> Page:  # fmt: skip
        """A page of a large part of a large map: first the versions that are on it, then their items."""
        found_text = {**text, "call": _call("standing", arguments, 3, by_place)}
        found = await store.fetch(conn, "features_found", found_text, limit, offset, *arguments.values())
        if not found:
            return Page(b"", 0, await _count(conn, text, "standing", arguments) if offset else 0)
        versions = [row["version_row_id"] for row in found]
        own = {name: value for name, value in arguments.items() if name not in _BOX}
        where = f"where version_row_id = any(${5 + len(own)}::bigint[])"
        page_text = {**text, "call": _call("standing", own, 5), "where": where}
        items, returned = await _items(conn, page_text, limit, 0, *links, *own.values(), versions)
        return Page(items, returned, found[0]["matched"])

    async def get_tile(self, conn: asyncpg.Connection, *, tms: TileMatrixSet, tile: Tile, **asked: Any) -> bytes:
        """One vector tile."""
        if not 0 <= tile.z <= MAX_ZOOM or not (0 <= tile.x < 2**tile.z and 0 <= tile.y < 2**tile.z):
            raise NotFound(f"There is no tile {tile.z}/{tile.x}/{tile.y}: the zoom levels are 0 to {MAX_ZOOM}.")
        box = asked.pop("bbox_filter", None)
        edges = tms.bounds(tile)
        arguments = self._arguments(box, asked.pop("datetime_filter", None))
        near = store.rows_near((edges.left, edges.bottom, edges.right, edges.top), self.served)
        if box is None and near != store.ALL_ROWS:
            arguments |= dict(zip((*_EDGES, *_NEAR), (*store.EVERYWHERE, *near), strict=True))
        asked["function_parameters"] = {
            name: value if isinstance(value, str) else repr(float(value)) for name, value in arguments.items()
        }
        tile_bytes: bytes = await super().get_tile(conn, tms=tms, tile=tile, **asked)
        return tile_bytes

    def _arguments(self, box: Degrees | None, interval: Interval | None) -> dict[str, str | float]:
        """Arguments of the function in the order of its parameters; names and instants as text.

        Without a box if the whole map is requested: that is a separate statement with its own plan.
        """
        near = store.ALL_ROWS if box is None else store.rows_near(box, self.served)
        arguments = {"map_name": self.served.map_name} | self._times(interval)
        if box is None or near == store.ALL_ROWS:
            return arguments
        edges = dict(zip((*_EDGES, *_NEAR), (*box, *near), strict=True))
        inner = dict(zip(_INNER, store.rows_within(box, self.served), strict=True)) if self.table == "features" else {}
        return arguments | edges | inner

    def _times(self, interval: Interval | None) -> dict[str, str | float]:
        asked = self.instants
        if self.table != "changes":
            start, end = interval or (asked.at or "infinity", asked.at)
            known_at = _text(asked.known_at or "infinity")
            return {"from_at": _text(start or "-infinity"), "to_at": _text(end or "infinity"), "known_at": known_at}
        if interval is not None:  # changes at its two ends are within it
            asked = replace(asked, start=None if interval[0] is None else interval[0] - _TICK, end=interval[1])
        return {
            "from_at": _text(asked.start or "-infinity"),
            "known_from": _text(asked.known_start or asked.known_end or "infinity"),
            "to_at": _text(asked.end or "infinity"),
            "known_to": _text(asked.known_end or "infinity"),
            "moved_from_m": ReconcileParams().min_gate_m,
        }


def collection_of(name: str, served: ServedMap, instants: Instants) -> AsOfCollection:
    """A collection of a map; name: of `COLLECTIONS`."""
    title, description, columns, parameters, geometry = COLLECTIONS[name]
    place = Column(name="geom", type="geometry", geometry_type=geometry, srid=4326, bounds=list(served.extent))
    listed = [_column(column) for column in columns]
    types = dict(parameters) | dict.fromkeys(_BOX, "float8")  # tipg leaves out those without a value
    return AsOfCollection(
        type="Function", id=f"{served.map_name}.{name}", table=name, schema=SCHEMA, title=f"{title} of the map {served.map_name}",
        description=description, table_columns=[*listed, place], properties=[*listed, place], id_column=listed[0],
        geometry_column=place, parameters=[Parameter(name=key, type=kind, default="") for key, kind in types.items()],
        served=served, instants=instants,
    )  # fmt: skip


def _column(name: str) -> Column:
    return Column(name=name, type=_type(name), description=FIELDS[name].meaning)


def _type(name: str) -> str:
    return _TYPES.get(name) or _TYPES_BY_UNIT.get(FIELDS[name].unit, "float8")


#: JSON Schema of the values of each property by which items are filtered.
FILTERS = {
    name: _SCHEMAS[_type(name)] | ({"enum": list(_WORDS[name])} if name in _WORDS else {})
    for name in (*CHANGE_COLUMNS, *MARKING_COLUMNS, *FEATURE_COLUMNS)
}


def as_ewkt(geometry: dict[str, Any]) -> str:
    """A GeoJSON point or line as PostGIS' extended well-known text."""
    kind, places = geometry["type"].upper(), geometry["coordinates"]
    vertices = ",".join(" ".join(map(repr, place)) for place in ([places] if kind == "POINT" else places))
    return f"SRID=4326;{kind}({vertices})"


async def _items(conn: asyncpg.Connection, text: Mapping[str, str], *arguments: object) -> tuple[bytes, int]:
    """Items of one page as comma-separated JSON, and their number."""
    [row] = await store.fetch(conn, "page", text, *arguments)
    return (row["items"] or "").encode(), row["returned"]


async def _count(
    conn: asyncpg.Connection, text: Mapping[str, str], source: str, arguments: Mapping[str, str | float]
) -> int:
    [row] = await store.fetch(conn, "count", {**text, "call": _call(source, arguments, 1)}, *arguments.values())
    return int(row[0])


def _call(function: str, arguments: Iterable[str], first: int, by_place: str | None = None) -> str:
    """A call of a function with named arguments; `first` is the number of the first one. Instants are sent as text."""
    types = _FEATURE_PARAMETERS | _CHANGE_PARAMETERS
    casts = {name: "::text::timestamptz" for name, kind in types.items() if kind == "timestamptz"}
    given = [f"{name} => ${k}{casts.get(name, '')}" for k, name in enumerate(arguments, first)]
    given += [] if by_place is None else [f"by_place => {by_place}"]
    return f"{SCHEMA}.{function}({', '.join(given)})"


def _checked_id(text: str) -> str:
    try:
        UUID(text)
    except ValueError as error:
        raise NotFound(f"There is no item {text!r}: ids of cones are UUIDs.") from error
    return text


def _text(time: datetime | str) -> str:
    return time if isinstance(time, str) else time.isoformat()
