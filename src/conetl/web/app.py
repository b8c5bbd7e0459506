"""The server of `conetl view`: a read-only API, decisions of writers, the built front end. It contacts no other host."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, JSONResponse, RedirectResponse
from fastapi.staticfiles import StaticFiles
from pydantic import SecretStr
from starlette.middleware.gzip import GZipMiddleware

from conetl.db.reader_pool import AsyncReaderPool, ReaderPool
from conetl.files.people import Person
from conetl.model.errors import DatabaseError, InputError, StorageError
from conetl.perception.images import ImageFileError
from conetl.web import basemap, decisions, downloads, frames, layers, lists, live, maps, search, tiles, zones
from conetl.web.models import Problem
from conetl.web.ogc.app import create_ogc_app
from conetl.web.security import EMBED_PATH, Guard

STATIC = Path(__file__).parent / "static"
_STATUS = {DatabaseError: 503, StorageError: 503, InputError: 404, ImageFileError: 404}


def create_app(
    database_url: str,
    map_name: str,
    *,
    closing: Callable[[], bool] = lambda: False,
    writer: decisions.Writer | None = None,
    reader_token: SecretStr | None = None,
    find_person: Callable[[str], Person | None] = lambda _: None,
    whole_images: bool = False,
    image_log: Path | None = None,
    base_map: basemap.BaseMap | None = None,
    embed_host: str | None = None,
) -> FastAPI:
    """The application for one database. Streams end when `closing` returns True. Without `writer` it is read-only.

    reader_token: required for reading; the writer's token serves as well. Without it, everybody who reaches the server may read.
    find_person: who has a token of a person, which logs in too. Used with `reader_token` only.
    whole_images: show whole images to everybody; otherwise only to people who may see them, and to others pixelated ones.
    image_log: file to which every whole image that is shown is appended.
    base_map: tiles under the map; the browser may request them from this one other server.
    embed_host: server whose pages may show `/embed.html` in a frame, a page without decisions; no other page may be framed.
    """
    pool = ReaderPool(database_url)
    ogc_pool = AsyncReaderPool(database_url)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        yield
        pool.close()
        await ogc_pool.close()

    app = FastAPI(
        title="conetl", docs_url=None, redoc_url=None, openapi_url="/api/openapi.json", lifespan=lifespan,
        responses={404: {"model": Problem}, 503: {"model": Problem}},
    )  # fmt: skip
    app.state.pool = pool
    app.state.map_name = map_name
    app.state.writer = writer
    app.state.whole_images = whole_images
    app.state.image_log = image_log
    app.state.basemap = base_map
    app.state.embed_host = embed_host
    app.state.zone_cache = zones.ZoneCache()
    app.state.watcher = live.HeadWatcher(pool, closing=closing)
    for routes in (lists, maps, tiles, search, frames, layers, zones, basemap, downloads, decisions, live):
        app.include_router(routes.router, prefix="/api")
    for error, status in _STATUS.items():
        app.add_exception_handler(error, _answer_with(status))
    compare = partial(app.state.zone_cache.read_whole, pool)
    app.mount("/ogc", create_ogc_app(ogc_pool, map_name, compare), name="ogc")
    app.add_route("/ogc", lambda request: RedirectResponse(request.url.replace(path="/ogc/")), include_in_schema=False)
    if embed_host:
        app.add_route(EMBED_PATH, lambda _: FileResponse(STATIC / "index.html"), include_in_schema=False)
    app.mount("/", StaticFiles(directory=STATIC, html=True), name="front end")
    # Level 5 would save another 6 kB of 350 kB, and take twice as long.
    app.add_middleware(GZipMiddleware, minimum_size=1024, compresslevel=2)
    tokens = [reader_token, *([writer.token] if writer else [])] if reader_token else []
    image_host = base_map.host if base_map else None
    app.add_middleware(Guard, tokens=tokens, find_person=find_person, image_host=image_host, embed_host=embed_host)
    return app


def _answer_with(status: int) -> Callable[[Request, Exception], JSONResponse]:
    def answer(_: Request, error: Exception) -> JSONResponse:
        return JSONResponse({"detail": str(error)}, status_code=status)

    return answer
