"""What people decided about a map, and their new decisions."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, HTTPException, Request
from fastapi.responses import JSONResponse

from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_decisions, read_feature_history
from conetl.model.errors import ConflictError, InputError
from conetl.web import rows as to
from conetl.web.models import Conflict, Decided, Decisions, Problem
from conetl.web.parameters import MapName, Reader, origin_of
from conetl.web.writing import PlaceWish, Wish, Writer, WritersRoute

router = APIRouter(tags=["decisions"], prefix="/maps/{map_name}/decisions", route_class=WritersRoute)
_MAX_DECISIONS = 1_000
_REFUSALS: dict[int | str, dict[str, Any]] = {
    409: {"model": Conflict, "description": "The feature changed meanwhile, or this was decided already."},
    401: {"model": Problem, "description": "No writer token, or another one."},
    403: {"model": Problem, "description": "This server takes no decisions, or not from that page."},
    411: {"model": Problem, "description": "No length."},
    413: {"model": Problem, "description": "Too long."},
    415: {"model": Problem, "description": "Not JSON."},
}


@router.get("")
def decisions(map_name: MapName, conn: Reader, request: Request) -> Decisions:
    """The decisions that hold, newest first."""
    origin = origin_of(conn, map_name)
    found = read_decisions(conn, map_name, _MAX_DECISIONS + 1)
    return Decisions(
        origin_m=origin,
        writable=request.app.state.writer is not None,
        decisions=[to.decision(row, origin) for row in found[:_MAX_DECISIONS]],
        truncated=len(found) > _MAX_DECISIONS,
    )


@router.post("", status_code=201, response_model=Decided, responses=_REFUSALS)
def decide(map_name: MapName, wish: Annotated[Wish, Body()], request: Request) -> Decided | JSONResponse:
    """Suppress or pin the place of a feature, revert a changeset, or withdraw a decision; what follows is worked out at once."""
    writer: Writer = request.app.state.writer
    try:
        return writer.decide(map_name, wish)
    except ConflictError as error:
        conflict = Conflict(detail=_sentence(error), now=_now(request.app.state.pool, map_name, wish))
        return JSONResponse(conflict.model_dump(mode="json"), status_code=409)
    except InputError as error:
        raise HTTPException(404, _sentence(error)) from error


def _now(pool: ReaderPool, map_name: str, wish: Wish) -> Any:
    """The newest state of the feature that a person decided about."""
    if not isinstance(wish, PlaceWish):
        return None
    with pool.reading() as conn:
        history = read_feature_history(conn, map_name, wish.feature_id)
        return to.history_item(history[-1], origin_of(conn, map_name)) if history else None


def _sentence(error: Exception) -> str:
    text = str(error)
    return text[:1].upper() + text[1:]
