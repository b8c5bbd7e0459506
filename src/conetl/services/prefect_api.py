"""A Prefect server as seen from outside, without importing Prefect: its command, its health, access to it."""

from __future__ import annotations

import sys

import httpx

from conetl.model.errors import ServiceError

_TIMEOUT_S = 5


def server_command(host: str, port: int) -> list[str]:
    """Command line of a Prefect server that answers to its own names only."""
    return [sys.executable, "-m", "flows.server_app", host, str(port)]


def answers(url: str) -> bool:
    """Whether GET `url` returns 200, or asks for a login."""
    try:
        answer = httpx.get(url, timeout=_TIMEOUT_S, trust_env=False)
        return answer.status_code in (httpx.codes.OK, httpx.codes.UNAUTHORIZED)
    except httpx.HTTPError:
        return False


def is_healthy(api: str) -> bool:
    """Whether a Prefect API answers; this requires no password."""
    return answers(f"{api}/health")


def require_access(api: str, auth: str | None, variable: str) -> None:
    """Raise ServiceError if a server rejects `auth` (user:password), naming the `variable` to set.

    Checked first because each of Prefect's clients fails differently. A server that does not answer is ignored.
    """
    credentials = None if auth is None else httpx.BasicAuth(*auth.partition(":")[::2])
    try:
        answer = httpx.get(f"{api}/admin/version", auth=credentials, timeout=_TIMEOUT_S, trust_env=False)
    except httpx.HTTPError:
        return
    if answer.status_code == httpx.codes.UNAUTHORIZED:
        given = "none was given" if auth is None else "it rejected the one given"
        raise ServiceError(
            f"the Prefect server at {api} requires a user and password, and {given}: set {variable} to the user:password that "
            "the server was started with. Nothing was written."
        )


def unavailable(error: BaseException) -> ServiceError | None:
    """The error of a Prefect server that stopped answering meanwhile, or whose database did; None for any other error.

    Where conetl noticed first that a service is gone, and Prefect failed because of that, the first one is the error.
    """
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in chain:
        chain.append(cause)
        cause = cause.__cause__ or cause.__context__
    for cause in chain:
        if isinstance(cause, ServiceError):
            return cause
    for cause in chain:
        failed = (
            isinstance(cause, httpx.HTTPStatusError) and cause.response.status_code >= httpx.codes.INTERNAL_SERVER_ERROR
        )
        if failed or isinstance(cause, httpx.TransportError):
            said = str(cause).partition("\n")[0].partition(" - ")[0] or type(cause).__name__
            return ServiceError(
                f"the Prefect server stopped answering ({said}); it may have lost its database, which is PostgreSQL under "
                "`conetl up`. `conetl status` shows what runs; run the same command again: what is on the map stays."
            )
    return None
