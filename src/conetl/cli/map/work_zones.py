"""Options of `conetl map export` for formats of work zones, and `conetl map check-layout`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from conetl.cli.console import (
    AsOfOption,
    Columns,
    JsonOption,
    MapOption,
    counted,
    parse_instant,
    print_json,
    print_records,
    say,
)
from conetl.cli.database import open_map
from conetl.exports.text_files import export_layout_geojson, finding_as_dict
from conetl.files.documents import read_yaml_model
from conetl.model.base import Record
from conetl.model.errors import InputError
from conetl.model.work_zone_params import LayoutParams, WorkZoneParams
from conetl.model.work_zone_records import LayoutFinding, Level, WorkZone
from conetl.pipeline.maps.work_zones import read_zones, zone_as_dict
from conetl.workzones import layout_check

FeedOption = Annotated[
    Path | None, typer.Option("--feed", help="Work zones: YAML file with publisher, road_names, contact, licence ...")
]
PublisherOption = Annotated[str | None, typer.Option("--publisher", help="Work zones: publisher of the feed.")]
RoadNamesOption = Annotated[
    list[str] | None, typer.Option("--road-name", help="Work zones: name of the road; may be repeated.")
]
CountryOption = Annotated[str | None, typer.Option("--country", help="DATEX II: country of the publisher, like de.")]
LanesOption = Annotated[
    Path | None,
    typer.Option(
        "--lanes",
        help="Lane boundaries: GeoJSON, GeoPackage, Lanelet2 (.osm) or any GDAL vector file; default: the base layers.",
    ),
]
RulesOption = Annotated[
    Path | None, typer.Option("--rules", help="YAML file with `layout` and `zones` rules that replace the defaults.")
]


class Rules(Record):
    """The file of `--rules`."""

    layout: LayoutParams = LayoutParams()
    zones: WorkZoneParams = WorkZoneParams()


MaxAgeOption = Annotated[
    str | None,
    typer.Option(
        "--max-age",
        help="Work zones: a survey is evidence for this long; then a zone has an end in the past, and unknown impact: 7d, 36h; "
        "default: 7d.",
    ),
]


def check_layout_command(
    speed_kmh: Annotated[float, typer.Option(min=5, max=200, help="Speed limit of the road, for the rules.")] = 50.0,
    standard: Annotated[
        str,
        typer.Option(help=f"Source of the rules: {', '.join(layout_check.STANDARDS)}."),
    ] = layout_check.DEFAULT,
    rules: RulesOption = None,
    lanes: LanesOption = None,
    as_of: AsOfOption = None,
    output: Annotated[
        Path | None, typer.Option("--out", help="GeoJSON file to write, one feature per finding.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--image", "--picture", help="PNG to write: the work zones along their road.")
    ] = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check the layout of the work zones: spacing, missing cones, taper lengths, cones in the open lane."""
    if standard not in layout_check.STANDARDS:
        raise InputError(f"--standard {standard}: expected one of {', '.join(layout_check.STANDARDS)}")
    chosen = read_yaml_model(rules, Rules, "rules")
    layout = layout_check.layout_rules(standard, chosen.layout)
    with open_map(map_name) as (conn, info):
        found = read_zones(conn, map_name=info.map_name, as_of=parse_instant(as_of), lanes=lanes, params=chosen.zones)
    standing = [zone for zone in found.zones if zone.history.end_ns is None]
    checked = [
        (zone, layout_check.check_layout(zone.history, zone.layout, speed_kmh, layout, chosen.zones))
        for zone in standing
    ]
    findings = [finding for _, some in checked for finding in some]
    taper_m, tangent_m = layout_check.allowed_spacing_m(speed_kmh, layout)
    spacing = (
        f"at most {taper_m:.1f} m between cones in tapers, {tangent_m:.1f} m in tangents"
        if math.isfinite(taper_m + tangent_m)
        else "no rule of spacing"
    )
    known = layout_check.read_standard(standard)
    title = f"Map {info.map_name}{f' as of {as_of}' if as_of else ''}, {known.standard}, {speed_kmh:g} km/h: {spacing}"
    if output is not None:
        export_layout_geojson(findings, output, srid=found.srid)
    if picture is not None:
        if not checked:
            raise InputError(f"{picture}: not written, because the map {info.map_name} has no work zones")
        from conetl.reports.layout_image import draw_layout  # matplotlib takes half a second to load

        draw_layout(picture, checked, found.paths, title=title)
    if as_json:
        print_json(
            {
                "map": info.map_name,
                "standard": known.standard,
                "not_covered": known.not_covered,
                "speed_kmh": speed_kmh,
                "lane_lines_from": found.lane_lines_from,
                "work_zones": [zone_as_dict(zone) for zone in standing],
                "findings": [finding_as_dict(finding) for finding in findings],
            }
        )
        return
    say(title)
    say(f"Not checked: {'; '.join(known.not_covered)}.")
    if not checked:
        say("There are no work zones on this map.")
    for zone, some in checked:
        _print_zone(zone, some, found.lane_lines_from)
    if output is not None:
        say(f"{counted(len(findings), 'finding')} -> {output}")
    if picture is not None:
        say(f"image -> {picture}")


def _print_zone(zone: WorkZone, findings: list[LayoutFinding], lane_lines_from: str | None) -> None:
    layout = zone.layout
    source = {"lanes": f"lane lines ({lane_lines_from})", "drives": "the drive paths", "cones": "the cones alone"}
    length = layout.stations_m[-1] - layout.stations_m[0]
    counts = {level: sum(finding.level is level for finding in findings) for level in Level}
    named = (
        f"{count} {level}" if level is Level.CANNOT_TELL else counted(count, level)
        for level, count in counts.items()
        if count
    )
    result = ", ".join(named) or "no findings"
    cones = f"{counted(len(layout.cones), 'cone')} over {length:.1f} m"
    say(f"\nWork zone {str(zone.history.zone_id)[:8]}: {cones}, offsets from {source[layout.axis_source]}: {result}")
    columns: Columns = {
        "": lambda item: item[0],
        "level": lambda item: str(item[1].level),
        "rule": lambda item: str(item[1].rule),
        "station m": lambda item: f"{item[1].station_m - layout.stations_m[0]:.2f}",
        "measured m": lambda item: f"{item[1].value:.2f}",
        "limit m": lambda item: f"{item[1].limit:.2f}",
        "sigma m": lambda item: f"{item[1].sigma:.2f}",
        "norm": lambda item: item[1].norm,
    }
    print_records("", columns, enumerate(findings, 1), numbers_from=3)
    for number, finding in enumerate(findings, 1):
        say(f"{number}  {finding.text}")
