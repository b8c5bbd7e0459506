"""Routes of decisions: the review queue, the decisions in effect, and new ones by holders of the writer token."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, get_args
from uuid import UUID

from fastapi import APIRouter, Body, HTTPException, Query, Request
from fastapi.responses import JSONResponse
from pydantic import Field, SecretStr, StringConstraints

from conetl.db.connection import Connection, connect
from conetl.db.map.decision_store import held_drives
from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import last_changes, read_feature_history, read_rows, review_page
from conetl.model.base import Record, Vec3
from conetl.model.errors import ConflictError, InputError
from conetl.model.health import HeldDrive
from conetl.pipeline.maps.decisions import accept_drive, approve_change, decide_location, revert
from conetl.pipeline.settings import Settings, read_settings
from conetl.reports.drive_passes import reasons_of
from conetl.web import models as m
from conetl.web import rows as to
from conetl.web.judging_models import Measured, Review, ReviewItem
from conetl.web.parameters import MapName, Origin, Reader, cut, origin_of
from conetl.web.security import WritersRoute, person_of

router = APIRouter(prefix="/maps/{map_name}", route_class=WritersRoute)
_MAX_DECISIONS = 1_000
#: How long a person waits for an ingest that has locked the map.
_LOCK_TIMEOUT_S = 15.0
ERRORS: dict[int | str, dict[str, Any]] = {
    409: {"model": m.Conflict, "description": "The feature has changed, or this was already decided."},
    401: {"model": m.Problem, "description": "The writer token is missing or wrong."},
    403: {
        "model": m.Problem,
        "description": "The server is read-only, the request comes from another page, or the person may not decide this.",
    },
    411: {"model": m.Problem, "description": "Content-Length is missing."},
    413: {"model": m.Problem, "description": "Too long."},
    415: {"model": m.Problem, "description": "Not JSON."},
}
_LINE = r"^[^\x00-\x1f\x7f]*$"
Name = Annotated[str, StringConstraints(strip_whitespace=True, min_length=2, max_length=80, pattern=_LINE)]
Reason = Annotated[str, StringConstraints(strip_whitespace=True, min_length=3, max_length=500, pattern=_LINE)]
#: Existence probabilities between these are near the threshold of 0.5.
_LEAST, _MOST = 0.3, 0.7
#: About half the width of a lane.
_MAX_ITEMS = 100
#: In the order of the queue, the statement of each kind of cones and its bounds.
_CONES: dict[str, tuple[str, dict[str, float | str]]] = {
    "removal": ("changes", {"change": "removed"}),
    "move": ("changes", {"change": "moved"}),
    "doubtful": ("doubtful", {"least": _LEAST, "most": _MOST}),
}
assert ("held", *_CONES) == get_args(ReviewItem.model_fields["kind"].annotation)


class _Request(Record):
    decided_by: Name
    """Name of the person; kept with the decision."""
    reason: Reason


class _About(_Request):
    feature_id: UUID
    expected_version: int = Field(ge=1, le=2**31 - 1)
    """Version of the feature that the person saw; 409 if it is another one now."""


class PlaceRequest(_About):
    """Whatever drives observe: no cone stands at the position of this feature (suppress), or the cone stands (pin)."""

    kind: Literal["suppress", "pin"]
    radius_m: float = Field(default=1.0, gt=0, le=20, allow_inf_nan=False)


class ClassRequest(_About):
    """The object that drives detect at the position of this feature is of another class."""

    kind: Literal["classify"]
    category: Annotated[str, StringConstraints(pattern=r"^[a-z_]{1,40}$")]


class ApproveRequest(_About):
    """What the last drive did to this feature is right; nothing changes on the map."""

    kind: Literal["approve"]


class DriveRequest(_Request):
    """The drive of a changeset is taken out of the map (revert), or merged although it is on hold (accept)."""

    kind: Literal["revert", "accept"]
    changeset_id: UUID


class WithdrawRequest(_Request):
    """A decision is withdrawn."""

    kind: Literal["withdraw"]
    decision_id: UUID


DecisionRequest = Annotated[
    PlaceRequest | ClassRequest | ApproveRequest | DriveRequest | WithdrawRequest, Field(discriminator="kind")
]


@dataclass(frozen=True)
class Writer:
    """The token that a server accepts, and the database of the decisions; each decision opens its own connection."""

    token: SecretStr
    database_url: str
    settings: Settings = field(default_factory=read_settings)
    """Folders of the QA reports that decisions change."""

    def decide(self, map_name: str, wish: DecisionRequest) -> m.Decided:
        """Write a decision as `conetl map suppress|pin|classify|revert` and `conetl drive accept` do.

        Raises InputError, ConflictError, DatabaseError.
        """
        from conetl.pipeline.publish import publish_decision  # matplotlib takes half a second to load

        common: dict[str, Any] = {
            "map_name": map_name, "note": wish.reason, "decided_by": wish.decided_by, "lock_timeout_s": _LOCK_TIMEOUT_S,
        }  # fmt: skip
        with closing(connect(self.database_url)) as conn:
            if isinstance(wish, ApproveRequest):
                done = approve_change(conn, wish.feature_id, expected_version=wish.expected_version, **common)
            elif isinstance(wish, _About):
                own = wish.model_dump(include={"kind", "radius_m", "category", "expected_version"})
                done = decide_location(conn, feature=str(wish.feature_id), **own, **common)
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
        return m.Decided(
            **{name: getattr(done, name) for name in m.Decided.model_fields if name not in computed}, **computed
        )


@router.get("/decisions", tags=["decisions"])
def decisions(map_name: MapName, conn: Reader, origin: Origin, request: Request) -> m.ActiveDecisions:
    """The decisions in effect, newest first."""
    rows = read_rows(conn, "decisions.active_decisions", map_name=map_name)
    found, truncated = cut(rows[::-1], _MAX_DECISIONS)
    person = person_of(request)
    writable = request.app.state.writer is not None and (person is None or person.may_decide)
    return m.ActiveDecisions(
        origin_m=origin,
        writable=writable,
        person=person.name if person else None,
        decides_drives=writable and (person is None or person.may_decide_drives),
        decisions=[to.decision(row, origin) for row in found],
        truncated=truncated,
    )


@router.post("/decisions", tags=["decisions"], status_code=201, response_model=m.Decided, responses=ERRORS)
def decide(
    map_name: MapName, decision: Annotated[DecisionRequest, Body()], request: Request
) -> m.Decided | JSONResponse:
    """Suppress or pin the position of a feature, correct its class, approve its last change; revert or accept a drive; withdraw a
    decision. The map is updated at once."""
    writer: Writer = request.app.state.writer
    if (person := person_of(request)) is not None:
        decision = decision.model_copy(update={"decided_by": person.name})
        if not person.may_decide_drives and _is_about_drive(request.app.state.pool, map_name, decision):
            raise HTTPException(403, "Decisions about whole drives require the role admin.")
    try:
        return writer.decide(map_name, decision)
    except ConflictError as error:
        conflict = m.Conflict(detail=sentence(error), now=_current_state(request.app.state.pool, map_name, decision))
        return JSONResponse(conflict.model_dump(mode="json"), status_code=409)
    except InputError as error:
        raise HTTPException(404, sentence(error)) from error


def _is_about_drive(pool: ReaderPool, map_name: str, decision: DecisionRequest) -> bool:
    if not isinstance(decision, WithdrawRequest):
        return isinstance(decision, DriveRequest)
    with pool.reading() as conn:
        rows = read_rows(conn, "decisions.active_decisions", map_name=map_name)
    return any(row["changeset_id"] is not None for row in rows if row["decision_id"] == decision.decision_id)


def _current_state(pool: ReaderPool, map_name: str, decision: DecisionRequest) -> Any:
    """The newest state of the feature of a decision; None for decisions about something else."""
    if not isinstance(decision, _About):
        return None
    with pool.reading() as conn:
        origin = origin_of(conn, map_name)
        last = read_feature_history(conn, map_name, decision.feature_id, origin_m=origin)[-1:]
        reasons = reasons_of(conn, last)
        return to.history(last, reasons)[0] if last else None


def sentence(error: Exception) -> str:
    """Its message, as an answer."""
    text = str(error)
    return text[:1].upper() + text[1:]


@router.get("/review", tags=["review"])
def review(
    map_name: MapName,
    conn: Reader,
    origin: Origin,
    offset: Annotated[int, Query(ge=0, le=1_000_000)] = 0,
    limit: Annotated[int, Query(ge=1, le=_MAX_ITEMS)] = 50,
) -> Review:
    """What to review: drives on hold, removed cones, moves of 1 m or more, cones with an existence probability of 0.3 to 0.7.
    What was decided already is left out."""
    held = held_drives(conn, map_name=map_name)
    counts = {"held": len(held)}
    items = [_held(drive) for drive in held[offset : offset + limit]]
    before = len(held)
    for kind, (statement, bounds) in _CONES.items():
        first_row, max_rows = max(offset - before, 0), limit - len(items)
        counts[kind], ids = review_page(conn, map_name, statement, first_row=first_row, max_rows=max_rows, **bounds)
        changes = last_changes(conn, map_name, ids)
        items += _cones(conn, kind, [changes[one] for one in ids if one in changes], origin)
        before += counts[kind]
    return Review(origin_m=origin, counts=counts, items=items)


def _held(drive: HeldDrive) -> ReviewItem:
    checks = [Measured(name=c.name, figures=c.figures, detail=c.detail) for c in drive.checks]
    return ReviewItem(
        kind="held", changeset_no=drive.changeset_no, changeset_id=drive.changeset_id, drive_id=drive.drive_id, at=drive.since,
        why=drive.reason, checks=checks, feature_id=None, version=None, xyz_m=None, existence_probability=None,
        category=None,
    )  # fmt: skip


def _cones(conn: Connection, kind: Any, rows: list[dict[str, Any]], origin: Vec3) -> list[ReviewItem]:
    return [
        to.answer(ReviewItem, row, origin, kind=kind, changeset_id=None, at=row["changed_at"], why=why, checks=[])
        for row, why in zip(rows, reasons_of(conn, rows), strict=True)
    ]
