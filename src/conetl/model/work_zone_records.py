"""Records of work zones: inputs and results. Metres of the map's CRS, UTC nanoseconds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple
from uuid import UUID

from conetl.model.arrays import Floats
from conetl.model.map_records import MapFeature
from conetl.model.rig import Side

#: Source of the line along which stations and offsets are counted.
AxisSource = Literal["lanes", "drives", "cones"]


@dataclass(frozen=True, eq=False)
class LaneLine:
    """One piece of a lane boundary or road edge, in either direction; the ends of pieces need not meet."""

    xy_m: Floats
    """(N, 2) in the map's CRS, N >= 2."""
    kind: str = ""
    """As named by the source, for example `line_thin/dashed`."""


@dataclass(frozen=True, eq=False)
class DrivePath:
    """Path of one drive."""

    drive_id: str
    captured_from_ns: int
    xy_m: Floats


@dataclass(frozen=True)
class ZoneHistory:
    """One work zone over time, up to an instant."""

    zone_id: UUID
    start_ns: int
    end_ns: int | None
    """When its last cone was removed; None while one stands."""
    merged_into: UUID | None
    """The older zone that its cones belong to since `end_ns`."""
    cones: tuple[MapFeature, ...]
    """The present ones; of an ended zone, the last ones."""
    phases: tuple[tuple[int, tuple[MapFeature, ...]], ...] = ()
    """The cones from each instant on (ns) at which others stood than before."""


class Knot(NamedTuple):
    """Where a row bends or ends."""

    station_m: float
    sigmas_m: tuple[float, float]
    """Towards smaller and larger stations."""
    cones_m: tuple[float, ...]
    """Stations of the cones that may mark it."""


@dataclass(frozen=True)
class Taper:
    """A part of a row that moves towards traffic (converging) or away from it, in the direction of travel."""

    first: int
    last: int
    """Positions in the row."""
    start: Knot
    end: Knot
    shift_m: float
    shift_sigma_m: float
    """Of the cones alone, without the error of the axis."""
    converging: bool

    @property
    def length_m(self) -> float:
        return self.end.station_m - self.start.station_m


@dataclass(frozen=True, eq=False)
class ConeRow:
    """Cones that follow each other in a line of tapers and tangents."""

    members: tuple[int, ...]
    """Indices of the zone's cones, by station."""
    tapers: tuple[Taper, ...]


@dataclass(frozen=True, eq=False)
class LaneBands:
    """Lane lines beside the axis: offsets (positive to the left) by station; NaN where a line is missing."""

    stations_m: Floats
    """(M,), increasing."""
    offsets_m: Floats
    """(M, K), lines from right to left at the middle."""


@dataclass(frozen=True, eq=False)
class ZoneLayout:
    """A zone along its road, in the direction of travel."""

    axis_m: Floats
    """(N, 2) in the direction of travel."""
    axis_source: AxisSource
    axis_sigma_m: float
    """Lateral sigma of the axis over the zone's length."""
    direction_known: bool
    cones: tuple[MapFeature, ...]
    """By station."""
    stations_m: Floats
    offsets_m: Floats
    """Positive to the left of the axis."""
    sigmas_s_m: Floats
    sigmas_o_m: Floats
    rows: tuple[ConeRow, ...]
    """Longest first."""
    traffic_side: Side | None
    """Side on which traffic passes the first row; the other side is closed."""
    bands: LaneBands | None
    two_way: bool
    """Drives passed in both directions: traffic beside the closed lane may be oncoming."""
    drive_ids: tuple[str, ...]


class VehicleImpact(StrEnum):
    """The values of WZDx that follow from cones alone."""

    ALL_LANES_OPEN = "all-lanes-open"
    SOME_LANES_CLOSED = "some-lanes-closed"
    SOME_LANES_CLOSED_MERGE_LEFT = "some-lanes-closed-merge-left"
    SOME_LANES_CLOSED_MERGE_RIGHT = "some-lanes-closed-merge-right"
    UNKNOWN = "unknown"


@dataclass(frozen=True, eq=False)
class WorkZone:
    """A work zone ready to be published."""

    history: ZoneHistory
    layout: ZoneLayout
    line_m: Floats
    """(N, 3) from the first to the last channelling device, along the row, in the direction of travel; of one device it is
    twice its position."""
    first: MapFeature
    last: MapFeature
    impact: VehicleImpact
    closed_side: Side | None
    closed_lane_count: int | None
    """None without known lane boundaries."""


class Rule(StrEnum):
    """Rules of the layout check."""

    SPACING = "spacing"
    MISSING_CONE = "missing cone"
    TAPER_LENGTH = "taper length"
    CONE_IN_LANE = "cone in open lane"


class Level(StrEnum):
    """Certainty of a finding."""

    VIOLATION = "violation"
    """A rule of a standard is exceeded by more than the uncertainty explains."""
    DEVIATION = "deviation"
    """The same of a rule that no standard states."""
    NOTICE = "notice"
    """No norm is exceeded, but the row departs from its own pattern by more than the uncertainty explains."""
    CANNOT_TELL = "cannot tell"
    """The value is beyond the rule by less than the uncertainty explains, or the deciding value is unknown."""


@dataclass(frozen=True)
class LayoutFinding:
    """One departure of a layout from a rule."""

    zone_id: UUID
    rule: Rule
    level: Level
    norm: str
    text: str
    value: float
    limit: float
    sigma: float
    """Of value minus limit, in the same unit."""
    unit: str
    station_m: float
    feature_ids: tuple[UUID, ...]
    """The cones on both sides of a gap, the ends of a taper, or the one cone."""
    xy_m: tuple[tuple[float, float], ...]
    """A point, or the line between two cones, in the map's CRS."""
