"""Who may write: holders of the server's writer token, from the server's own page, in JSON. Checked before a body is read."""

from __future__ import annotations

import hmac
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol
from uuid import UUID

from fastapi import HTTPException, Request, Response
from fastapi.routing import APIRoute
from pydantic import BaseModel, ConfigDict, Field, SecretStr, StringConstraints

from conetl.web.models import Decided

MAX_BODY_BYTES = 8192
_LINE = r"^[^\x00-\x1f\x7f]*$"
Name = Annotated[str, StringConstraints(strip_whitespace=True, min_length=2, max_length=80, pattern=_LINE)]
Reason = Annotated[str, StringConstraints(strip_whitespace=True, min_length=3, max_length=500, pattern=_LINE)]


class _Wish(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    decided_by: Name
    """Name of the person; kept with the decision."""
    reason: Reason


class PlaceWish(_Wish):
    """Nothing stands where this feature is (suppress), or the cone stands (pin), whatever drives see."""

    kind: Literal["suppress", "pin"]
    feature_id: UUID
    expected_version: int = Field(ge=1, le=2**31 - 1)
    """Version of the feature that the person looked at; 409 where it is another one now."""
    radius_m: float = Field(default=1.0, gt=0, le=20, allow_inf_nan=False)


class RevertWish(_Wish):
    """A changeset's drive does not count any more."""

    kind: Literal["revert"]
    changeset_id: UUID


class WithdrawWish(_Wish):
    """A decision is taken back."""

    kind: Literal["withdraw"]
    decision_id: UUID


Wish = Annotated[PlaceWish | RevertWish | WithdrawWish, Field(discriminator="kind")]


class Decide(Protocol):
    """Writes a decision. Raises InputError where it cannot be, ConflictError where things changed, DatabaseError."""

    def __call__(self, map_name: str, wish: PlaceWish | RevertWish | WithdrawWish, /) -> Decided: ...


@dataclass(frozen=True)
class Writer:
    """What a server needs to take decisions."""

    token: SecretStr
    decide: Decide


class WritersRoute(APIRoute):
    """A route for holders of the writer token: everything else is refused before the body is read."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()

        async def guarded(request: Request) -> Response:
            if request.method not in {"GET", "HEAD"}:
                _require_writer(request)
            return await handle(request)

        return guarded


def _require_writer(request: Request) -> None:
    writer: Writer | None = request.app.state.writer
    headers = request.headers
    if writer is None:
        raise HTTPException(403, "This server takes no decisions: start it with `conetl view --decisions`.")
    # A browser names the page that sends; a program that is no browser holds no other page's trust.
    if headers.get("origin", own := f"{request.url.scheme}://{headers.get('host')}") != own:
        raise HTTPException(403, "Decisions are taken from this server's own page only.")
    if headers.get("sec-fetch-site", "same-origin") != "same-origin":
        raise HTTPException(403, "Decisions are taken from this server's own page only.")
    scheme, _, given = headers.get("authorization", "").partition(" ")
    wanted = writer.token.get_secret_value().encode()
    if not (hmac.compare_digest(given.strip().encode(), wanted) and scheme.lower() == "bearer"):
        raise HTTPException(
            401, "The writer token is missing or is not this server's.", headers={"WWW-Authenticate": "Bearer"}
        )
    if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise HTTPException(415, "A decision is sent as application/json.")
    length = headers.get("content-length", "")
    if not length.isdigit():
        raise HTTPException(411, "A decision comes with its length.")
    if int(length) > MAX_BODY_BYTES:
        raise HTTPException(413, f"A decision has at most {MAX_BODY_BYTES} bytes.")
