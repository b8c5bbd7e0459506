"""`conetl view`: the map in a browser."""

from __future__ import annotations

import socket
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
import uvicorn

from conetl.cli.console import JsonOption, err, out, print_json
from conetl.db.cluster.cluster import cluster_up
from conetl.db.connection import connect, migrate
from conetl.model.errors import InputError
from conetl.pipeline.settings import Settings, read_settings
from conetl.web.app import STATIC, create_app
from conetl.web.decisions import Decide, PlaceRequest, RevertRequest, WithdrawRequest, Writer
from conetl.web.models import Decided
from conetl.web.security import checked_token, make_writer_token, read_writer_token

#: Requests that are served at one time; more are answered 503 at once.
_MAX_CONNECTIONS = 256
#: A person does not wait longer for an ingest that holds the map.
_LOCK_TIMEOUT_S = 15.0


def view(
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port on this machine (127.0.0.1).")] = 8791,
    map_name: Annotated[str | None, typer.Option("--map", help="Map to show first; default CONETL_MAP_NAME.")] = None,
    decisions: Annotated[
        bool,
        typer.Option(
            "--decisions",
            help="Take decisions (suppress, pin, revert) from holders of the writer token, which is made under CONETL_HOME.",
        ),
    ] = False,
    writer_token_file: Annotated[
        Path | None,
        typer.Option(
            "--writer-token-file", help="Likewise, with the token in this file (mode 600); or set CONETL_WRITER_TOKEN."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the map in a browser: before and after every drive, live, with the pictures that each cone was seen in."""
    settings = read_settings()
    if not (STATIC / "index.html").is_file():
        raise InputError(f"the front end is missing in {STATIC}: build it with `make web`, or install conetl again")
    url = _database_url(settings)
    with closing(connect(url)) as conn:
        migrate(conn)
    writer = writer_of(settings, url, on_request=decisions, token_file=writer_token_file)
    address = f"http://127.0.0.1:{port}/"
    with closing(_listen(port)) as listener:
        server: uvicorn.Server | None = None
        app = create_app(
            url, map_name or settings.map_name, closing=lambda: server is not None and server.should_exit, writer=writer
        )
        config = uvicorn.Config(
            app, log_level="error", access_log=False, limit_concurrency=_MAX_CONNECTIONS, timeout_graceful_shutdown=3,
            server_header=False,
        )  # fmt: skip
        server = uvicorn.Server(config)
        if as_json:
            print_json({"url": address, "map": map_name or settings.map_name, "decisions": writer is not None})
        else:
            out.print(f"The map is at {address} (only on this machine; Ctrl-C ends it)", markup=False)
        server.run(sockets=[listener])


def writer_of(settings: Settings, url: str, *, on_request: bool, token_file: Path | None) -> Writer | None:
    """None where nobody may write. The token itself is never printed."""
    if token_file is None and on_request and settings.writer_token is None:
        token_file = make_writer_token(settings.home)
    if token_file is not None:
        token = read_writer_token(token_file)
        err.print(
            f"Decisions are taken from holders of the writer token in {token_file.resolve()}",
            markup=False,
            soft_wrap=True,
        )
    elif settings.writer_token is not None:
        token = checked_token(settings.writer_token, "CONETL_WRITER_TOKEN")
    else:
        return None
    return Writer(token=token, decide=decide_on(url))


def decide_on(url: str) -> Decide:
    """The function by which the web view writes decisions, as `conetl map suppress|pin|revert` do."""
    from conetl.pipeline.decisions import decide_place, revert

    def decide(map_name: str, wish: PlaceRequest | RevertRequest | WithdrawRequest, /) -> Decided:
        with closing(connect(url)) as conn:
            if isinstance(wish, PlaceRequest):
                done = decide_place(
                    conn, wish.kind, str(wish.feature_id), map_name=map_name, radius_m=wish.radius_m, note=wish.reason,
                    decided_by=wish.decided_by, expected_version=wish.expected_version, lock_timeout_s=_LOCK_TIMEOUT_S,
                )  # fmt: skip
            else:
                what = wish.changeset_id if isinstance(wish, RevertRequest) else wish.decision_id
                done = revert(
                    conn, str(what), map_name=map_name, note=wish.reason, decided_by=wish.decided_by,
                    lock_timeout_s=_LOCK_TIMEOUT_S,
                )  # fmt: skip
        return Decided(
            decision_id=done.decision_id,
            kind=done.kind,
            decided_at=done.decided_at,
            versions_written=done.versions_written,
            replayed=done.replayed,
            also_changed=[conflict.feature_id for conflict in done.conflicts],
        )

    return decide


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
