"""Who may call the server: logins, refusal of other web pages, headers of every answer, and who may decide."""

from __future__ import annotations

import base64
import hmac
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from fastapi import HTTPException, Request, Response
from fastapi.routing import APIRoute
from pydantic import SecretStr
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import JSONResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from conetl.files.people import Person

#: Bytes of path and query together; a filter by a hundred ids has 4 kB.
MAX_URL_BYTES = 8_192
MAX_BODY_BYTES = 8_192
_CROSS_SITE = "This server answers its own pages and programs on this machine, not other web pages."
_OWN_PAGE_ONLY = "Decisions are accepted from this server's own page only."
_LOG_IN = (
    "Log in: open the address with the token that `conetl status` or `conetl view` prints, or give the token (your own of "
    "`conetl user add`, or the file view_token in CONETL_HOME) as the password, with any user name."
)
_WRONG_TOKEN = "The writer token is missing or wrong: `conetl view` prints the path of its file when it starts."
_REALM = "conetl view, token as password"
_LOGIN_S = 30 * 86_400
#: Names by which a browser on this machine may call; any other belongs to a page elsewhere that rebound its name to this machine.
_LOOPBACK_NAMES = ["127.0.0.1", "localhost", "[::1]"]
#: The page that another server's pages may show in a frame, if the operator names that server.
EMBED_PATH = "/embed.html"
#: Only this server's own files run or load, and no other page may embed or read them.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:{images}; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors {frames}"
)
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Cache-Control": "no-cache",
}


class Guard:
    """ASGI middleware: refusal of requests of other pages, for other hosts and of overlong ones; login; headers of every answer.

    Other pages could not read the answers, but they could keep the server and its streams busy. Streams are not buffered.
    tokens: one of them is required of every request, as a cookie, as the password of Basic authentication, as a Bearer token, or
    once as `?token=` of a page, which sets the cookie; without tokens, everybody who reaches the server may read.
    find_person: who has a token of a person; the routes find them by `person_of`.
    image_host: the one other server whose images pages may load, such as https://tiles.example; None for none.
    embed_host: the one other server whose pages may show EMBED_PATH in a frame; None for none.
    """

    def __init__(
        self,
        app: ASGIApp,
        tokens: Sequence[SecretStr] = (),
        find_person: Callable[[str], Person | None] = lambda _: None,
        image_host: str | None = None,
        embed_host: str | None = None,
    ) -> None:
        self._app = app
        # Before the login, which answers with an address of this host.
        self._of_own_host = TrustedHostMiddleware(self._logged_in, allowed_hosts=_LOOPBACK_NAMES, www_redirect=False)
        images = f" {image_host}" if image_host else ""
        self._headers = _HEADERS | {"Content-Security-Policy": _POLICY.format(images=images, frames="'none'")}
        self._may_be_framed = {EMBED_PATH} if embed_host else set()
        self._embed_headers = self._headers | {
            "Content-Security-Policy": _POLICY.format(images=images, frames=embed_host)
        }
        del self._embed_headers["X-Frame-Options"]  # it has no form for one other server
        self._tokens = [token.get_secret_value() for token in tokens]
        self._find_person = find_person

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        is_embed = scope.get("path") in self._may_be_framed
        own = self._embed_headers if is_embed else self._headers

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in own.items():
                    headers.setdefault(name, value)  # a route may set its own policy
            await send(message)

        if scope["type"] == "http":
            if scope["method"] == "HEAD" and scope["path"].startswith("/ogc/"):
                scope = {**scope, "method": "GET"}  # the server leaves out the body
            await (_refusal(scope, may_be_framed=is_embed) or self._of_own_host)(scope, receive, send_with_headers)
        else:
            await self._app(scope, receive, send)

    async def _logged_in(self, scope: Scope, receive: Receive, send: Send) -> None:
        await (self._login(scope) or self._app)(scope, receive, send)

    def _login(self, scope: Scope) -> Response | None:
        """What to answer instead of the request; None for one that is logged in."""
        request = Request(scope)
        # Cookies of one name are shared by all ports of a host.
        cookie = f"conetl_view_{(scope.get('server') or ('', 0))[1]}"
        # Also of those who are logged in: links that they send must not contain the token.
        if self._is_known(given := request.query_params.get("token", "")):
            answer = RedirectResponse(request.url.remove_query_params("token"), status_code=303)
            answer.set_cookie(cookie, given, max_age=_LOGIN_S, httponly=True, samesite="lax")
            return answer
        if not self._tokens:
            return None
        for given in (request.cookies.get(cookie, ""), _credential(request)):
            if self._is_known(given):
                scope.setdefault("state", {})["person"] = self._find_person(given)
                return None
        # For Basic a browser opens a dialog of its own, at every request of a page that is open; the page asks once.
        scheme = "Bearer" if request.headers.get("sec-fetch-dest") == "empty" else "Basic"
        return JSONResponse(
            {"detail": _LOG_IN}, status_code=401, headers={"WWW-Authenticate": f'{scheme} realm="{_REALM}"'}
        )

    def _is_known(self, given: str) -> bool:
        is_shared = any(hmac.compare_digest(given.encode(), token.encode()) for token in self._tokens)
        return is_shared or (bool(given) and self._find_person(given) is not None)


def _credential(request: Request) -> str:
    """The Bearer token or the Basic password of a request; empty without one."""
    scheme, _, value = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        return value.strip()
    try:
        return base64.b64decode(value, validate=True).decode().partition(":")[2] if scheme.lower() == "basic" else ""
    except ValueError:
        return ""


def _refusal(scope: Scope, *, may_be_framed: bool) -> JSONResponse | None:
    if len(scope.get("raw_path") or b"") + len(scope["query_string"]) > MAX_URL_BYTES:
        return JSONResponse({"detail": f"The URL has more than {MAX_URL_BYTES} bytes."}, status_code=414)
    if not scope["path"].isprintable():
        code = {"code": "NotFound"} if scope["path"].startswith("/ogc") else {}
        return JSONResponse(code | {"detail": "The path contains control characters."}, status_code=404)
    if _is_cross_site(Headers(scope=scope), may_be_framed=may_be_framed):
        return JSONResponse({"detail": _CROSS_SITE}, status_code=403)
    return None


def _is_cross_site(headers: Headers, *, may_be_framed: bool) -> bool:
    """True for a request of another web page (Fetch Metadata, Origin), except for a followed link and an allowed frame."""
    origin, host = headers.get("origin"), headers.get("host")
    if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
        return True
    shown_in = ("document", "iframe") if may_be_framed else ("document",)
    is_link = headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") in shown_in
    return headers.get("sec-fetch-site") in ("cross-site", "same-site") and not is_link


def person_of(request: Request) -> Person | None:
    """Who is logged in by name; None for holders of the view's own token, and without logins."""
    return getattr(request.state, "person", None)


class WritersRoute(APIRoute):
    """A route that accepts other methods than GET from people who may decide, and from holders of the writer token who are not
    logged in by name; refuses before it reads the body."""

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
    has_token = hmac.compare_digest(given.strip().encode(), wanted) and scheme.lower() == "bearer"
    person = person_of(request)
    if person is not None and not person.may_decide:
        raise HTTPException(403, f"{person.name} has the role {person.role}: decisions require the role review.")
    if person is None and not has_token:
        raise HTTPException(401, _WRONG_TOKEN, headers={"WWW-Authenticate": "Bearer"})
    if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise HTTPException(415, "A decision must be sent as application/json.")
    length = headers.get("content-length", "")
    if not length.isdigit():
        raise HTTPException(411, "A decision requires a Content-Length.")
    if int(length) > MAX_BODY_BYTES:
        raise HTTPException(413, f"A decision has at most {MAX_BODY_BYTES} bytes.")
