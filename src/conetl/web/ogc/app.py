"""The application that is mounted at `/ogc`."""

from __future__ import annotations

import csv
import io
from collections.abc import Awaitable, Callable
from urllib.parse import parse_qsl, urlencode

import asyncpg
from fastapi import Depends, FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Receive, Scope, Send
from tipg.errors import NotFound, TiPgError

from conetl.db.async_reader_pool import AsyncReaderPool
from conetl.db.ogc_store import MapDirectory
from conetl.db.reader_pool import STATEMENT_TIMEOUT
from conetl.model.errors import DatabaseError
from conetl.web.ogc.collections import EmptyTableError
from conetl.web.ogc.definition import define
from conetl.web.ogc.endpoints import API_DEFINITION_TYPE, DESCRIPTION, TITLE, conformance, endpoints, landing
from conetl.web.ogc.parameters import (
    MAX_LIMIT,
    read_instants,
    refuse_unknown,
)
from conetl.web.ogc.values import BadParameterError

#: In place of "Not Found" and "Method Not Allowed".
_WORDS = {
    404: "There is nothing here: the landing page /ogc/ links to what there is.",
    405: "This API only reads: GET.",
}
Handler = Callable[[Request, Exception], Awaitable[Response]]


def create_ogc_app(pool: AsyncReaderPool, map_name: str) -> ASGIApp:
    """OGC API Features and tiles of all maps of a database; the collections of `map_name` come first."""
    app = FastAPI(
        title=TITLE, description=DESCRIPTION, version="1.0.0", openapi_url=None, docs_url=None, redoc_url=None,
        dependencies=[Depends(refuse_unknown), Depends(read_instants)], redirect_slashes=False,
    )  # fmt: skip
    app.state.pool = pool
    app.state.maps = MapDirectory()
    app.state.map_name = map_name
    app.openapi = lambda: define(app)  # type: ignore[method-assign]
    app.get("/", tags=["OGC Common"])(landing)
    app.get("/conformance", tags=["OGC Common"])(conformance)
    app.get("/api", tags=["OGC Common"])(_definition)
    for part in endpoints():
        app.include_router(part.router)
    _add_refusals(app)
    return _prepared(app)


def _definition(request: Request) -> JSONResponse:
    """The API definition (OpenAPI 3.1)."""
    document = request.app.openapi() | {"servers": [{"url": str(request.base_url).rstrip("/")}]}
    return JSONResponse(document, media_type=API_DEFINITION_TYPE)


def _prepared(app: FastAPI) -> ASGIApp:
    """Links start where the application is mounted, and a limit beyond the largest one is the largest one (17-069r4, 7.15.2)."""

    async def serve(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            scope = {**scope, "app_root_path": scope.get("root_path", "")}
            if b"limit=" in scope["query_string"]:
                scope["query_string"] = _limited(scope["query_string"].decode("latin-1")).encode("latin-1")
        await app(scope, receive, send)

    return serve


def _limited(query: str) -> str:
    pairs = parse_qsl(query, keep_blank_values=True)
    return urlencode([
        (name, str(MAX_LIMIT) if name == "limit" and value.isdecimal() and int(value[:20]) > MAX_LIMIT else value)
        for name, value in pairs
    ])  # fmt: skip


def _add_refusals(app: FastAPI) -> None:
    """Every refusal is `{"code": ..., "detail": ...}`, as the standard and the rest of the API have it."""
    too_long = f"The database ended a question that took longer than {STATEMENT_TIMEOUT}: ask for a smaller box or fewer items."
    not_ready = "The database lacks conetl's present schema: run `conetl db migrate`."
    known: dict[type[Exception], Handler] = {
        BadParameterError: _refusal(400, "InvalidParameterValue"),
        TiPgError: _refusal(400, "InvalidParameterValue"),
        NotFound: _refusal(404, "NotFound"),
        asyncpg.DataError: _refusal(400, "InvalidParameterValue"),
        asyncpg.QueryCanceledError: _refusal(503, "TooLong", too_long),
        asyncpg.InsufficientPrivilegeError: _refusal(503, "DatabaseNotReady", not_ready),
        asyncpg.InvalidSchemaNameError: _refusal(503, "DatabaseNotReady", not_ready),
        asyncpg.UndefinedFunctionError: _refusal(503, "DatabaseNotReady", not_ready),
        asyncpg.UndefinedTableError: _refusal(503, "DatabaseNotReady", not_ready),
        DatabaseError: _refusal(503, "DatabaseNotReady"),
        RequestValidationError: _invalid,
        HTTPException: _http,
        EmptyTableError: _empty_table,
    }
    for kind, handler in known.items():
        app.add_exception_handler(kind, handler)


def _refusal(status: int, code: str, text: str | None = None) -> Handler:
    async def answer(_: Request, error: Exception) -> Response:
        return JSONResponse({"code": code, "detail": text or str(error)}, status_code=status)

    return answer


async def _invalid(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0]
    where = first["loc"][-1]
    return JSONResponse({"code": "InvalidParameterValue", "detail": f"{where}: {first['msg']}"}, status_code=400)


async def _http(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse(
        {"code": "NotFound" if error.status_code == 404 else "Refused", "detail": _WORDS.get(error.status_code, error.detail)},
        status_code=error.status_code, headers=error.headers,
    )  # fmt: skip


async def _empty_table(_: Request, error: Exception) -> Response:
    assert isinstance(error, EmptyTableError)
    line = io.StringIO()
    csv.writer(line).writerow(error.names)
    return Response(line.getvalue(), media_type="text/csv")
