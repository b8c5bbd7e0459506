"""`conetl map export|import|licence|qgis`: the map to other programs, and maps of others onto this one."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Annotated

import click
import typer

from conetl.cli.console import JsonOption, out, parse_time, print_json
from conetl.cli.database import open_map
from conetl.io.exports import FORMATS
from conetl.io.exports.export import export_map
from conetl.io.exports.source import ExportRequest, What
from conetl.settings import read_settings


def export(
    output: Annotated[Path, typer.Option("--out", help="File to write; a manifest is written beside it.")],
    file_format: Annotated[
        str, typer.Option("--format", click_type=click.Choice(list(FORMATS)), help="File format.")
    ] = "geojson",
    what: Annotated[
        What, typer.Option("--what", help="What stands, every version there ever was, or what changed between two times.")
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
    as_json: JsonOption = False,
) -> None:
    """Write the map, as it is or was, its history, or what changed, to a file with a manifest (FILE.manifest.json)."""
    settings = read_settings()
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
    if as_json:
        print_json({"written": str(output), what.value: manifest["rows"], "manifest": manifest})
    else:
        noun = {What.FEATURES: "cones", What.HISTORY: "versions", What.CHANGES: "changes"}[what]
        out.print(f"{manifest['rows']} {noun} -> {output}", markup=False)
