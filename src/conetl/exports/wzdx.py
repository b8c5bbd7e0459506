"""Work zones as WZDx 4.2 feeds (USDOT): WorkZoneFeed, and DeviceFeed with a location marker per cone.

docs/how-to/work_zones.md describes the source of every field. A document is checked against the published schemas, which are
shipped, before its file is written.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal
from uuid import NAMESPACE_URL, uuid5

from jsonschema import Draft7Validator, FormatChecker
from pydantic import Field
from pyproj import Geod
from referencing import Registry
from referencing.jsonschema import DRAFT7

from conetl.exports.text_files import coordinates, iso_utc
from conetl.files.atomic import write_json
from conetl.files.documents import read_yaml_mapping, validated
from conetl.geometry.geodesy import bbox_of_degrees
from conetl.geometry.packing import horizontal_sigma_m
from conetl.model.base import Record, ns_from_utc, utc_from_ns
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE
from conetl.model.map_records import MapFeature
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import WorkZone

_CC0 = "https://creativecommons.org/publicdomain/zero/1.0/"
_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/data_source")
_GEOD = Geod(ellps="WGS84")
_QUARTERS = ("northbound", "eastbound", "southbound", "westbound")
_SCHEMAS = Path(__file__).with_name("wzdx_schemas")
#: Consumers of WZDx expect whole seconds.
_iso = partial(iso_utc, timespec="seconds")
_formats = FormatChecker(formats=("email", "date-time"))
Object = dict[str, Any]
Direction = Literal[
    "northbound", "eastbound", "southbound", "westbound", "undefined", "unknown", "inner-loop", "outer-loop"
]


class FeedInfo(Record):
    """Publisher and road of a feed, which the map does not contain."""

    publisher: str = Field(min_length=1)
    road_names: tuple[str, ...] = Field(min_length=1)
    contact_name: str | None = None
    contact_email: str | None = Field(default=None, pattern=r"^[^@\s]+@[^@\s]+\.[^@\s]+$")
    license: Literal["cc0"] | None = None
    update_frequency_s: int | None = Field(default=None, ge=1)
    organization_name: str | None = Field(default=None, min_length=1)
    data_source_id: str | None = Field(default=None, min_length=1)
    direction: Direction | None = None


def read_feed_info(path: Path | None, **flags: Any) -> FeedInfo:
    """The values of a YAML file, overridden by flags that are not empty. Raises InputError naming what is missing or wrong."""
    name = "the feed's description" if path is None else f"feed {path}"
    values = {} if path is None else read_yaml_mapping(path, "feed", " publisher: Road office")
    values |= {key: value for key, value in flags.items() if value}
    missing = [key for key in ("publisher", "road_names") if not values.get(key)]
    if missing:
        raise InputError(
            f"{name}: WZDx requires {' and '.join(missing)}: use --publisher and --road-name, or a YAML file with --feed "
            "(its keys are in docs/how-to/work_zones.md)"
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


def export_work_zone_feed(zones: Sequence[WorkZone], path: Path, context: FeedContext) -> int:
    """Write a WorkZoneFeed with one road event per zone that exists or ended recently. Returns their number."""
    oldest_ns = ns_from_utc(context.at - timedelta(days=context.params.keep_ended_days))
    shown = [z for z in zones if z.history.end_ns is None or z.history.end_ns >= oldest_ns]
    ids = {zone.history.zone_id for zone in shown}
    features = [_road_event(zone, context, ids) for zone in shown]
    return _write(features, path, context, "WorkZoneFeed")


def export_device_feed(cones: Sequence[MapFeature], zones: Sequence[WorkZone], path: Path, context: FeedContext) -> int:
    """Write a DeviceFeed with one location marker per standing cone, which names its zone. Returns their number."""
    of_cone = {cone.feature_id: zone for zone in zones if zone.history.end_ns is None for cone in zone.layout.cones}
    ordered = sorted(cones, key=lambda cone: str(cone.feature_id))
    features = [_location_marker(cone, of_cone.get(cone.feature_id), context) for cone in ordered]
    return _write(features, path, context, "DeviceFeed")


def _write(features: list[Object], path: Path, context: FeedContext, schema: str) -> int:
    document: Object = {"feed_info": _feed_info(context), "type": "FeatureCollection", "features": features}
    faults = schema_faults(document, schema)
    if faults:
        raise ValueError(f"the {schema} would not be valid WZDx 4.2, nothing was written: {'; '.join(faults[:5])}")
    write_json(path, document, allow_nan=False)
    return len(features)


def _feed_info(context: FeedContext) -> Object:
    info = context.info
    shared = {
        "contact_name": info.contact_name,
        "contact_email": info.contact_email,
        "update_frequency": info.update_frequency_s,
        "update_date": _iso(context.made_at),
    }
    organization = info.organization_name or info.publisher
    source = {"data_source_id": context.data_source_id, "organization_name": organization, **shared}
    if context.surveyed_at is not None:
        source["update_date"] = _iso(context.surveyed_at)
    licence = _CC0 if info.license else None
    head = {
        "publisher": info.publisher,
        **shared,
        "version": "4.2",
        "license": licence,
        "data_sources": [_known(source)],
    }
    return _known(head)


def _road_event(zone: WorkZone, context: FeedContext, ids: set[Any]) -> Object:
    history, params = zone.history, context.params
    line = coordinates(zone.line_m, context.srid)
    ended = history.end_ns is not None
    surveyed = utc_from_ns(max(cone.last_seen_ns for cone in zone.layout.cones))
    stale = not ended and context.at - surveyed > timedelta(days=params.max_age_days)
    # The end of a recently surveyed zone is limited by the age of that survey.
    assumed_end = context.at + timedelta(hours=params.assumed_duration_h)
    if not stale:
        assumed_end = max(min(assumed_end, surveyed + timedelta(days=params.max_age_days)), context.at)
    end = assumed_end if history.end_ns is None else utc_from_ns(history.end_ns)
    related = [{"type": "related-work-zone", "id": str(history.merged_into)}] if history.merged_into in ids else None
    core = {
        "event_type": "work-zone",
        "data_source_id": context.data_source_id,
        "related_road_events": related,
        "road_names": list(context.info.road_names),
        "direction": _direction(zone, context),
        "description": _description(zone, surveyed, params.max_age_days if stale else None),
        "creation_date": _iso(utc_from_ns(history.start_ns)),
        # Consumers skip events whose date they know, and each publication may assume another end or find the survey too old.
        "update_date": _iso(context.at),
    }
    known = zone.layout.direction_known
    properties = {
        "core_details": _known(core),
        "start_date": _iso(utc_from_ns(history.start_ns)),
        "end_date": _iso(end),
        "is_start_date_verified": True,
        "is_end_date_verified": ended and history.merged_into is None,
        "is_start_position_verified": known and not stale and _is_verified(zone.first, params),
        "is_end_position_verified": known and not stale and _is_verified(zone.last, params),
        "work_zone_type": "static",
        "event_status": "completed" if ended else "planned" if stale else "active",
        "vehicle_impact": "unknown" if stale else str(zone.impact),
        "location_method": "channel-device-method",
    }
    return {
        "id": str(history.zone_id),
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "LineString", "coordinates": line},
        "bbox": bbox_of_degrees(line),
        "conetl": {"last_surveyed_at": _iso(surveyed), "stale": stale, **_evidence(zone)},
    }


def _evidence(zone: WorkZone) -> Object:
    """A foreign member (RFC 7946, 6.1) that links the feed to the map."""
    return {
        "first_device_id": str(zone.first.feature_id),
        "last_device_id": str(zone.last.feature_id),
        "device_ids": [str(cone.feature_id) for cone in zone.layout.cones],
        "start_sigma_m": round(horizontal_sigma_m(zone.first.cov_m2), 3),
        "end_sigma_m": round(horizontal_sigma_m(zone.last.cov_m2), 3),
        "closed_side": zone.closed_side,
        "closed_lane_count": zone.closed_lane_count,
        "road_axis_from": zone.layout.axis_source,
        "drives": list(zone.layout.drive_ids),
        "tapers": [
            {"length_m": round(t.length_m, 1), "shift_m": round(t.shift_m, 2), "converging": t.converging}
            for row in zone.layout.rows[:1]
            for t in row.tapers
        ],
    }


def _description(zone: WorkZone, surveyed: datetime, max_age_days: float | None) -> str:
    """max_age_days: set if the last survey of the zone is older than that; else None."""
    count = len(zone.layout.cones)
    length = float(zone.layout.stations_m[-1] - zone.layout.stations_m[0])
    devices = "cones" if all(cone.category == CONE for cone in zone.layout.cones) else "devices"
    state = f"{count} {devices} over {length:.0f} m, last surveyed by vehicle at {_iso(surveyed)}"
    if zone.history.merged_into is not None:
        return f"{state}; now part of work zone {zone.history.merged_into}."
    if zone.history.end_ns is not None:
        return f"{state}; the last cone is gone."
    if max_age_days is not None:
        return f"{state}, more than {max_age_days:g} days ago: whether the work zone still stands is not known."
    return f"{state}; the end date is an assumption, the work zone stood when it was last surveyed."


def _location_marker(cone: MapFeature, zone: WorkZone | None, context: FeedContext) -> Object:
    marks = ["delineator"]
    if zone is not None:
        ends = (("work-zone-start", zone.first), ("work-zone-end", zone.last))
        marks = [mark for mark, end in ends if end.feature_id == cone.feature_id] or marks
    event_id = str(zone.history.zone_id) if zone is not None else None
    core = {
        "device_type": "location-marker",
        "data_source_id": context.data_source_id,
        "device_status": "unknown",
        "update_date": _iso(utc_from_ns(cone.last_seen_ns)),
        "has_automatic_location": False,
        "road_direction": _direction(zone, context) if zone is not None else None,
        "road_names": list(context.info.road_names),
        "description": f"{cone.category.replace('_', ' ').capitalize()}, {cone.object_height_m:.2f} m high, located by survey "
        f"drives; sigma {horizontal_sigma_m(cone.cov_m2):.2f} m; last seen at {_iso(utc_from_ns(cone.last_seen_ns))}.",
        "is_moving": False,
        "road_event_ids": [event_id] if event_id else None,
    }
    return {
        "id": str(cone.feature_id),
        "type": "Feature",
        "properties": {
            "core_details": _known(core),
            "marked_locations": [_known({"type": mark, "road_event_id": event_id}) for mark in marks],
        },
        "geometry": {"type": "Point", "coordinates": coordinates([cone.xyz_m], context.srid)[0]},
    }


def _direction(zone: WorkZone, context: FeedContext) -> str:
    """The direction given by the publisher; else the compass quarter of the true bearing from the first to the last device."""
    if context.info.direction is not None:
        return context.info.direction
    if not zone.layout.direction_known:
        return "unknown"
    start, end = coordinates([zone.first.xyz_m, zone.last.xyz_m], context.srid)
    bearing_deg = _GEOD.inv(start[0], start[1], end[0], end[1])[0]
    return _QUARTERS[int(((bearing_deg + 45.0) % 360.0) // 90.0)]


def _is_verified(cone: MapFeature, params: WorkZoneParams) -> bool:
    return (
        horizontal_sigma_m(cone.cov_m2) <= params.verified_sigma_m
        and cone.existence_probability >= params.verified_existence
    )


def _known(values: Object) -> Object:
    return {key: value for key, value in values.items() if value is not None}


@cache
def _registry() -> Registry[Any]:
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(_SCHEMAS.glob("*/*.json"))]
    return Registry().with_resources([(document["$id"], DRAFT7.create_resource(document)) for document in documents])


def schema_faults(document: Object, schema: str) -> list[str]:
    """Faults of a feed with their location, [] for a valid one; schema: `WorkZoneFeed` or `DeviceFeed`."""
    root = json.loads((_SCHEMAS / "4.2" / f"{schema}.json").read_text(encoding="utf-8"))
    validator = Draft7Validator(root, registry=_registry(), format_checker=_formats)
    faults = []
    for error in sorted(validator.iter_errors(document), key=lambda one: list(map(str, one.absolute_path))):
        location = "/".join(map(str, error.absolute_path)) or "the document"
        # The closest branch of an `anyOf` explains more than "is not valid under any of the given schemas".
        deepest = min(error.context or [error], key=lambda one: -len(one.absolute_path))
        faults.append(f"{location}: {deepest.message[:200]}")
    return faults
