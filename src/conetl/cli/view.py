"""`conetl view`: the map in a browser."""

from __future__ import annotations

import signal
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
import uvicorn

from conetl.cli.console import DecisionsOption, JsonOption, MapOption, answer, err, note
from conetl.cli.database import require_maps
from conetl.db.map.map_store import require_map
from conetl.files.home import WRITER_TOKEN, login_address, make_secret, read_secret, validated_secret, view_token
from conetl.files.people import IMAGE_LOG, people_of
from conetl.model.errors import InputError
from conetl.pipeline.database import MapDatabase
from conetl.pipeline.settings import Settings, read_settings
from conetl.services.http_protocol import BoundedProtocol
from conetl.services.processes import free_port
from conetl.web.app import STATIC, create_app
from conetl.web.basemap import base_map
from conetl.web.decisions import Writer

#: Requests served at the same time; further ones are answered 503.
_MAX_CONNECTIONS = 256


def view(
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port on 127.0.0.1.")] = 8791,
    map_name: MapOption = None,
    decisions: DecisionsOption = False,
    writer_token_file: Annotated[
        Path | None,
        typer.Option(help="Enable decisions with the token in this file (mode 600); or set CONETL_WRITER_TOKEN."),
    ] = None,
    login: Annotated[
        bool,
        typer.Option("--login/--no-login", help="Require the view token; --no-login: for a proxy with its own login."),
    ] = True,
    basemap: Annotated[
        str | None,
        typer.Option(
            help="Base map: a tile URL like https://HOST/{z}/{x}/{y}.png (XYZ or WMTS), or a PMTiles file. The browser loads "
            "tiles from HOST, which must allow this (CORS). Default: none.",
        ),
    ] = None,
    basemap_attribution: Annotated[
        str | None, typer.Option(help="Source and licence of the base map, shown on the map.")
    ] = None,
    basemap_zoom: Annotated[
        int | None,
        typer.Option(min=0, max=24, help="Highest zoom level of the base map. Default: 19, or that of the file."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the map in a browser, before and after every drive, with the images of each cone."""
    settings = read_settings(map_name)
    tiles = base_map(basemap, basemap_attribution, basemap_zoom) if basemap else None
    if not (STATIC / "index.html").is_file():
        raise InputError(f"{STATIC}: the front end is missing; build it with `make web`, or reinstall conetl")
    with MapDatabase(require_maps(settings)) as database, database.connection() as conn:
        url = database.url
        try:
            require_map(conn, settings.map_name)
        except InputError as error:
            if map_name is not None:  # without --map the first drive may come later
                raise
            note(str(error))
    writer = decision_writer(settings, url, on_request=decisions, token_file=writer_token_file)
    token = view_token(settings.home) if login else None
    with closing(free_port("127.0.0.1", port, "the map viewer", "--port")) as listener:
        server: uvicorn.Server | None = None
        app = create_app(
            url, settings.map_name, closing=lambda: server is not None and server.should_exit, writer=writer,
            reader_token=token, find_person=people_of(settings.home), whole_images=settings.images == "full",
            image_log=settings.home / "logs" / IMAGE_LOG, base_map=tiles, embed_host=settings.embed_host,
        )  # fmt: skip
        config = uvicorn.Config(
            app, log_level="error", http=BoundedProtocol, access_log=False, limit_concurrency=_MAX_CONNECTIONS,
            timeout_graceful_shutdown=3, server_header=False,
        )  # fmt: skip
        server = uvicorn.Server(config)
        address = login_address(f"http://127.0.0.1:{port}/", token)
        facts = {"url": address, "map": settings.map_name, "decisions": writer is not None}
        answer(as_json, facts, f"Map: {address} (this machine only; press Ctrl-C to stop)")
        # uvicorn stops at Ctrl-C and then raises the signal again; here it is how the command ends, not an interruption.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        server.run(sockets=[listener])


def decision_writer(settings: Settings, url: str, *, on_request: bool, token_file: Path | None) -> Writer | None:
    """Who may write decisions; None for nobody. The token itself is never printed."""
    if token_file is None and on_request and settings.writer_token is None:
        token_file = make_secret(settings.home / WRITER_TOKEN)
    if token_file is not None:
        token = read_secret(token_file)
        err.print(f"Decisions are enabled; the writer token is in {token_file.resolve()}", soft_wrap=True)
    elif settings.writer_token is not None:
        token = validated_secret(settings.writer_token, "CONETL_WRITER_TOKEN")
    else:
        return None
    return Writer(token, url, settings)
