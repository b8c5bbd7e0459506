"""Who may call the server: refusal of other web pages, headers of every answer, and the writer token of those who decide."""

from __future__ import annotations

import hmac
import os
import secrets
import stat
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from fastapi import HTTPException, Request, Response
from fastapi.routing import APIRoute
from pydantic import SecretStr
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from conetl.model.errors import InputError

#: Bytes of path and query together; a filter by a hundred ids has 4 kB.
MAX_URL_BYTES = 8_192
MAX_BODY_BYTES = 8_192
MIN_TOKEN_LENGTH = 16
_CROSS_SITE = "This server answers its own pages and programs on this machine, not other web pages."
_OWN_PAGE_ONLY = "Decisions are accepted from this server's own page only."
#: Only this server's own files run or load, and no other page may embed or read them.
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Cache-Control": "no-cache",
}


class Guard:
    """ASGI middleware. Other pages could not read the answers, but they could keep the server and its streams busy.

    Refuses their requests and those of absurd length, and adds headers to every answer; streams are not buffered.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)  # a route may set its own policy
            await send(message)

        if scope["type"] == "http":
            await (_refusal(scope) or self._app)(scope, receive, send_with_headers)
        else:
            await self._app(scope, receive, send)


def _refusal(scope: Scope) -> JSONResponse | None:
    if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > MAX_URL_BYTES:
        return JSONResponse({"detail": f"The URL has more than {MAX_URL_BYTES} bytes."}, status_code=414)
    if not scope["path"].isprintable():
        code = {"code": "NotFound"} if scope["path"].startswith("/ogc") else {}
        return JSONResponse(code | {"detail": "The path contains control characters."}, status_code=404)
    if _is_cross_site(Headers(scope=scope)):
        return JSONResponse({"detail": _CROSS_SITE}, status_code=403)
    return None


def _is_cross_site(headers: Headers) -> bool:
    """True for a request of another web page (Fetch Metadata, Origin), except for a link to this server that is followed."""
    origin, host = headers.get("origin"), headers.get("host")
    if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
        return True
    is_link = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document"
    return headers.get("sec-fetch-site") in ("cross-site", "same-site") and not is_link


class WritersRoute(APIRoute):
    """A route that accepts other methods than GET from holders of the writer token only; refuses before it reads the body."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()

        async def guarded(request: Request) -> Response:
            if request.method not in {"GET", "HEAD"}:
                _require_writer(request)
            return await handle(request)

        return guarded


def _require_writer(request: Request) -> None:
    writer = request.app.state.writer
    headers = request.headers
    if writer is None:
        raise HTTPException(403, "This server is read-only: start it with `conetl view --decisions`.")
    # Browsers name the page that sends; other programs send neither header.
    if headers.get("origin", own := f"{request.url.scheme}://{headers.get('host')}") != own:
        raise HTTPException(403, _OWN_PAGE_ONLY)
    if headers.get("sec-fetch-site", "same-origin") != "same-origin":
        raise HTTPException(403, _OWN_PAGE_ONLY)
    scheme, _, given = headers.get("authorization", "").partition(" ")
    wanted = writer.token.get_secret_value().encode()
    if not (hmac.compare_digest(given.strip().encode(), wanted) and scheme.lower() == "bearer"):
        raise HTTPException(401, "The writer token is missing or wrong.", headers={"WWW-Authenticate": "Bearer"})
    if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise HTTPException(415, "A decision must be sent as application/json.")
    length = headers.get("content-length", "")
    if not length.isdigit():
        raise HTTPException(411, "A decision requires a Content-Length.")
    if int(length) > MAX_BODY_BYTES:
        raise HTTPException(413, f"A decision has at most {MAX_BODY_BYTES} bytes.")


def make_writer_token(home: Path) -> Path:
    """The token file under `home` (mode 600), created with a new token of 256 bits if it is missing."""
    path = home / "writer_token"
    home.mkdir(parents=True, exist_ok=True)
    try:
        handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    except FileExistsError:
        return path
    with os.fdopen(handle, "w") as file:
        file.write(f"{secrets.token_urlsafe(32)}\n")
    return path


def read_writer_token(path: Path) -> SecretStr:
    """The token in a file. Raises InputError if it is unreadable, accessible to others or too short; never quotes the token."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
        text = path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeError) as error:
        raise InputError(f"the writer token in {path} cannot be read: {type(error).__name__}") from error
    if mode & 0o077:
        raise InputError(f"{path} may be read or written by others (mode {mode:o}): run `chmod 600 {path}`")
    return checked_token(SecretStr(text), f"the file {path}")


def checked_token(token: SecretStr, source: str) -> SecretStr:
    """The token, if it is long enough and can be sent in a header. Raises InputError."""
    text = token.get_secret_value()
    if len(text) < MIN_TOKEN_LENGTH or not text.isascii() or not text.isprintable() or " " in text:
        raise InputError(
            f"{source} holds no writer token: at least {MIN_TOKEN_LENGTH} printable ASCII characters without a space"
        )
    return token
