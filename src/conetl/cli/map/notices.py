"""`conetl zones notify|undelivered`: tell other systems about work zones, and list what they could not be told."""

from __future__ import annotations

from typing import Annotated

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.db.map import notice_store as store
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.pipeline.maps.notices import receivers_of, tell_about_zones
from conetl.pipeline.settings import read_settings


def notify(
    again: Annotated[bool, typer.Option("--again", help="Also what was given up.")] = False,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Tell the receivers of CONETL_WEBHOOKS which work zones began, changed or ended, and how they differ from plans.

    Schedules do the same every 5 minutes. Exit code 1: a receiver could not be told; it is tried again later.
    """
    from flows.notices import send_event  # Prefect takes a second to load

    with open_map(map_name) as (conn, info):
        receivers = receivers_of(read_settings(info.map_name), send_event)
        if not receivers:
            raise InputError("CONETL_WEBHOOKS is not set: it names the addresses to be told, separated by commas")
        if again:
            store.try_again(conn, info.map_id)
        told = tell_about_zones(conn, receivers, map_name=info.map_name)
    text = f"{ui.counted(told.recorded, 'new notice')} of map {info.map_name}; {told.delivered} delivered, {told.failed} failed"
    ui.answer(as_json, told._asdict(), text)
    if told.failed:
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def undelivered(map_name: ui.MapOption = None, as_json: ui.JsonOption = False) -> None:
    """List the notices that receivers could not be told, with the reason and the next attempt."""
    with open_map(map_name) as (conn, info):
        rows = store.undelivered(conn, info.map_name)
    if as_json:
        ui.print_json(rows)
        return
    columns: ui.Columns = {
        "no": "notice_no", "receiver": "receiver", "notice": lambda row: f"{row['topic']}.{row['event']}",
        "attempts": "attempts", "next attempt (UTC)": lambda row: row["next_at"] or "given up", "problem": "problem",
    }  # fmt: skip
    ui.print_records("", columns, rows)
    ui.say(f"{ui.counted(len(rows), 'undelivered notice')} of map {info.map_name}")
