"""`conetl drive held|accept`: drives on hold, which contradict themselves or the map."""

from __future__ import annotations

from typing import Annotated

import typer

from conetl.cli.console import JsonOption, MapOption, print_held, print_json, say
from conetl.cli.database import open_map
from conetl.cli.map.decisions import By, Note, finish, who_decides
from conetl.db.map.hold_store import held_drives
from conetl.db.map.map_store import list_changesets


def held(map_name: MapOption = None, as_json: JsonOption = False) -> None:
    """List the drives on hold, and why."""
    with open_map(map_name) as (conn, info):
        found = held_drives(conn, map_name=info.map_name)
        known = {one.changeset_id: one for one in list_changesets(conn, map_name=info.map_name)}
    if as_json:
        print_json([vars(known[one.changeset_id]) | one.model_dump(mode="json") for one in found])
        return
    print_held(found)
    if not found:
        say("No drive is on hold.")


def accept(
    drive: Annotated[str, typer.Argument(help="Drive on hold: its id, or the number of its changeset.")],
    note: Note = "",
    by: By = None,
    map_name: MapOption = None,
    as_json: JsonOption = False,
) -> None:
    """Let a drive on hold count as it is: it is compared with the map, and so are later drives over the same roads."""
    from conetl.pipeline.maps.decisions import accept_drive

    with open_map(map_name) as (conn, info):
        decided = accept_drive(conn, drive, map_name=info.map_name, note=note, decided_by=who_decides(by))
        finish(conn, decided, info.map_name, as_json)
