"""Route of the review queue: what needs a person first."""

from __future__ import annotations

from typing import Annotated, Any, get_args

from fastapi import APIRouter, Query

from conetl.db.connection import Connection
from conetl.db.judging_store import last_changes, review_page
from conetl.db.map.hold_store import held_drives
from conetl.model.health import HeldDrive
from conetl.model.records import Vec3
from conetl.reports.drive_passes import reasons_of
from conetl.web import judging_models as m
from conetl.web import rows as to
from conetl.web.parameters import MapName, Reader, origin_of

router = APIRouter(tags=["review"], prefix="/maps/{map_name}")
#: Existence probabilities between these are near the threshold of 0.5.
_LEAST, _MOST = 0.3, 0.7
#: A move as large as a lane is half wide.
_MOVED_FROM_M = 1.0
_MAX_ITEMS = 100
#: In the order of the queue, the statement of each kind of cones and its bounds.
_CONES: dict[str, tuple[str, dict[str, float | str]]] = {
    "removal": ("changes", {"change": "removed", "moved_from_m": _MOVED_FROM_M}),
    "move": ("changes", {"change": "moved", "moved_from_m": _MOVED_FROM_M}),
    "doubtful": ("doubtful", {"least": _LEAST, "most": _MOST}),
}
assert ("held", *_CONES) == get_args(m.ReviewItem.model_fields["kind"].annotation)


@router.get("/review")
def review(
    map_name: MapName,
    conn: Reader,
    offset: Annotated[int, Query(ge=0, le=1_000_000)] = 0,
    limit: Annotated[int, Query(ge=1, le=_MAX_ITEMS)] = 50,
) -> m.Review:
    """What waits for a person: drives on hold, removed cones, moves of 1 m or more, cones with an existence probability of 0.3 to
    0.7. What somebody decided is not in it."""
    origin = origin_of(conn, map_name)
    held = held_drives(conn, map_name=map_name)
    counts = {"held": len(held)}
    items = [_held(drive) for drive in held[offset : offset + limit]]
    before = len(held)
    for kind, (statement, bounds) in _CONES.items():
        first_row, max_rows = max(offset - before, 0), limit - len(items)
        counts[kind], ids = review_page(conn, map_name, statement, first_row=first_row, max_rows=max_rows, **bounds)
        changes = last_changes(conn, map_name, ids)
        items += _cones(conn, map_name, kind, [changes[one] for one in ids if one in changes], origin)
        before += counts[kind]
    return m.Review(origin_m=origin, counts=counts, items=items)


def _held(drive: HeldDrive) -> m.ReviewItem:
    checks = [m.Measured(name=c.name, figures=c.figures, detail=c.detail) for c in drive.checks]
    return m.ReviewItem(
        kind="held", changeset_no=drive.changeset_no, changeset_id=drive.changeset_id, drive_id=drive.drive_id, at=drive.since,
        why=drive.reason, checks=checks, feature_id=None, version=None, xyz_m=None, existence_probability=None,
    )  # fmt: skip


def _cones(conn: Connection, map_name: str, kind: Any, rows: list[dict[str, Any]], origin: Vec3) -> list[m.ReviewItem]:
    return [
        to.answer(m.ReviewItem, row, origin, kind=kind, changeset_id=None, at=row["changed_at"], why=why, checks=[])
        for row, why in zip(rows, reasons_of(conn, map_name, None, rows), strict=True)
    ]
