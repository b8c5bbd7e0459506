"""The Prefect server of conetl as an ASGI application: Prefect's own, for callers who use one of its names.

Without this check a page elsewhere could point a name of its own at this machine and call the server as its own origin (DNS
rebinding).
"""

from __future__ import annotations

from urllib.parse import urlsplit

from prefect.server.api.server import create_app as create_prefect_app
from prefect.settings import PREFECT_SERVER_UI_API_URL
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.types import ASGIApp

from conetl.pipeline.settings import read_settings

_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


def create_app() -> ASGIApp:
    """The application, for `uvicorn --factory flows.server_app:create_app`."""
    page = urlsplit(str(PREFECT_SERVER_UI_API_URL.value() or "")).hostname
    further = [name.strip() for name in read_settings().prefect_hosts.split(",")]
    names = {name for name in (*_LOOPBACK, page, *further) if name}
    return TrustedHostMiddleware(create_prefect_app(), allowed_hosts=sorted(names), www_redirect=False)
