"""Routes of decisions: those that are in effect, and new ones by holders of the writer token."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal
from uuid import UUID

from fastapi import APIRouter, Body, HTTPException, Request
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field, SecretStr, StringConstraints

from conetl.db.connection import connect
from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_decisions, read_feature_history
from conetl.model.errors import ConflictError, InputError
from conetl.pipeline.maps.decisions import accept_drive, decide_place, revert
from conetl.pipeline.settings import Settings, read_settings
from conetl.reports.drive_passes import reasons_of
from conetl.web import rows as to
from conetl.web.models import ActiveDecisions, Conflict, Decided, Problem
from conetl.web.parameters import MapName, Reader, cut, origin_of
from conetl.web.security import WritersRoute

router = APIRouter(tags=["decisions"], prefix="/maps/{map_name}/decisions", route_class=WritersRoute)
_MAX_DECISIONS = 1_000
#: How long a person waits for an ingest that has locked the map.
_LOCK_TIMEOUT_S = 15.0
_ERRORS: dict[int | str, dict[str, Any]] = {
    409: {"model": Conflict, "description": "The feature changed meanwhile, or this was decided already."},
    401: {"model": Problem, "description": "The writer token is missing or wrong."},
    403: {"model": Problem, "description": "The server is read-only, or the request comes from another page."},
    411: {"model": Problem, "description": "Content-Length is missing."},
    413: {"model": Problem, "description": "Too long."},
    415: {"model": Problem, "description": "Not JSON."},
}
_LINE = r"^[^\x00-\x1f\x7f]*$"
Name = Annotated[str, StringConstraints(strip_whitespace=True, min_length=2, max_length=80, pattern=_LINE)]
Reason = Annotated[str, StringConstraints(strip_whitespace=True, min_length=3, max_length=500, pattern=_LINE)]


class _Request(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    decided_by: Name
    """Name of the person; kept with the decision."""
    reason: Reason


class PlaceRequest(_Request):
    """No cone stands at the position of this feature (suppress), or the cone stands (pin), whatever drives observe."""

    kind: Literal["suppress", "pin"]
    feature_id: UUID
    expected_version: int = Field(ge=1, le=2**31 - 1)
    """Version of the feature that the person saw; 409 if it is another one now."""
    radius_m: float = Field(default=1.0, gt=0, le=20, allow_inf_nan=False)


class DriveRequest(_Request):
    """The drive of a changeset no longer counts (revert), or counts although it is on hold (accept)."""

    kind: Literal["revert", "accept"]
    changeset_id: UUID


class WithdrawRequest(_Request):
    """A decision is withdrawn."""

    kind: Literal["withdraw"]
    decision_id: UUID


DecisionRequest = Annotated[PlaceRequest | DriveRequest | WithdrawRequest, Field(discriminator="kind")]


@dataclass(frozen=True)
class Writer:
    """The token that a server accepts, and the database of the decisions; each opens a connection of its own that can write."""

    token: SecretStr
    database_url: str
    settings: Settings = field(default_factory=read_settings)
    """Folders of the QA reports that decisions change."""

    def decide(self, map_name: str, wish: DecisionRequest) -> Decided:
        """Write a decision as `conetl map suppress|pin|revert` and `conetl drive accept` do. Raises InputError, ConflictError,
        DatabaseError."""
        from conetl.pipeline.publish import publish_decision  # matplotlib takes half a second to load

        common: dict[str, Any] = {
            "map_name": map_name, "note": wish.reason, "decided_by": wish.decided_by, "lock_timeout_s": _LOCK_TIMEOUT_S,
        }  # fmt: skip
        with closing(connect(self.database_url)) as conn:
            if isinstance(wish, PlaceRequest):
                done = decide_place(
                    conn, wish.kind, str(wish.feature_id), radius_m=wish.radius_m,
                    expected_version=wish.expected_version, **common,
                )  # fmt: skip
            elif wish.kind == "accept":
                done = accept_drive(conn, str(wish.changeset_id), **common)
            else:
                what = wish.changeset_id if isinstance(wish, DriveRequest) else wish.decision_id
                done = revert(conn, str(what), **common)
            problem = publish_decision(conn, done, self.settings.model_copy(update={"map_name": map_name}))
        computed = {
            "also_changed": [conflict.feature_id for conflict in done.conflicts],
            "hold_changes": [change.sentence for change in done.hold_changes],
            "report_problem": problem,
        }
        return Decided(
            **{name: getattr(done, name) for name in Decided.model_fields if name not in computed}, **computed
        )


@router.get("")
def decisions(map_name: MapName, conn: Reader, request: Request) -> ActiveDecisions:
    """The decisions in effect, newest first."""
    origin = origin_of(conn, map_name)
    found, truncated = cut(read_decisions(conn, map_name, _MAX_DECISIONS + 1), _MAX_DECISIONS)
    return ActiveDecisions(
        origin_m=origin,
        writable=request.app.state.writer is not None,
        decisions=[to.decision(row, origin) for row in found],
        truncated=truncated,
    )


@router.post("", status_code=201, response_model=Decided, responses=_ERRORS)
def decide(map_name: MapName, decision: Annotated[DecisionRequest, Body()], request: Request) -> Decided | JSONResponse:
    """Suppress or pin the position of a feature, revert a changeset, or withdraw a decision; the map is updated at once."""
    writer: Writer = request.app.state.writer
    try:
        return writer.decide(map_name, decision)
    except ConflictError as error:
        conflict = Conflict(detail=_sentence(error), now=_current_state(request.app.state.pool, map_name, decision))
        return JSONResponse(conflict.model_dump(mode="json"), status_code=409)
    except InputError as error:
        raise HTTPException(404, _sentence(error)) from error


def _current_state(pool: ReaderPool, map_name: str, decision: DecisionRequest) -> Any:
    """The newest state of the feature of a decision; None for decisions about something else."""
    if not isinstance(decision, PlaceRequest):
        return None
    with pool.reading() as conn:
        last = read_feature_history(conn, map_name, decision.feature_id)[-1:]
        reasons = reasons_of(conn, map_name, decision.feature_id, last)
        return to.history(last, reasons, origin_of(conn, map_name))[0] if last else None


def _sentence(error: Exception) -> str:
    text = str(error)
    return text[:1].upper() + text[1:]
