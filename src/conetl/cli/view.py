"""`conetl view`: the map in a browser."""

from __future__ import annotations

import socket
from contextlib import closing
from typing import Annotated

import typer
import uvicorn

from conetl.cli.console import JsonOption, out, print_json
from conetl.errors import InputError
from conetl.io.db import connect, migrate
from conetl.io.services.cluster import cluster_up
from conetl.settings import Settings, read_settings
from conetl.web.app import STATIC, create_app

#: Requests that are served at one time; more are answered 503 at once.
_MAX_CONNECTIONS = 256


def view(
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port on this machine (127.0.0.1).")] = 8791,
    map_name: Annotated[str | None, typer.Option("--map", help="Map to show first; default CONETL_MAP_NAME.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the map in a browser: before and after every drive, live, with the pictures that each cone was seen in."""
    settings = read_settings()
    if not (STATIC / "index.html").is_file():
        raise InputError(f"the front end is missing in {STATIC}: build it with `make web`, or install conetl again")
    url = _database_url(settings)
    with closing(connect(url)) as conn:
        migrate(conn)
    address = f"http://127.0.0.1:{port}/"
    with closing(_listen(port)) as listener:
        server: uvicorn.Server | None = None
        app = create_app(
            url, map_name or settings.map_name, closing=lambda: server is not None and server.should_exit
        )  # fmt: skip
        config = uvicorn.Config(
            app, log_level="error", access_log=False, limit_concurrency=_MAX_CONNECTIONS, timeout_graceful_shutdown=3,
            server_header=False,
        )  # fmt: skip
        server = uvicorn.Server(config)
        if as_json:
            print_json({"url": address, "map": map_name or settings.map_name})
        else:
            out.print(f"The map is at {address} (only on this machine; Ctrl-C ends it)", markup=False)
        server.run(sockets=[listener])


def _database_url(settings: Settings) -> str:
    return settings.database_url.get_secret_value() if settings.database_url else cluster_up(settings.home)


def _listen(port: int) -> socket.socket:
    """The listening socket, on loopback only. Raises InputError where the port is taken."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1", port))
    except OSError as error:
        listener.close()
        raise InputError(
            f"port {port} of this machine cannot be used ({error.strerror}): choose another one with --port"
        ) from error
    return listener
