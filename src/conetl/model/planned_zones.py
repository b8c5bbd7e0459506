"""Records of planned work zones: what a publication or a permit states, in WGS 84."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import AwareDatetime, Field, model_validator

from conetl.model.base import Latitude, Longitude, Record

Text = Annotated[str, Field(min_length=1)]


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


@dataclass(frozen=True)
class PlanFile:
    """All records of a file of plans: each is used or named."""

    zones: tuple[PlannedZone, ...]
    unused: tuple[UnusedRecord, ...]
