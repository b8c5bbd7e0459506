"""The application that is mounted at `/ogc`: tipg's routes without HTML, our item pages, the API definition and errors."""

from __future__ import annotations

import csv
import io
from collections.abc import Awaitable, Callable
from typing import Annotated, Any
from urllib.parse import urlencode

import asyncpg
import orjson
import tipg.factory
from fastapi import Depends, FastAPI, Path, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from morecantile import tms as all_tilings
from morecantile.defaults import TileMatrixSets
from starlette.exceptions import HTTPException
from tipg import model
from tipg.dependencies import properties_filter_query
from tipg.errors import NotFound, TiPgError
from tipg.factory import EndpointsFactory, OGCFeaturesFactory, OGCTilesFactory
from tipg.resources.enums import MediaType
from tipg.resources.response import GeoJSONResponse, ORJSONResponse

from conetl.db.ogc_store import Degrees, MapDirectory
from conetl.db.reader_pool import STATEMENT_TIMEOUT, AsyncReaderPool
from conetl.model.errors import DatabaseError
from conetl.web.models import Problem
from conetl.web.ogc import parameters as p
from conetl.web.ogc.collections import FILTERS, AsOfCollection, Compare, Page, as_ewkt
from conetl.web.parameters import BadParameterError, Interval

TITLE = "conetl: maps of traffic cones"
DESCRIPTION = (
    "Each map has four collections: MAP.features, the cones and other point objects, and MAP.lane_markings, the lane markings, "
    "both as of an instant (at, known_at), MAP.changes, the changes of points between two instants (from, to, known_from, "
    "known_to), and MAP.differences, planned work zones against those that were found (at, known_at)."
)
_API_DEFINITION_TYPE = "application/vnd.oai.openapi+json;version=3.1"
#: tipg itself would also claim HTML, OpenAPI 3.0 (the API definition is of 3.1) and filter expressions.
_CONFORMS_TO = [
    f"http://www.opengis.net/spec/ogcapi-{part}"
    for part in (
        "common-1/1.0/conf/core", "common-1/1.0/conf/landingPage", "common-1/1.0/conf/json", "common-2/1.0/conf/collections",
        "features-1/1.0/conf/core", "features-1/1.0/conf/geojson",
        "tiles-1/1.0/conf/core", "tiles-1/1.0/conf/mvt", "tiles-1/1.0/conf/tileset", "tiles-1/1.0/conf/tilesets-list",
    )
]  # fmt: skip
#: Parameters of tipg that are not offered: a filter could call any database function, the others mean nothing for points.
_NOT_OFFERED = frozenset({"filter", "filter-lang", "geom-column", "datetime-column", "simplify", "bbox-only", "type"})
ITEMS = "/collections/{collectionId}/items"
#: Operations that have a filter for each property.
_FILTERED = (ITEMS, "/collections/{collectionId}/tiles/{tileMatrixSetId}/{z}/{x}/{y}")
_ERROR_RESPONSES = {
    "400": "A parameter is invalid or unknown.",
    "404": "There is no such map, collection, item or tile.",
    "503": "The database is unavailable or busy, or the query takes too long.",
}
_MESSAGES = {
    404: "Not found: the landing page /ogc/ links to all resources.",
    405: "This API is read-only: use GET.",
}
_Handler = Callable[[Request, Exception], Awaitable[Response]]
_TILING = "WebMercatorQuad"
#: Parameters that links to items carry: a link leads to the same state of the map.
_CARRIED = ("at", "known_at", "from", "to", "known_from", "known_to")
#: Stands for the id of an item in its links; no name of a map and no instant contains it.
_ID = "ITEM-ID"
Properties = Annotated[
    str | None, Query(description="Only these properties, comma-separated; empty: none. Default: all.")
]
_FORMS = (MediaType.geojson, MediaType.csv, MediaType.json, MediaType.geojsonseq, MediaType.ndjson)


def create_ogc_app(pool: AsyncReaderPool, map_name: str, compare: Compare) -> FastAPI:
    """OGC API Features and tiles of all maps of a database; the collections of `map_name` come first. compare: of differences."""
    app = FastAPI(
        title=TITLE, description=DESCRIPTION, version="1.0.0", openapi_url=None, docs_url=None, redoc_url=None,
        dependencies=[Depends(p.prepare), Depends(p.read_instants)], redirect_slashes=False,
    )  # fmt: skip
    app.state.pool = pool
    app.state.maps = MapDirectory()
    app.state.map_name = map_name
    app.state.compare = compare
    app.openapi = lambda: _definition(app)  # type: ignore[method-assign]
    for path, endpoint in (("/", _landing), ("/conformance", _conformance), ("/api", _api)):
        app.get(path, tags=["OGC Common"])(endpoint)
    for part in endpoints():
        app.include_router(part.router)
    _add_error_handlers(app)
    return app


def _landing(request: Request) -> dict[str, Any]:
    """Links to all resources."""
    base = str(request.base_url)
    pages = [
        ("", "self", "application/json", "This page"),
        ("api", "service-desc", _API_DEFINITION_TYPE, "API definition"),
        ("conformance", "conformance", "application/json", "Conformance"),
        ("collections", "data", "application/json", "Collections"),
        ("tileMatrixSets", "http://www.opengis.net/def/rel/ogc/1.0/tiling-schemes", "application/json", "Tilings"),
    ]
    links = [{"href": base + path, "rel": rel, "type": kind, "title": title} for path, rel, kind, title in pages]
    return {"title": TITLE, "description": DESCRIPTION, "links": links}


def _conformance() -> dict[str, list[str]]:
    """Conformance classes of the standards."""
    return {"conformsTo": _CONFORMS_TO}


def _api(request: Request) -> JSONResponse:
    """The API definition (OpenAPI 3.1)."""
    document = request.app.openapi() | {"servers": [{"url": str(request.base_url).rstrip("/")}]}
    return JSONResponse(document, media_type=_API_DEFINITION_TYPE)


class OgcProblem(Problem):
    """Every error, with the code that the standard requires."""

    code: str


def _definition(app: FastAPI) -> dict[str, Any]:
    """FastAPI's definition without HTML and without what is not offered, with filters by property; built once."""
    if app.openapi_schema is not None:
        return app.openapi_schema
    document = get_openapi(title=app.title, version=app.version, routes=app.routes, description=app.description)
    problem = {"application/json": {"schema": {"$ref": "#/components/schemas/OgcProblem"}}}
    errors = {status: {"description": text, "content": problem} for status, text in _ERROR_RESPONSES.items()}
    for path, operations in document["paths"].items():
        operation = operations["get"]
        parameters = [p for p in operation.get("parameters", ()) if p["name"] not in _NOT_OFFERED]
        names = {p["name"] for p in parameters}
        operation["parameters"] = parameters + [
            {
                "name": name, "in": "query", "required": False, "schema": schema,
                "description": f"Only items with this value: {meaning}",
            }
            for name, (schema, meaning) in FILTERS.items() if path in _FILTERED and name not in names
        ]  # fmt: skip
        operation["responses"].pop("422", None)
        for answer in operation["responses"].values():
            answer.get("content", {}).pop("text/html", None)
        operation["responses"] |= errors
    document["components"]["schemas"]["OgcProblem"] = OgcProblem.model_json_schema()
    [limit] = [p for p in document["paths"][ITEMS]["get"]["parameters"] if p["name"] == "limit"]
    document["components"]["parameters"] = {"limit": limit}  # QGIS reads the largest page from here
    app.openapi_schema = document
    return document


def _add_error_handlers(app: FastAPI) -> None:
    """Every error is `{"code": ..., "detail": ...}`, as the standard and the rest of the API have it."""
    too_long = f"The query took longer than {STATEMENT_TIMEOUT}: request a smaller box or fewer items."
    not_ready = _error(503, "DatabaseNotReady", "The database schema is not up to date: run `conetl db migrate`.")
    handlers: dict[type[Exception], _Handler] = {
        BadParameterError: _error(400, "InvalidParameterValue"),
        TiPgError: _error(400, "InvalidParameterValue"),
        NotFound: _error(404, "NotFound"),
        asyncpg.DataError: _error(400, "InvalidParameterValue"),
        asyncpg.QueryCanceledError: _error(503, "TooLong", too_long),
        asyncpg.InsufficientPrivilegeError: not_ready,
        asyncpg.InvalidSchemaNameError: not_ready,
        asyncpg.UndefinedFunctionError: not_ready,
        asyncpg.UndefinedTableError: not_ready,
        DatabaseError: _error(503, "DatabaseNotReady"),
        RequestValidationError: _invalid,
        HTTPException: _http,
    }
    for kind, handler in handlers.items():
        app.add_exception_handler(kind, handler)


def _error(status: int, code: str, text: str | None = None) -> _Handler:
    async def answer(_: Request, error: Exception) -> Response:
        return JSONResponse({"code": code, "detail": text or str(error)}, status_code=status)

    return answer


async def _invalid(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    detail = f"{first['loc'][-1]}: {first['msg']}"
    return JSONResponse({"code": "InvalidParameterValue", "detail": detail}, status_code=400)


async def _http(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    code = "NotFound" if error.status_code == 404 else "Refused"
    detail = _MESSAGES.get(error.status_code, error.detail)
    return JSONResponse({"code": code, "detail": detail}, status_code=error.status_code, headers=error.headers)


async def items(
    request: Request,
    collection: Annotated[AsOfCollection, Depends(p.one_collection)],
    box: Annotated[Degrees | None, Depends(p.read_box)],
    interval: Annotated[Interval | None, Depends(p.read_interval)],
    ids: Annotated[str | None, Query(description="Only these items, comma-separated.")] = None,
    properties: Properties = None,
    sortby: Annotated[
        str | None, Query(description="Properties, comma-separated; a - before a name sorts in descending order.")
    ] = None,
    limit: Annotated[
        int, Query(ge=1, json_schema_extra={"maximum": p.MAX_LIMIT}, description="At most this number of items.")
    ] = 10,
    offset: Annotated[int, Query(ge=0, le=p.MAX_OFFSET, description="Number of items to skip.")] = 0,
    f: p.ItemForm = "geojson",
) -> Response:
    """Items of a collection."""
    limit = min(limit, p.MAX_LIMIT)  # a larger one is not an error (17-069r4, 7.15.2)
    wanted = _names(properties)
    asked = _pinned(request, collection)
    here = f"{request.base_url}collections/{collection.id}"
    to_collection = _link(here, "collection", MediaType.json, "Collection")
    to_item = _link(f"{here}/items/{_ID}?{_carried(asked)}", "item", MediaType.geojson, "Item")
    before, after = orjson.dumps([to_collection, to_item]).decode().split(_ID)
    async with request.app.state.pool.acquire() as conn:
        page = await collection.page(
            conn, limit=limit, offset=offset, ids=ids.split(",") if ids else None, box=box, interval=interval,
            values=properties_filter_query(request, collection), sortby=sortby, properties=wanted, links=(before, after),
        )  # fmt: skip
    links = _page_links(f"{here}/items", page, asked, limit, offset)
    if f == "geojson":
        head = {
            "type": "FeatureCollection", "id": collection.id, "title": collection.title,
            "description": collection.description, "numberMatched": page.matched, "numberReturned": page.returned,
            "links": [to_collection, *_forms(f"{here}/items", asked, "Items"), *links],
        }  # fmt: skip
        body = b'%b,"features":[%b]}' % (orjson.dumps(head)[:-1], page.items)
        return Response(body, media_type=MediaType.geojson.value)
    answer = _other_form(collection, page.parsed(), f, wanted)
    # These forms hold no links; whoever does not follow this one has the first page only.
    if following := [link["href"] for link in links if link["rel"] == "next"]:
        answer.headers["Link"] = f'<{following[0]}>; rel="next"; type="{MediaType[f].value}"'
    return answer


async def item(
    request: Request,
    collection: Annotated[AsOfCollection, Depends(p.one_collection)],
    itemId: Annotated[str, Path(description="Id of the item.")],
    properties: Properties = None,
    f: p.ItemForm = "geojson",
) -> Response:
    """One item of a collection."""
    wanted = _names(properties)
    async with request.app.state.pool.acquire() as conn:
        page = await collection.page(conn, ids=[itemId], properties=wanted, limit=2)  # not full: not counted
    if not page.returned:
        raise NotFound(f"There is no item {itemId} in the collection {collection.id}.")
    found = page.parsed()
    here = f"{request.base_url}collections/{collection.id}"
    links = [_link(here, "collection", MediaType.json, "Collection")]
    found[0]["links"] = links + _forms(f"{here}/items/{found[0]['id']}", {**request.query_params}, "Item")
    if f == "geojson":
        return GeoJSONResponse(found[0])
    return ORJSONResponse(_row(collection, found[0])) if f == "json" else _other_form(collection, found, f, wanted)


def _names(properties: str | None) -> list[str] | None:
    return None if properties is None else [name.strip() for name in properties.split(",")]


def _other_form(
    collection: AsOfCollection, found: list[dict[str, Any]], form: str, wanted: list[str] | None
) -> Response:
    """Items in a form other than GeoJSON."""
    if form == "geojsonseq":  # each record begins with a separator (RFC 8142)
        text = b"".join(b"\x1e%b\n" % orjson.dumps(item) for item in found)
        return _attachment(text, MediaType.geojsonseq, "items.geojson")
    rows = [_row(collection, item) for item in found]
    if form == "json":
        return ORJSONResponse(rows)
    if form == "ndjson":
        text = b"".join(orjson.dumps(row) + b"\n" for row in rows)
        return _attachment(text, MediaType.ndjson, "items.ndjson")
    table = io.StringIO()
    writer = csv.DictWriter(table, ["collectionId", "itemId", *collection.columns(wanted), "geometry"])
    writer.writeheader()
    writer.writerows(rows)
    return _attachment(table.getvalue().encode(), MediaType.csv, "items.csv")


def _row(collection: AsOfCollection, item: dict[str, Any]) -> dict[str, Any]:
    return {
        "collectionId": collection.id,
        "itemId": item["id"],
        **item["properties"],
        "geometry": as_ewkt(item["geometry"]),
    }


def _pinned(request: Request, collection: AsOfCollection) -> dict[str, str]:
    """The query of a request with the state of the database that it shows: links to other pages lead to the same state."""
    name = "known_to" if collection.table == "changes" else "known_at"
    latest = collection.served.last_written_at.isoformat().replace("+00:00", "Z")
    return {**request.query_params} | ({} if name in request.query_params else {name: latest})


def _page_links(url: str, page: Page, asked: dict[str, str], limit: int, offset: int) -> list[dict[str, str]]:
    """Links from a page of items to its neighbours."""
    pages = []
    if page.returned and offset + page.returned < page.matched:
        pages.append(("next", offset + page.returned, "Next page"))
    if offset:
        pages.append(("prev", max(offset - limit, 0), "Previous page"))
    return [
        _link(f"{url}?{urlencode(asked | {'offset': first})}", rel, MediaType.geojson, title)
        for rel, first, title in pages
    ]


def _forms(url: str, asked: dict[str, str], title: str) -> list[dict[str, str]]:
    """Links to a resource as GeoJSON and in its other forms (requirements fc-links and f-links)."""
    itself = _link(f"{url}?{urlencode(asked)}".removesuffix("?"), "self", MediaType.geojson, title)
    others = [_link(f"{url}?{urlencode(asked | {'f': form.name})}", "alternate", form, title) for form in _FORMS[1:]]
    return [itself, *others]


def _attachment(body: bytes, kind: MediaType, name: str) -> Response:
    return Response(body, media_type=kind.value, headers={"Content-Disposition": f"attachment;filename={name}"})


def _link(href: str, rel: str, kind: MediaType, title: str) -> dict[str, str]:
    return {"title": title, "href": href, "rel": rel, "type": kind.value}


def _carried(query: Any) -> str:
    return urlencode([(name, value) for name, value in query.items() if name in _CARRIED])


class _Features(OGCFeaturesFactory):
    """tipg's routes with our items."""

    def _items_route(self) -> None:
        self._add(ITEMS, items, model.Items)

    def _item_route(self) -> None:
        self._add(f"{ITEMS}/{{itemId}}", item, model.Item)

    def _add(self, path: str, endpoint: Callable[..., Awaitable[Response]], answer: type) -> None:
        responses: dict[int | str, dict[str, Any]] = {
            200: {"content": {form.value: {} for form in _FORMS}, "model": answer}
        }
        self.router.get(path, response_class=GeoJSONResponse, responses=responses, tags=["OGC Features API"])(endpoint)


def endpoints() -> list[EndpointsFactory]:
    """The routers of the API.

    While tipg declares its routes, its dependencies are ours: FastAPI's dependency_overrides would resolve them for every
    request, which takes 20 ms of processor time.
    """
    ours = {
        "bbox_query": p.read_box, "datetime_query": p.read_interval, "filter_query": p.refuse_filter,
        "OutputType": p.read_json_only, "QueryablesOutputType": p.read_json_only,
    }  # fmt: skip
    theirs = {name: getattr(tipg.factory, name) for name in ours}
    tilings = TileMatrixSets({_TILING: all_tilings.get(_TILING)})
    one: Any = p.one_collection  # tipg's types allow no coroutines here, FastAPI does
    every: Any = p.all_collections
    try:
        vars(tipg.factory).update(ours)
        return [
            _Features(collection_dependency=one, collections_dependency=every, with_common=False),
            OGCTilesFactory(collection_dependency=one, supported_tms=tilings, with_viewer=False, with_common=False),
        ]
    finally:
        vars(tipg.factory).update(theirs)
