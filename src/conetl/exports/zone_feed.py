"""What all feeds of work zones share: the publisher's description, the state of a zone at the feed's time, texts, directions.

docs/reference/wzdx.md describes the source of every field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, Literal
from uuid import NAMESPACE_URL, UUID, uuid5

from pydantic import Field
from pyproj import Geod

from conetl.exports.text_files import coordinates, iso_utc
from conetl.files.documents import read_yaml_mapping, validated
from conetl.geometry.packing import horizontal_sigma_m
from conetl.model.base import Record, ns_from_utc, utc_from_ns
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE
from conetl.model.map_records import MapFeature
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import WorkZone

_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/data_source")
_GEOD = Geod(ellps="WGS84")
_QUARTERS = ("northbound", "eastbound", "southbound", "westbound")
_OPTIONS = {"publisher": "--publisher", "road_names": "--road-name", "country": "--country"}
#: Consumers of feeds expect whole seconds.
iso_seconds = partial(iso_utc, timespec="seconds")
Direction = Literal[
    "northbound", "eastbound", "southbound", "westbound", "undefined", "unknown", "inner-loop", "outer-loop"
]


class FeedInfo(Record):
    """Publisher and road of a feed, which the map does not contain."""

    publisher: str = Field(min_length=1)
    road_names: tuple[str, ...] = Field(min_length=1)
    country: str | None = Field(default=None, pattern=r"^[A-Za-z]{2}$")
    """ISO 3166-1, of the publisher."""
    contact_name: str | None = None
    contact_email: str | None = Field(default=None, pattern=r"^[^@\s]+@[^@\s]+\.[^@\s]+$")
    license: Literal["cc0"] | None = None
    update_frequency_s: int | None = Field(default=None, ge=1)
    organization_name: str | None = Field(default=None, min_length=1)
    data_source_id: str | None = Field(default=None, min_length=1)
    direction: Direction | None = None


def read_feed_info(path: Path | None, required: Sequence[str] = ("publisher", "road_names"), **flags: Any) -> FeedInfo:
    """The values of a YAML file, overridden by flags that are not empty. Raises InputError naming what is missing or wrong."""
    name = "the feed's description" if path is None else f"feed {path}"
    values = {} if path is None else read_yaml_mapping(path, "feed", " publisher: Road office")
    values |= {key: value for key, value in flags.items() if value}
    missing = [key for key in required if not values.get(key)]
    if missing:
        raise InputError(
            f"{name}: the format requires {' and '.join(missing)}: use {' and '.join(_OPTIONS[key] for key in missing)}, or a "
            "YAML file with --feed (its keys are in docs/map/work_zones.md)"
        )
    return validated(values, FeedInfo, name)


@dataclass(frozen=True)
class FeedContext:
    """Values that all parts of one feed share."""

    info: FeedInfo
    id_name: str
    """Name in the ids of the map's features, which stays when the map is renamed."""
    srid: int
    at: datetime
    """The instant that the feed describes."""
    made_at: datetime
    params: WorkZoneParams
    surveyed_at: datetime | None = None
    """When the last cone of the whole map was seen; None: unknown."""

    @property
    def data_source_id(self) -> str:
        made = uuid5(_NAMESPACE, f"{self.info.publisher}/{self.id_name}")
        return self.info.data_source_id or str(made)


@dataclass(frozen=True)
class ZoneState:
    """What the map can say of a zone at the instant of a feed."""

    start: datetime
    """When it was first observed."""
    surveyed: datetime
    """When a cone of it was last observed."""
    expires: datetime
    """Until when that survey is evidence that the zone stands."""
    ended: datetime | None
    stale: bool
    """Not ended, but the survey has expired: whether it still stands is unknown."""


def state_of(zone: WorkZone, context: FeedContext) -> ZoneState:
    """See `ZoneState`."""
    surveyed = utc_from_ns(max(cone.last_seen_ns for cone in zone.layout.cones))
    expires = surveyed + timedelta(days=context.params.max_age_days)
    ended = None if zone.history.end_ns is None else utc_from_ns(zone.history.end_ns)
    return ZoneState(
        utc_from_ns(zone.history.start_ns), surveyed, expires, ended, ended is None and context.at > expires
    )


def zones_to_publish(zones: Sequence[WorkZone], context: FeedContext) -> tuple[list[WorkZone], set[UUID]]:
    """Zones that exist or ended recently, and their ids, to which others may refer."""
    oldest_ns = ns_from_utc(context.at - timedelta(days=context.params.keep_ended_days))
    shown = [z for z in zones if z.history.end_ns is None or z.history.end_ns >= oldest_ns]
    return shown, {zone.history.zone_id for zone in shown}


def description_of(zone: WorkZone, state: ZoneState, params: WorkZoneParams) -> str:
    """Devices, length, time of the last survey, and what is known of the end, in one sentence."""
    count = len(zone.layout.cones)
    length = float(zone.layout.stations_m[-1] - zone.layout.stations_m[0])
    noun = "cone" if all(cone.category == CONE for cone in zone.layout.cones) else "device"
    what = f"{count} {noun}{'' if count == 1 else 's'}"
    known = f"{what} over {length:.0f} m, last surveyed by vehicle at {iso_seconds(state.surveyed)}"
    if zone.history.merged_into is not None:
        return f"{known}; now part of work zone {zone.history.merged_into}."
    if state.ended is not None:
        return f"{known}; the last cone is gone."
    if state.stale:
        days = params.max_age_days
        age = f"{days:g} days" if days >= 2 else f"{24 * days:.3g} h"
        return f"{known}, more than {age} ago: whether the work zone still stands is not known."
    return f"{known}; the end date is an assumption, the work zone stood when it was last surveyed."


def direction_of(zone: WorkZone, context: FeedContext) -> str:
    """The direction given by the publisher; else the compass quarter of the true bearing from the first to the last device."""
    if context.info.direction is not None:
        return context.info.direction
    if not zone.layout.direction_known or zone.first.feature_id == zone.last.feature_id:
        return "unknown"
    start, end = coordinates([zone.first.xyz_m, zone.last.xyz_m], context.srid)
    bearing_deg = _GEOD.inv(start[0], start[1], end[0], end[1])[0]
    return _QUARTERS[int(((bearing_deg + 45.0) % 360.0) // 90.0)]


def is_verified(cone: MapFeature, params: WorkZoneParams) -> bool:
    """Whether the position of a device is certain enough to be called verified."""
    return (
        horizontal_sigma_m(cone.cov_m2) <= params.verified_sigma_m
        and cone.existence_probability >= params.verified_existence
    )
