"""`conetl drive held|accept`: drives on hold, whose recordings contradict themselves."""

from __future__ import annotations

from typing import Annotated

import typer

from conetl.cli.console import Columns, JsonOption, print_json, print_records, say
from conetl.cli.database import open_map
from conetl.cli.map.decisions import By, Note, print_outcome, who_decides
from conetl.db.map.map_store import list_changesets
from conetl.pipeline.settings import read_settings


def held(as_json: JsonOption = False) -> None:
    """List the drives on hold, and why."""
    settings = read_settings()
    with open_map(settings) as conn:
        found = [known for known in list_changesets(conn, map_name=settings.map_name) if known.hold is not None]
    if as_json:
        print_json(found)
        return
    columns: Columns = {"no": "changeset_no", "drive": "drive_id", "ingested (UTC)": "committed_at", "why": "hold"}
    print_records("", columns, found, numbers_from=len(columns))
    if not found:
        say("No drive is on hold.")


def accept(
    drive: Annotated[str, typer.Argument(help="Drive on hold: its id, or the number of its changeset.")],
    note: Note = "",
    by: By = None,
    as_json: JsonOption = False,
) -> None:
    """Let a drive on hold count as it is: it is compared with the map, and so are later drives over the same roads."""
    from conetl.pipeline.maps.decisions import accept_drive

    settings = read_settings()
    with open_map(settings) as conn:
        decided = accept_drive(conn, drive, map_name=settings.map_name, note=note, decided_by=who_decides(by))
    print_outcome(decided, as_json)
