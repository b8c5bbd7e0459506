"""`conetl report`: quality reports of a drive, a night or the map, one HTML file each, from the database and the drop folder."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map, require_maps
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.pipeline.database import open_maps
from conetl.pipeline.settings import read_settings


def drive(
    name: Annotated[str, typer.Argument(help="Drive id, or number of its changeset (see `conetl map log`).")],
    output: Annotated[
        Path | None, typer.Option("--out", help="HTML file; default: exports/reports/<map>/<drive>.html.")
    ] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Write the report of one drive: counts, changes with images, residuals, rejected records, times, versions and hashes."""
    from conetl.reports.drive_facts import find_drive
    from conetl.reports.drive_page import write_drive_page  # matplotlib takes half a second to load

    settings = read_settings(map_name)
    with open_map(map_name) as (conn, _):
        changeset = find_drive(conn, name, map_name=settings.map_name)
        path = output or settings.drive_report_path(changeset.drive_id, changeset.changeset_no)
        write_drive_page(conn, changeset, path, map_name=settings.map_name)
    _print_written(as_json, path, {"drive_id": changeset.drive_id, "changeset_no": changeset.changeset_no})


def night(
    day: Annotated[
        str | None, typer.Argument(help="Day of processing (UTC), e.g. 2026-03-03; default: the last 24 hours.")
    ] = None,
    since: Annotated[str | None, typer.Option(help="Drives committed at or after this time.")] = None,
    until: Annotated[
        str | None, typer.Option(help="Drives committed before this time, or up to the end of this day; default: now.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--out", help="HTML file; default: exports/reports/<map>/night-<until>.html.")
    ] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Write a report of all drives processed in a period: committed, on hold, failed and why, changes, worst drives, map size.

    Drives on hold come first, including those of earlier days. What is in the drop folder and no drive, or still arriving, has a
    row too. Exit code 1: at least one drive is on hold, or failed, or something is no drive.
    """
    from conetl.pipeline.backfill_plan import drop_folder_rows
    from conetl.reports.night_page import write_night_page

    settings = read_settings(map_name)
    begin, end = _period(day, since, until)
    path = output or settings.reports_folder / f"night-{end:%Y%m%dT%H%M%SZ}.html"
    with open_maps(require_maps(settings)) as conn:  # a first drive that failed has no map
        facts = write_night_page(
            conn, path, map_name=settings.map_name, since=begin, until=end, drop_folder=drop_folder_rows(settings)
        )
    if not as_json:
        ui.print_held(facts.held, facts.map_name)
        ui.print_hold_events(facts.hold_events)
        maps = sum(row["kind"] == "import" for row in facts.drives)
        drives = ui.counted(len(facts.drives) - maps, "drive") if facts.drives else "No drives"
        drives += f" and {ui.counted(maps, 'imported map')}" if maps else ""
        columns: ui.Columns = {"entry": "drive_id", "state": "state", "why": "reason"}
        ui.print_records("Not on the map", columns, [*facts.failures, *facts.waiting], numbers_from=len(columns))
        failed = f", {len(facts.failures)} failed or no drive" if facts.failures else ""
        failed += f", {len(facts.waiting)} still arriving" if facts.waiting else ""
        hint = "" if facts.drives or failed else " Drives are listed by the time of processing, not of recording."
        ui.say(f"{drives} processed from {begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC{failed}.{hint}")
    counts = {"drives": len(facts.drives), "failed": len(facts.failures), "entries": facts.entries}
    rows = {"held": facts.held, "hold_events": facts.hold_events}
    _print_written(as_json, path, {"since": begin, "until": end, **counts, **rows})
    if facts.held or facts.failed:
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def quality(
    checkpoints: Annotated[
        Path | None,
        typer.Option(help="Surveyed feet of objects, as for `map check-points`; default: no test of positions."),
    ] = None,
    crs: ui.FileCrsOption = None,
    heights: ui.HeightsOption = None,
    sigma_m: ui.SurveySigmaOption = None,
    within_m: ui.WithinOption = 0.75,
    as_of: ui.AsOfOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "--output",
            help="HTML file, or ISO 19157 as XML (.xml), or a folder; default: exports/reports/<map>/quality.html.",
        ),
    ] = None,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Write the quality of the map: accuracy at check points (ASPRS 2023, NSSDA), measures of ISO 19157-1, coverage, latency.

    `--json` prints all figures; `--out report.xml` is a DQ_DataQuality for metadata of ISO 19115-3. Exit code 1: residuals
    contradict the stated sigmas, or an audit finds rows.
    """
    from conetl.evaluation.map_quality import read_quality, write_quality_page
    from conetl.evaluation.quality_xml import write_quality_xml
    from conetl.readers.surveyed_points import read_surveyed_points

    settings = read_settings(map_name)
    path = output or settings.reports_folder
    path = path if path.suffix else path / "quality.html"
    if path.suffix.lower() not in (".html", ".xml"):
        raise InputError(f"--out {path}: expected a name that ends with .html or .xml, or a folder")
    with open_map(map_name) as (conn, info):
        points = (
            []
            if checkpoints is None
            else read_surveyed_points(checkpoints, info.srid, crs=crs, heights=heights, sigma_m=sigma_m)
        )
        found = read_quality(
            conn,
            map_name=info.map_name,
            srid=info.srid,
            as_of=ui.parse_instant(as_of),
            points=points,
            within_m=within_m,
        )
    (write_quality_xml if path.suffix.lower() == ".xml" else write_quality_page)(path, found)
    if not as_json and found.positional is not None:
        ui.say(found.positional.statement)
    _print_written(as_json, path, found.model_dump(mode="json"))
    if found.needs_attention:
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def _print_written(as_json: bool, path: Path, facts: dict[str, Any]) -> None:
    size = path.stat().st_size
    ui.answer(as_json, {"written": str(path), "bytes": size} | facts, f"{path} ({size / 1e3:.0f} kB)")


def _period(day: str | None, since: str | None, until: str | None) -> tuple[datetime, datetime]:
    """Begin and end, UTC. Raises InputError."""
    if day is not None:
        if since or until:
            raise InputError("give a day or --since and --until, not both")
        begin = ui.parse_instant(day)
        assert begin is not None
        begin = begin.replace(hour=0, minute=0, second=0, microsecond=0)
        try:
            return begin, begin + timedelta(days=1)
        except OverflowError:
            raise InputError(f"invalid time {day!r}: the calendar ends here") from None
    begin, end = ui.parse_span(since, until, ("--since", "--until"))
    end = end or datetime.now(UTC)
    return begin or end - timedelta(days=1), end
