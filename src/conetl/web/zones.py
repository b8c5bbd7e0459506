"""Routes of work zones: their areas, and how they differ from plans, the worst first, with verdicts."""

from __future__ import annotations

import threading
from collections import OrderedDict
from contextlib import closing
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any
from uuid import UUID

import numpy as np
import shapely
from fastapi import APIRouter, Body, HTTPException, Request
from pydantic import Field

from conetl.db.connection import Connection, connect
from conetl.db.map.map_store import require_map
from conetl.db.map.notice_store import round_due
from conetl.db.reader_pool import ReaderPool
from conetl.db.serve_store import read_heads
from conetl.model.base import Record, Vec3, utc_from_ns
from conetl.model.errors import ConflictError, DatabaseError, InputError
from conetl.model.planned_zones import PlanVerdict
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import WorkZone
from conetl.pipeline.maps.planned_zones import PlanComparison, PlanRow, compare_with_plans, judge
from conetl.pipeline.maps.work_zones import read_zones
from conetl.web import layer_models as m
from conetl.web.decisions import ERRORS, Name, sentence
from conetl.web.parameters import Instant, MapName, Origin, Reader, origin_of
from conetl.web.security import WritersRoute, person_of
from conetl.web.tiles import MapState
from conetl.workzones.plan_comparison import PlacedPlan
from conetl.workzones.zone_area import zone_area

router = APIRouter(prefix="/maps/{map_name}", route_class=WritersRoute, tags=["work zones"])
#: Zones are chained from all features of a map, which takes seconds beyond this number.
MOST_FEATURES = 5_000
_DECIMALS = 2
#: A comparison as of now is made again after this time, as plans begin and end, else when something was written.
_KEPT = timedelta(minutes=1)
_MOST_KEPT = 16
#: Around the line or point of a plan, to be seen.
_WIDE_M = 1.5


class ZoneCache:
    """The last zones and comparisons: pages, tiles and people ask for the same ones."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[Any, ...], PlanComparison] = OrderedDict()
        self._zones: OrderedDict[tuple[Any, ...], list[WorkZone]] = OrderedDict()
        self._lock, self._zones_lock = threading.Lock(), threading.Lock()

    def zones(self, pool: ReaderPool, map_name: str, as_of: datetime | None) -> tuple[Vec3, list[WorkZone] | None]:
        """The origin of a map and its zones; None: it has too many features. Who waits for another request has no connection."""
        with self._zones_lock, pool.reading() as conn:
            origin = origin_of(conn, map_name)
            if _has_many(conn, map_name, as_of):
                return origin, None
            key = (map_name, read_heads(conn).get(map_name), as_of)
            if key not in self._zones:
                found = read_zones(conn, map_name=map_name, as_of=as_of, lanes=None, params=WorkZoneParams())
                self._zones[key] = found.zones
                if len(self._zones) > _MOST_KEPT:
                    self._zones.popitem(last=False)
            return origin, self._zones[key]

    def read(
        self, conn: Connection, map_name: str, as_of: datetime | None = None, known_at: datetime | None = None
    ) -> PlanComparison | None:
        """As `compare_with_plans`; without plans nothing differs. None: the map has too many features."""
        due = round_due(conn, require_map(conn, map_name).map_id, most_s=0.0)
        if not due["has_plans"]:
            return PlanComparison(as_of or datetime.now(UTC), [])
        key = (map_name, due["newest"], as_of, known_at)
        with self._lock:  # several at once would all compute the same
            found = self._kept.get(key)
            if found is None or (as_of is None and datetime.now(UTC) - found.at > _KEPT):
                if _has_many(conn, map_name, as_of):
                    return None
                found = compare_with_plans(conn, map_name=map_name, as_of=as_of, known_at=known_at)
                self._kept[key] = found
                if len(self._kept) > _MOST_KEPT:
                    self._kept.popitem(last=False)
            return found

    def read_whole(
        self, pool: ReaderPool, map_name: str, as_of: datetime | None, known_at: datetime | None
    ) -> PlanComparison:
        """As `read`, with a connection of the pool. Raises DatabaseError if the map has too many features."""
        with pool.reading() as conn:
            found = self.read(conn, map_name, as_of, known_at)
        if found is None:
            raise DatabaseError(
                f"The map {map_name} has more than {MOST_FEATURES} features: compare it with `conetl zones compare --out FILE`."
            )
        return found


def _has_many(conn: Connection, map_name: str, as_of: datetime | None) -> bool:
    counts: list[int] = [row["feature_count"] for row in MapState(conn, map_name, as_of, None).summary()]
    return sum(counts) > MOST_FEATURES


class VerdictRequest(Record):
    """What a person says about a difference; `open` takes it back."""

    verdict: PlanVerdict
    decided_by: Name
    note: str = Field(default="", max_length=500, pattern=r"^[^\x00-\x1f\x7f]*$")


@router.get("/work-zones")
def work_zones(map_name: MapName, request: Request, valid_at: Instant = None) -> m.WorkZoneAreas:
    """The work zones that stand at an instant, as the database knows them now; none, and `truncated`, where features are many."""
    origin, found = request.app.state.zone_cache.zones(request.app.state.pool, map_name, valid_at)
    if found is None:
        return m.WorkZoneAreas(origin_m=origin, zones=[], truncated=True)
    zones = [
        m.WorkZoneArea(
            zone_id=zone.history.zone_id, start=utc_from_ns(zone.history.start_ns), cone_count=len(zone.layout.cones),
            length_m=round(float(np.ptp(zone.layout.stations_m)), 1), closed_side=zone.closed_side,
            closed_lane_count=zone.closed_lane_count,
            ring_m=_ring(zone, origin),
        )
        for zone in found
        if zone.history.end_ns is None
    ]  # fmt: skip
    return m.WorkZoneAreas(origin_m=origin, zones=zones, truncated=False)


@router.get("/differences")
def differences(
    map_name: MapName,
    conn: Reader,
    origin: Origin,
    request: Request,
    valid_at: Instant = None,
    known_at: Instant = None,
) -> m.Differences:
    """Planned work zones against those that were found, at an instant; the worst difference first, what agrees last."""
    found = request.app.state.zone_cache.read(conn, map_name, valid_at, known_at)
    if found is None:
        return m.Differences(origin_m=origin, plan_count=0, counts={}, rows=[], truncated=True)
    rest = [row for row in found.rows if row.rank is None]
    zones = {zone.history.zone_id: zone for zone in found.zones}
    plans = {plan.key: plan for plan in found.plans}
    return m.Differences(
        origin_m=origin, plan_count=len(found.plans), counts=found.counts, truncated=False,
        rows=[
            _row(row, plans.get(row.difference.key), zones.get(row.difference.zone_id), origin)
            for row in (*found.worst_first, *rest)
        ],
    )  # fmt: skip


@router.post("/differences/{difference_id}", status_code=201, responses=ERRORS)
def judge_difference(
    map_name: MapName, difference_id: UUID, said: Annotated[VerdictRequest, Body()], request: Request
) -> m.DifferenceVerdict:
    """Say whether a difference is confirmed, accepted or wrong, as `conetl zones judge` does. Nothing changes on the map."""
    person = person_of(request)
    name = said.decided_by if person is None else person.name
    try:
        with closing(connect(request.app.state.writer.database_url)) as conn:
            judge(
                conn, str(difference_id), said.verdict, map_name=map_name, note=said.note, decided_by=name, as_of=None
            )
    except (InputError, ConflictError) as error:
        raise HTTPException(404, sentence(error)) from error
    return m.DifferenceVerdict(difference_id=difference_id, verdict=said.verdict, decided_by=name)


def _row(row: PlanRow, plan: PlacedPlan | None, zone: WorkZone | None, origin: Vec3) -> m.DifferenceRow:
    one, (x, y) = row.difference, row.difference.xy_m
    z_m = None if zone is None else round(float(np.median(zone.line_m[:, 2])) - origin[2], 2)
    return m.DifferenceRow(
        **one.model_dump(), **row.model_dump(include={"rank", "last_night", "verdict", "note", "decided_by"}),
        feature_id=None if zone is None else zone.first.feature_id,
        passed_at=one.looked_at, from_at=one.span[0], until_at=one.span[1],
        at_m=(round(x - origin[0], 2), round(y - origin[1], 2), z_m),
        zone_ring_m=[] if zone is None else _ring(zone, origin),
        plan_rings_m=[] if plan is None else _rings(plan, origin),
    )  # fmt: skip


def _rings(plan: PlacedPlan, origin: Vec3) -> list[list[float]]:
    """x, y of the corners of each part, around it."""
    area = shapely.buffer(plan.shape, _WIDE_M, join_style="mitre")
    rings = [shapely.get_coordinates(part.exterior.simplify(0.1))[:-1] for part in shapely.get_parts(area)]
    return [(ring - origin[:2]).round(2).ravel().tolist() for ring in rings]


def _ring(zone: WorkZone, origin: Vec3) -> list[float]:
    """x, y, z of the corners of its area on the ground, one after the other, from the map's origin."""
    xy_m = zone_area(zone)
    at = np.column_stack([xy_m, np.full(len(xy_m), float(np.median(zone.line_m[:, 2])))]) - origin
    return [float(value) for value in at.round(_DECIMALS).ravel()]
