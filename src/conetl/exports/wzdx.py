"""Work zones as WZDx 4.2 feeds (USDOT): WorkZoneFeed, and DeviceFeed with a location marker per cone.

docs/how-to/work_zones.md says what each field is derived from. A document is checked against the published schema before the file
appears.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np
from numpy.typing import NDArray
from pyproj import Geod, Transformer

from conetl.exports.feed_info import CC0, FeedInfo
from conetl.exports.geojson import HEIGHT_DECIMALS, LON_LAT_DECIMALS
from conetl.exports.wzdx_schema import schema_faults
from conetl.files.atomic import atomic_text_file
from conetl.model.map_records import MapFeature
from conetl.model.params import WorkZoneParams
from conetl.model.records import utc_from_ns
from conetl.model.work_zone_records import WorkZone

_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/data_source")
_GEOD = Geod(ellps="WGS84")
_QUARTERS = ("northbound", "eastbound", "southbound", "westbound")


@dataclass(frozen=True)
class FeedContext:
    """What all parts of one feed share."""

    info: FeedInfo
    map_name: str
    srid: int
    at: datetime
    """The instant that the feed tells of."""
    made_at: datetime
    params: WorkZoneParams

    @property
    def data_source_id(self) -> str:
        made = uuid5(_NAMESPACE, f"{self.info.publisher}/{self.map_name}")
        return self.info.data_source_id or str(made)


def export_work_zone_feed(zones: Sequence[WorkZone], path: Path, context: FeedContext) -> int:
    """Write a WorkZoneFeed with one road event per zone that stands or ended lately; their number."""
    oldest_ns = _ns(context.at - timedelta(days=context.params.keep_ended_days))
    shown = [z for z in zones if z.history.end_ns is None or z.history.end_ns >= oldest_ns]
    ids = {zone.history.zone_id for zone in shown}
    features = [_road_event(zone, context, ids) for zone in shown]
    return _write(features, path, context, "WorkZoneFeed")


def export_device_feed(cones: Sequence[MapFeature], zones: Sequence[WorkZone], path: Path, context: FeedContext) -> int:
    """Write a DeviceFeed with one location marker per standing cone, with the zone that it belongs to; their number."""
    of_cone = {cone.feature_id: zone for zone in zones if zone.history.end_ns is None for cone in zone.layout.cones}
    ordered = sorted(cones, key=lambda cone: str(cone.feature_id))
    features = [_location_marker(cone, of_cone.get(cone.feature_id), context) for cone in ordered]
    return _write(features, path, context, "DeviceFeed")


def _write(features: list[dict[str, Any]], path: Path, context: FeedContext, schema: str) -> int:
    document: dict[str, Any] = {"feed_info": _feed_info(context), "type": "FeatureCollection", "features": features}
    faults = schema_faults(document, schema)
    if faults:
        raise ValueError(f"the {schema} would not be valid WZDx 4.2, nothing was written: {'; '.join(faults[:5])}")
    with atomic_text_file(path) as file:
        json.dump(document, file, indent=1, allow_nan=False)
        file.write("\n")
    return len(features)


def _feed_info(context: FeedContext) -> dict[str, Any]:
    info = context.info
    source = {
        "data_source_id": context.data_source_id,
        "organization_name": info.organization_name or info.publisher,
        "contact_name": info.contact_name,
        "contact_email": info.contact_email,
        "update_frequency": info.update_frequency_s,
        "update_date": _iso(context.made_at),
    }
    head = {
        "publisher": info.publisher,
        "contact_name": info.contact_name,
        "contact_email": info.contact_email,
        "update_frequency": info.update_frequency_s,
        "update_date": _iso(context.made_at),
        "version": "4.2",
        "license": CC0 if info.license else None,
        "data_sources": [_known(source)],
    }
    return _known(head)


def _road_event(zone: WorkZone, context: FeedContext, ids: set[Any]) -> dict[str, Any]:
    history, params = zone.history, context.params
    line = _lon_lat(zone.line_m, context.srid)
    ended = history.end_ns is not None
    end = (
        utc_from_ns(history.end_ns)
        if history.end_ns is not None
        else context.at + timedelta(hours=params.assumed_duration_h)
    )
    related = [{"type": "related-work-zone", "id": str(history.merged_into)}] if history.merged_into in ids else None
    core = {
        "event_type": "work-zone",
        "data_source_id": context.data_source_id,
        "related_road_events": related,
        "road_names": list(context.info.road_names),
        "direction": _direction(zone, context),
        "description": _words(zone),
        "creation_date": _iso(utc_from_ns(history.start_ns)),
        "update_date": _iso(utc_from_ns(zone.updated_ns)),
    }
    known = zone.layout.direction_known
    properties = {
        "core_details": _known(core),
        "start_date": _iso(utc_from_ns(history.start_ns)),
        "end_date": _iso(end),
        "is_start_date_verified": True,
        "is_end_date_verified": ended and history.merged_into is None,
        "is_start_position_verified": known and _is_verified(zone.first, params),
        "is_end_position_verified": known and _is_verified(zone.last, params),
        "work_zone_type": "static",
        "event_status": "completed" if ended else "active",
        "vehicle_impact": str(zone.impact),
        "location_method": "channel-device-method",
    }
    return {
        "id": str(history.zone_id),
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "LineString", "coordinates": line},
        "bbox": _bbox(line),
        "conetl": _evidence(zone),
    }


def _evidence(zone: WorkZone) -> dict[str, Any]:
    """A foreign member (RFC 7946, 6.1) for those who want to follow the feed back to the map."""
    return {
        "first_device_id": str(zone.first.feature_id),
        "last_device_id": str(zone.last.feature_id),
        "device_ids": [str(cone.feature_id) for cone in zone.layout.cones],
        "start_sigma_m": round(_sigma_m(zone.first), 3),
        "end_sigma_m": round(_sigma_m(zone.last), 3),
        "closed_side": zone.closed_side,
        "closed_lane_count": zone.closed_lane_count,
        "road_axis_from": zone.layout.axis_source,
        "drives": list(zone.layout.drive_ids),
        "tapers": [
            {"length_m": round(t.end_m - t.start_m, 1), "shift_m": round(t.shift_m, 2), "converging": t.converging}
            for row in zone.layout.rows[:1]
            for t in row.tapers
        ],
    }


def _words(zone: WorkZone) -> str:
    count = len(zone.layout.cones)
    length = float(zone.layout.stations_m[-1] - zone.layout.stations_m[0])
    state = f"{count} cones over {length:.0f} m, surveyed by vehicle"
    if zone.history.merged_into is not None:
        return f"{state}; now part of work zone {zone.history.merged_into}."
    if zone.history.end_ns is not None:
        return f"{state}; the last cone is gone."
    return f"{state}; the end date is an assumption, the work zone stood when it was last surveyed."


def _location_marker(cone: MapFeature, zone: WorkZone | None, context: FeedContext) -> dict[str, Any]:
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
        "description": f"Traffic cone, {cone.cone_height_m:.2f} m high, located by survey drives; sigma {_sigma_m(cone):.2f} m.",
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
        "geometry": {"type": "Point", "coordinates": _lon_lat(np.array([cone.xyz_m]), context.srid)[0]},
    }


def _direction(zone: WorkZone, context: FeedContext) -> str:
    """As the publisher names it; else the quarter of the true bearing from the first to the last device."""
    if context.info.direction is not None:
        return context.info.direction
    if not zone.layout.direction_known:
        return "unknown"
    start, end = _lon_lat(np.array([zone.first.xyz_m, zone.last.xyz_m]), context.srid)
    bearing_deg = _GEOD.inv(start[0], start[1], end[0], end[1])[0]
    return _QUARTERS[int(((bearing_deg + 45.0) % 360.0) // 90.0)]


def _is_verified(cone: MapFeature, params: WorkZoneParams) -> bool:
    return _sigma_m(cone) <= params.verified_sigma_m and cone.existence_probability >= params.verified_existence


def _sigma_m(cone: MapFeature) -> float:
    """Of the horizontal position, in its worst direction."""
    xx, xy, yy = cone.cov_m2[0], cone.cov_m2[1], cone.cov_m2[3]
    return float(np.sqrt(np.linalg.eigvalsh(np.array([[xx, xy], [xy, yy]]))[-1]))


def _lon_lat(points_m: NDArray[np.float64], srid: int) -> list[list[float]]:
    to_wgs84 = Transformer.from_crs(f"EPSG:{srid}", "EPSG:4326", always_xy=True)
    lon, lat = to_wgs84.transform(points_m[:, 0], points_m[:, 1])
    return [
        [round(float(x), LON_LAT_DECIMALS), round(float(y), LON_LAT_DECIMALS), round(float(z), HEIGHT_DECIMALS)]
        for x, y, z in zip(lon, lat, points_m[:, 2], strict=True)
    ]


def _bbox(line: list[list[float]]) -> list[float]:
    """Lowest, then highest longitude, latitude and height: as many as the coordinates have (RFC 7946, 5)."""
    places = np.array(line)
    return [*places.min(axis=0).tolist(), *places.max(axis=0).tolist()]


def _known(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _iso(instant: datetime) -> str:
    """RFC 3339 in whole seconds: what consumers of WZDx expect."""
    return instant.astimezone(UTC).replace(microsecond=0).isoformat().replace("+00:00", "Z")


def _ns(instant: datetime) -> int:
    return int(instant.timestamp() * 1_000_000) * 1000
