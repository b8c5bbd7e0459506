"""Refuses what no page of this server and no program of its user asks: calls from other pages, and questions of absurd length."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

#: Bytes of path and query together; a filter by a hundred ids has 4 kB.
MAX_URL_BYTES = 8_192
FROM_ELSEWHERE = "This server answers its own pages and programs on this machine, not other web pages."
NO_TEXT = "Nothing here has a name with control characters."
TOO_LONG = f"The address has more than {MAX_URL_BYTES} bytes."


class Guard:
    """ASGI middleware. A page elsewhere could not read the answers, but it could keep the server and its streams busy."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            headers = Headers(scope=scope)
            if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > MAX_URL_BYTES:
                return await JSONResponse({"detail": TOO_LONG}, status_code=414)(scope, receive, send)
            if not scope["path"].isprintable():
                code = {"code": "NotFound"} if scope["path"].startswith("/ogc") else {}
                return await JSONResponse(code | {"detail": NO_TEXT}, status_code=404)(scope, receive, send)
            if is_from_elsewhere(headers):
                return await JSONResponse({"detail": FROM_ELSEWHERE}, status_code=403)(scope, receive, send)
        return await self._app(scope, receive, send)


def is_from_elsewhere(headers: Headers) -> bool:
    """True for what another web page asks for (Fetch Metadata, Origin); following a link to the server is no such thing."""
    origin, host = headers.get("origin"), headers.get("host")
    if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
        return True
    site = headers.get("sec-fetch-site")
    is_link = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
    return site in ("cross-site", "same-site") and not is_link
