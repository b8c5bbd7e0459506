"""Routes of lists: features and changes by pages, filtered and sorted by the database, and changes by what is in view.

A list is asked for from a row on (`offset`, for a scroll bar), or after the last row of another page (`after`, its `next`), which
is as fast at the end of a long list as at its beginning.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from typing import Annotated, Any, NamedTuple
from uuid import UUID

import shapely
from fastapi import APIRouter, Depends, Query, Response
from fastapi.exceptions import RequestValidationError
from pydantic import AfterValidator, FiniteFloat

from conetl.db.connection import or_infinity
from conetl.db.list_store import KINDS, ORDERS, Listed, ListOrder
from conetl.db.map.map_store import require_map
from conetl.db.serve_store import read_rows
from conetl.web import models as m
from conetl.web import rows as to
from conetl.web.listing import listing
from conetl.web.parameters import Instant, MapName, Origin, Reader

router = APIRouter(tags=["lists"], prefix="/maps/{map_name}")
#: Changes that a view shows one by one, as of a tile.
MAX_IN_VIEW = 2_000
_MAX_ROWS = 1_000
_MAX_CORNERS = 32
_DRAWN: dict[str, type[m.Change]] = {"changes": m.Change, "markings": m.StretchChange}
#: How keys of pages are read that are no numbers.
_KEYS: dict[str, Callable[[str], object]] = {"id": UUID, "seen": datetime.fromisoformat}
Words = Annotated[list[str] | None, Query(max_length=64)]
Share = Annotated[float | None, Query(ge=0, le=1)]
Metres = Annotated[float | None, Query(ge=0, le=1_000, allow_inf_nan=False)]
Number = Annotated[int | None, Query(ge=1, le=2**62)]


def _corners(area: list[float] | None) -> list[float] | None:
    if area and (len(area) < 6 or len(area) % 2):
        raise ValueError("expected easting and northing of at least three points")
    return area


def read_filters(
    map_name: MapName,
    conn: Reader,
    kinds: Words = None,
    hidden_classes: Words = None,
    least_existence: Share = None,
    most_existence: Share = None,
    most_sigma_m: Metres = None,
    least_height_m: Metres = None,
    most_height_m: Metres = None,
    of_changeset: Annotated[Number, Query(description="Changeset that wrote the row.")] = None,
    seen_from: Instant = None,
    seen_before: Instant = None,
    area: Annotated[
        list[FiniteFloat] | None, AfterValidator(_corners),
        Query(
            max_length=2 * _MAX_CORNERS, description="Easting, northing of at least three points: the area between them."
        ),
    ] = None,
) -> dict[str, Any]:  # fmt: skip
    """Conditions of the rows; without any, all are listed."""
    box = None
    if area:
        hull = shapely.MultiPoint(list(zip(area[::2], area[1::2], strict=True))).convex_hull
        box = f"SRID={require_map(conn, map_name).srid};{hull.wkt}"
    found = {
        "kinds": kinds, "hidden_classes": hidden_classes, "least_existence": least_existence, "most_existence": most_existence,
        "most_sigma_m": most_sigma_m, "least_height_m": least_height_m, "most_height_m": most_height_m,
        "of_changeset": of_changeset, "seen_from": seen_from, "seen_before": seen_before, "box": box,
    }  # fmt: skip
    return {name: value for name, value in found.items() if value is not None}


Filters = Annotated[dict[str, Any], Depends(read_filters)]


def features_of(
    map_name: MapName, conn: Reader, filters: Filters, valid_at: Instant = None, known_at: Instant = None
) -> Listed:
    """What stood on a map at `valid_at`, as known at `known_at`."""
    state = {"map_name": map_name, "valid_at": or_infinity(valid_at), "known_at": or_infinity(known_at)}
    [row] = read_rows(conn, "serving.is_now", **state)
    return Listed("standing" if row["is_now"] else "stood", state, filters)


def changes_of(
    map_name: MapName,
    filters: Filters,
    changeset_no: Annotated[Number, Query(description="Its changes, instead of those between two instants.")] = None,
    from_valid_at: Instant = None,
    from_known_at: Instant = None,
    to_valid_at: Instant = None,
    to_known_at: Instant = None,
) -> Listed:
    """What a changeset did to every feature that its drive could see, or how a map differs between two instants, each as
    known at its own."""
    if changeset_no is not None:
        return Listed("changed_by", {"map_name": map_name, "changeset_no": changeset_no}, filters)
    instants: dict[str, datetime | None] = {
        "from_valid_at": from_valid_at, "from_known_at": from_known_at, "to_valid_at": to_valid_at, "to_known_at": to_known_at,
    }  # fmt: skip
    return Listed(
        "changed_between", {"map_name": map_name, **{k: or_infinity(v) for k, v in instants.items()}}, filters
    )


def read_order(
    sort: Annotated[
        str, Query(pattern=f"^({'|'.join(ORDERS)})-?$", description="A column; - after it: descending.")
    ] = "id",
) -> ListOrder:
    """The order of a list."""
    return ListOrder(sort.removesuffix("-"), sort.endswith("-"))


class Slice(NamedTuple):
    """Which rows of a list are asked for."""

    order: ListOrder
    limit: int
    offset: int
    after: tuple[str, int] | None

    def read(self, conn: Reader, rows: Listed, origin: Origin) -> tuple[list[dict[str, Any]], str | None]:
        """The rows of a page, and where the next one begins."""
        found = rows.page(
            conn, self.order, rows=self.limit + 1, offset=self.offset, after=self.after, origin_m=list(origin)
        )
        page = found[: self.limit]
        return page, f"{page[-1]['key']},{page[-1]['row_id']}" if len(found) > len(page) > 0 else None


def read_slice(
    order: Annotated[ListOrder, Depends(read_order)],
    limit: Annotated[int, Query(ge=1, le=_MAX_ROWS)] = 100,
    offset: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0,
    after: Annotated[str | None, Query(max_length=100, description="`next` of another page of this order.")] = None,
) -> Slice:
    """From `offset` rows on, or from there after a page."""
    if after is None:
        return Slice(order, limit, offset, None)
    key, _, row_id = after.rpartition(",")
    try:
        _KEYS.get(order.by, float)(key)
        return Slice(order, limit, offset, (key, int(row_id)))
    except ValueError as error:
        problem = {
            "type": "value_error",
            "loc": ("query", "after"),
            "msg": "it is not the next of a page in this order",
        }
        raise RequestValidationError([problem]) from error


Features = Annotated[Listed, Depends(features_of)]
Changes = Annotated[Listed, Depends(changes_of)]
Page = Annotated[Slice, Depends(read_slice)]


@router.get("/features")
def features(conn: Reader, origin: Origin, rows: Features, page: Page) -> m.FeaturePage:
    """A page of the features of a state."""
    found, following = page.read(conn, rows, origin)
    return m.FeaturePage(origin_m=origin, features=[to.answer(m.Feature, row, origin) for row in found], next=following)


@router.get("/changes")
def changes(conn: Reader, origin: Origin, rows: Changes, page: Page) -> m.ChangePage:
    """A page of changes."""
    found, following = page.read(conn, rows, origin)
    return m.ChangePage(origin_m=origin, changes=[to.answer(m.Change, row, origin) for row in found], next=following)


@router.get("/features/count")
def count_features(conn: Reader, _: Origin, rows: Features, page: Page, feature: UUID | None = None) -> m.ListCount:
    """Number of features in a list, and at which row of it one of them is."""
    return _count(conn, rows, page, feature)


@router.get("/changes/count")
def count_changes(conn: Reader, _: Origin, rows: Changes, page: Page, feature: UUID | None = None) -> m.ListCount:
    """Number of changes in a list, and at which row of it that of one feature is."""
    return _count(conn, rows, page, feature)


def _count(conn: Reader, rows: Listed, page: Slice, feature: UUID | None) -> m.ListCount:
    count, index = rows.count(conn, page.order, feature)
    return m.ListCount(count=count, index=index)


@router.get("/changes/summary")
def summarise_changes(conn: Reader, _: Origin, rows: Changes) -> m.ChangeSummary:
    """Number of changes of each kind, and of each class."""
    kinds: dict[str, int] = dict.fromkeys(KINDS, 0)
    categories: dict[str, int] = {}
    for row in rows.read(conn, "summary"):
        kinds[row["kind"]] += row["row_count"]
        categories[row["category"]] = categories.get(row["category"], 0) + row["row_count"]
    return m.ChangeSummary(kinds={kind: n for kind, n in kinds.items() if n}, categories=categories)


@router.get("/changes/view", response_model=m.ChangesInView)
def changes_in_view(
    conn: Reader, origin: Origin, rows: Changes, cell_zoom: Annotated[int, Query(ge=0, le=30)] = 10
) -> m.ChangesInView | Response:
    """The changes in an area one by one, if there are at most 2,000, else those other than `confirmed`; if these are too many,
    too, their numbers in squares of 2^(20 - cell_zoom) m."""
    cells = rows.read(conn, "cells", cell_zoom=cell_zoom)
    kinds: dict[str, int] = {}
    for cell in cells:
        kinds[cell["kind"]] = kinds.get(cell["kind"], 0) + cell["feature_count"]
    listed = [kind for kind in kinds if kind != "confirmed" or sum(kinds.values()) <= MAX_IN_VIEW]
    if sum(kinds[kind] for kind in listed) > MAX_IN_VIEW:
        clusters = [m.ChangeCluster(xyz_m=xyz_m, kinds=counts) for xyz_m, counts in to.clusters(cells, "kind", origin)]
        return m.ChangesInView(origin_m=origin, kinds=kinds, listed=[], clusters=clusters, changes=[], markings=[])
    wanted = replace(rows, filters={**rows.filters, "kinds": listed})
    head = f'"kinds":{json.dumps(kinds)},"listed":{json.dumps(listed)},"clusters":[],'
    return listing(conn, wanted.sql("drawn"), _DRAWN, origin, head=head, **wanted.values())
