"""Work zones of a map: computed from its history, and exported as feeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from conetl.db.base_store import read_lanes_near
from conetl.db.connection import Connection
from conetl.db.map.map_store import read_paths, read_versions, require_map
from conetl.db.map.notice_store import read_zone_aliases
from conetl.exports import ZONE_FORMATS, zone_writer_of
from conetl.exports.zone_feed import FeedContext, read_feed_info
from conetl.model.base import ns_from_utc, utc_from_ns
from conetl.model.errors import InputError
from conetl.model.feature_classes import FEATURE_CLASSES
from conetl.model.map_records import FeatureVersion, MapFeature
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import DrivePath, LaneLine, WorkZone, ZoneHistory
from conetl.workzones.work_zones import with_kept_ids, zones_over_time
from conetl.workzones.zone_layout import describe, layout_of

#: Objects of other classes, as signs, neither found nor end a work zone.
_IN_ROWS = frozenset(name for name, one in FEATURE_CLASSES.items() if one.in_rows)


@dataclass(frozen=True)
class MapZones:
    """The work zones of a map at a time."""

    srid: int
    zones: list[WorkZone]
    standing: list[MapFeature]
    paths: list[DrivePath]
    lane_lines_from: str | None
    """File, base layers or the map's lane markings; None if there are no lane lines."""


def export_zones(
    conn: Connection,
    output: Path,
    file_format: str,
    *,
    map_name: str,
    as_of: datetime | None,
    feed: Path | None,
    publisher: str | None,
    road_names: list[str] | None,
    lanes: Path | None,
    country: str | None = None,
    max_age: timedelta | None = None,
    now: datetime | None = None,
) -> int:
    """Write a format of `ZONE_FORMATS` and return the number of features. Raises InputError."""
    required = ZONE_FORMATS[file_format].required
    info = read_feed_info(feed, required, publisher=publisher, road_names=road_names, country=country)
    params = WorkZoneParams()
    if max_age is not None:
        params = params.model_copy(update={"max_age_days": max_age / timedelta(days=1)})
    found = read_zones(conn, map_name=map_name, as_of=as_of, lanes=lanes, params=params)
    now = now or datetime.now(UTC)
    last_ns = max((cone.last_seen_ns for cone in found.standing), default=None)
    surveyed_at = None if last_ns is None else utc_from_ns(last_ns)
    context = FeedContext(
        info,
        require_map(conn, map_name).id_name,
        found.srid,
        at=as_of or now,
        made_at=now,
        params=params,
        surveyed_at=surveyed_at,
    )
    return zone_writer_of(file_format)(found.zones, found.standing, output, context)


def read_zones(
    conn: Connection, *, map_name: str, as_of: datetime | None, lanes: Path | None, params: WorkZoneParams
) -> MapZones:
    """Current and ended work zones of a map until a time (None: now).

    Raises InputError if the map does not exist, and for a file of lanes that belong to no work zone.
    """
    info = require_map(conn, map_name)
    every = read_versions(conn, map_name=map_name, until=as_of)
    versions = [v for v in every if v.feature.category in _IN_ROWS]
    paths = read_paths(conn, map_name=map_name, until=as_of)
    at_ns = None if as_of is None else ns_from_utc(as_of) + 999
    computed = zones_over_time(versions, paths, params, map_name=info.id_name, at_ns=at_ns)
    histories = with_kept_ids(computed, read_zone_aliases(conn, map_name=map_name))
    lines, source = _lane_lines(conn, histories, lanes, _standing(every, at_ns), map_name=map_name, srid=info.srid)
    zones = [
        describe(history, layout_of(history, paths, some, params), params)
        for history, some in zip(histories, lines, strict=True)
    ]
    if lanes is not None and zones and all(zone.layout.bands is None for zone in zones):
        raise InputError(
            f"{lanes}: none of its lines is beside a work zone of the map {map_name} and the drives that passed it. It may "
            "be of another road or in another CRS than stated, or have longitude and latitude swapped; nothing was written"
        )
    return MapZones(info.srid, zones, _standing(versions, at_ns), paths, source)


def _standing(versions: Sequence[FeatureVersion], at_ns: int | None) -> list[MapFeature]:
    """What stands at a time (None: now), from versions that began until then."""
    open_until = [v for v in versions if v.valid_to_ns is None or (at_ns is not None and v.valid_to_ns > at_ns)]
    return [v.feature for v in open_until if v.present and not v.suppressed]


def _lane_lines(
    conn: Connection,
    histories: list[ZoneHistory],
    lanes: Path | None,
    standing: Sequence[MapFeature],
    *,
    map_name: str,
    srid: int,
) -> tuple[list[list[LaneLine]], str | None]:
    """Lane lines beside each zone and their source: the file, if given, else the map's base layers, else its markings."""
    if lanes is not None:
        from conetl.readers.base_layers.line_files import read_lane_lines  # GDAL takes seconds to load

        return [read_lane_lines(lanes, srid=srid)] * len(histories), str(lanes)
    positions = [np.array([cone.xyz_m[:2] for cone in history.cones]) for history in histories]
    lines, layers = read_lanes_near(conn, positions, map_name=map_name)
    if layers:
        return lines, f"base layers {', '.join(layers)}"
    markings = [
        LaneLine(np.array(feature.marking.vertices_m)[:, :2], feature.marking.pattern)
        for feature in standing
        if feature.marking is not None
    ]
    return [markings] * len(histories), "lane markings of the map" if markings else None


def zone_as_dict(zone: WorkZone) -> dict[str, object]:
    """A work zone as JSON values."""
    layout = zone.layout
    return {
        "work_zone_id": str(zone.history.zone_id),
        "cones": [str(cone.feature_id) for cone in layout.cones],
        "first": str(zone.first.feature_id),
        "last": str(zone.last.feature_id),
        "length_m": round(float(layout.stations_m[-1] - layout.stations_m[0]), 2),
        "road_axis_from": layout.axis_source,
        "direction_known": layout.direction_known,
        "closed_side": zone.closed_side,
        "closed_lane_count": zone.closed_lane_count,
        "vehicle_impact": str(zone.impact),
        "tapers": [
            {"length_m": round(t.length_m, 2), "shift_m": round(t.shift_m, 2), "converging": t.converging}
            for row in layout.rows[:1]
            for t in row.tapers
        ],
    }
