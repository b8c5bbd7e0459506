"""The Prefect server of conetl: Prefect's own application, for callers who use one of its names. `python -m flows.server_app`.

Without this check a page elsewhere could point a name of its own at this machine and call the server as its own origin (DNS
rebinding).
"""

from __future__ import annotations

import sys
from urllib.parse import urlsplit

import uvicorn
from prefect.server.api.server import create_app as create_prefect_app
from prefect.settings import PREFECT_SERVER_UI_API_URL
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.types import ASGIApp

from conetl.pipeline.settings import read_settings
from conetl.services.http_protocol import BoundedProtocol

_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def create_app() -> ASGIApp:
    """Prefect's application behind the check of names."""
    page = urlsplit(str(PREFECT_SERVER_UI_API_URL.value() or "")).hostname
    further = [name.strip() for name in read_settings().prefect_hosts.split(",")]
    names = {name for name in (*_LOOPBACK, page, *further) if name}
    return TrustedHostMiddleware(create_prefect_app(), allowed_hosts=sorted(names), www_redirect=False)


def main(host: str, port: str) -> None:
    """Serve until the process is stopped."""
    uvicorn.run(create_app(), host=host, port=int(port), log_level="warning", http=BoundedProtocol)


if __name__ == "__main__":
    main(*sys.argv[1:])
