"""Records of planned work zones: what a publication or a permit states, in WGS 84; and how the zones that were found differ from
it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Annotated
from uuid import UUID

from pydantic import AwareDatetime, ConfigDict, Field, model_validator

from conetl.model.base import Latitude, Longitude, NonNegative, Probability, Record, Vec2

#: Words of sources for a plan that does not apply.
_VOID = frozenset({"cancelled", "canceled", "rejected", "revoked", "withdrawn"})
Text = Annotated[str, Field(min_length=1)]


class NotAPlanError(ValueError):
    """A record of a publication is something else than a plan of a work zone."""


class PlannedPeriod(Record):
    """A part of the time of a plan."""

    starts_at: AwareDatetime | None
    ends_at: AwareDatetime | None
    """None: open, as far as the plan goes."""


class PlannedZone(Record):
    """One planned closure or work zone. What the source does not state is None or empty."""

    plan_id: Text
    """Of the record in its source."""
    version: str | None = None
    group_id: str | None = None
    """Of the situation or permit to which several records belong."""
    kind: Text
    """The source's word, such as `MaintenanceWorks` or `work-zone`."""
    starts_at: AwareDatetime
    ends_at: AwareDatetime | None = None
    periods: tuple[PlannedPeriod, ...] = ()
    """Parts of that time in which the works take place; empty: all of it."""
    status: str | None = None
    """The source's word."""
    parts: tuple[tuple[tuple[Longitude, Latitude], ...], ...] = Field(min_length=1)
    """Lines of longitude and latitude (degrees); a part of one position is a point, a closed one may be an area."""
    approximate: bool = False
    """The parts are a position to show, or points of a reference to a road network, between which the road is not known."""
    carriageways: tuple[str, ...] = ()
    lanes: tuple[str, ...] = ()
    """Affected lanes in the source's words."""
    closed_lane_count: int | None = Field(default=None, ge=0)
    road_names: tuple[str, ...] = ()
    description: str = ""
    source: str = ""

    @property
    def is_void(self) -> bool:
        return (self.status or "").lower() in _VOID

    @property
    def order(self) -> tuple[int, str]:
        """Of two versions the one with the greater order is the newer one; versions are numbers, or times as text."""
        version = self.version or ""
        return (int(version), "") if version.isdecimal() and len(version) < 20 else (-1, version)

    @model_validator(mode="after")
    def _require_order(self) -> PlannedZone:
        if self.ends_at is not None and self.ends_at < self.starts_at:
            raise ValueError(f"it ends ({self.ends_at.isoformat()}) before it starts ({self.starts_at.isoformat()})")
        if any(not part for part in self.parts):
            raise ValueError("a part of its location has no position")
        return self


@dataclass(frozen=True)
class UnusedRecord:
    """A record of a file of plans that is not used."""

    record: str
    """So that a user finds it, such as `situation 12, record 12-1`."""
    reason: str
    is_broken: bool = True
    """False: it is no plan of a work zone, or another version of one that is used."""


@dataclass(frozen=True)
class PlanFile:
    """All records of a file of plans: each is used or named."""

    zones: tuple[PlannedZone, ...]
    unused: tuple[UnusedRecord, ...]


class DifferenceKind(StrEnum):
    """What a comparison of a plan with the zones that were found may state."""

    PERMITTED = "permitted and found"
    NO_PERMIT = "found without permit"
    NOT_FOUND = "permitted but not found"
    NOT_LOOKED = "not looked"
    """Too little of its place was passed, in the time of the plan, to say that it is not there."""
    LONGER = "longer"
    OTHER_LANES = "other lanes"
    ELSEWHERE = "elsewhere"
    EARLY = "set up before the start"
    OVERRUN = "still there after the end"
    ENDED_EARLY = "gone before the end"


class Sight(Record):
    """One pass of a drive."""

    at: datetime
    drive_id: str | None = None
    """None: of an imported map."""
    drive_uuid: UUID | None = None
    frame_index: int | None = None
    """Of a frame pair just before the place."""


class Difference(Record):
    """One row of the comparison: a plan, a zone that was found, or both."""

    model_config = ConfigDict(extra="ignore")  # verdicts keep rows of earlier versions of conetl
    difference_id: UUID
    kind: DifferenceKind
    list_name: str | None = None
    """The list of plans, and the plan in it; None without a permit."""
    plan_id: str | None = None
    zone_id: UUID | None = None
    text: str
    amount: float | None = None
    """By how much it differs, in `unit`, and its standard deviation where the positions of devices decide."""
    unit: str = ""
    sigma: NonNegative | None = None
    coverage: Probability | None = None
    """Share of the plan's place that drives passed in its time."""
    confidence: Probability
    planned_from: datetime | None = None
    planned_until: datetime | None = None
    absent: Sight | None = None
    """The last pass before the zone, which did not find it: it was set up between this one and `first`."""
    first: Sight | None = None
    """The first and the last pass that found the zone; of a plan that was not found, those that looked."""
    last: Sight | None = None
    gone: Sight | None = None
    """The first pass after the zone: it was taken away between `last` and this one."""
    xy_m: Vec2
    """Middle of the zone, else of the plan, in the map's CRS."""
    radius_m: NonNegative
    """Of a circle around all of it."""

    @property
    def key(self) -> tuple[str | None, str | None]:
        return self.list_name, self.plan_id

    @property
    def span(self) -> tuple[datetime | None, datetime | None]:
        """When the zone stood, as far as drives know, else when it was planned; None: open."""
        if self.zone_id is None or self.first is None:
            return self.planned_from, self.planned_until
        return self.first.at, None if self.gone is None else self.gone.at

    def is_same(self, other: Difference) -> bool:
        """Whether it is about the same as another one: of its kind and plan, at its place and time."""
        (begin, end), (other_begin, other_end) = self.span, other.span
        return (
            (self.kind, self.key) == (other.kind, other.key)
            and math.dist(self.xy_m, other.xy_m) <= max(self.radius_m, other.radius_m)
            and (end is None or other_begin is None or other_begin <= end)
            and (other_end is None or begin is None or begin <= other_end)
        )
