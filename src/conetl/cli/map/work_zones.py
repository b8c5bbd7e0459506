"""Work zones: `conetl map export --format wzdx|wzdx-devices` and `conetl map check-layout`."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydantic import BaseModel, ConfigDict

from conetl.cli.console import JsonOption, counted, out, parse_time, print_json, print_table
from conetl.cli.database import open_map
from conetl.db.connection import Connection
from conetl.db.map.map_store import find_map
from conetl.db.zone_store import read_lanes_near, read_paths, read_versions
from conetl.exports.feed_info import read_feed_info
from conetl.exports.layout_files import export_layout_geojson, finding_as_dict
from conetl.exports.wzdx import FeedContext, export_device_feed, export_work_zone_feed
from conetl.files.yaml_model import read_yaml_model
from conetl.model.errors import InputError
from conetl.model.map_records import MapFeature
from conetl.model.params import LayoutParams, WorkZoneParams
from conetl.model.work_zone_records import DrivePath, Finding, LaneLine, Level, WorkZone, ZoneHistory
from conetl.pipeline.settings import read_settings
from conetl.workzones.layout_check import allowed_spacing_m, check_layout
from conetl.workzones.work_zones import zones_over_time
from conetl.workzones.zone_layout import describe, layout_of

FeedOption = Annotated[
    Path | None, typer.Option("--feed", help="For wzdx: YAML file with publisher, road_names, contact, licence ...")
]
PublisherOption = Annotated[str | None, typer.Option("--publisher", help="For wzdx: who publishes the feed.")]
RoadNamesOption = Annotated[
    list[str] | None, typer.Option("--road-name", help="For wzdx: the road's name; may be given several times.")
]
LanesOption = Annotated[
    Path | None,
    typer.Option(
        "--lanes",
        help="Lane boundaries: GeoJSON, GeoPackage, Lanelet2 (.osm) or whatever GDAL reads; default: the base layers.",
    ),
]
RulesOption = Annotated[
    Path | None, typer.Option("--rules", help="YAML file with `layout` and `zones`: rules other than the defaults.")
]


class Rules(BaseModel):
    """The file of `--rules`."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    layout: LayoutParams = LayoutParams()
    zones: WorkZoneParams = WorkZoneParams()


@dataclass(frozen=True)
class MapZones:
    """The work zones of a map at an instant."""

    srid: int
    zones: list[WorkZone]
    standing: list[MapFeature]
    paths: list[DrivePath]
    lane_lines_from: str | None
    """The file, or the base layers; None where no lane lines are known."""


def export_wzdx(
    conn: Connection,
    output: Path,
    *,
    devices: bool,
    map_name: str,
    as_of: datetime | None,
    feed: Path | None,
    publisher: str | None,
    road_names: list[str] | None,
    lanes: Path | None,
) -> int:
    """Write a WorkZoneFeed, or a DeviceFeed, checked against its schema; the number of features. Raises InputError."""
    info = read_feed_info(feed, publisher=publisher, road_names=road_names)
    params = WorkZoneParams()
    found = read_zones(conn, map_name=map_name, as_of=as_of, lanes=lanes, params=params)
    now = datetime.now(UTC)
    context = FeedContext(info, map_name, found.srid, at=as_of or now, made_at=now, params=params)
    if devices:
        return export_device_feed(found.standing, found.zones, output, context)
    return export_work_zone_feed(found.zones, output, context)


def read_zones(
    conn: Connection, *, map_name: str, as_of: datetime | None, lanes: Path | None, params: WorkZoneParams
) -> MapZones:
    """The map's work zones, standing and ended, up to an instant (None: now). Raises InputError where there is no such map."""
    info = find_map(conn, map_name)
    if info is None:
        raise InputError(f"there is no map named {map_name} in this database: ingest a drive or import a map first.")
    versions = read_versions(conn, map_name=map_name, until=as_of)
    paths = read_paths(conn, map_name=map_name, until=as_of)
    at_ns = None if as_of is None else int(as_of.timestamp() * 1_000_000) * 1000 + 999
    histories = zones_over_time(versions, paths, params, map_name=map_name, at_ns=at_ns)
    lines, source = _lane_lines(conn, histories, lanes, map_name=map_name, srid=info.srid)
    zones = [
        describe(history, layout_of(history, paths, some, params), params)
        for history, some in zip(histories, lines, strict=True)
    ]
    open_until = [v for v in versions if v.valid_to_ns is None or (at_ns is not None and v.valid_to_ns > at_ns)]
    standing = [v.feature for v in open_until if v.present and not v.suppressed]
    return MapZones(info.srid, zones, standing, paths, source)


def _lane_lines(
    conn: Connection, histories: list[ZoneHistory], lanes: Path | None, *, map_name: str, srid: int
) -> tuple[list[list[LaneLine]], str | None]:
    """Lane lines beside each zone, and where they come from: the file where one is named, else the map's base layers."""
    if lanes is not None:
        from conetl.readers.base_layers.line_files import read_lane_lines  # GDAL takes seconds to load

        return [read_lane_lines(lanes, srid=srid)] * len(histories), str(lanes)
    places = [np.array([cone.xyz_m[:2] for cone in history.cones]) for history in histories]
    lines, layers = read_lanes_near(conn, places, map_name=map_name)
    return lines, f"base layers {', '.join(layers)}" if layers else None


def check_layout_command(
    speed_kmh: Annotated[
        float, typer.Option("--speed-kmh", min=5, max=200, help="Speed limit that the rules ask for.")
    ] = 50.0,
    rules: RulesOption = None,
    lanes: LanesOption = None,
    as_of: Annotated[str | None, typer.Option("--as-of", help="The map as it stood on the road at this time.")] = None,
    output: Annotated[Path | None, typer.Option("--out", help="GeoJSON file to write: one feature a finding.")] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="PNG file to write: the zones along their road.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check the layout of the work zones: spacing, missing cones, taper lengths, cones in the open lane."""
    settings = read_settings()
    chosen = read_yaml_model(rules, Rules, "rules")
    with closing(open_map(settings)) as conn:
        found = read_zones(conn, map_name=settings.map_name, as_of=parse_time(as_of), lanes=lanes, params=chosen.zones)
    standing = [zone for zone in found.zones if zone.history.end_ns is None]
    checked = [
        (zone, check_layout(zone.history, zone.layout, speed_kmh, chosen.layout, chosen.zones)) for zone in standing
    ]
    findings = [finding for _, some in checked for finding in some]
    if output is not None:
        export_layout_geojson(findings, output, srid=found.srid)
    if picture is not None:
        if not checked:
            raise InputError(f"the map {settings.map_name} has no work zone to draw: {picture} was not written")
        from conetl.reports.layout_image import draw_layout  # so does matplotlib

        draw_layout(picture, checked, found.paths, title=_title(settings.map_name, speed_kmh, chosen.layout, as_of))
    if as_json:
        print_json(
            {
                "map": settings.map_name,
                "speed_kmh": speed_kmh,
                "lane_lines_from": found.lane_lines_from,
                "work_zones": [_zone_as_dict(zone) for zone in standing],
                "findings": [finding_as_dict(finding) for finding in findings],
            }
        )
        return
    _print(checked, _title(settings.map_name, speed_kmh, chosen.layout, as_of), found.lane_lines_from)
    for path, what in ((output, counted(len(findings), "finding")), (picture, "picture")):
        if path is not None:
            out.print(f"{what} -> {path}", markup=False)


def _title(map_name: str, speed_kmh: float, rules: LayoutParams, as_of: str | None) -> str:
    taper_m, tangent_m = allowed_spacing_m(speed_kmh, rules)
    when = f" as of {as_of}" if as_of else ""
    limits = f"at most {taper_m:.1f} m between cones in tapers, {tangent_m:.1f} m in tangents"
    return f"Map {map_name}{when}, {speed_kmh:g} km/h: {limits}"


def _print(checked: list[tuple[WorkZone, list[Finding]]], title: str, lane_lines_from: str | None) -> None:
    out.print(title, markup=False)
    if not checked:
        out.print("No work zone stands on this map.")
        return
    for zone, findings in checked:
        layout = zone.layout
        lanes = f"lane lines ({lane_lines_from})"
        source = {"lanes": lanes, "drives": "the driven paths", "cones": "the cones alone"}[layout.axis_source]
        length = layout.stations_m[-1] - layout.stations_m[0]
        counts = {level: sum(finding.level is level for finding in findings) for level in Level}
        words = ", ".join(_counted(count, level) for level, count in counts.items() if count) or "nothing to report"
        what = f"{counted(len(layout.cones), 'cone')} over {length:.1f} m, offsets from {source}: {words}"
        out.print(f"\nWork zone {str(zone.history.zone_id)[:8]}: {what}", markup=False)
        if findings:
            rows: list[tuple[object, ...]] = []
            for n, f in enumerate(findings, 1):
                metres = (f.station_m - layout.stations_m[0], f.value, f.limit, f.sigma)
                rows.append((n, f.level, f.rule, *(f"{value:.2f}" for value in metres), f.norm))
            columns = ("", "level", "rule", "at m", "is m", "limit m", "sigma m", "norm")
            print_table("", columns, rows, numbers_from=3)
            for n, finding in enumerate(findings, 1):
                out.print(f"{n}  {finding.text}", markup=False)


def _counted(count: int, level: Level) -> str:
    return f"{count} {level}" if level is Level.CANNOT_TELL else counted(count, level)


def _zone_as_dict(zone: WorkZone) -> dict[str, object]:
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
            {"length_m": round(t.end_m - t.start_m, 2), "shift_m": round(t.shift_m, 2), "converging": t.converging}
            for row in layout.rows[:1]
            for t in row.tapers
        ],
    }
