"""`conetl map export|import|licence|qgis`: exchange of maps with other programs."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from conetl.cli.console import (
    AsOfOption,
    FileCrsOption,
    JsonOption,
    KnownOption,
    MapOption,
    answer,
    counted,
    counted_by_class,
    note,
    parse_instant,
    parse_known,
    parse_span,
)
from conetl.cli.database import open_map
from conetl.cli.map import work_zones
from conetl.db.map.import_store import read_licence, set_licence
from conetl.db.map.map_store import find_map
from conetl.db.retention import parse_age
from conetl.exports import FORMATS, ZONE_FORMATS
from conetl.exports.export import export_map
from conetl.exports.kind_marks import kinds_text
from conetl.exports.qgis_project import write_qgis_project
from conetl.exports.source import ExportContent, ExportRequest
from conetl.files.documents import first_message
from conetl.geometry.geodesy import map_crs
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE, FEATURE_CLASSES, LANE_MARKING, noun_of
from conetl.model.params import ImportParams
from conetl.pipeline.database import open_maps
from conetl.pipeline.maps.work_zones import export_zones
from conetl.pipeline.settings import read_settings

ALL_FORMATS = (*FORMATS, *ZONE_FORMATS)


def export(
    output: Annotated[Path, typer.Option("--out", help="File to write; a manifest is written beside it.")],
    file_format: Annotated[
        str | None, typer.Option("--format", help=f"One of {', '.join(ALL_FORMATS)}; default: by the file name.")
    ] = None,
    what: Annotated[
        ExportContent, typer.Option(help="Current features, all versions, or the changes between two times.")
    ] = ExportContent.FEATURES,
    as_of: AsOfOption = None,
    known_at: KnownOption = None,
    since: Annotated[
        str | None,
        typer.Option(
            "--from",
            help="Only changes from this time on (a date includes that day); default: since the first drive.",
        ),
    ] = None,
    until: Annotated[
        str | None, typer.Option("--to", help="Only changes up to this time (a date includes that day); default: now.")
    ] = None,
    crs: Annotated[
        str | None,
        typer.Option(help="CRS of positions, and height system: EPSG:25832, EPSG:25832+7837; default: the map's."),
    ] = None,
    category: Annotated[
        str | None, typer.Option(help="Only objects of this class, such as drum or lane_marking; default: all.")
    ] = None,
    feed: work_zones.FeedOption = None,
    publisher: work_zones.PublisherOption = None,
    road_names: work_zones.RoadNamesOption = None,
    country: work_zones.CountryOption = None,
    lanes: work_zones.LanesOption = None,
    max_age: work_zones.MaxAgeOption = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Export the map, its history or its changes to a file, or its work zones as a feed (WZDx 4.2, DATEX II 3.7).

    Writes a manifest, FILE.manifest.json, beside the file. Lane markings are lines in the same file; in CSV, GeoParquet and
    FlatGeobuf, which hold one type of geometry, they are in a second file, FILE_lane_markings.
    """
    file_format = _format_by_name(output) if file_format is None else file_format
    category = None if category == "all" else category
    if file_format in ZONE_FORMATS:
        if what is not ExportContent.FEATURES or known_at or since or until or crs or category:
            raise InputError(
                f"--what, --known-at, --from, --to, --crs and --category cannot be used with --format {file_format}"
            )
        with open_map(map_name) as (conn, info):
            count = export_zones(
                conn, output, file_format, map_name=info.map_name, as_of=parse_instant(as_of),
                feed=feed, publisher=publisher, road_names=road_names, country=country, lanes=lanes,
                max_age=None if max_age is None else timedelta(seconds=parse_age(max_age)),
            )  # fmt: skip
        text = f"{counted(count, ZONE_FORMATS[file_format].noun)} -> {output}"
        answer(as_json, {"written": str(output), "features": count}, text)
        return
    if feed or publisher or road_names or country or lanes or max_age:
        raise InputError(
            "--feed, --publisher, --road-name, --country, --lanes and --max-age require --format "
            + " or ".join(ZONE_FORMATS)
        )
    if file_format not in FORMATS:
        raise InputError(f"unknown format {file_format}: use one of {', '.join(ALL_FORMATS)}")
    valid_at, (begin, end) = parse_instant(as_of), parse_span(since, until, ("--from", "--to"))
    request = ExportRequest(
        read_settings(map_name).map_name, what, as_of=valid_at, known_at=parse_known(known_at, end or valid_at),
        since=begin, until=end, crs=None if crs is None else map_crs(crs), category=category,
    )  # fmt: skip
    with open_map(map_name) as (conn, _):
        manifest = export_map(conn, output, file_format, request)
    rows, lines = manifest["rows"], manifest.get("lane_markings")
    count_of_lines = 0 if lines is None else lines["rows"]
    first = {name: count for name, count in manifest["rows_by_class"].items() if lines is None or name != LANE_MARKING}
    if what is ExportContent.FEATURES:
        text = counted_by_class(first or {category or CONE: 0})
        of_lines = counted_by_class({LANE_MARKING: count_of_lines})
    else:
        noun = "version" if what is ExportContent.HISTORY else "change"
        text, of_lines = counted(sum(first.values()), noun), f"{counted(count_of_lines, noun)} of lane markings"
    text += f" -> {output}"
    if lines is not None:
        text += f"\n{of_lines} -> {output.with_name(lines['file'])}"
    answer(as_json, {"written": str(output), what.value: rows, "manifest": manifest}, text)


def _format_by_name(output: Path) -> str:
    """The format of a file name; GeoJSON without a suffix. Raises InputError for an unknown suffix."""
    by_suffix = {form.suffix: name for name, form in FORMATS.items()} | {".json": "geojson", "": "geojson"}
    found = by_suffix.get(output.suffix.lower())
    if found is None:
        raise InputError(f"{output}: unknown suffix, choose a format with --format ({', '.join(ALL_FORMATS)})")
    return found


def import_(
    file: Annotated[Path, typer.Argument(help="GeoJSON, CSV, GeoPackage, FlatGeobuf or GeoParquet file of points.")],
    crs: FileCrsOption = None,
    map_srid: Annotated[int | None, typer.Option(help="EPSG code of the map, if this import creates it.")] = None,
    surveyed_at: Annotated[
        str | None, typer.Option(help="Time of the survey; default: the latest last_seen_at.")
    ] = None,
    sigma_m: Annotated[float, typer.Option(help="Sigma of each coordinate if the file has none.")] = 0.5,
    object_height_m: Annotated[
        float, typer.Option("--object-height-m", "--cone-height-m", help="Height of the objects if the file has none.")
    ] = 0.5,
    existence: Annotated[float, typer.Option(help="Existence probability if the file has none.")] = 0.9,
    ground_height_m: Annotated[
        float | None, typer.Option(help="Ellipsoidal height of the ground if the file has none.")
    ] = None,
    layer: Annotated[str | None, typer.Option(metavar="NAME", help="Layer to import, if the file has several.")] = None,
    new_ids: Annotated[
        bool, typer.Option("--new-ids", help="Create new ids instead of using those of the file.")
    ] = False,
    accept: Annotated[
        bool, typer.Option("--accept", help="Import a file that contradicts the map, or holds cones twice.")
    ] = False,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Import an existing map as one changeset. Drives confirm, move and remove its cones like any others."""
    from conetl.pipeline.maps.import_map import import_map
    from conetl.readers.maps.imported_rows import read_map_file  # GDAL takes seconds to load

    settings = read_settings(map_name)
    try:
        params = ImportParams(
            sigma_m=sigma_m, cone_height_m=object_height_m, existence_probability=existence, ground_height_m=ground_height_m,
            new_ids=new_ids,
        )  # fmt: skip
    except ValidationError as error:
        raise InputError(f"--{first_message(error).replace('_', '-', 2)}") from error
    with open_maps(settings) as conn:
        info = find_map(conn, settings.map_name)
        if info is not None and map_srid not in (None, info.srid):
            raise InputError(
                f"--map-srid {map_srid}: the map {settings.map_name} already exists and is in EPSG:{info.srid}; omit the option"
            )
        srid = info.srid if info else map_srid
        imported = read_map_file(
            file, params, crs=crs, map_srid=srid, stated_at=parse_instant(surveyed_at), layer=layer
        )
        total, noun = len(imported.statements), "cone" if imported.classes.keys() == {CONE} else "object"
        done = import_map(conn, imported, params, map_name=settings.map_name, accept=accept)
    if imported.lines_left_out:
        note(
            f"{counted(imported.lines_left_out, noun_of(LANE_MARKING))} of {file} skipped: `map import` reads only point objects"
        )
    text = f"{file} is already on the map {settings.map_name}: no changes."
    if done.own:
        note(f"{done.own} of {counted(total, noun)} of {file} were exported from this map: skipped, no new evidence")
        if not done.committed and done.changeset_id is None:
            text = f"{file} was exported from this map: no changes."
    if done.same_place:
        note(
            f"{done.same_place} of {counted(total, noun)} are exactly where objects of the map are or were. If the file was "
            "exported from this map, its evidence now counts twice: undo the import with `conetl map revert`"
        )
    if done.far:
        note(
            f"{done.far} of {counted(total, noun)} are more than 1 km from everything on the map {settings.map_name}: check "
            "the CRS of the file and of the map. If one is wrong, undo the import with `conetl map revert`"
        )
    if others := imported.classes.keys() - FEATURE_CLASSES.keys():
        note(
            f"{sum(imported.classes[name] for name in others)} of {counted(total, 'object')} have a class that drives do not "
            f"confirm or remove: {', '.join(sorted(others))}. conetl detects {', '.join(FEATURE_CLASSES)}"
        )
    if done.committed:
        again = f" {counted(done.replayed, 'later drive')} recomputed." if done.replayed else ""
        text = f"{counted(total - done.own, noun)} (EPSG:{imported.srid}): {kinds_text(done.counts)}.{again}"
    facts = {"file": str(file), "sha256": imported.content_sha256, "srid": imported.srid}
    answer(as_json, done._asdict() | facts, text)


def licence(
    text: Annotated[
        str | None, typer.Argument(help="Licence of the data of the map; default: show the current one.")
    ] = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show or set the licence that every export of the map contains."""
    with open_map(map_name) as (conn, info):
        if text is not None:
            set_licence(conn, info.map_name, text)
        found = read_licence(conn, info.map_name)
    answer(as_json, {"map": info.map_name, "licence": found}, found or "No licence is set.")


def qgis(
    output: Annotated[Path, typer.Option("--out", help="Project to write (.qgz or .qgs).")],
    user: Annotated[str | None, typer.Option(help="Database user of QGIS, e.g. with the role conetl_reader.")] = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a QGIS project of the live map, styled by change and existence probability, ready for the temporal controller.

    The project contains no password.
    """
    with open_map(map_name) as (conn, info):
        write_qgis_project(conn, output, map_name=info.map_name, user=user)
    answer(as_json, {"written": str(output)}, f"Project -> {output}")
