"""`conetl report`: QA reports of a drive and of a night, one HTML file each, from the database alone."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import typer

from conetl.cli.console import JsonOption, out, parse_time, print_json
from conetl.cli.database import open_map
from conetl.model.errors import InputError
from conetl.pipeline.settings import read_settings
from conetl.reports.drive_facts import find_drive

app = typer.Typer(help="QA reports: what a drive, or a night, did to the map.", no_args_is_help=True)


@app.command()
def drive(
    name: Annotated[str, typer.Argument(help="A drive's id, or the number of its changeset (`conetl map log`).")],
    output: Annotated[
        Path | None, typer.Option("--out", help="HTML file to write; exports/reports/<map>/<drive>.html unless given.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Counts, changes with pictures, residuals, refused records, times, versions and hashes of one drive."""
    from conetl.reports.drive_page import write_drive_page  # here: matplotlib takes half a second to load

    settings = read_settings()
    with closing(open_map(settings)) as conn:
        changeset = find_drive(conn, name, map_name=settings.map_name)
        path = output or settings.drive_report_path(changeset.drive_id, changeset.changeset_no)
        write_drive_page(conn, changeset, path, map_name=settings.map_name)
    _say(path, {"drive_id": changeset.drive_id, "changeset_no": changeset.changeset_no}, as_json=as_json)


def _say(path: Path, facts: dict[str, object], *, as_json: bool) -> None:
    if as_json:
        print_json({"written": str(path), "bytes": path.stat().st_size} | facts)
    else:
        out.print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)", markup=False)


@app.command()
def night(
    day: Annotated[
        str | None, typer.Argument(help="Day of processing (UTC), e.g. 2026-03-03; the last 24 hours unless given.")
    ] = None,
    since: Annotated[str | None, typer.Option(help="Drives that came onto the map since this time ...")] = None,
    until: Annotated[str | None, typer.Option(help="... until this time; default: now.")] = None,
    output: Annotated[
        Path | None, typer.Option("--out", help="HTML file; exports/reports/<map>/night-<until>.html unless given.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """All drives of a map in a span of processing time: taken, failed and why, changes, worst drives, map size."""
    from conetl.reports.night_page import write_night_page

    settings = read_settings()
    begin, end = _span(day, since, until)
    path = output or settings.reports_folder / f"night-{end:%Y%m%dT%H%M%SZ}.html"
    with closing(open_map(settings)) as conn:
        facts = write_night_page(conn, path, map_name=settings.map_name, since=begin, until=end)
    counted = {
        "since": begin.isoformat(),
        "until": end.isoformat(),
        "drives": len(facts.drives),
        "failed": len(facts.failures),
    }
    _say(path, {**counted}, as_json=as_json)


def _span(day: str | None, since: str | None, until: str | None) -> tuple[datetime, datetime]:
    """Begin and end, UTC. Raises InputError."""
    if day is not None:
        if since or until:
            raise InputError("a day, or --since and --until: not both")
        begin = _time(day).replace(hour=0, minute=0, second=0, microsecond=0)
        try:
            return begin, begin + timedelta(days=1)
        except OverflowError:
            raise InputError(f"{day}: the calendar ends with this day") from None
    end = _time(until) if until else datetime.now(UTC)
    return (_time(since) if since else end - timedelta(days=1)), end


def _time(text: str) -> datetime:
    found = parse_time(text)
    assert found is not None  # only of None
    return found
