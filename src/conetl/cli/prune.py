"""`conetl db prune`: delete old records and files."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

import typer

from conetl.cli.console import Columns, JsonOption, print_json, print_records, say
from conetl.cli.database import open_map
from conetl.db.retention import parse_age, prunable_drives, prune_drives
from conetl.files.atomic import sweep
from conetl.files.expiry import old_images, old_publications, old_results, remove, size_bytes
from conetl.model.errors import InputError
from conetl.pipeline.settings import read_settings

_COLUMNS: Columns = {
    "map": "map_name",
    "drive": "drive_id",
    "recorded until": lambda drive: f"{drive.captured_to:%Y-%m-%d %H:%M}",
    "detections": "detection_count",
    "matches": "match_count",
    "positions": "position_count",
}


def prune(
    keep_positions: Annotated[
        str | None,
        typer.Option(help="Keep the detections, stereo matches and positions of drives this long: 90d, 12w, 36h."),
    ] = None,
    keep_results: Annotated[str | None, typer.Option(help="Keep the files of intermediate results this long.")] = None,
    keep_pictures: Annotated[
        str | None, typer.Option("--keep-pictures", "--keep-images", help="Keep images unpacked from bags this long.")
    ] = None,
    keep_publications: Annotated[
        str | None, typer.Option(help="Keep published files this long; the latest are always kept.")
    ] = None,
    do_it: Annotated[bool, typer.Option("--yes", help="Delete. Without it only list what would be deleted.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Delete raw records and files older than given ages. Without --yes nothing is deleted.

    The map and its whole history are kept. A drive without its raw records cannot be compared with the map again: conetl then
    refuses earlier drives over the same road and decisions that affect its changes.
    """
    ages = {"results": keep_results, "pictures": keep_pictures, "publications": keep_publications}
    settings, now = read_settings(), datetime.now(UTC)
    since = {kind: now - timedelta(seconds=parse_age(age)) for kind, age in ages.items() if age is not None}
    if keep_positions is None and not since:
        raise InputError("nothing to prune: use for example --keep-positions 90d or --keep-results 30d (see --help)")
    done = "deleted" if do_it else "to delete"
    report: dict[str, Any] = {"deleted": do_it}
    if keep_positions is not None:
        before = now - timedelta(seconds=parse_age(keep_positions))
        with open_map(settings) as conn:
            drives = prunable_drives(conn, before)
            rows = sum(d.detection_count + d.match_count + d.position_count for d in drives)
            if do_it:
                rows = prune_drives(conn, drives, now=now)
        report |= {"drives": drives, "rows": rows}
        if not as_json:
            print_records("", _COLUMNS, drives, numbers_from=3)
            say(f"{done}: {rows} rows of {len(drives)} drives")
    find = {
        "results": (old_results, settings.results_folder),
        "pictures": (old_images, settings.images_folder),
        "publications": (old_publications, settings.exports_folder),
    }
    for kind, before in since.items():
        old, folder = find[kind]
        paths = old(folder, before)
        report[kind] = {"count": len(paths), "bytes": remove(paths) if do_it else size_bytes(paths)}
        if not as_json:
            say(f"{done}: {len(paths)} {kind}, {report[kind]['bytes'] / 1e6:.1f} MB")
    if do_it:
        sweep((settings.results_folder, settings.exports_folder))
    if as_json:
        print_json(report)
    elif not do_it:
        say("Nothing was deleted: add --yes to delete.")
