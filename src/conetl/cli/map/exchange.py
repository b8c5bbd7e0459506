"""`conetl map export|import|licence|qgis`: the map to other programs, and maps of others onto this one."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError

from conetl.cli.console import JsonOption, counted, out, parse_time, print_json
from conetl.cli.database import open_map
from conetl.cli.map import work_zones
from conetl.db.map.import_store import read_licence, set_licence
from conetl.db.map.map_store import find_map
from conetl.exports import FORMATS
from conetl.exports.export import export_map
from conetl.exports.qgis_project import write_qgis_project
from conetl.exports.source import ExportRequest, What
from conetl.geometry.geodesy import check_map_srid
from conetl.model.errors import InputError
from conetl.model.params import ImportParams
from conetl.pipeline.settings import read_settings

#: Formats of `map export` that tell of work zones, not of cones one by one (`work_zones.py`).
WZDX, WZDX_DEVICES = "wzdx", "wzdx-devices"
ALL_FORMATS = (*FORMATS, WZDX, WZDX_DEVICES)
_NOUNS = {What.FEATURES: "cone", What.HISTORY: "version", What.CHANGES: "change"}


def export(
    output: Annotated[Path, typer.Option("--out", help="File to write; a manifest is written beside it.")],
    file_format: Annotated[
        str | None, typer.Option("--format", help=f"One of {', '.join(ALL_FORMATS)}; by the file's name unless given.")
    ] = None,
    what: Annotated[
        What,
        typer.Option("--what", help="What stands, every version there ever was, or what changed between two times."),
    ] = What.FEATURES,
    as_of: Annotated[
        str | None,
        typer.Option("--as-of", help="Features as they stood on the road at this time, e.g. 2026-03-02T10:00+01:00."),
    ] = None,
    believed_at: Annotated[
        str | None, typer.Option("--believed-at", help="As the database believed at this time; default: now.")
    ] = None,
    since: Annotated[str | None, typer.Option("--from", help="Changes on the road since this time ...")] = None,
    until: Annotated[str | None, typer.Option("--to", help="... until this time; default: now.")] = None,
    feed: work_zones.FeedOption = None,
    publisher: work_zones.PublisherOption = None,
    road_names: work_zones.RoadNamesOption = None,
    lanes: work_zones.LanesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write the map, as it is or was, its history, or what changed, to a file with a manifest (FILE.manifest.json); or its work
    zones as a WZDx 4.2 feed."""
    settings = read_settings()
    file_format = _format_by_name(output) if file_format is None else file_format
    if file_format in (WZDX, WZDX_DEVICES):
        if what is not What.FEATURES or believed_at or since or until:
            raise InputError(
                f"--what, --believed-at, --from and --to do not go with --format {file_format}: leave them out"
            )
        with closing(open_map(settings)) as conn:
            count = work_zones.export_wzdx(
                conn, output, devices=file_format == WZDX_DEVICES, map_name=settings.map_name, as_of=parse_time(as_of),
                feed=feed, publisher=publisher, road_names=road_names, lanes=lanes,
            )  # fmt: skip
        _say(output, count, "work zone" if file_format == WZDX else "cone", {"features": count}, as_json)
        return
    if feed or publisher or road_names or lanes:
        raise InputError(f"--feed, --publisher, --road-name and --lanes belong to --format {WZDX} or {WZDX_DEVICES}")
    if file_format not in FORMATS:
        raise InputError(f"there is no format {file_format}: choose one of {', '.join(ALL_FORMATS)}")
    request = ExportRequest(
        settings.map_name,
        what,
        as_of=parse_time(as_of),
        believed_at=parse_time(believed_at),
        since=parse_time(since),
        until=parse_time(until),
    )
    with closing(open_map(settings)) as conn:
        manifest = export_map(conn, output, file_format, request)
    rows = manifest["rows"]
    _say(output, rows, _NOUNS[what], {what.value: rows, "manifest": manifest}, as_json)


def _format_by_name(output: Path) -> str:
    """GeoJSON where the name has no ending. Raises InputError for an ending that says nothing."""
    by_suffix = {form.suffix: name for name, form in FORMATS.items()} | {".json": "geojson", "": "geojson"}
    found = by_suffix.get(output.suffix.lower())
    if found is None:
        raise InputError(
            f"{output}: the name does not tell which format to write: choose one by --format ({', '.join(ALL_FORMATS)})"
        )
    return found


def _say(output: Path, count: int, noun: str, answer: dict[str, object], as_json: bool) -> None:
    if as_json:
        print_json({"written": str(output)} | answer)
    else:
        out.print(f"{counted(count, noun)} -> {output}", markup=False)


def import_(
    file: Annotated[Path, typer.Argument(help="GeoJSON, CSV, GeoPackage, FlatGeobuf or GeoParquet file of points.")],
    crs: Annotated[
        str | None, typer.Option("--crs", help="CRS of the file's coordinates where it names none, e.g. EPSG:25832.")
    ] = None,
    map_srid: Annotated[int | None, typer.Option("--map-srid", help="CRS of a map that this import begins.")] = None,
    surveyed_at: Annotated[
        str | None,
        typer.Option("--surveyed-at", help="Time for which the file speaks; default: its latest last_seen_at."),
    ] = None,
    sigma_m: Annotated[
        float, typer.Option("--sigma-m", help="Sigma of each coordinate where the file has none.")
    ] = 0.5,
    cone_height_m: Annotated[float, typer.Option("--cone-height-m", help="Cone height where the file has none.")] = 0.5,
    existence: Annotated[
        float, typer.Option("--existence", help="Existence probability where the file has none.")
    ] = 0.9,
    ground_height_m: Annotated[
        float | None,
        typer.Option("--ground-height-m", help="Ellipsoidal height of the ground where the file has none."),
    ] = None,
    layer: Annotated[
        str | None, typer.Option("--layer", metavar="NAME", help="Layer to import of a file that has several.")
    ] = None,
    new_ids: Annotated[
        bool, typer.Option("--new-ids", help="Found new ids instead of taking those of the file.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Take a map that was made elsewhere onto this one, as one changeset. Drives confirm, move and remove its cones like
    others."""
    from conetl.pipeline.import_map import import_map
    from conetl.readers.maps.statements import read_map_file  # GDAL takes seconds to load

    settings = read_settings()
    try:
        params = ImportParams(
            sigma_m=sigma_m,
            cone_height_m=cone_height_m,
            existence_probability=existence,
            ground_height_m=ground_height_m,
            new_ids=new_ids,
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{first['loc'][0]} is {first['input']}: {first['msg']}") from error
    with closing(open_map(settings)) as conn:
        info = find_map(conn, settings.map_name)
        if info is not None and map_srid is not None and map_srid != info.srid:
            raise InputError(
                f"the map {settings.map_name} is in EPSG:{info.srid}, not in EPSG:{map_srid}: leave out --map-srid"
            )
        srid = info.srid if info else map_srid
        if srid is not None:
            require_map_srid(srid)
        imported = read_map_file(file, params, crs=crs, map_srid=srid, stated_at=parse_time(surveyed_at), layer=layer)
        require_map_srid(imported.srid)
        done = import_map(conn, imported, params, map_name=settings.map_name)
    if as_json:
        print_json(done._asdict() | {"file": str(file), "sha256": imported.content_sha256, "srid": imported.srid})
    elif not done.committed:
        out.print(f"{file} is on the map {settings.map_name} already: no changes.", markup=False)
    else:
        counts = ", ".join(f"{count} {kind}" for kind, count in done.counts.items() if count)
        again = f" Compared with the map again: {counted(done.replayed, 'later drive')}." if done.replayed else ""
        out.print(f"{counted(len(imported.statements), 'cone')} (EPSG:{imported.srid}): {counts}.{again}", markup=False)


def licence(
    text: Annotated[str | None, typer.Argument(help="Licence of the map's data; without it, show what is set.")] = None,
    as_json: JsonOption = False,
) -> None:
    """The licence that is handed out with every export of the map."""
    settings = read_settings()
    with closing(open_map(settings)) as conn:
        if text is not None:
            set_licence(conn, settings.map_name, text)
        found = read_licence(conn, settings.map_name)
    if as_json:
        print_json({"map": settings.map_name, "licence": found})
    else:
        out.print(found or "No licence is set.", markup=False)


def qgis(
    output: Annotated[Path, typer.Option("--out", help="Project to write (.qgz or .qgs).")],
    user: Annotated[
        str | None,
        typer.Option("--user", help="Login that QGIS uses, e.g. one with the role conetl_reader; no password is kept."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a QGIS project over the live map: styled by change and probability, with the temporal controller set."""
    settings = read_settings()
    with closing(open_map(settings)) as conn:
        write_qgis_project(conn, output, map_name=settings.map_name, user=user)
    if as_json:
        print_json({"written": str(output)})
    else:
        out.print(f"Project -> {output}", markup=False)


def require_map_srid(srid: int) -> None:
    """Raises InputError unless a map may be in EPSG:srid."""
    try:
        check_map_srid(srid)
    except ValueError as error:
        raise InputError(f"{error}: state another one (--map-srid)") from error
