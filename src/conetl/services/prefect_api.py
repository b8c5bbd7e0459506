"""A Prefect server, as far as it can be known without Prefect: whether it answers, and whether it lets this process in."""

from __future__ import annotations

import httpx

from conetl.model.errors import ServiceError

_TIMEOUT_S = 5


def is_healthy(api: str) -> bool:
    """Whether a server answers at an API's address; it needs no password for it."""
    try:
        return httpx.get(f"{api}/health", timeout=_TIMEOUT_S, trust_env=False).status_code == httpx.codes.OK
    except httpx.HTTPError:
        return False


def require_access(api: str, auth: str | None, variable: str) -> None:
    """Raises ServiceError where a server asks for another password than `auth` (user:password), naming the `variable` to set.

    Asked first, since each of Prefect's many clients has its own way to fail of it. A server that does not answer is passed over.
    """
    who = None if auth is None else httpx.BasicAuth(*auth.partition(":")[::2])
    try:
        answer = httpx.get(f"{api}/admin/version", auth=who, timeout=_TIMEOUT_S, trust_env=False)
    except httpx.HTTPError:
        return
    if answer.status_code == httpx.codes.UNAUTHORIZED:
        what = "none was given" if auth is None else "another one was given"
        raise ServiceError(
            f"the Prefect server at {api} asks for its user and password, and {what}: set {variable} to the user:password that "
            "the server was started with. Nothing was written."
        )
