"""`conetl db`: the database that holds the maps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

import typer

from conetl.cli.console import Columns, JsonOption, MapOption, answer, print_json, print_records, print_table, say
from conetl.db.cluster.cluster import cluster_down, cluster_status, cluster_up
from conetl.db.connection import Connection, connect
from conetl.db.map.map_store import require_map
from conetl.db.map.results import MapInfo
from conetl.db.retention import archive_drive, parse_age, prunable_drives, prune_drives, restore_drives
from conetl.db.schema import database_status, run_audits
from conetl.db.schema import migrate as apply_migrations
from conetl.files.atomic import old_images, old_publications, old_results, remove, remove_leftovers, size_bytes
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.pipeline.database import open_database, open_maps
from conetl.pipeline.settings import Settings, read_settings


@contextmanager
def open_map(map_name: str | None) -> Iterator[tuple[Connection, MapInfo]]:
    """A connection to the database, and the map of this name, or of the settings. Raises InputError, with the nearest names."""
    settings = read_settings(map_name)
    with open_maps(require_maps(settings)) as conn:
        yield conn, require_map(conn, settings.map_name)


def require_maps(settings: Settings) -> Settings:
    """The same settings, for a command that only reads. Raises InputError.

    No cluster is made for it: where there is none, the current folder is probably another one than that of the ingest.
    """
    if not settings.database_url and cluster_status(settings.home).state == "absent":
        raise InputError(
            f"{settings.home.absolute()}: contains no maps. They are in `.conetl` of the folder in which `conetl ingest` ran: "
            "change to that folder, or set CONETL_HOME; a new map begins with `conetl ingest DRIVE`"
        )
    return settings


def up(as_json: JsonOption = False) -> None:
    """Start the private PostGIS cluster. Creates it if necessary and migrates its schema."""
    settings = read_settings()
    if settings.database_url:
        say("CONETL_DATABASE_URL is set: conetl uses that database, so there is no private cluster to start.")
        return
    url = cluster_up(settings.home)
    with closing(connect(url)) as conn:
        applied = apply_migrations(conn)
    answer(as_json, {"url": url, "migrations_applied": list(applied)}, f"PostGIS is running: psql '{url}'")


def down(as_json: JsonOption = False) -> None:
    """Stop the private PostGIS cluster. Its data are kept."""
    stopped = cluster_down(read_settings().home)
    answer(as_json, {"stopped": stopped}, "PostGIS is stopped." if stopped else "PostGIS was not running.")


def status(as_json: JsonOption = False) -> None:
    """Show the state of the cluster, the schema, the roles and the maps."""
    settings = read_settings()
    cluster = None if settings.database_url else cluster_status(settings.home)
    database = None
    if cluster is None or cluster.state == "running":
        with closing(open_database(settings)) as conn:
            database = database_status(conn)
    if as_json:
        print_json({"cluster": cluster, "database": database})
        return
    values = {f"cluster {name}": value for name, value in asdict(cluster).items()} if cluster else {}
    values |= database or {}
    if database is not None:
        *_, last = database["applied_migrations"] or ("none",)
        values["applied_migrations"] = f"{len(database['applied_migrations'])}, the last {last}"
    rows = [(name.replace("_", " "), _text(value)) for name, value in values.items()]
    print_table("", ("property", "value"), rows, numbers_from=2)


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(" EPSG:".join(map(str, v)) if isinstance(v, tuple) else str(v) for v in value) or "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "none" if value is None else str(value)


def migrate(as_json: JsonOption = False) -> None:
    """Migrate the schema to the latest version. This cannot be undone."""
    with closing(open_database(read_settings())) as conn:
        applied = list(apply_migrations(conn))
    answer(
        as_json,
        {"migrations_applied": applied},
        f"Applied: {', '.join(applied)}." if applied else "The schema is up to date.",
    )


def audit(as_json: JsonOption = False) -> None:
    """Check the consistency of the maps. Exit code 1: a check found inconsistent rows."""
    with closing(open_database(require_maps(read_settings()))) as conn:
        results = run_audits(conn)
    if as_json:
        print_json(results)
    else:
        columns: Columns = {
            "check": "name",
            "result": lambda r: f"{r.row_count} rows" if r.rows else "passed",
            "seconds": lambda r: f"{r.seconds:.1f}",
        }
        print_records("", columns, results, numbers_from=2)
        for result in results:
            for row in result.rows[:10]:
                say(f"{result.name}: {row}")
    if any(result.rows for result in results):
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


_KeepPositions = Annotated[
    str | None,
    typer.Option(
        "--keep-positions",
        help="Keep the detections, stereo matches and positions of drives this long: 90d, 12w, 36h.",
    ),
]
_Yes = Annotated[bool, typer.Option("--yes", help="Do it; without it, only list what would be done.")]
_PRUNABLE: Columns = {
    "map": "map_name",
    "drive": "drive_id",
    "recorded until": lambda drive: f"{drive.captured_to:%Y-%m-%d %H:%M}",
    "detections": "detection_count",
    "matches": "match_count",
    "positions": "position_count",
}


def archive(
    keep_positions: _KeepPositions = None,
    folder: Annotated[
        Path | None, typer.Option("--to", help="Folder for the files; default: `archive` in CONETL_HOME.")
    ] = None,
    restore: Annotated[
        str | None, typer.Option(help="Move the records of this drive back into the tables.", metavar="DRIVE_ID")
    ] = None,
    do_it: _Yes = False,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Move raw records of old drives from the database to Parquet files. Without --yes it only lists them.

    The map and its history are not affected. conetl reads the files back into the tables when a late drive over the same
    road or a decision needs them, so do not move or delete them.
    """
    if (keep_positions is None) == (restore is None):
        raise InputError("give either an age (--keep-positions 90d) or a drive to restore (--restore DRIVE_ID)")
    settings = read_settings(map_name)
    if restore is not None:
        with open_map(map_name) as (conn, _):
            restored = restore_drives(conn, settings.map_name, restore)
        if not restored:
            raise InputError(f"the map {settings.map_name} has no archived drive {restore}: see `conetl map log`")
        answer(as_json, {"restored": restored}, f"Drives restored: {len(restored)}.")
        return
    to = folder or settings.home / "archive"
    before = datetime.now(UTC) - timedelta(seconds=parse_age(keep_positions or ""))
    with open_maps(require_maps(settings)) as conn:
        drives = prunable_drives(conn, before)
        sizes = [archive_drive(conn, drive, to) for drive in drives] if do_it else []
    if do_it:  # without those that another process archived meanwhile
        drives = [drive for drive, size in zip(drives, sizes, strict=True) if size]
    size = sum(sizes) if do_it else None
    if as_json:
        print_json({"archived": do_it, "drives": drives, "folder": to, "bytes": size})
        return
    print_records("", _PRUNABLE, drives, numbers_from=3)
    say(
        f"{len(drives)} drives "
        + (f"moved to {to}: {(size or 0) / 1e6:.1f} MB" if do_it else "to move: add --yes to move them.")
    )


def prune(
    keep_positions: _KeepPositions = None,
    keep_results: Annotated[str | None, typer.Option(help="Keep files of intermediate results this long.")] = None,
    keep_pictures: Annotated[
        str | None, typer.Option("--keep-images", "--keep-pictures", help="Keep images unpacked from bags this long.")
    ] = None,
    keep_publications: Annotated[
        str | None, typer.Option(help="Keep published files this long; the latest publication is always kept.")
    ] = None,
    do_it: _Yes = False,
    as_json: JsonOption = False,
) -> None:
    """Delete raw records and files older than the given ages. Without --yes it only lists them.

    The map and its history are not affected. conetl cannot compare a drive with the map again without its raw records, so it will
    refuse older drives over the same road, and decisions that affect its changes.
    """
    ages = {"results": keep_results, "pictures": keep_pictures, "publications": keep_publications}
    settings, now = read_settings(), datetime.now(UTC)
    since = {kind: now - timedelta(seconds=parse_age(age)) for kind, age in ages.items() if age is not None}
    if keep_positions is None and not since:
        raise InputError("give at least one age, for example --keep-positions 90d or --keep-results 30d")
    done = "deleted" if do_it else "to delete"
    report: dict[str, Any] = {"deleted": do_it}
    if keep_positions is not None:
        before = now - timedelta(seconds=parse_age(keep_positions))
        with open_maps(require_maps(settings)) as conn:
            drives = prunable_drives(conn, before)
            rows = sum(d.detection_count + d.match_count + d.position_count for d in drives)
            if do_it:
                rows = prune_drives(conn, drives)
        report |= {"drives": drives, "rows": rows}
        if not as_json:
            print_records("", _PRUNABLE, drives, numbers_from=3)
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
        remove_leftovers((settings.results_folder, settings.exports_folder))
    if as_json:
        print_json(report)
    elif not do_it:
        say("Nothing was deleted: add --yes to delete.")
