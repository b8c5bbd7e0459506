"""Dependencies of the OGC API: instants, collections and filters of a request. Invalid values are answered with 400 or 404."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from fastapi import Depends, Path, Query, Request
from tipg.collections import CollectionList
from tipg.errors import NotFound

from conetl.db.ogc_store import Degrees, MapDirectory, ServedMap, parts_of_box
from conetl.db.reader_pool import AsyncReaderPool
from conetl.web.ogc.collections import COLLECTIONS, MAX_ZOOM, AsOfCollection, Instants, collection_of
from conetl.web.parameters import BadParameterError, Instant, Interval, parse_box, parse_interval

#: Items or collections of one page; a larger limit is not an error, but returns no more.
MAX_LIMIT = 10_000
#: No map has more items.
MAX_OFFSET = 2**31
_MOST = {"offset": MAX_OFFSET, "minzoom": MAX_ZOOM, "maxzoom": MAX_ZOOM}
ItemForm = Annotated[Literal["geojson", "json", "csv", "geojsonseq", "ndjson"], Query(description="Format.")]


# All dependencies are coroutines: FastAPI runs each plain function in a thread.
async def read_instants(
    at: Instant = None,
    known_at: Instant = None,
    start: Annotated[Instant, Query(alias="from")] = None,
    end: Annotated[Instant, Query(alias="to")] = None,
    known_from: Instant = None,
    known_to: Instant = None,
) -> Instants:
    """Instants that every operation accepts: `at` and `known_at` for features and lane markings, the others for changes."""
    if start is not None and end is not None and start > end:
        raise BadParameterError(f"from={start.isoformat()} is later than to={end.isoformat()}.")
    return Instants(at, known_at, start, end, known_from, known_to)


RequestInstants = Annotated[Instants, Depends(read_instants)]


async def prepare(request: Request) -> None:
    """Raise BadParameterError for a parameter that the API definition does not list, or that is a property of other collections
    only (requirement query-param-unknown), or that is repeated (query-param-invalid)."""
    request.scope["app_root_path"] = request.scope.get("root_path", "")  # links start where the application is mounted
    path = request.scope["route"].path
    defined = request.app.openapi()["paths"].get(path, {}).get("get", {}).get("parameters", ())
    known = {parameter["name"] for parameter in defined if parameter["in"] == "query"}
    if own := COLLECTIONS.get(request.path_params.get("collectionId", "").rpartition(".")[2]):
        known -= {name for each in COLLECTIONS.values() for name in each[2]} - set(own[2])
    for name, value in request.query_params.multi_items():
        if name not in known:
            raise BadParameterError(f"Unknown parameter {name!r}; known are: {', '.join(sorted(known))}.")
        if (times := len(request.query_params.getlist(name))) > 1:  # the standard's parameters have one value
            raise BadParameterError(f"The parameter {name} is given {times} times: expected one value.")
        if not value.isprintable():
            raise BadParameterError(f"The parameter {name} contains control characters: {value!r}.")
        if name == "limit" and value.strip("+0") == "":
            raise BadParameterError("limit should be 1 or more.")
        if (most := _MOST.get(name)) is not None and not (value.isdecimal() and int(value[:20]) <= most):
            raise BadParameterError(f"{name}={value} should be a whole number from 0 to {most}.")


async def one_collection(
    request: Request,
    collectionId: Annotated[
        str,
        Path(
            description="MAP.features, MAP.lane_markings, MAP.changes or MAP.differences, where MAP is the name of a map"
        ),
    ],
    instants: RequestInstants,
) -> AsOfCollection:
    """The collection of a path. Raises NotFound."""
    map_name, _, kind = collectionId.rpartition(".")
    found = await _maps(request, map_name) if kind in COLLECTIONS and map_name.isprintable() else []
    if not found:
        raise NotFound(f"There is no collection {collectionId}: see /collections.")
    latest = found[0].last_written_at  # all queries of a request see one state
    pinned = replace(instants, known_at=instants.known_at or latest, known_end=instants.known_end or latest)
    return collection_of(kind, found[0], pinned, request.app.state.compare)


async def all_collections(
    request: Request,
    instants: RequestInstants,
    bbox: Annotated[str | None, Query(description="Only collections that overlap west,south,east,north.")] = None,
    datetime: Annotated[
        str | None, Query(description="Only collections of maps that begin before the end of this interval.")
    ] = None,
    limit: Annotated[int, Query(ge=1, description="At most this number of collections.")] = MAX_LIMIT,
    offset: Annotated[int, Query(ge=0, le=MAX_OFFSET, description="Number of collections to skip.")] = 0,
) -> CollectionList:
    """The collections of each map; the map that the server was started for comes first."""
    box = None if bbox is None else parse_box(bbox)
    end = None if datetime is None else parse_interval(datetime)[1]
    found = [
        m
        for m in await _maps(request)
        if (box is None or parts_of_box(box, m.extent)) and (end is None or end >= m.since)
    ]
    found.sort(key=lambda m: (m.map_name != request.app.state.map_name, m.map_name))
    listed = [collection_of(kind, m, instants, request.app.state.compare) for m in found for kind in COLLECTIONS]
    page = listed[offset : offset + limit]
    following = offset + len(page)
    return CollectionList(
        collections=[*page],
        matched=len(listed),
        next=following if page and following < len(listed) else None,
        prev=max(offset - limit, 0) if offset else None,
    )


async def read_box(
    bbox: Annotated[
        str | None,
        Query(
            description="west,south,east,north in degrees, edges included; west > east crosses 180 degrees. "
            "Of six numbers, with lowest and highest height, the heights are ignored."
        ),
    ] = None,
) -> Degrees | None:
    """The box of a request. Raises BadParameterError."""
    return None if bbox is None else parse_box(bbox)


async def read_interval(
    instants: RequestInstants,
    datetime: Annotated[
        str | None,
        Query(
            description="RFC 3339: an instant (the map as of it), "
            "or an interval a/b, a/.. or ../b (what stood or changed within it)."
        ),
    ] = None,
) -> Interval | None:
    """The temporal filter of a request. Raises BadParameterError."""
    if datetime is not None and (instants.at or instants.start or instants.end):
        raise BadParameterError("datetime cannot be combined with at, from or to.")
    return None if datetime is None else parse_interval(datetime)


async def read_json_only(f: Annotated[Literal["json", "schemajson"] | None, Query()] = None) -> None:
    """JSON is the only format."""


async def refuse_filter() -> None:
    """Filter expressions are not offered: they could call any function of the database."""


async def _maps(request: Request, map_name: str | None = None) -> list[ServedMap]:
    pool: AsyncReaderPool = request.app.state.pool
    directory: MapDirectory = request.app.state.maps
    async with pool.acquire() as conn:
        return await directory.maps(conn, map_name)
