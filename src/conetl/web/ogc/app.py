"""The application that is mounted at `/ogc`: its routes, API definition and errors."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import asyncpg
from fastapi import Depends, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from tipg.errors import NotFound, TiPgError

from conetl.db.ogc_store import MapDirectory
from conetl.db.reader_pool import STATEMENT_TIMEOUT, AsyncReaderPool
from conetl.exports.fields import FIELDS
from conetl.model.errors import DatabaseError
from conetl.web.models import Problem
from conetl.web.ogc.collections import CHANGE_COLUMNS, FEATURE_COLUMNS, MARKING_COLUMNS
from conetl.web.ogc.endpoints import ITEMS, endpoints
from conetl.web.ogc.parameters import prepare, read_instants
from conetl.web.ogc.values import BadParameterError

TITLE = "conetl: maps of traffic cones"
DESCRIPTION = (
    "Each map has three collections: MAP.features, the cones and other point objects, and MAP.lane_markings, the lane markings, "
    "both as of an instant (at, known_at), and MAP.changes, the changes of points between two instants (from, to, known_from, "
    "known_to)."
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
#: Operations with a filter for each property.
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


def create_ogc_app(pool: AsyncReaderPool, map_name: str) -> FastAPI:
    """OGC API Features and tiles of all maps of a database; the collections of `map_name` come first."""
    app = FastAPI(
        title=TITLE, description=DESCRIPTION, version="1.0.0", openapi_url=None, docs_url=None, redoc_url=None,
        dependencies=[Depends(prepare), Depends(read_instants)], redirect_slashes=False,
    )  # fmt: skip
    app.state.pool = pool
    app.state.maps = MapDirectory()
    app.state.map_name = map_name
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
    """FastAPI's definition without HTML and what is not offered, with filters by property; built once."""
    if app.openapi_schema is not None:
        return app.openapi_schema
    document = get_openapi(title=app.title, version=app.version, routes=app.routes, description=app.description)
    problem = {"application/json": {"schema": {"$ref": "#/components/schemas/OgcProblem"}}}
    errors = {status: {"description": text, "content": problem} for status, text in _ERROR_RESPONSES.items()}
    for path, operations in document["paths"].items():
        operation = operations["get"]
        parameters = [p for p in operation.get("parameters", ()) if p["name"] not in _NOT_OFFERED]
        names = {p["name"] for p in parameters}
        filters = dict.fromkeys((*CHANGE_COLUMNS, *MARKING_COLUMNS, *FEATURE_COLUMNS)) if path in _FILTERED else {}
        operation["parameters"] = parameters + [
            {
                "name": name, "in": "query", "required": False, "schema": {"type": "string"},
                "description": f"Only items with this value: {FIELDS[name].meaning}",
            }
            for name in filters if name not in names
        ]  # fmt: skip
        operation["responses"].pop("422", None)
        for answer in operation["responses"].values():
            answer.get("content", {}).pop("text/html", None)
        operation["responses"] |= errors
    document["components"]["schemas"]["OgcProblem"] = OgcProblem.model_json_schema()
    [limit] = [p for p in document["paths"][ITEMS]["get"]["parameters"] if p["name"] == "limit"]
    document["components"]["parameters"] = {"limit": limit}  # where QGIS reads the largest page
    app.openapi_schema = document
    return document


def _add_error_handlers(app: FastAPI) -> None:
    """Every error is `{"code": ..., "detail": ...}`, as the standard and the rest of the API have it."""
    too_long = f"The query took longer than {STATEMENT_TIMEOUT}: request a smaller box or fewer items."
    not_ready = _error(503, "DatabaseNotReady", "The database lacks conetl's present schema: run `conetl db migrate`.")
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
