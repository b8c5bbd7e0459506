"""`conetl db prune`: delete what is old by policy."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Annotated, Any

import typer

from conetl.cli.console import JsonOption, out, print_json, print_table
from conetl.db.retention import parse_age, prunable_drives, prune_drives
from conetl.files.expiry import old_images, old_publications, old_results, remove, size_bytes
from conetl.files.partial_files import sweep
from conetl.model.errors import InputError
from conetl.pipeline.settings import read_settings


def prune(
    keep_positions: Annotated[
        str | None,
        typer.Option(
            help="Delete detections, stereo matches and positions of drives recorded longer ago: 90d, 12w, 36h."
        ),
    ] = None,
    keep_results: Annotated[
        str | None, typer.Option(help="Delete intermediate results (files) that were written longer ago.")
    ] = None,
    keep_pictures: Annotated[
        str | None, typer.Option(help="Delete pictures unpacked from bags that no run asked for in this time.")
    ] = None,
    keep_publications: Annotated[
        str | None, typer.Option(help="Delete what `publish` wrote longer ago; the latest stays, however old.")
    ] = None,
    do_it: Annotated[bool, typer.Option("--yes", help="Delete; without it this only says what would go.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Delete raw records and files that are older than a policy says. Without --yes nothing is deleted.

    The map and its whole history stay. A drive without its raw records cannot be compared with the map again: drives recorded
    before it over the same road, and decisions that touch what it did, are refused from then on.
    """
    # Here, not at the top: `conetl db` adds this command.
    from conetl.cli.database import open_map

    ages = {"results": keep_results, "pictures": keep_pictures, "publications": keep_publications}
    settings, now = read_settings(), datetime.now(UTC)
    since = {kind: now - timedelta(seconds=parse_age(age)) for kind, age in ages.items() if age is not None}
    if keep_positions is None and not since:
        raise InputError("say what to keep, for instance --keep-positions 90d or --keep-results 30d (see --help)")
    report: dict[str, Any] = {"deleted": do_it}
    if keep_positions is not None:
        before = now - timedelta(seconds=parse_age(keep_positions))
        with closing(open_map(settings)) as conn:
            drives = prunable_drives(conn, before)
            rows = sum(d.detection_count + d.match_count + d.position_count for d in drives)
            if do_it:
                rows = prune_drives(conn, drives, now=now)
        report |= {"drives": [asdict(drive) for drive in drives], "rows": rows}
    find = {
        "results": partial(old_results, settings.results_folder),
        "pictures": partial(old_images, settings.images_folder),
        "publications": partial(old_publications, settings.exports_folder),
    }
    files = {kind: find[kind](before) for kind, before in since.items()}
    for kind, paths in files.items():
        report[kind] = {"count": len(paths), "bytes": remove(paths) if do_it else size_bytes(paths)}
    if do_it:
        sweep((settings.results_folder, settings.exports_folder))
    if as_json:
        print_json(report)
        return
    if keep_positions is not None:
        names = ("map", "drive", "recorded until", "detections", "matches", "positions")
        lines = [
            (
                d.map_name,
                d.drive_id,
                f"{d.captured_to:%Y-%m-%d %H:%M}",
                d.detection_count,
                d.match_count,
                d.position_count,
            )
            for d in drives
        ]
        print_table("", names, lines, numbers_from=3)
        out.print(f"{report['rows']} rows of {len(drives)} drives {'were deleted' if do_it else 'would go'}.")
    for kind, paths in files.items():
        size = report[kind]["bytes"] / 1e6
        out.print(f"{len(paths)} {kind}, {size:.1f} MB, {'were deleted' if do_it else 'would go'}.")
    if not do_it:
        out.print("Nothing was deleted: add --yes to do it.")
