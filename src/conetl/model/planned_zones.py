"""Records of planned work zones: what a publication or a permit states, in WGS 84; and how the zones that were found differ from
it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Annotated, Any, Literal, get_args
from uuid import UUID

from pydantic import AwareDatetime, ConfigDict, Field, model_validator

from conetl.model.base import Latitude, Longitude, NonNegative, Probability, Record, Vec2
from conetl.model.columns import FeatureColumn

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


#: What a person may say about a difference; open takes a verdict back.
PlanVerdict = Literal["confirmed", "accepted", "wrong", "open"]
VERDICTS: tuple[str, ...] = get_args(PlanVerdict)
#: What a person judges, the worst kind first.
WORST_FIRST = (
    DifferenceKind.NO_PERMIT, DifferenceKind.OVERRUN, DifferenceKind.OTHER_LANES, DifferenceKind.ELSEWHERE, DifferenceKind.LONGER,
    DifferenceKind.EARLY, DifferenceKind.NOT_FOUND, DifferenceKind.ENDED_EARLY,
)  # fmt: skip


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
    def looked_at(self) -> datetime | None:
        """When a drive last passed it; None: none did."""
        return max((sight.at for sight in (self.first, self.last, self.gone) if sight is not None), default=None)

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


def _of(kind: Any, words: tuple[str, ...] = (), /, **meanings: str) -> tuple[FeatureColumn, ...]:
    """Columns of a type of PostgreSQL; words: all values, where they are few."""
    return tuple(FeatureColumn(name, kind, "", name, meaning, words=words) for name, meaning in meanings.items())


def _pass(name: str, meaning: str) -> tuple[FeatureColumn, ...]:
    return _of("timestamptz", **{f"{name}_at": f"{meaning}."}) + _of(
        "text", **{f"{name}_drive": f"{meaning}: its drive."}
    )


#: In the order of files; `link` and `images` are of tables and files only.
DIFFERENCE_COLUMNS = (
    *_of("uuid", difference_id="The difference."),
    *_of("text", tuple(DifferenceKind), kind="What differs."),
    *_of("text", list_name="List of the plan.", plan_id="The plan; null: none."),
    *_of("uuid", zone_id="The work zone that was found; null: none."),
    *_of("text", text="What differs, in words."),
    *_of("float8", amount="By how much it differs."),
    *_of("text", unit="Of amount."),
    *_of("float8", sigma="Standard deviation of amount, of positions.", coverage="Share of the plan's place that drives passed.",
        confidence="Probability that it differs."),
    *_of("timestamptz", planned_from="Begin of the plan.", planned_until="End of the plan; null: open."),
    *_pass("absent", "The last pass before the zone, which did not find it"),
    *_pass("first", "The first pass that found the zone, or looked"),
    *_pass("last", "The last pass that found the zone, or looked"),
    *_pass("gone", "The first pass after the zone, which did not find it"),
    *_of("float8", lon_deg="Longitude of its middle.", lat_deg="Latitude of its middle."),
    *_of("text", VERDICTS, verdict="What a person said."),
    *_of("text", note="Note of the verdict.", decided_by="Who said so."),
    *_of("integer", rank="1: to be looked at first; null: no difference."),
    *_of("boolean", last_night="Whether a drive looked at it in the last 24 hours of drives."),
    *_of("text", link="Of the map viewer, from its address on.", images="Left images of the passes first and last."),
)  # fmt: skip
