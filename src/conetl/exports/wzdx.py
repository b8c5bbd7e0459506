"""Work zones as WZDx 4.2 feeds (USDOT): WorkZoneFeed, and DeviceFeed with a location marker per cone.

`SOURCES` has the source of every field, as docs/reference/wzdx.md shows it. A document is checked against the published schemas,
which are shipped, before its file is written.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import Any
from uuid import UUID

from jsonschema import Draft7Validator, FormatChecker
from referencing import Registry
from referencing.jsonschema import DRAFT7

from conetl.exports.text_files import coordinates
from conetl.exports.zone_feed import (
    FeedContext,
    description_of,
    direction_of,
    is_verified,
    iso_seconds,
    state_of,
    zones_to_publish,
)
from conetl.files.atomic import write_json
from conetl.geometry.geodesy import bbox_of_degrees
from conetl.geometry.packing import horizontal_sigma_m
from conetl.model.base import utc_from_ns
from conetl.model.map_records import MapFeature
from conetl.model.work_zone_records import WorkZone

_CC0 = "https://creativecommons.org/publicdomain/zero/1.0/"
_SCHEMAS = Path(__file__).with_name("wzdx_schemas")
_formats = FormatChecker(formats=("email", "date-time"))
Object = dict[str, Any]
#: Field of a road event -> where its value comes from; docs/reference/wzdx.md is made from it.
SOURCES = {
    "id": "A UUID of the map's name, the zone's first cone and the first changeset with the zone. A late "
    "drive may change it.",
    "geometry": "A line through the row from the first to the last cone, in the direction of travel, with "
    "ellipsoidal heights.",
    "bbox": "Of the line.",
    "event_type": "`work-zone`.",
    "data_source_id": "`data_source_id` of `--feed`; default: made from publisher and map.",
    "related_road_events": "The zone that this one became part of.",
    "road_names": "`--road-name`.",
    "direction": "`direction` of `--feed`, otherwise the quadrant of the true bearing from the first to the last cone.",
    "description": "What conetl knows of the zone, and when a drive last observed a cone of it.",
    "creation_date": "As start_date.",
    "update_date": "Time of the feed: consumers skip events whose date they know.",
    "start_date": "When a drive first observed the first cone. The work may have begun earlier.",
    "end_date": "Of completed zones when a drive observed that the last cone was gone. The schema requires an "
    "end: of active zones it is the feed's time plus 24 h, or the expiry of the survey (`--max-age`) "
    "if that is earlier.",
    "is_start_date_verified": "True: a vehicle observed the devices.",
    "is_end_date_verified": "True if a drive observed that the cones were gone; false if the zone became part of another.",
    "is_start_position_verified": "Direction known, sigma of the first cone at most 0.5 m in its worst direction, existence "
    "probability at least 0.9, survey not expired.",
    "is_end_position_verified": "The same of the last cone.",
    "work_zone_type": "`static`.",
    "event_status": "`active`, or `completed` for 14 days. Absent if the last survey has expired (7 days): the end is"
    " then in the past.",
    "vehicle_impact": "With lane lines `some-lanes-closed` where a cone leaves less than 2.5 m of a lane, `all-lanes-"
    "open` where the row enters no lane. Without them `some-lanes-closed` for a converging taper at "
    "least 2.8 m wide. Both by more than two sigmas; otherwise, or if the survey has expired, "
    "`unknown`. `-merge-left` and `-merge-right` only with a converging taper and where no drive came"
    " the other way.",
    "location_method": "`channel-device-method`.",
    "conetl": "Foreign member: last survey, first and last cone, all cones, sigmas, closed side, tapers, drives.",
}


def export_work_zone_feed(
    zones: Sequence[WorkZone], standing: Sequence[MapFeature], path: Path, context: FeedContext
) -> int:
    """Write a WorkZoneFeed with one road event per zone that exists or ended recently. Returns their number."""
    shown, ids = zones_to_publish(zones, context)
    return _write([_road_event(zone, context, ids) for zone in shown], path, context, "WorkZoneFeed")


def export_device_feed(
    zones: Sequence[WorkZone], standing: Sequence[MapFeature], path: Path, context: FeedContext
) -> int:
    """Write a DeviceFeed with one location marker per standing cone, which names its zone. Returns their number."""
    of_cone = {cone.feature_id: zone for zone in zones if zone.history.end_ns is None for cone in zone.layout.cones}
    ordered = sorted(standing, key=lambda cone: str(cone.feature_id))
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
        "update_date": iso_seconds(context.made_at),
    }
    organization = info.organization_name or info.publisher
    source = {"data_source_id": context.data_source_id, "organization_name": organization, **shared}
    if context.surveyed_at is not None:
        source["update_date"] = iso_seconds(context.surveyed_at)
    licence = _CC0 if info.license else None
    head = {
        "publisher": info.publisher,
        **shared,
        "version": "4.2",
        "license": licence,
        "data_sources": [_known(source)],
    }
    return _known(head)


def _road_event(zone: WorkZone, context: FeedContext, ids: set[UUID]) -> Object:
    history, params, state = zone.history, context.params, state_of(zone, context)
    line = coordinates(zone.line_m, context.srid)
    # The schema requires an end; it is not assumed beyond what the last survey is evidence for.
    end = state.ended or min(context.at + timedelta(hours=params.assumed_duration_h), state.expires)
    related = [{"type": "related-work-zone", "id": str(history.merged_into)}] if history.merged_into in ids else None
    core = {
        "event_type": "work-zone",
        "data_source_id": context.data_source_id,
        "related_road_events": related,
        "road_names": list(context.info.road_names),
        "direction": direction_of(zone, context),
        "description": description_of(zone, state, params),
        "creation_date": iso_seconds(state.start),
        # Consumers skip events whose date they know, and each publication may assume another end or find the survey too old.
        "update_date": iso_seconds(context.at),
    }
    known = zone.layout.direction_known and not state.stale
    properties = {
        "core_details": _known(core),
        "start_date": iso_seconds(state.start),
        "end_date": iso_seconds(end),
        "is_start_date_verified": True,
        "is_end_date_verified": state.ended is not None and history.merged_into is None,
        "is_start_position_verified": known and is_verified(zone.first, params),
        "is_end_position_verified": known and is_verified(zone.last, params),
        "work_zone_type": "static",
        # No status of WZDx says that it is unknown whether the zone stands; its end date is in the past, and not verified.
        "event_status": "completed" if state.ended else None if state.stale else "active",
        "vehicle_impact": "unknown" if state.stale else str(zone.impact),
        "location_method": "channel-device-method",
    }
    return {
        "id": str(history.zone_id),
        "type": "Feature",
        "properties": _known(properties),
        "geometry": {"type": "LineString", "coordinates": line},
        "bbox": bbox_of_degrees(line),
        "conetl": {"last_surveyed_at": iso_seconds(state.surveyed), "stale": state.stale, **_evidence(zone)},
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
        "update_date": iso_seconds(utc_from_ns(cone.last_seen_ns)),
        "has_automatic_location": False,
        "road_direction": direction_of(zone, context) if zone is not None else None,
        "road_names": list(context.info.road_names),
        "description": f"{cone.category.replace('_', ' ').capitalize()}, {cone.object_height_m:.2f} m high, located by survey "
        f"drives; sigma {horizontal_sigma_m(cone.cov_m2):.2f} m; last seen at {iso_seconds(utc_from_ns(cone.last_seen_ns))}.",
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
