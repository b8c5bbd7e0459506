"""`conetl map list|create|rename|delete|restore`: the maps of a database."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from conetl.cli.console import Columns, JsonOption, answer, at_a_question, counted, print_json, print_records, say
from conetl.cli.database import open_map, require_maps
from conetl.db.connection import transaction
from conetl.db.map.archive import delete_map, list_maps, rename_map, restore_map
from conetl.db.map.map_store import find_map, insert_map
from conetl.geometry.geodesy import height_system_name, map_crs
from conetl.model.errors import InputError
from conetl.pipeline.database import open_maps
from conetl.pipeline.settings import read_settings, validated_map_name

_MAPS: Columns = {
    "map": "map_name",
    "CRS": lambda m: f"EPSG:{m['srid']}",
    "heights": lambda m: height_system_name(m["vertical_srid"]),
    "features": "feature_count",
    "changesets": "changeset_count",
    "base layers": "layer_count",
    "last change (UTC)": lambda m: m["last_committed_at"] and f"{m['last_committed_at']:%Y-%m-%d %H:%M}",
}

MapArgument = Annotated[str, typer.Argument(metavar="NAME", help="Name of the map.")]


def list_(as_json: JsonOption = False) -> None:
    """List the maps of the database."""
    with open_maps(require_maps(read_settings())) as conn:
        found = list_maps(conn)
    if as_json:
        print_json(found)
    elif found:
        print_records("", _MAPS, found, numbers_from=3)
    else:
        say("This database contains no map yet: `conetl ingest DRIVE` or `conetl map create` creates one.")


def create(
    name: MapArgument,
    crs: Annotated[
        str,
        typer.Option(
            help="Projected CRS in metres, e.g. EPSG:25832; with a height system: EPSG:25832+7837 (see below)."
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Create an empty map. This is optional: the first drive creates its map, in its UTM zone.

    Heights are stored as ellipsoidal heights. The part after + names the height system that exports use.
    """
    settings = read_settings(name)
    srid, vertical_srid = map_crs(crs)
    with open_maps(settings) as conn, transaction(conn, f"The map {name} was not created"):
        if find_map(conn, name) is not None:
            raise InputError(f"a map named {name} already exists: choose another name (`conetl map list` lists all)")
        insert_map(conn, name, srid, vertical_srid=vertical_srid)
    facts = {"map": name, "srid": srid, "vertical_srid": vertical_srid}
    text = (
        f"Map {name}: EPSG:{srid}, heights {height_system_name(vertical_srid)}. Next: conetl ingest --map {name} DRIVE"
    )
    answer(as_json, facts, text)


def rename(
    name: MapArgument,
    new_name: Annotated[str, typer.Argument(metavar="NEW", help="Its new name: a-z, 0-9, _ and -.")],
    as_json: JsonOption = False,
) -> None:
    """Rename a map. Its history, decisions, receipts and reports are kept."""
    settings = read_settings(name)
    reports, target = settings.reports_folder, settings.reports_folder.with_name(validated_map_name(new_name))
    with open_map(name) as (conn, _):
        if target.exists() and find_map(conn, new_name) is None:
            raise InputError(f"{target}: contains reports of an earlier map {new_name}; move them away first")
        rename_map(conn, name, new_name)
    if reports.is_dir():
        reports.rename(target)
    answer(as_json, {"map": new_name, "was": name}, f"Renamed the map {name} to {new_name}.")


def delete(
    name: MapArgument,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")] = False,
    dump: Annotated[
        Path | None, typer.Option(help="File for the dump; default: dumps/NAME-TIME.zip in CONETL_HOME.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Delete a map with its history. A dump is written first, from which `conetl map restore` can restore it.

    Drive folders and reports are not affected.
    """
    settings = read_settings(name)
    path = dump or settings.home / "dumps" / f"{settings.map_name}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.zip"
    if path.exists():
        raise InputError(f"{path}: already exists; choose another file with --dump")
    with open_map(name) as (conn, _):
        size = next(one for one in list_maps(conn) if one["map_name"] == name)
        text = f"map {name} with {counted(size['feature_count'], 'feature')} and {counted(size['changeset_count'], 'changeset')}"
        if not yes:
            if as_json or not sys.stdin.isatty():
                raise InputError(f"nothing was deleted: add --yes to delete the {text} (a dump is written first)")
            with at_a_question():
                agreed = typer.confirm(f"Delete the {text}? A dump will be written to {path}.")
            if not agreed:
                say("Nothing was deleted.")
                return
        rows = delete_map(conn, name, path)
    facts = {"map": name, "dump": str(path), "bytes": path.stat().st_size, "rows": rows}
    answer(as_json, facts, f"Deleted the {text}. To restore it: conetl map restore {path}")


def restore(
    file: Annotated[Path, typer.Argument(help="File that `conetl map delete` wrote.")],
    name: Annotated[
        str | None, typer.Option("--map", metavar="NAME", help="Another name for the map; default: its own.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Restore a deleted map with its whole history, in this or another database with the same schema."""
    settings = read_settings()
    with open_maps(settings) as conn:
        info = restore_map(conn, file, None if name is None else validated_map_name(name))
        size = next(one for one in list_maps(conn) if one["map_name"] == info.map_name)
    text = f"Map {info.map_name}: {counted(size['feature_count'], 'feature')}, {counted(size['changeset_count'], 'changeset')}."
    answer(
        as_json, {"map": info.map_name, "features": size["feature_count"], "changesets": size["changeset_count"]}, text
    )
