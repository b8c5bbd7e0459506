"""`conetl db prune`: delete what is old by policy."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from typing import Annotated

import typer

from conetl.cli.console import JsonOption, out, print_json, print_table
from conetl.errors import InputError
from conetl.io.leftovers import sweep
from conetl.io.stores.retention import parse_age, prunable_drives, prunable_results, prune_drives, prune_results
from conetl.settings import read_settings


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
    do_it: Annotated[bool, typer.Option("--yes", help="Delete; without it this only says what would go.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Delete raw records and intermediate results that are older than a policy says. Without --yes nothing is deleted.

    The map and its whole history stay. A drive without its raw records cannot be compared with the map again: drives recorded
    before it over the same road, and decisions that touch what it did, are refused from then on.
    """
    # Here, not at the top: `conetl db` adds this command.
    from conetl.cli.database import open_map

    if keep_positions is None and keep_results is None:
        raise InputError("say what to keep: --keep-positions 90d, --keep-results 30d, or both")
    settings, now = read_settings(), datetime.now(UTC)
    report: dict[str, object] = {"deleted": do_it}
    if keep_positions is not None:
        before = now - timedelta(seconds=parse_age(keep_positions))
        with closing(open_map(settings)) as conn:
            drives = prunable_drives(conn, before)
            rows = sum(d.detection_count + d.match_count + d.position_count for d in drives)
            if do_it:
                rows = prune_drives(conn, drives, now=now)
        report |= {"drives": [asdict(drive) for drive in drives], "rows": rows}
    if keep_results is not None:
        old = prunable_results(settings.results_folder, now - timedelta(seconds=parse_age(keep_results)))
        size = sum(path.stat().st_size for path in old)
        if do_it:
            size = prune_results(old)
            sweep((settings.results_folder, settings.exports_folder))
        report |= {"result_files": len(old), "bytes": size}
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
    if keep_results is not None:
        out.print(f"{len(old)} result files, {size / 1e6:.1f} MB, {'were deleted' if do_it else 'would go'}.")
    if not do_it:
        out.print("Nothing was deleted: add --yes to do it.")
