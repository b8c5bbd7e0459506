"""Answers about what is shown beside the features: base layers, work zones, provisional features."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from conetl.model.base import Record, Vec3
from conetl.model.planned_zones import Difference, PlanVerdict
from conetl.web.models import Cov2, Listing


class BaseLayer(Record):
    layer_name: str
    kind: Literal["points", "lines"]
    files: int
    count: int


class BaseTile(Record):
    """A square of points with a side of 4096 m / 2^level. A point is origin_m + steps * scale_m."""

    level: int
    points: int
    origin_m: Vec3
    scale_m: Vec3
    high_m: float
    sha256: str


class BaseLayers(Listing):
    layers: list[BaseLayer]
    tiles: list[BaseTile]
    """Coarse levels first; the tiles of all levels together are the whole cloud."""


class BaseLine(Record):
    kind: str
    subtype: str | None
    xyz_m: list[float]
    """x, y, z of all vertices, one vertex after the other."""


class BaseLines(Listing):
    lines: list[BaseLine]


class WorkZoneArea(Record):
    """A work zone that stands at the instant asked for."""

    zone_id: UUID
    start: datetime
    """When it was first observed."""
    cone_count: int
    length_m: float
    closed_side: Literal["left", "right"] | None
    closed_lane_count: int | None
    ring_m: list[float]
    """x, y, z of the corners of the closed area, one after the other."""


class WorkZoneAreas(Listing):
    zones: list[WorkZoneArea]


class DifferenceRow(Difference):
    """A difference between a plan and what was found, or an agreement (`rank` is null)."""

    feature_id: UUID | None
    """First device of the zone."""
    passed_at: datetime | None
    """When a drive last passed it."""
    from_at: datetime | None
    """When the zone stood, as far as drives know, else when it was planned; null: open."""
    until_at: datetime | None
    rank: int | None
    """1: the worst."""
    last_night: bool
    verdict: PlanVerdict
    note: str
    decided_by: str | None
    at_m: tuple[float, float, float | None]
    """Middle of the zone, else of the plan, from the map's origin; z is null where no zone was found."""
    zone_ring_m: list[float]
    """x, y, z of the corners of the zone, one after the other."""
    plan_rings_m: list[list[float]]
    """x, y of the corners of the plan's parts."""


class Differences(Listing):
    """Truncated: none, because the map has too many features for a comparison on request."""

    plan_count: int
    counts: dict[str, int]
    """Number of rows by kind."""
    rows: list[DifferenceRow]
    """Differences by rank, then what agrees or was not looked at."""


class DifferenceVerdict(Record):
    difference_id: UUID
    verdict: PlanVerdict
    decided_by: str


class ProvisionalFeature(Record):
    """A cone of a drive that is being recorded, or that was recorded and is not ingested yet; not part of the map."""

    drive_id: str
    feature_index: int
    """Number within its drive; it does not change while the drive is watched."""
    is_watched: bool
    """False if the watch has ended and the drive is not ingested yet."""
    xyz_m: Vec3
    cov_m2: Cov2
    object_height_m: float
    existence_probability: float
    observation_count: int
    last_seen_at: datetime
    near_feature_id: UUID | None
    """A feature of the map nearby that may be the same object."""


class ProvisionalFeatures(Listing):
    features: list[ProvisionalFeature]
