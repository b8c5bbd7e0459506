"""What a request to the OGC API may say. Takes the place of tipg's own dependencies where those answer 500 or too much."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime
from typing import Annotated, Literal

from fastapi import Depends, Path, Query, Request
from starlette.datastructures import QueryParams
from tipg.collections import CollectionList
from tipg.errors import NotFound
from tipg.resources.enums import MediaType

from conetl.db.async_reader_pool import AsyncReaderPool
from conetl.db.ogc_store import Degrees, MapDirectory, ServedMap
from conetl.web.ogc.collections import AsOfCollection, Instants, changes_of, features_of
from conetl.web.ogc.values import BadParameterError, read_instant
from conetl.web.parameters import Instant

#: Instants go on into links, so that a link leads to the same state of the map.
CARRIED = ("at", "known_at", "from", "to", "known_from", "known_to")
#: What would let a page of thousands of items be one of ten: more than this is no error, but is not sent either.
MAX_LIMIT = 10_000
#: No map has more items than this.
MAX_OFFSET = 2**31
Interval = tuple[datetime | None, datetime | None]


# All are coroutines: FastAPI runs plain functions in a thread each.
async def read_instants(
    at: Instant = None,
    known_at: Instant = None,
    start: Annotated[Instant, Query(alias="from")] = None,
    end: Annotated[Instant, Query(alias="to")] = None,
    known_from: Instant = None,
    known_to: Instant = None,
) -> Instants:
    """Instants that every operation accepts: `at` and `known_at` for features, the others for changes."""
    if start is not None and end is not None and start > end:
        raise BadParameterError(
            f"from={start.isoformat()} is later than to={end.isoformat()}: "
            "changes are asked for from the earlier instant to the later."
        )
    return Instants(at, known_at, start, end, known_from, known_to)


AskedInstants = Annotated[Instants, Depends(read_instants)]


async def refuse_unknown(request: Request) -> None:
    """Raise BadParameterError for a parameter that the API definition does not name (requirement query-param-unknown)."""
    path = request.scope["route"].path
    defined = request.app.openapi()["paths"].get(path, {}).get("get", {}).get("parameters", ())
    known = {parameter["name"] for parameter in defined if parameter["in"] == "query"}
    for name, value in request.query_params.multi_items():
        if name not in known:
            raise BadParameterError(f"There is no parameter {name!r} here; there are: {', '.join(sorted(known))}.")
        if not value.isprintable():
            raise BadParameterError(f"The parameter {name} holds characters that are no text: {value!r}.")
        if name == "limit" and value.strip("+0") == "":
            raise BadParameterError("limit should be 1 or more.")
        if name == "offset" and value.isdecimal() and int(value[:20]) > MAX_OFFSET:
            raise BadParameterError(f"offset={value} should be a whole number from 0 to {MAX_OFFSET}.")


async def one_collection(
    request: Request,
    collectionId: Annotated[
        str, Path(description="Name of a map and of what is asked of it: MAP.features or MAP.changes")
    ],
    instants: AskedInstants,
) -> AsOfCollection:
    """The collection that a path names; raises NotFound where there is none."""
    map_name, _, kind = collectionId.rpartition(".")
    make = _KINDS.get(kind)
    found = await _maps(request, map_name) if make and map_name.isprintable() else []
    if make is None or not found:
        raise NotFound(f"There is no collection {collectionId}: /collections lists those that there are.")
    served = found[0]
    _pin_links(request, kind, served)
    return make(served, _pinned(instants, served), request.query_params.get("f", "geojson"))


async def all_collections(
    request: Request,
    instants: AskedInstants,
    bbox: Annotated[str | None, Query(description="Collections that reach into west,south,east,north.")] = None,
    datetime_: Annotated[
        str | None, Query(alias="datetime", description="Collections of maps begun before its end.")
    ] = None,
    limit: Annotated[int | None, Query(ge=1, description="At most so many collections.")] = None,
    offset: Annotated[int, Query(ge=0, le=MAX_OFFSET, description="From this one on.")] = 0,
) -> CollectionList:
    """Two collections a map; the map that the server was started for comes first."""
    box, interval = _box(bbox), _parsed(datetime_)
    found = [
        m
        for m in await _maps(request)
        if _meets(m, box) and (interval is None or interval[1] is None or interval[1] >= m.since)
    ]
    found.sort(key=lambda m: (m.map_name != request.app.state.map_name, m.map_name))
    listed = [make(m, instants, "geojson") for m in found for make in _KINDS.values()]
    page = listed[offset : offset + (limit or MAX_LIMIT)]
    end = offset + len(page)
    return CollectionList(
        collections=[*page],
        matched=len(listed),
        next=end if page and end < len(listed) else None,
        prev=max(offset - (limit or MAX_LIMIT), 0) if offset else None,
    )


async def read_box(
    bbox: Annotated[
        str | None,
        Query(
            description="west,south,east,north in degrees, edges included; "
            "six numbers with lowest and highest height, which do not count."
        ),
    ] = None,
) -> Degrees | None:
    """The box of a request; west > east goes across 180 degrees. Raises BadParameterError."""
    return _box(bbox)


async def read_interval(
    instants: AskedInstants,
    datetime: Annotated[
        str | None,
        Query(
            description="RFC 3339: an instant (the map as of it), "
            "or an interval a/b, a/.. or ../b (what stood or changed within it)."
        ),
    ] = None,
) -> Interval | None:
    """The temporal filter of a request as its ends; None of an end: open. Raises BadParameterError."""
    interval = _parsed(datetime)
    if interval is not None and (instants.at or instants.start or instants.end):
        raise BadParameterError("datetime says the same as at, from and to: give one or the other.")
    return interval


def _box(bbox: str | None) -> Degrees | None:
    if bbox is None:
        return None
    try:
        numbers = [float(text) for text in bbox.split(",")]
    except ValueError as error:
        raise BadParameterError(f"bbox={bbox!r} should be four numbers with commas: west,south,east,north.") from error
    if len(numbers) not in (4, 6) or not all(math.isfinite(number) for number in numbers):
        raise BadParameterError(f"bbox={bbox!r} should be four finite numbers: west,south,east,north.")
    west, south, east, north = numbers if len(numbers) == 4 else (numbers[0], numbers[1], numbers[3], numbers[4])
    if max(abs(west), abs(east)) > 180 or max(abs(south), abs(north)) > 90 or south > north:
        raise BadParameterError(f"bbox={bbox!r} lies outside -180,-90,180,90, or its south lies north of its north.")
    return west, south, east, north


def _parsed(datetime: str | None) -> Interval | None:
    if datetime is None:
        return None
    parts = datetime.split("/")
    if len(parts) > 2 or (len(parts) == 1 and parts[0] in ("", "..")) or set(parts) <= {"", ".."}:
        raise BadParameterError(f"datetime={datetime!r} should be an instant, or an interval a/b, a/.. or ../b.")
    ends = [None if part in ("", "..") else read_instant(part) for part in parts]
    start, end = ends[0], ends[-1]
    if start is not None and end is not None and start > end:
        raise BadParameterError(f"datetime={datetime!r} begins after its end.")
    return start, end


async def read_output(
    f: Annotated[Literal["geojson", "json", "csv", "geojsonseq", "ndjson"], Query()] = "geojson",
) -> MediaType:
    """Form of items."""
    return MediaType[f]


async def read_json_only(f: Annotated[Literal["json", "schemajson"] | None, Query()] = None) -> None:
    """JSON is the only form."""


async def read_ids(
    ids: Annotated[str | None, Query(description="Only these items, with commas.")] = None,
) -> list[str] | None:
    """Items by their ids."""
    return ids.split(",") if ids else None


async def read_properties(
    properties: Annotated[
        str | None, Query(description="Only these properties, with commas; empty: none. Without it: all.")
    ] = None,
) -> list[str] | None:
    """Properties that are wanted."""
    return None if properties is None else [name.strip() for name in properties.split(",")]


async def read_order(
    sortby: Annotated[
        str | None, Query(description="Properties with commas, each with - before it where the largest comes first.")
    ] = None,
) -> str | None:
    """Order of the items; by id where none is given."""
    return sortby


async def refuse_filter() -> None:
    """Expressions may call any function of the database: they are not offered."""


_KINDS = {"features": features_of, "changes": changes_of}


def _pinned(instants: Instants, served: ServedMap) -> Instants:
    """The same, with the newest changeset or decision as the latest: all queries of a request see one state, and so do its next
    pages."""
    latest = served.last_committed_at
    return replace(instants, known_at=instants.known_at or latest, known_end=instants.known_end or latest)


def _pin_links(request: Request, kind: str, served: ServedMap) -> None:
    """Links to this page and the next ones name the state of the database that this one shows."""
    name = "known_at" if kind == "features" else "known_to"
    if request.scope["route"].name == "items" and name not in request.query_params:  # a layer of tiles stays live
        latest = served.last_committed_at.isoformat().replace("+00:00", "Z")
        pinned = [*request.query_params.multi_items(), (name, latest)]
        request._query_params = QueryParams(pinned)  # where Request keeps them once read; tipg makes links of them


def _meets(served: ServedMap, box: Degrees | None) -> bool:
    if box is None:
        return True
    west, south, east, north = served.extent
    pieces = [(box[0], box[2])] if box[0] <= box[2] else [(box[0], 180.0), (-180.0, box[2])]
    return south <= box[3] and north >= box[1] and any(west <= right and east >= left for left, right in pieces)


async def _maps(request: Request, map_name: str | None = None) -> list[ServedMap]:
    pool: AsyncReaderPool = request.app.state.pool
    directory: MapDirectory = request.app.state.maps
    async with pool.acquire() as conn:
        return await directory.maps(conn, map_name)
